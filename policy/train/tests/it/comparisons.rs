//! Comparisons under a protocol, and the searching expert.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::palpate_train;
use super::policies::{printed, train, zeroed};

#[test]
fn what_is_wrong_with_a_comparison_is_named_before_anything_starts() {
    for (args, expected) in [
        (
            &["--protocol", "wild"][..],
            "--protocol is \"wild\", which is no file and no protocol in assets/grasp/protocols: claim, paper",
        ),
        (&["--controls"], "--protocol"),
        (&["--protocol", "wide", "--start-cm", "5"], "--start-cm and --protocol exclude each other"),
        (&["--protocol", "wide", "--objects", "cube,cube"], "--objects names \"cube\" twice"),
        (&["--protocol", "wide", "--objects", "cueb"], "which is no file and no object"),
        (&["--protocol", "wide", "--trials", "0"], "--trials is 0"),
        (&["--protocol", "wide", "--beside", "oracle", "--beside", "oracle"], "\"oracle\" is compared twice"),
        (&["--protocol", "wide", "--out", "no_such_folder/a.json"], "there is no folder \"no_such_folder\""),
        (
            &["--protocol", "wide", "--closings", "no_such_file"],
            "`palpate-train closings --out` makes such a file",
        ),
        (&["--protocol", "wide", "--closings", "Cargo.toml"], "holds no closings that can be used"),
    ] {
        let output = palpate_train(&[&["evaluate", "--policy", "search"], args].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains(expected), "{args:?}: {said}");
    }
    let output = palpate_train(&["closings", "--count", "0"]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("--count is 0"));
}

#[test]
fn a_policy_of_zeros_is_paired_with_the_script_start_by_start() {
    let folder = tempfile::tempdir().expect("a folder");
    train(folder.path());
    let bytes = std::fs::read(folder.path().join("run/checkpoint.safetensors")).expect("a checkpoint");
    std::fs::write(folder.path().join("cube.safetensors"), zeroed(&bytes, 0.0)).expect("a file");
    let policy = folder.path().join("{object}.safetensors");
    let report: Value = serde_json::from_str(&printed(&[
        "evaluate",
        "--policy",
        policy.to_str().expect("a path"),
        "--protocol",
        "wide",
        "--trials",
        "6",
        "--beside",
        "script",
        "--json",
    ]))
    .expect("a report");
    assert_eq!((&report["protocol"], &report["overall"]["trials"]), (&"wide".into(), &6.into()));
    let script = &report["controls"]["script"];
    assert_eq!(report["overall"], script["overall"]);
    assert_eq!(
        script["paired"]["overall"],
        serde_json::json!({"only_policy": 0, "only_control": 0, "p_value": 1.0})
    );
    assert!(report["unseen"].is_null() && report["seen"] == report["overall"]);
}

#[test]
fn a_search_is_compared_with_its_controls_and_has_the_same_bits_for_any_number_of_threads() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("a path").to_owned();
    let closings = path("closings.safetensors");
    let make = |out: &str, threads: &str| {
        printed(&[
            "closings",
            "--objects",
            "cube",
            "--count",
            "24",
            "--window-cm",
            "8",
            "--seed",
            "3",
            "--out",
            out,
            "--threads",
            threads,
        ])
    };
    make(&closings, "1");
    let again = path("again.safetensors");
    make(&again, "3");
    assert_eq!(std::fs::read(&closings).expect("a file"), std::fs::read(&again).expect("a file"));
    let kept = path("kept");
    let call = |objects: &str, seed: &str, out: &str, more: &[&str]| {
        let args = [
            "evaluate",
            "--policy",
            "search",
            "--protocol",
            "claim",
            "--objects",
            objects,
            "--trials",
            "3",
            "--seed",
            seed,
            "--controls",
            "--beside",
            "search:touch",
            "--closings",
            &closings,
            "--out",
            out,
        ];
        palpate_train(&[&args, more].concat())
    };
    let run = |objects: &str, out: &str, more: &[&str]| -> (Value, String) {
        let output = call(objects, "9", out, more);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{said}");
        let text = std::fs::read_to_string(Path::new(out)).expect("a file");
        (serde_json::from_str(&text).expect("a report"), said)
    };
    let (mut one, _) = run("cube,ring", &path("one.json"), &["--threads", "1"]);
    // In two calls, each of which keeps its trials.
    let shown = path("pictures");
    let by_object = ["--threads", "3", "--by-object", &kept, "--pictures", &shown];
    let (ring, _) = run("ring", &path("ring.json"), &by_object);
    let pictures = || {
        let entries = std::fs::read_dir(&shown).expect("a folder");
        let read = |path: PathBuf| (path.clone(), std::fs::read_to_string(path).expect("a picture"));
        entries.map(|entry| read(entry.expect("an entry").path())).collect::<BTreeMap<_, _>>()
    };
    let of_ring = pictures();
    for (path, picture) in &of_ring {
        let name = path.file_stem().expect("a name").to_string_lossy();
        assert!(name.starts_with("ring_") && picture.starts_with("<svg"), "{name}");
        // What a searching expert believed before its first try is what it began with.
        assert!(picture.contains("believed at 0.0 s") && picture.contains("class=\"believed\""), "{name}");
        let verdict = if name.contains("_won_") { ": won" } else { ": lost" };
        assert!(picture.contains(verdict), "{name}");
    }
    assert_eq!(ring["trials"]["ring"], one["trials"]["ring"]);
    let (mut other, said) = run("cube,ring", &path("other.json"), &by_object);
    assert!(said.contains("ring: 3 trials are there already") && !said.contains("cube: 3"), "{said}");
    let both = pictures();
    assert!(
        both.len() > of_ring.len() && of_ring.iter().all(|(path, picture)| both.get(path) == Some(picture))
    );
    for report in [&mut one, &mut other] {
        report["seconds"] = Value::Null;
    }
    assert_eq!(one, other);
    for name in
        ["script", "repetition", "oracle", "silenced", "tracking_hidden", "clock_only", "search:touch"]
    {
        let control = &one["controls"][name];
        assert_eq!(control["overall"]["trials"], 6, "{name}");
        assert_eq!(control["trials"]["ring"].as_array().map(Vec::len), Some(3), "{name}");
        let paired = &control["paired"]["overall"];
        let won = |report: &Value| report["overall"]["successes"].as_i64().expect("a number");
        let only = |who: &str| paired[who].as_i64().expect("a number");
        assert_eq!(won(&one) - won(control), only("only_policy") - only("only_control"), "{name}");
    }
    assert_eq!((&one["seen"]["trials"], &one["unseen"]["trials"]), (&3.into(), &3.into()));
    let refused = call("ring", "8", &path("refused.json"), &by_object);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        !refused.status.success() && said.contains("3 starts of seed 9 within 8 cm, expected 3 of seed 8"),
        "{said}"
    );
    // Who has been told the place finds the cube.
    assert!(one["controls"]["oracle"]["objects"]["cube"]["successes"].as_i64() >= Some(2), "{one}");
}
