//! Encoders: pretrained on demonstrations, interrupted, exported, refused.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::palpate_train;
use super::policies::{printed, train, zeroed};

const CONFIG: &str = "epochs = 2\nbatch_size = 8\ncheckpoint_updates = 3\nhistory = 4\nframe_stride = 4\n\
    held_out_share = 0.4\nhand_points = 16\nobject_points = 16\n\
    [network]\nwidth = 8\nheads = 2\nlayers = 1\nfeed_forward = 8\npoints_per_query = 8\n";

/// Two folders of two demonstrations each, of a policy that leaves the script alone; and the file of the configuration.
fn prepared(folder: &Path) -> [String; 3] {
    train(folder);
    let bytes = std::fs::read(folder.join("run/checkpoint.safetensors")).expect("a checkpoint");
    let policy = folder.join("still.safetensors");
    std::fs::write(&policy, zeroed(&bytes, 0.0)).expect("a file");
    let text = |path: &Path| path.to_str().expect("a path").to_owned();
    let demos = ["1", "2"].map(|seed| {
        let out = text(&folder.join(seed));
        let policy = text(&policy);
        let fixed = ["demos", "--policy", &policy, "--count", "2", "--start-cm", "1", "--seed", seed];
        printed(&[&fixed[..], &["--out", &out]].concat());
        out
    });
    let config = folder.join("encoder.toml");
    std::fs::write(&config, CONFIG).expect("a file");
    let [first, second] = demos;
    [first, second, text(&config)]
}

#[test]
fn an_encoder_learns_from_demonstrations_and_their_order_does_not_matter() {
    let folder = tempfile::tempdir().expect("a folder");
    let [first, second, config] = prepared(folder.path());
    let out = |name: &str| -> PathBuf { folder.path().join(name) };
    let call = |demos: [&str; 2], name: &str, more: &[&str]| -> Vec<String> {
        let out = out(name);
        let fixed = ["encode", "--config", &config, "--out", out.to_str().expect("a path"), "--demos"];
        [&fixed[..], &demos, more].concat().into_iter().map(str::to_owned).collect()
    };
    let run = |demos: [&str; 2], name: &str, more: &[&str]| -> Value {
        let call = call(demos, name, more);
        let said = printed(&call.iter().map(String::as_str).collect::<Vec<_>>());
        serde_json::from_str(&said).expect("a report")
    };
    let refused = |demos: [&str; 2], name: &str, more: &[&str]| -> String {
        let call = call(demos, name, more);
        let output = palpate_train(&call.iter().map(String::as_str).collect::<Vec<_>>());
        assert!(!output.status.success(), "{more:?} must be refused");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };

    let report = run([&first, &second], "run_a", &["--json", "--threads", "1"]);
    assert!(report["updates"].as_u64() > Some(2), "{report}");
    for who in ["held_out", "mean_baseline"] {
        assert!(
            report[who]["samples"].as_u64() > Some(0) && report[who]["hand_chamfer_mm"].is_f64(),
            "{report}"
        );
    }
    run([&second, &first], "run_b", &["--json", "--threads", "3"]);
    let checkpoint =
        |name: &str| std::fs::read(out(name).join("checkpoint.safetensors")).expect("a checkpoint");
    assert!(checkpoint("run_a") == checkpoint("run_b"), "other bits");
    // Scored again.
    assert_eq!(run([&first, &second], "run_a", &["--json", "--resume"]), report);

    let exported = out("encoder.safetensors");
    printed(&[
        "export",
        "--encoder",
        out("run_a").to_str().expect("a path"),
        "--out",
        exported.to_str().expect("a path"),
    ]);
    assert!(std::fs::read(&exported).expect("a file").len() < checkpoint("run_a").len() / 4);

    for (demos, name, more, expected) in [
        (
            [&*first, &*first],
            "new",
            &[][..],
            "both hold demonstrations of \"cube\" with the seed 1; leave one out",
        ),
        ([&*first, "no_such_folder"], "new", &[], "failed to read \"no_such_folder/manifest.json\""),
        (
            [&*first, &*second],
            "run_a",
            &[],
            "holds a checkpoint already: resume it, or choose another folder",
        ),
        (
            [&*first, &*second],
            "run_a",
            &["--resume", "--epochs", "3"],
            "epochs is 2, that of the configuration is 3",
        ),
        (
            [&*first, &*second],
            "run_a",
            &["--resume", "--silence-touch"],
            "inputs.touch is true, that of the configuration is false",
        ),
        (
            [&*first, &*second],
            "new",
            &["--silence-touch", "--without-positions"],
            "has nothing to learn from",
        ),
    ] {
        let said = refused(demos, name, more);
        assert!(said.contains(expected), "{more:?}: {said}");
    }
    let shard = Path::new(&second).join("shard-00000.safetensors.zst");
    let mut bytes = std::fs::read(&shard).expect("a file");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&shard, bytes).expect("a file");
    let said = refused([&first, &second], "new", &[]);
    assert!(said.contains("shard-00000") && said.contains("does not match the SHA-256"), "{said}");
    let manifest = Path::new(&first).join("manifest.json");
    let text = std::fs::read_to_string(&manifest).expect("a manifest");
    let mut changed: Value = serde_json::from_str(&text).expect("JSON");
    let sources = changed["sources"].as_array_mut().expect("sources");
    let object = sources.iter_mut().find(|source| source["role"] == "object").expect("an object");
    object["sha256"] = "0".into();
    std::fs::write(&manifest, changed.to_string()).expect("a file");
    let said = refused([&first, &second], "new", &[]);
    assert!(said.contains("cube.toml") && said.contains("it is another file than when"), "{said}");
}
