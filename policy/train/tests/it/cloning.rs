//! What the searching expert does, kept, learned from and tried.

use std::path::{Path, PathBuf};

use palpate_wire::api::{EXPERTS, HEADS, MEMORIES, PAPER_POLICIES};
use serde_json::Value;

use super::palpate_train;
use super::policies::printed;

fn refused(args: &[&str]) -> String {
    let output = palpate_train(args);
    assert!(!output.status.success(), "{args:?} must be refused");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path")
}

/// A policy so small and so little trained that it knows nothing.
const CONFIG: &str = "updates = 4\nbatch_size = 32\ncheckpoint_updates = 2\ntrunk = [16]\nhead = \"diffusion\"\n\
    [observation]\nframes = 2\nstride = 4\n[diffusion]\nchannels = [4, 8]\nsteps = 8\nsampled_steps = 2\n";

/// The file of this configuration in `folder`.
fn small_training(folder: &Path) -> PathBuf {
    small_training_where(folder, "stride = 4")
}

/// The same, whose line on the stride is `observation`.
fn small_training_where(folder: &Path, observation: &str) -> PathBuf {
    let path = folder.join("tiny.toml");
    std::fs::write(&path, CONFIG.replace("stride = 4", observation)).expect("a file");
    path
}

/// What `policy` came to in `trials` trials on the cube under the protocol `wide`, but for how long that took.
fn on_the_cube(policy: &str, trials: &str, more: &[&str]) -> Value {
    let fixed = ["evaluate", "--protocol", "wide", "--object", "cube", "--json", "--policy", policy];
    let said = printed(&[&fixed[..], &["--trials", trials], more].concat());
    let mut compared: Value = serde_json::from_str(&said).expect("a comparison");
    compared["seconds"] = Value::Null;
    compared
}

/// The policy of the training in `folder`, as an evaluation names it.
fn policy_of(folder: &Path) -> String {
    format!("clone:{}", text(folder))
}

#[test]
fn an_expert_is_kept_learned_from_and_tried_again_to_the_same_bits() {
    let folder = tempfile::tempdir().expect("a folder");
    let gathered = folder.path().join("gathered");
    let gather = |out: &Path, more: &[&str]| -> Vec<String> {
        let fixed = ["gather", "--objects", "cube,ball", "--count", "3", "--json", "--out", text(out)];
        [&fixed[..], more].concat().into_iter().map(str::to_owned).collect()
    };
    let call = |args: &[String]| printed(&args.iter().map(String::as_str).collect::<Vec<_>>());
    let said = call(&gather(&gathered, &["--threads", "1"]));
    let lines: Vec<Value> = said.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!((&lines[0]["object"], &lines[1]["score"]["trials"]), (&"cube".into(), &3.into()));

    // What is there is not made again, and other threads make the same bytes.
    let cube = gathered.join("cube.safetensors.zst");
    let first = std::fs::read(&cube).expect("a file");
    assert_eq!(call(&gather(&gathered, &[])), "");
    std::fs::remove_file(&cube).expect("it is gone");
    call(&gather(&gathered, &["--threads", "2"]));
    assert!(std::fs::read(&cube).expect("a file") == first, "other bytes");
    let other = gather(&gathered, &["--seed", "7"]);
    let problem = refused(&other.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(problem.contains("cube.safetensors.zst") && problem.contains("another --out"), "{problem}");

    let config = small_training(folder.path());
    let out = folder.path().join("run");
    let clone =
        ["clone", "--data", text(&gathered), "--config", text(&config), "--json", "--out", text(&out)];
    let report: Value = serde_json::from_str(&printed(&clone)).expect("a report");
    assert_eq!(
        (&report["updates"], &report["episodes"], &report["held_out_episodes"]),
        (&4.into(), &5.into(), &1.into())
    );
    assert!(report["held_out_loss"].as_f64().is_some_and(|loss| loss > 0.0));
    assert!(refused(&clone).contains("checkpoint"), "a folder that holds a training is not written over");
    let data = text(&gathered);
    let twice = ["clone", "--data", data, data, "--out", text(&out), "--config", text(&config)];
    assert!(refused(&twice).contains("holds 3 trials on ball, protocol wide, seed 101 once more"));

    let policy = policy_of(&out);
    let evaluate = |threads: &str| on_the_cube(&policy, "2", &["--controls", "--threads", threads]);
    let compared = evaluate("1");
    assert_eq!(compared, evaluate("2"), "a trial draws the same chunks on any number of threads");
    assert_eq!(compared["controls"].as_object().map(serde_json::Map::len), Some(6), "{compared}");
}

/// An encoder as small.
const ENCODER: &str = "epochs = 1\nbatch_size = 8\ncheckpoint_updates = 50\nhistory = 3\nframe_stride = 8\n\
    held_out_share = 0.4\nhand_points = 8\nobject_points = 8\n\
    [network]\nwidth = 6\nheads = 2\nlayers = 1\nfeed_forward = 8\npoints_per_query = 8\n";

/// The file of gathered trials at `path` without this tensor, which earlier versions did not keep.
fn without(path: &Path, tensor: &str) -> Vec<u8> {
    let bytes = zstd::decode_all(&*std::fs::read(path).expect("a file")).expect("compressed");
    let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).expect("a header");
    let file = safetensors::SafeTensors::deserialize(&bytes).expect("tensors");
    let kept = file.tensors().into_iter().filter(|(name, _)| name != tensor);
    let bytes = safetensors::serialize(kept, header.metadata().clone()).expect("a file");
    zstd::encode_all(&*bytes, 3).expect("compressed")
}

#[test]
fn a_policy_takes_the_features_of_an_encoder_that_learned_from_the_same_trials() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let (gathered, encoder, exported) = (path("gathered"), path("encoder"), path("encoder.safetensors"));
    printed(&["gather", "--objects", "cube", "--count", "4", "--out", text(&gathered)]);
    let config = small_training_where(folder.path(), "stride = 4\nfeatures = true");
    let encoder_config = path("encoder.toml");
    std::fs::write(&encoder_config, ENCODER).expect("a file");
    let encode = ["encode", "--demos", text(&gathered), "--config", text(&encoder_config), "--json", "--out"];
    let pretrained: Value =
        serde_json::from_str(&printed(&[&encode[..], &[text(&encoder)]].concat())).expect("a report");
    assert!(pretrained["train_samples"].as_u64() > Some(8), "{pretrained}");
    assert!(pretrained["held_out"]["position_cm"].is_f64(), "{pretrained}");
    printed(&["export", "--encoder", text(&encoder), "--out", text(&exported)]);

    // The folder of a pretraining is as good as what is exported, and any number of threads.
    let clone = |out: &str, encoder: &Path, threads: &str, more: &[&str]| -> Vec<String> {
        let out = path(out);
        let fixed = ["clone", "--data", text(&gathered), "--config", text(&config), "--out", text(&out)];
        let given = ["--encoder", text(encoder), "--threads", threads];
        [&fixed[..], &given, more].concat().into_iter().map(str::to_owned).collect()
    };
    let call = |args: &[String]| printed(&args.iter().map(String::as_str).collect::<Vec<_>>());
    let refuse = |args: &[String]| refused(&args.iter().map(String::as_str).collect::<Vec<_>>());
    call(&clone("one", &encoder, "1", &[]));
    call(&clone("two", &exported, "2", &[]));
    let policy = |out: &str| std::fs::read(path(out).join("policy.safetensors")).expect("a policy");
    assert!(policy("one") == policy("two"), "other bits");
    let inside = std::fs::read(&exported).expect("a file");
    assert!(policy("one").windows(inside.len()).any(|window| window == inside), "it has the encoder inside");
    call(&clone("one", &exported, "1", &["--resume"]));

    let imitation = policy_of(&path("one"));
    let evaluate = |threads: &str| on_the_cube(&imitation, "2", &["--controls", "--threads", threads]);
    assert_eq!(evaluate("1"), evaluate("2"));

    // Another encoder, and none, and one that nobody looks at.
    let other = path("other");
    printed(&[&encode[..], &[text(&other), "--seed", "7"]].concat());
    let said = refuse(&clone("one", &other, "1", &["--resume"]));
    assert!(said.contains("its features were made by the encoder with SHA-256"), "{said}");
    let plain = ["clone", "--data", text(&gathered), "--out", text(&path("three"))].map(str::to_owned);
    let said = refuse(&[&plain[..], &["--features".to_owned()]].concat());
    assert!(said.contains("there is no encoder to make features; give --encoder FILE"), "{said}");
    let said = refuse(&[&plain[..], &["--encoder".to_owned(), text(&encoder).to_owned()]].concat());
    assert!(said.contains("observation.features is false") && said.contains("add --features"), "{said}");
    let said = refuse(&clone("three", &config, "1", &[]));
    assert!(said.contains("not a whole safetensors file"), "{said}");
    assert!(!path("three").exists(), "nothing was begun");

    // Trials of earlier versions are learned from as before, but no encoder is.
    let old = path("old");
    std::fs::create_dir(&old).expect("a folder");
    let name = "cube.safetensors.zst";
    std::fs::write(old.join(name), without(&gathered.join(name), "object_poses")).expect("a file");
    let said = refused(&["encode", "--demos", text(&old), "--out", text(&path("four"))]);
    assert!(said.contains("does not say where the object was") && said.contains("gather"), "{said}");
    let mut args = clone("five", &encoder, "1", &[]);
    args[2] = text(&old).to_owned();
    call(&args);
    let said = refused(&["encode", "--demos", text(&gathered), text(&gathered), "--out", text(&path("six"))]);
    assert!(said.contains("both hold trials on cube, protocol wide, seed 101; leave one out"), "{said}");
}

/// The file of gathered trials at `path` as a version wrote it that did not keep how wide their region was.
fn without_half_width(path: &Path) -> Vec<u8> {
    let bytes = zstd::decode_all(&*std::fs::read(path).expect("a file")).expect("compressed");
    let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).expect("a header");
    let mut metadata = header.metadata().clone().expect("a record");
    let mut record: Value = serde_json::from_str(&metadata["gathered"]).expect("JSON");
    assert!(record.as_object_mut().expect("a record").remove("half_width_m").is_some());
    metadata.insert("gathered".to_owned(), record.to_string());
    let file = safetensors::SafeTensors::deserialize(&bytes).expect("tensors");
    let bytes = safetensors::serialize(file.tensors(), Some(metadata)).expect("a file");
    zstd::encode_all(&*bytes, 3).expect("compressed")
}

#[test]
fn a_policy_is_told_its_region_by_trials_of_several_and_by_the_protocol() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let (wide, paper, out) = (path("wide"), path("paper"), path("run"));
    let gather = |out: &Path, more: &[&str]| {
        let fixed = ["gather", "--objects", "cube", "--count", "2", "--out", text(out)];
        printed(&[&fixed[..], more].concat())
    };
    gather(&wide, &[]);
    gather(&paper, &["--protocol", "paper", "--expert", "repetition"]);
    let config = small_training(folder.path());
    let clone = |data: &[&Path]| -> Vec<String> {
        let fixed = ["clone", "--region", "--config", text(&config), "--out", text(&out), "--data"];
        fixed.iter().copied().chain(data.iter().map(|path| text(path))).map(str::to_owned).collect()
    };
    let refuse = |args: &[String]| refused(&args.iter().map(String::as_str).collect::<Vec<_>>());
    let said = refuse(&clone(&[&wide]));
    assert!(said.contains("all episodes began within 0.08 m of the middle"), "{said}");

    // Trials of earlier versions are there all the same, and the command that made them adds what they lack.
    let cube = wide.join("cube.safetensors.zst");
    let whole = std::fs::read(&cube).expect("a file");
    std::fs::write(&cube, without_half_width(&cube)).expect("a file");
    let said = refuse(&clone(&[&wide, &paper]));
    assert!(said.contains("does not say how wide the region was") && said.contains("gather"), "{said}");
    gather(&wide, &[]);
    assert!(std::fs::read(&cube).expect("a file") == whole, "what is added is what is kept now");

    printed(&clone(&[&wide, &paper]).iter().map(String::as_str).collect::<Vec<_>>());
    let policy = policy_of(&out);
    for protocol in ["paper", "wide"] {
        let args = ["evaluate", "--protocol", protocol, "--trials", "1", "--json", "--policy", &policy];
        let compared: Value = serde_json::from_str(&printed(&args)).expect("a comparison");
        assert_eq!(compared["overall"]["trials"], 1);
    }
}

#[test]
fn an_expert_takes_over_from_a_policy_and_teaches_from_there_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let (first, taken, out) = (path("first"), path("taken"), path("run"));
    let gather = |out: &Path, more: &[&str]| {
        let fixed = ["gather", "--objects", "cube", "--count", "3", "--out", text(out)];
        printed(&[&fixed[..], more].concat())
    };
    gather(&first, &[]);
    let config = small_training(folder.path());
    let clone = |data: &[&Path], out: &Path, more: &[&str]| -> Value {
        let data = data.iter().map(|path| text(path));
        let fixed = ["clone", "--config", text(&config), "--json", "--out", text(out)];
        let args = fixed.into_iter().chain(more.iter().copied()).chain(["--data"]).chain(data);
        serde_json::from_str(&printed(&args.collect::<Vec<_>>())).expect("a report")
    };
    // Of another head, that of action chunking with Transformers.
    let alone = clone(&[&first], &out, &["--head", "act"]);
    let student = policy_of(&out);
    gather(&taken, &["--takeover", &student, "--seed", "102", "--threads", "1"]);
    let cube = taken.join("cube.safetensors.zst");
    let bytes = std::fs::read(&cube).expect("a file");
    std::fs::remove_file(&cube).expect("it is gone");
    gather(&taken, &["--takeover", &student, "--seed", "102", "--threads", "2"]);
    assert!(std::fs::read(&cube).expect("a file") == bytes, "other bytes");
    let raw = zstd::decode_all(&*bytes).expect("compressed");
    let file = safetensors::SafeTensors::deserialize(&raw).expect("tensors");
    let counts = |name: &str| -> Vec<u64> {
        let data = file.tensor(name).expect("it is there").data();
        data.as_chunks().0.iter().map(|bytes| u64::from_le_bytes(*bytes)).collect()
    };
    let (steps, taught) = (counts("first_steps"), counts("taught_from"));
    assert!(taught.iter().any(|&from| from > 0), "{taught:?}");
    let learned = clone(&[&first, &taken], &path("again"), &[]);
    // One trial of each training is held out.
    let most = steps[3] - taught.iter().sum::<u64>();
    let more = learned["steps"].as_u64().expect("steps");
    assert!(more > alone["steps"].as_u64().expect("steps"), "{learned} {alone}");
    assert!(more <= alone["steps"].as_u64().expect("steps") + 200 + most, "{learned} {alone}");
    let said = refused(&["gather", "--out", text(&path("none")), "--takeover", "clone:no_such_policy"]);
    assert!(said.contains("--takeover") && said.contains("no_such_policy"), "{said}");
}

#[test]
fn points_of_the_hand_are_seen_by_the_papers_policy_that_has_no_encoder() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let (gathered, out, config) = (path("gathered"), path("run"), small_training(folder.path()));
    printed(&["gather", "--objects", "cube", "--count", "3", "--out", text(&gathered)]);
    let clone = ["clone", "--data", text(&gathered), "--config", text(&config), "--out", text(&out)];
    let said = refused(&[&clone[..], &["--policy", "dp"]].concat());
    assert!(said.contains("none of raw-dp, kinematic-dp, pretrained-dp"), "{said}");
    let said = refused(&[&clone[..], &["--policy", "pretrained-act"]].concat());
    assert!(said.contains("there is no encoder to make features"), "{said}");
    printed(&[&clone[..], &["--policy", "kinematic-dp"]].concat());
    assert_eq!(on_the_cube(&policy_of(&out), "1", &[])["overall"]["trials"], 1);
}

#[test]
fn a_policy_may_see_how_strongly_channels_are_touched_where_that_can_be_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let (gathered, out) = (folder.path().join("gathered"), folder.path().join("run"));
    printed(&["gather", "--objects", "cube", "--count", "3", "--out", text(&gathered)]);
    // Places of taxels and how strongly they are touched: the paper's continuous input.
    let config = small_training_where(folder.path(), "stride = 4\npoints = true\nstrengths = true");
    let clone = ["clone", "--data", text(&gathered), "--config", text(&config), "--out"];
    printed(&[&clone[..], &[text(&out)]].concat());
    let policy = policy_of(&out);
    assert_eq!(
        on_the_cube(&policy, "2", &["--threads", "1"]),
        on_the_cube(&policy, "2", &["--threads", "2"])
    );
    let fixed = ["evaluate", "--protocol", "wide", "--object", "cube", "--trials", "1", "--policy", &policy];
    let problem = refused(&[&fixed[..], &["--truth", "assets/truth/demo.toml"]].concat());
    assert!(problem.contains("a sensor model tells and a truth file does not"), "{problem}");

    let cube = gathered.join("cube.safetensors.zst");
    std::fs::write(&cube, without(&cube, "strengths")).expect("a file");
    let other = folder.path().join("other");
    let problem = refused(&[&clone[..], &[text(&other)]].concat());
    assert!(problem.contains("does not say how strongly channels were touched"), "{problem}");
}

#[test]
fn the_shipped_policies_fit_the_shipped_station() {
    for name in ["searching", "region"] {
        let policy = format!("clone:assets/policies/imitation/{name}.safetensors");
        assert_eq!(on_the_cube(&policy, "2", &[])["overall"]["trials"], 2, "{name}");
    }
}

#[test]
fn what_cannot_be_learned_from_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let (empty, out) = (folder.path().join("empty"), folder.path().join("out"));
    std::fs::create_dir(&empty).expect("a folder");
    let clone = |more: &[&str]| {
        let fixed = ["clone", "--data", text(&empty), "--out", text(&out)];
        refused(&[&fixed[..], more].concat())
    };
    assert!(clone(&[]).contains("holds no file *.safetensors.zst; `palpate-train gather` makes such files"));
    assert!(clone(&["--preset", "fast"]).contains("the preset is \"fast\", expected small or paper"));
    assert!(
        clone(&["--head", "transformer"])
            .contains("\"transformer\" is none of regression, diffusion and act")
    );
    // The studio's requests know the same names.
    for (flag, known) in [("--head", &HEADS[..]), ("--memory", &MEMORIES), ("--policy", &PAPER_POLICIES)] {
        let said = clone(&[flag, "other"]);
        assert!(known.iter().all(|name| said.contains(name)), "{said}");
    }
    let said = refused(&["gather", "--out", text(&out), "--expert", "other"]);
    assert!(EXPERTS.iter().all(|name| said.contains(name)), "{said}");
    assert!(clone(&["--updates", "0"]).contains("updates is 0, expected 1 or more"));
    std::fs::write(empty.join("cube.safetensors.zst"), b"not compressed").expect("a file");
    assert!(clone(&[]).contains("cube.safetensors.zst\" holds no trials of an expert"));
    assert!(!out.exists(), "nothing was begun");
    let gather = ["gather", "--out", text(&out), "--objects", "cube", "--count", "1", "--seed", "2"];
    assert!(refused(&gather).contains("the seed of the protocol \"wide\""));
    let evaluate = ["evaluate", "--protocol", "wide", "--trials", "1", "--policy", "clone:no_such_folder"];
    let problem = refused(&evaluate);
    assert!(problem.contains("no_such_folder"), "{problem}");
}
