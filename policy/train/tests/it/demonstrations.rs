//! Demonstrations: made, interrupted, damaged, verified, read.

use std::collections::BTreeMap;
use std::path::Path;

use safetensors::SafeTensors;
use serde_json::Value;

use super::palpate_train;
use super::policies::{printed, train, zeroed};

const MANIFEST: &str = "manifest.json";

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry"));
    let file = |entry: std::fs::DirEntry| {
        (entry.file_name().into_string().expect("a name"), std::fs::read(entry.path()).expect("a file"))
    };
    entries.map(file).collect()
}

#[test]
fn demonstrations_survive_an_interruption_and_tell_when_they_were_altered() {
    let folder = tempfile::tempdir().expect("a folder");
    train(folder.path());
    let bytes = std::fs::read(folder.path().join("run/checkpoint.safetensors")).expect("a checkpoint");
    let policy = folder.path().join("still.safetensors");
    std::fs::write(&policy, zeroed(&bytes, 0.0)).expect("a file");
    let policy = policy.to_str().expect("a path");
    let call = |out: &Path, more: &[&str]| -> Vec<String> {
        let fixed = ["demos", "--policy", policy, "--count", "3", "--shard-demos", "2", "--start-cm", "2"];
        let out = ["--out", out.to_str().expect("a path")];
        [&fixed[..], &out, more].concat().into_iter().map(str::to_owned).collect()
    };
    let run = |out: &Path, more: &[&str]| {
        printed(&call(out, more).iter().map(String::as_str).collect::<Vec<_>>());
    };
    let refused = |out: &Path, more: &[&str]| {
        let output = palpate_train(&call(out, more).iter().map(String::as_str).collect::<Vec<_>>());
        assert!(!output.status.success(), "{more:?} must be refused");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };

    let whole = folder.path().join("whole");
    run(&whole, &["--threads", "1"]);
    let expected = files(&whole);
    assert_eq!(expected.len(), 3, "{:?}", expected.keys());

    // Killed when the second file was under way.
    let parts = folder.path().join("parts");
    std::fs::create_dir(&parts).expect("a folder");
    let mut manifest: Value = serde_json::from_slice(&expected[MANIFEST]).expect("JSON");
    let first = manifest["files"][0].clone();
    manifest["files"] = vec![first.clone()].into();
    let name = first["file"].as_str().expect("a name").to_owned();
    std::fs::write(parts.join(MANIFEST), manifest.to_string()).expect("a file");
    std::fs::write(parts.join(&name), &expected[&name]).expect("a file");
    std::fs::write(parts.join("shard-00001.safetensors.partial"), b"half a fi").expect("a file");
    run(&parts, &["--threads", "3"]);
    assert!(files(&parts) == expected, "other files");

    let said = refused(&parts, &["--seed", "7"]);
    assert!(said.contains("seed is 1, this call's is 7"), "{said}");
    let mut damaged = expected[&name].clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    std::fs::write(parts.join(&name), damaged).expect("a file");
    let said = refused(&parts, &[]);
    assert!(said.contains(&name) && said.contains("does not match the SHA-256"), "{said}");

    let out = printed(&call(&whole, &["--verify"]).iter().map(String::as_str).collect::<Vec<_>>());
    assert!(out.contains("3 of 3 demonstrations succeed again, 3 with the same bits"), "{out}");
    increments_lead_from_command_to_command(&expected, &name);
}

/// In the file called `name`, for every step but the last of a demonstration.
fn increments_lead_from_command_to_command(files: &BTreeMap<String, Vec<u8>>, name: &str) {
    let manifest: Value = serde_json::from_slice(&files[MANIFEST]).expect("JSON");
    let tensors = manifest["tensors"].as_array().expect("tensors");
    let of = |name: &str| tensors.iter().find(|tensor| tensor["name"] == name).expect("a tensor");
    let segments = of("actor_observations")["segments"].as_array().expect("segments");
    let commands = segments.iter().find(|segment| segment["name"] == "commands").expect("commands");
    let first = commands["first"].as_u64().expect("a column") as usize;

    let bytes = zstd::decode_all(&files[name][..]).expect("zstd");
    let file = SafeTensors::deserialize(&bytes).expect("safetensors");
    let rows = |name: &str| -> Vec<Vec<f32>> {
        let view = file.tensor(name).expect("a tensor");
        let numbers = view.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
        numbers.collect::<Vec<_>>().chunks(view.shape()[1]).map(<[f32]>::to_vec).collect()
    };
    let (observations, increments) = (rows("actor_observations"), rows("joint_increments"));
    assert_eq!(manifest["files"][0]["steps"], observations.len());
    let begins = file.tensor("first_steps").expect("a tensor");
    let begins: Vec<i64> =
        begins.data().as_chunks().0.iter().map(|bytes| i64::from_le_bytes(*bytes)).collect();
    let mut moved = 0;
    for step in (1..observations.len()).filter(|&step| !begins.contains(&(step as i64))) {
        for (joint, increment) in increments[step - 1].iter().enumerate() {
            let change = observations[step][first + joint] - observations[step - 1][first + joint];
            assert!((change - increment).abs() < 1e-6, "step {step}, joint {joint}: {change} {increment}");
            moved += usize::from(increment.abs() > 1e-3);
        }
    }
    assert!(moved > 100, "{moved} joints moved");
}
