//! Rollouts beside the grasp world: a made-up one, which was simulated and has to be found again to the bit.

use std::path::Path;
use std::sync::Arc;

use palpate_grasp::trial::Judge;
use palpate_grasp::{GraspConfig, GraspEnv, GraspScene, Script, ScriptRun, Start};
use palpate_robot_model::ObjectModel;
use palpate_rollout::task::sha256;
use palpate_sim::SensorModel;
use serde_json::{Value, json};

use super::rollouts::{asset, station};
use super::{palpate_train, turn};

const MODEL: &str = "assets/models/demo_diagnosed.toml";
const SEED: u64 = 5;

fn text(path: &str) -> String {
    std::fs::read_to_string(asset(path)).expect("a shipped file")
}

/// A hand that is the grasp world with the diagnosed model.
struct MadeUp {
    scene: Arc<GraspScene>,
    script: Script,
}

impl MadeUp {
    fn new() -> Self {
        let station = station();
        let world = GraspConfig::from_toml("world", &text("grasp/xarm6_leap.toml"), &station.robot);
        let world = world.expect("a world");
        let script = Script::from_toml("script", &text("grasp/scripts/cube.toml"), &station.robot, &world);
        let model = SensorModel::from_toml("model", &text("models/demo_diagnosed.toml")).expect("a model");
        let object =
            ObjectModel::from_toml("cube", &text("objects/cube.toml"), |_| Err("no mesh".to_owned()));
        let scene = GraspScene::new(station, world, &object.expect("a cube"), &model).expect("a scene");
        Self { scene: Arc::new(scene), script: script.expect("a script") }
    }

    /// Lines of the record of a trial, as a rollout writes them.
    fn record(&self, trial: u64) -> Vec<Value> {
        let (scene, station) = (&self.scene, self.scene.station());
        let start = Start::of_trial(scene, scene.config().task.half_width_m, SEED, trial);
        let mut env = GraspEnv::new(Arc::clone(scene), 0, 0).expect("an environment");
        env.begin(&start).expect("a start");
        let (at, turned) =
            (env.world().base_from_object().translation.vector, env.world().base_from_object().rotation);
        let files: Vec<Value> = [("world", "grasp/xarm6_leap.toml"), ("object", "objects/cube.toml"), ("script", "grasp/scripts/cube.toml")]
            .iter()
            .map(|(role, path)| json!({ "role": role, "path": format!("assets/{path}"), "sha256": sha256(text(path).as_bytes()) }))
            .collect();
        let rate_hz = scene.config().control_rate_hz;
        let mut lines = vec![json!({ "kind": "trial", "trial": {
            "trial": trial, "object": "cube", "policy": "script assets/grasp/scripts/cube.toml",
            "start": { "seed": SEED, "trial": trial, "start_cm": null,
                "object_pose": [at.x, at.y, at.z, turned.w, turned.i, turned.j, turned.k] },
            "station": station.id, "files": files, "control_rate_hz": rate_hz,
            "joints": station.robot.dofs().map(|joint| joint.name.as_str()).collect::<Vec<_>>(),
            "channels": station.layout.channels.iter().map(|channel| channel.id.as_str()).collect::<Vec<_>>(),
            "begins_at": start.positions,
        } })];
        let mut judge = Judge::new(env.world(), scene.config().task.episode_s);
        let mut run = ScriptRun::new(&self.script);
        let verdict = loop {
            let targets = run.targets(&self.script, station, scene.config(), env.sensed());
            let active = env.readings().active.iter().enumerate().filter(|(_, on)| **on);
            let active: Vec<usize> = active.map(|(channel, _)| channel).collect();
            lines.push(json!({ "kind": "step", "time_s": env.time_s(), "positions": env.positions(), "active": active }));
            let at_s = env.time_s() + 0.5 / rate_hz;
            lines.push(json!({ "kind": "frame", "at_s": at_s, "let_through": targets }));
            env.step(&targets).expect("a step");
            let contacts = env.world().contacts();
            if let Some(outcome) = judge.look(scene.config(), env.world(), &contacts) {
                break outcome;
            }
        };
        let word = if verdict == palpate_grasp::trial::Outcome::Success { "success" } else { "EG" };
        lines.push(json!({ "kind": "outcome", "outcome": { "suggested": word, "truth": null } }));
        lines
    }
}

fn write(folder: &Path, number: u64, lines: &[Value]) {
    let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
    std::fs::write(folder.join(format!("trial-{number:04}.jsonl")), text).expect("a record");
}

#[test]
fn what_was_simulated_is_found_again_to_the_bit_and_what_cannot_be_compared_is_counted() {
    let _turn = turn();
    let (hand, folder) = (MadeUp::new(), tempfile::tempdir().expect("a folder"));
    let rollout = folder.path().join("rollout");
    std::fs::create_dir(&rollout).expect("a folder");
    for trial in 0..2 {
        write(&rollout, trial, &hand.record(trial));
    }
    let spoiled = |number: u64, spoil: &dyn Fn(&mut Vec<Value>)| {
        let mut lines = hand.record(0);
        lines[0]["trial"]["trial"] = json!(number);
        spoil(&mut lines);
        write(&rollout, number, &lines);
    };
    spoiled(2, &|lines| lines[0]["trial"]["start"] = json!(null));
    spoiled(3, &|lines| lines[0]["trial"]["start"]["object_pose"][0] = json!(0.0));
    spoiled(4, &|lines| lines.last_mut().expect("a line")["outcome"]["suggested"] = json!("void"));
    spoiled(5, &|lines| drop(lines.pop()));

    // Another object, and a policy that was told that it feels nothing, as one folder of a campaign has them.
    spoiled(6, &|lines| lines[0]["trial"]["object"] = json!("ball"));
    spoiled(7, &|lines| lines[0]["trial"]["is_silenced"] = json!(true));
    let dir = rollout.to_str().expect("a path");
    for (only, expected) in [
        ("0,1,6", "compare them apart, by --only"),
        ("0,7", "compare them apart, by --only"),
        ("7", "was told that it feels nothing"),
        ("0,9", "--only names 9"),
    ] {
        let refused = palpate_train()
            .args(["compare-rollout", "--rollout", dir, "--only", only])
            .output()
            .expect("the command starts");
        let said = String::from_utf8_lossy(&refused.stderr);
        assert!(!refused.status.success() && said.contains(expected), "{only}: {said}");
    }

    let out = folder.path().join("compared.json");
    let call = [
        "compare-rollout",
        "--rollout",
        dir,
        "--only",
        "0,1,2,3,4,5",
        "--model",
        "nominal",
        "--model",
        MODEL,
        "--json",
        "--out",
    ];
    let output = palpate_train()
        .args([&call[..], &[out.to_str().expect("a path")]].concat())
        .output()
        .expect("the command starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).expect("a document");
    assert_eq!((&found["recorded"], &found["compared"]), (&json!(6), &json!(2)));
    assert_eq!(
        found["left_out"],
        json!({ "unknown_start": [2], "another_start": [3], "void": [4], "no_outcome": [5] })
    );
    let (nominal, own) = (&found["models"][0], &found["models"][1]);
    for how in ["same_start", "same_commands"] {
        assert_eq!(
            (&own[how]["same_verdict"], &own[how]["p_value"]),
            (&json!(2), &json!(1.0)),
            "{how}: {own}"
        );
        let touch = &own[how]["touch"];
        assert_eq!((&touch["f1"], &touch["gap"]), (&json!(1.0), &json!(0.0)), "{how}: {touch}");
        assert!(touch["hand_contacts"].as_u64().expect("a number") > 1, "touch is part of it: {touch}");
        // A script that feels nothing does the same whatever it feels; what is felt differs.
        assert_eq!(nominal[how]["same_verdict"], json!(2));
        assert!(nominal[how]["touch"]["f1"].as_f64().expect("a number") < 1.0, "{how}: {nominal}");
    }
    let apart = own["same_commands"]["joint_difference"].as_array().expect("joints").iter();
    assert!(apart.flat_map(Value::as_f64).all(|difference| difference < 1e-12), "the same motion");
    let kept: Value = serde_json::from_slice(&std::fs::read(&out).expect("a file")).expect("a document");
    assert_eq!(kept["models"][0]["same_start"]["each"][1]["trial"], json!(1));
}

#[test]
fn a_rollout_of_other_files_is_refused_by_name() {
    let _turn = turn();
    let (hand, folder) = (MadeUp::new(), tempfile::tempdir().expect("a folder"));
    let refused = |spoil: &dyn Fn(&mut Value), expected: &str| {
        let rollout = folder.path().join("rollout");
        let _ = std::fs::remove_dir_all(&rollout);
        std::fs::create_dir(&rollout).expect("a folder");
        let mut lines = hand.record(0);
        spoil(&mut lines[0]["trial"]);
        write(&rollout, 0, &lines);
        let output = palpate_train()
            .args(["compare-rollout", "--rollout", rollout.to_str().expect("a path")])
            .output()
            .expect("the command starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains(expected), "{said}");
    };
    refused(
        &|trial| trial["files"][2]["sha256"] = json!("0"),
        "the script of the rollout, is another file now",
    );
    refused(
        &|trial| trial["files"][1]["path"] = json!("gone.toml"),
        "failed to read \"gone.toml\", the object",
    );
    refused(&|trial| trial["joints"][0] = json!("elbow"), "the rollout's joints");
    refused(&|trial| drop(trial["files"].as_array_mut().map(Vec::pop)), "neither a policy nor a script");
    refused(&|trial| trial["control_rate_hz"] = json!(30.0), "30 steps a second, its world file says 20");
    let output = palpate_train()
        .args(["compare-rollout", "--rollout", "assets"])
        .output()
        .expect("the command starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("holds no record of a trial"), "{said}");
}
