//! Policies: trainings of one update, and what comes of them.

use std::collections::HashMap;
use std::ops::Range;
use std::path::Path;

use palpate_robot_model::Station;
use safetensors::{SafeTensors, tensor::TensorView};
use serde_json::Value;

use super::palpate_train;

/// Trains in `folder` for the few steps of one update.
pub(crate) fn train(folder: &Path) {
    let config = folder.join("small.toml");
    let text = "num_envs = 1\nunroll_length = 4\nbatch_size = 1\nnum_minibatches = 1\nnum_epochs = 1\n\
                total_steps = 4\ncheckpoint_updates = 1\n[networks]\nactor = [8]\ncritic = [8]\n";
    std::fs::write(&config, text).expect("a file");
    let run = folder.join("run");
    let output = palpate_train(&[
        "ppo",
        "--config",
        config.to_str().expect("a path"),
        "--out",
        run.to_str().expect("a path"),
    ]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Of the shipped station: what touch is in an observation, after three numbers of each joint.
const TOUCH: Range<usize> = 66..154;

/// The checkpoint of a training, every weight of whose actor is zero: a policy that leaves the script alone, or with a
/// `touch_weight` one that opens the hand as soon as it feels something.
pub(crate) fn zeroed(checkpoint: &[u8], touch_weight: f32) -> Vec<u8> {
    let (_, header) = SafeTensors::read_metadata(checkpoint).expect("a header");
    let state = header.metadata().as_ref().expect("metadata")["state"].clone();
    let mut state: Value = serde_json::from_str(&state).expect("JSON");
    let file = SafeTensors::deserialize(checkpoint).expect("tensors");
    let mut tensors: Vec<(String, _, Vec<usize>, Vec<u8>)> = Vec::new();
    for (name, view) in file.tensors() {
        let mut bytes = view.data().to_vec();
        if name.starts_with("actor.") && !name.ends_with("log_std") {
            let mut values = vec![0.0; bytes.len() / 4];
            if name == "actor.0.weight" {
                let num_out = view.shape()[1];
                values[TOUCH.start * num_out..TOUCH.end * num_out].fill(touch_weight);
            } else if name == "actor.1.weight" {
                values.fill(-touch_weight);
            }
            bytes = values.into_iter().flat_map(f32::to_le_bytes).collect();
            state["checksums"][&name] = crc32fast::hash(&bytes).into();
        }
        tensors.push((name, view.dtype(), view.shape().to_vec(), bytes));
    }
    let state = state.to_string();
    for (name, _, _, bytes) in &mut tensors {
        if name == "state.crc32" {
            *bytes = crc32fast::hash(state.as_bytes()).to_le_bytes().to_vec();
        }
    }
    let views = tensors.iter().map(|(name, dtype, shape, bytes)| {
        (name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).expect("a tensor"))
    });
    safetensors::serialize(views, Some(HashMap::from([("state".to_owned(), state)]))).expect("a file")
}

/// What a command that must succeed prints.
pub(crate) fn printed(args: &[&str]) -> String {
    let output = palpate_train(args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("text")
}

#[test]
fn a_policy_of_zeros_has_the_trials_of_the_script_and_so_has_one_that_only_touch_moves_without_it() {
    let folder = tempfile::tempdir().expect("a folder");
    train(folder.path());
    let run = folder.path().join("run");
    let bytes = std::fs::read(run.join("checkpoint.safetensors")).expect("a checkpoint");
    let still = folder.path().join("still.safetensors");
    std::fs::write(&still, zeroed(&bytes, 0.0)).expect("a file");
    let trials = ["--object", "cube", "--trials", "6", "--seed", "5", "--start-cm", "5", "--json"];
    let script = printed(&[&["script"], &trials[..]].concat());
    let still = ["evaluate", "--policy", still.to_str().expect("a path")];
    assert_eq!(printed(&[&still, &trials[..]].concat()), script);
    let feels = folder.path().join("feels.safetensors");
    std::fs::write(&feels, zeroed(&bytes, 1.0)).expect("a file");
    let feels = ["evaluate", "--policy", feels.to_str().expect("a path")];
    assert_ne!(printed(&[&feels, &trials[..]].concat()), script);
    assert_eq!(printed(&[&feels, &trials[..], &["--silence-touch"]].concat()), script);
    let run = ["evaluate", "--policy", run.to_str().expect("a path")];
    let mine = |more: &[&str]| printed(&[&run, &trials[..], more].concat());
    let one = mine(&["--threads", "1"]);
    assert_eq!(mine(&["--threads", "3"]), one);
}

#[test]
fn a_policy_that_does_not_fit_is_refused_by_what_differs() {
    let folder = tempfile::tempdir().expect("a folder");
    train(folder.path());
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let changed = |shipped: &str| {
        let text = std::fs::read_to_string(root.join(shipped)).expect("a file");
        let path = folder.path().join("changed.toml");
        std::fs::write(&path, format!("{text}\n# Changed.\n")).expect("a file");
        path.to_str().expect("a path").to_owned()
    };
    let run = folder.path().join("run");
    let run = run.to_str().expect("a path");
    let empty = folder.path().to_str().expect("a path").to_owned();
    for (policy, args, expected) in [
        (
            run,
            vec!["--object".to_owned(), "ball".to_owned()],
            "trained with the object \"cube\", not \"ball\"",
        ),
        (run, vec!["--without-script".to_owned()], "leave --without-script out"),
        (
            run,
            vec!["--script".to_owned(), changed("assets/grasp/scripts/xarm6_leap_cube.toml")],
            "another script (--script): SHA-256 ",
        ),
        (&empty, vec![], "--policy is a training's folder, a checkpoint or an exported policy"),
        (run, vec!["--trials".to_owned(), "0".to_owned()], "--trials is 0"),
    ] {
        let mut call = vec!["evaluate", "--policy", policy];
        call.extend(args.iter().map(String::as_str));
        let output = palpate_train(&call);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains(expected), "{args:?}: {said}");
    }
    let learning = changed("assets/grasp/xarm6_leap_learning.toml");
    let output = palpate_train(&["evaluate", "--policy", run, "--learning", &learning]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("another learning file (--learning): SHA-256 "), "{said}");
}

#[test]
fn an_exported_policy_is_small_has_the_scores_of_its_training_and_is_no_training_to_go_on_with() {
    let folder = tempfile::tempdir().expect("a folder");
    train(folder.path());
    let run = folder.path().join("run");
    let exported = folder.path().join("cube.safetensors");
    let path = |path: &Path| path.to_str().expect("a path").to_owned();
    printed(&["export", "--policy", &path(&run), "--out", &path(&exported)]);
    let small = std::fs::read(&exported).expect("a file");
    let whole = std::fs::read(run.join("checkpoint.safetensors")).expect("a checkpoint");
    assert!(4 * small.len() < whole.len(), "{} of {} bytes", small.len(), whole.len());
    let curve = std::fs::read_to_string(exported.with_extension("jsonl")).expect("a curve");
    let point: Value = serde_json::from_str(curve.lines().next().expect("a line")).expect("JSON");
    assert_eq!((point["steps"].as_u64(), point["start_half_width_m"].as_f64()), (Some(4), Some(0.03)));

    let again = folder.path().join("again.safetensors");
    printed(&["export", "--policy", &path(&exported), "--out", &path(&again)]);
    assert!(std::fs::read(&again).expect("a file") == small, "what is exported again has the same bytes");

    let score = |policy: &Path, more: &[&str]| {
        let policy = path(policy);
        let call = ["evaluate", "--policy", &policy, "--trials", "3", "--seed", "5", "--json"];
        printed(&[&call, more].concat())
    };
    assert_eq!(score(&exported, &[]), score(&run, &[]));

    std::fs::copy(&exported, run.join("checkpoint.safetensors")).expect("a copy");
    let config = path(&folder.path().join("small.toml"));
    let output = palpate_train(&["ppo", "--config", &config, "--out", &path(&run), "--resume"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("checkpoint.safetensors: it holds a policy alone"), "{said}");

    let picture = folder.path().join("curves.svg");
    printed(&["curves", "--policies", &path(folder.path()), "--out", &path(&picture)]);
    let picture = std::fs::read_to_string(picture).expect("a picture");
    assert!(picture.contains(">cube</text>"), "{picture}");
    std::fs::write(exported.with_extension("jsonl"), format!("{curve}{{\n")).expect("a file");
    let output = palpate_train(&["curves", "--policies", &path(folder.path()), "--out", "/dev/null"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("cube.jsonl:2 is no line of metrics"), "{said}");
}

#[test]
fn touch_can_be_that_of_a_truth_file_whose_channels_are_those_of_the_station() {
    let folder = tempfile::tempdir().expect("a folder");
    train(folder.path());
    let bytes = std::fs::read(folder.path().join("run/checkpoint.safetensors")).expect("a checkpoint");
    let feels = folder.path().join("feels.safetensors");
    std::fs::write(&feels, zeroed(&bytes, 1.0)).expect("a file");
    let feels = feels.to_str().expect("a path");
    let call = ["evaluate", "--policy", feels, "--trials", "4", "--seed", "5", "--start-cm", "5", "--json"];
    let with = |more: &[&str]| printed(&[&call, more].concat());
    let truth = ["--truth", "assets/truth/demo.toml"];
    let one = with(&[&truth[..], &["--threads", "1"]].concat());
    assert_eq!(with(&[&truth[..], &["--threads", "3"]].concat()), one);
    assert_eq!(with(&[&truth[..], &["--silence-touch"]].concat()), with(&["--silence-touch"]));
    assert_ne!(one, with(&["--silence-touch"]), "what the truth lets it feel moves it");
    let deaf = folder.path().join("deaf.toml");
    std::fs::write(&deaf, map_without_contact("xarm6-leap")).expect("a file");
    let deaf = deaf.to_str().expect("a path");
    let mapped = with(&[&truth[..], &["--contact-map", deaf]].concat());
    assert_eq!(mapped, with(&["--silence-touch"]), "the map's events stand in place of the firmware's");

    let refused = |args: &[&str]| {
        let output = palpate_train(&[&call, args].concat());
        assert!(!output.status.success(), "{args:?} must be refused");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    assert!(
        refused(&["--contact-map", deaf]).contains("--truth"),
        "a map reads what the truth's devices read"
    );
    std::fs::write(deaf, map_without_contact("elsewhere")).expect("a file");
    let said = refused(&[&truth[..], &["--contact-map", deaf]].concat());
    assert!(said.contains("was learned on station \"elsewhere\""), "{said}");
    let said = refused(&["--truth", "assets/truth/bench.toml"]);
    assert!(said.contains("whose joints and channels are not those of"), "{said}");
    let said = refused(&["--truth", "assets/truth/demo.toml", "--model", "assets/models/nominal.toml"]);
    assert!(said.contains("cannot be used with"), "{said}");
}

/// A contact map of the shipped hand, said to be that of `station`, which takes nothing for contact.
fn map_without_contact(station: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/stations");
    let read = |path: &str| std::fs::read(folder.join(path)).map_err(|err| err.to_string());
    let layout = Station::read("xarm6_leap.toml", read).expect("a shipped station").layout;
    let target = std::fs::read_to_string(folder.join("../models/nominal.toml")).expect("a shipped model");
    let mut map = format!(
        "format = 1\nname = \"deaf\"\nstation = {station:?}\nlags_s = [0.0, 0.1]\ntarget = '''\n{target}'''\n"
    );
    for (idx, stream) in layout.streams.iter().enumerate() {
        let ids: Vec<&str> =
            layout.channels[stream.channels.clone()].iter().map(|channel| channel.id.as_str()).collect();
        let is_shared = layout.patches.iter().any(|patch| patch.stream == idx && patch.channels.len() > 1);
        let inputs = if is_shared { 4 } else { 2 };
        map += &format!(
            "[[stream]]\nid = {:?}\nchannels = {ids:?}\nscales_raw = {:?}\noffsets = {:?}\non = 1.0\noff = 1.0\n\
             inputs = {inputs}\nhidden = 0\nweights = {:?}\n",
            stream.id,
            vec![1.0; ids.len()],
            vec![0.0; ids.len()],
            vec![0.0; inputs + 1],
        );
    }
    map
}
