//! From a sensor model to scored policies, by one command.

use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;

/// Policies so small and so little trained that they know nothing.
const TINY: &str = "updates = 4\nbatch_size = 32\ncheckpoint_updates = 2\ntrunk = [16]\n\
    [observation]\nframes = 2\nstride = 4\n";

fn config(tiny: &Path, evaluated: u64) -> String {
    format!(
        "[closings]\nobjects = \"cube\"\ncount = 12\nseed = 3\n\
         [trials]\nobjects = \"cube\"\ncount = 4\nprotocol = \"wide\"\nseed = 101\n\
         [[policies]]\nname = \"tiny\"\nconfig = {tiny:?}\nseeds = [0, 1]\n\
         [[evaluations]]\nprotocol = \"wide\"\nobjects = \"cube,ring\"\ntrials = {evaluated}\n\
         [[evaluations]]\nprotocol = \"wide\"\nobjects = \"cube\"\ntrials = 1\ntruth = \"assets/truth/demo.toml\"\n"
    )
}

/// Runs the pipeline; gives what it said.
fn pipeline(args: &[&str]) -> Result<String, String> {
    let mut child = Command::new(env!("CARGO_BIN_EXE_palpate-train"))
        .arg("pipeline")
        .args(args)
        .current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("../.."))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the command starts");
    // With --events it ends when its input does.
    let _stdin = child.stdin.take();
    let output = child.wait_with_output().expect("it ends");
    let said =
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    if output.status.success() { Ok(said) } else { Err(said) }
}

#[test]
fn what_has_not_changed_is_not_made_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("a path").to_owned();
    let (file, out) = (path("pipeline.toml"), path("out"));
    std::fs::write(folder.path().join("tiny.toml"), TINY).expect("a file");
    let configure = |evaluated: u64| {
        std::fs::write(&file, config(&folder.path().join("tiny.toml"), evaluated)).expect("a file");
    };
    let bytes = |name: &str| std::fs::read(folder.path().join("out").join(name)).expect("a file");
    let call = ["--config", &file, "--out", &out];
    configure(2);
    let planned = pipeline(&[&call[..], &["--plan"]].concat()).expect("a plan");
    assert!(planned.contains("evaluation wide_demo") && planned.contains("min in all"), "{planned}");
    assert!(!Path::new(&out).exists(), "a plan does nothing");

    let said = pipeline(&[&call[..], &["--events"]].concat()).expect("it runs");
    let of_kind = |kind: &str| -> Vec<Value> {
        let events = said.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        events.filter(|event| event["event"] == kind).collect()
    };
    let report = &of_kind("report")[0]["report"];
    assert_eq!(report["evaluations"]["wide"]["tiny_1"]["overall"]["trials"], 4, "{report}");
    assert_eq!(report["evaluations"]["wide_demo"]["tiny_0"]["seen"]["trials"], 1, "{report}");
    assert!(of_kind("metrics").iter().any(|event| event["point"]["tiny_1.held_out_loss"].is_f64()), "{said}");
    let fractions: Vec<f64> =
        of_kind("progress").iter().filter_map(|event| event["fraction"].as_f64()).collect();
    assert!(
        !fractions.is_empty() && fractions.iter().all(|share| (0.0..=1.0).contains(share)),
        "{fractions:?}"
    );
    assert_eq!(report["policy"], "policies/tiny_0/policy.safetensors");
    let page = String::from_utf8(bytes("report.html")).expect("text");
    for words in
        ["Evaluation wide_demo", "tiny_1", "palpate-train gather", "<polyline", "data:image/svg+xml;base64,"]
    {
        assert!(page.contains(words), "the page does not say {words:?}");
    }

    let made = ["closings.safetensors", "policies/tiny_1/policy.safetensors", "evaluations/wide_demo.json"];
    let before = made.map(bytes);
    let said = pipeline(&call).expect("it runs");
    assert_eq!(said.matches("it is left as it is").count(), 6, "{said}");

    // Another number of trials: that evaluation alone.
    configure(1);
    let said = pipeline(&call).expect("it runs");
    assert_eq!(said.matches("it is left as it is").count(), 5, "{said}");
    assert!(said.contains("evaluation wide (5 of 6): palpate-train evaluate"), "{said}");

    // A policy that was altered is learned again, to the same bits, so what is made of it stays.
    std::fs::write(Path::new(&out).join(made[1]), "altered").expect("a file");
    let said = pipeline(&call).expect("it runs");
    assert_eq!(said.matches("it is left as it is").count(), 5, "{said}");
    assert_eq!(made.map(bytes), before, "other bytes");
}

#[test]
fn an_expert_takes_over_in_rounds_and_policies_see_regions_of_several_protocols() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("a path").to_owned();
    let (file, out) = (path("pipeline.toml"), path("out"));
    std::fs::write(folder.path().join("tiny.toml"), TINY).expect("a file");
    let configure = |also: &str| {
        let text = format!(
            "[closings]\nobjects = \"cube\"\ncount = 12\nseed = 3\n\
             [trials]\nobjects = \"cube\"\ncount = 3\nprotocol = \"wide\"\nseed = 101\n{also}\
             [takeover]\nrounds = 1\ncount = 2\n\
             [[policies]]\nname = \"tiny\"\nconfig = {:?}\nregion = true\nseeds = [0]\n\
             [[evaluations]]\nprotocol = \"wide\"\nobjects = \"cube\"\ntrials = 1\n",
            path("tiny.toml")
        );
        std::fs::write(&file, text).expect("a file");
    };
    let call = ["--config", &file, "--out", &out, "--events"];
    configure("");
    let said = pipeline(&call).expect_err("one region");
    assert!(said.contains("sees the region, but all trials are of one region"), "{said}");
    configure("[[trials.also]]\nprotocol = \"paper\"\nexpert = \"repetition\"\n");
    let said = pipeline(&call).expect("it runs");
    for stage in ["trials_2", "takeover_1", "tiny_0_round1"] {
        assert!(said.contains(stage), "{stage}: {said}");
    }
    let report: Value = said
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .find(|event| event["event"] == "report")
        .expect("a report");
    let of_student = &report["report"]["evaluations"]["wide"]["tiny_0_round1"];
    assert_eq!(of_student["overall"]["trials"], 1, "{report}");
}

/// An encoder as small.
const TINY_ENCODER: &str = "epochs = 1\nbatch_size = 8\nhistory = 3\nframe_stride = 8\nheld_out_share = 0.4\n\
    hand_points = 8\nobject_points = 8\n\
    [network]\nwidth = 6\nheads = 2\nlayers = 1\nfeed_forward = 8\npoints_per_query = 8\n";

#[test]
fn policies_may_see_the_features_of_an_encoder_that_is_a_stage() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("a path").to_owned();
    let (file, out) = (path("pipeline.toml"), path("out"));
    std::fs::write(path("tiny.toml"), TINY).expect("a file");
    std::fs::write(path("encoder.toml"), TINY_ENCODER).expect("a file");
    let (tiny, encoder) = (path("tiny.toml"), path("encoder.toml"));
    let policy = |name: &str, more: &str| {
        format!("[[policies]]\nname = {name:?}\nconfig = {tiny:?}\nseeds = [0]\n{more}")
    };
    let text = format!(
        "[closings]\nobjects = \"cube\"\ncount = 12\nseed = 3\n\
         [trials]\nobjects = \"cube\"\ncount = 4\nprotocol = \"wide\"\nseed = 101\n\
         [encoder]\nconfig = {encoder:?}\nseed = 0\n{}{}\
         [[evaluations]]\nprotocol = \"wide\"\nobjects = \"cube\"\ntrials = 1\n",
        policy("plain", "policy = \"kinematic-dp\"\n"),
        policy("feeling", "policy = \"pretrained-dp\"\n"),
    );
    std::fs::write(&file, text).expect("a file");
    let call = ["--config", &file, "--out", &out];
    let planned = pipeline(&[&call[..], &["--plan"]].concat()).expect("a plan");
    let line = planned.lines().find(|line| line.starts_with("encoder ")).expect("its line");
    assert!(line.contains("palpate-train encode"), "{planned}");
    let line = planned.lines().find(|line| line.starts_with("feeling_0 ")).expect("its line");
    assert!(line.contains("--policy pretrained-dp") && line.contains("--encoder"), "{planned}");
    let said = pipeline(&[&call[..], &["--events"]].concat()).expect("it runs");
    let mut events = said.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let report = events.rfind(|event| event["event"] == "report").expect("a report");
    let encoder = &report["report"]["encoder"];
    assert_eq!(encoder["seen_by"], serde_json::json!(["feeling_0"]), "{report}");
    assert!(encoder["held_out"]["total"].is_f64(), "{report}");
    let page = std::fs::read_to_string(Path::new(&out).join("report.html")).expect("text");
    assert!(page.contains("<h2>Encoder</h2>") && page.contains("palpate-train encode"));
    // Two policies of the paper that differ in one part, on one object and with one seed.
    let parts = &report["report"]["parts"]["wide"];
    assert_eq!(
        (parts[0]["part"].as_str(), parts[0]["units"].as_u64()),
        (Some("encoder, pretrained"), Some(1)),
        "{report}"
    );
    assert_eq!(parts[0]["paper_percent"], serde_json::json!([60.4, 36.2]), "{report}");
    assert!(page.contains("What each part is worth") && page.contains("one object and seed says nothing"));
    let said = pipeline(&call).expect("it runs");
    assert_eq!(said.matches("it is left as it is").count(), 6, "{said}");
}

#[test]
fn what_is_wrong_with_a_pipeline_is_named_before_anything_starts() {
    let folder = tempfile::tempdir().expect("a folder");
    let tiny = folder.path().join("tiny.toml");
    std::fs::write(&tiny, TINY).expect("a file");
    let file = folder.path().join("pipeline.toml").to_str().expect("a path").to_owned();
    let out = folder.path().join("out").to_str().expect("a path").to_owned();
    let whole = config(&tiny, 2);
    for (from, to, expected) in [
        ("count = 12", "count = 0", "closings.count is 0"),
        ("count = 12", "cuont = 12", "pipeline.toml:3: unknown field `cuont`"),
        ("objects = \"cube,ring\"", "objects = \"cueb\"", "objects of \"wide\" is \"cueb\""),
        ("seed = 101", "seed = 2", "the seed of the protocol \"wide\""),
        ("seeds = [0, 1]", "seeds = [1, 1]", "seeds of \"tiny\" are [1, 1]"),
        ("name = \"tiny\"", "name = \"../tiny\"", "the name is \"../tiny\""),
        ("truth = \"assets/truth/demo.toml\"", "", "\"wide\" is there twice"),
        ("assets/truth/demo.toml", "assets/truth/none.toml", "there is no such file"),
        ("protocol = \"wide\"\nseed", "protocol = \"wild\"\nseed", "trials.protocol"),
        ("seeds = [0, 1]", "seeds = [0, 1]\nfeatures = true", "there is no section [encoder]"),
        ("[[policies]]", "[encoder]\n[[policies]]", "encoder: no policy sees its features"),
        ("[[policies]]", "[encoder]\nepochs = 0\n[[policies]]", "epochs is 0, expected 1 or more"),
    ] {
        assert!(whole.contains(from), "{from}");
        std::fs::write(&file, whole.replacen(from, to, 1)).expect("a file");
        let said = pipeline(&["--config", &file, "--out", &out]).expect_err("it is refused");
        assert!(said.contains(expected), "{to}: {said}");
        assert!(!Path::new(&out).exists(), "{to}: something was begun");
    }
    for (args, expected) in [
        (&["--preset", "large", "--out", &out][..], "expected one of small, tables, paper"),
        (&["--model", "none.toml", "--out", &out], "--model is \"none.toml\""),
        (&[], "--out"),
    ] {
        let said = pipeline(args).expect_err("it is refused");
        assert!(said.contains(expected), "{args:?}: {said}");
    }
    // Presets are files that it takes.
    for preset in ["small", "tables", "paper"] {
        std::fs::write(&file, pipeline(&["--preset", preset, "--print-config"]).expect("a preset"))
            .expect("a file");
        pipeline(&["--config", &file, "--out", &out, "--plan"]).expect("a plan");
    }
    // What others have made is not removed.
    std::fs::create_dir_all(Path::new(&out).join("trials")).expect("a folder");
    std::fs::write(Path::new(&out).join("closings.safetensors"), "mine").expect("a file");
    std::fs::write(&file, &whole).expect("a file");
    let said = pipeline(&["--config", &file, "--out", &out]).expect_err("it is refused");
    assert!(said.contains("no pipeline made it"), "{said}");
    assert_eq!(std::fs::read(Path::new(&out).join("closings.safetensors")).expect("a file"), b"mine");
}
