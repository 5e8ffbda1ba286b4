//! A policy that is told how wide the region is that objects begin in, on the physical emulated station.

use std::collections::VecDeque;
use std::sync::Arc;

use palpate_cloning::Cloned;
use palpate_grasp::GraspConfig;
use palpate_rollout::policy::{ClonedPolicy, Policy as _, Seen};
use palpate_rollout::studio::Studio;
use palpate_wire::api::Campaign;
use serde_json::{Value, json};

use super::rollouts::{asset, station};
use super::station::{cube_station, palpate, studio};
use super::{palpate_train, turn};

const POLICY: &str = "policies/imitation/region.safetensors";
/// Not that of the world file.
const HALF_WIDTH_M: f64 = 0.08;

/// Where the policy goes first, told a region of `half_width_m`: it sees what the record of a rollout says that it saw.
fn first_targets(world: &GraspConfig, record: &[Value], half_width_m: f64) -> Vec<f64> {
    let numbers = |value: &Value| -> Vec<f64> { serde_json::from_value(value.clone()).expect("numbers") };
    let station = station();
    let step = record.iter().find(|line| line["kind"] == "step").expect("a step");
    let mut active = vec![false; station.layout.num_channels()];
    for channel in step["active"].as_array().expect("channels") {
        active[channel.as_u64().expect("a channel") as usize] = true;
    }
    let time_s = step["time_s"].as_f64().expect("a time");
    let seen = VecDeque::from([Seen { time_s, positions: numbers(&step["positions"]), active }]);
    let (_, _, cloned) = Cloned::read(&asset(POLICY)).expect("a policy");
    let mut policy =
        ClonedPolicy::new(Arc::new(cloned), station, world, Some(half_width_m)).expect("it fits");
    policy.begin(&numbers(&record[0]["trial"]["begins_at"]));
    policy.plan(&seen).expect("a plan").remove(0).targets
}

/// How far the joint that differs most is apart, rad or m.
fn apart(some: &[f64], others: &[f64]) -> f64 {
    some.iter().zip(others).map(|(one, other)| (one - other).abs()).fold(0.0, f64::max)
}

#[test]
fn a_policy_is_told_the_region_of_its_campaign_and_refused_where_nobody_knows_it() {
    let Some(palpate) = palpate() else { return };
    let _turn = turn();
    let folder = tempfile::tempdir().expect("a folder");
    let (_station, found) = cube_station(&folder.path().join("devices"));
    let (_studio, url) = studio(&palpate, &folder.path().join("data"), &[], &found);
    let source = format!("clone:assets/{POLICY}");

    // Somebody has placed the object, and has not said in which region.
    let none = folder.path().join("none");
    let output = palpate_train()
        .args(["rollout", "--placed", "--policy", &source, "--url", &url, "--out"])
        .arg(&none)
        .output()
        .expect("the command starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && !none.exists(), "{said}");
    for words in ["region.safetensors", "observation.region", "nobody says how wide that is", "--region-cm"] {
        assert!(said.contains(words), "{said}");
    }

    let plan = json!({
        "name": "Told", "starts": 1, "half_width_m": HALF_WIDTH_M, "seed": 5,
        "policies": [{ "id": "told", "source": source }], "objects": [{ "id": "cube" }],
    });
    let studio = Studio::new(&url, None, None).expect("a studio");
    let _: Campaign = studio.post("/campaigns", &plan).expect("a campaign");
    // Shorter than a grasp takes: what is looked at here is what the policy is told.
    let text = std::fs::read_to_string(asset("grasp/xarm6_leap.toml")).expect("a world");
    let text = text.replace("episode_s = 10.0", "episode_s = 3.0");
    let short = folder.path().join("world.toml");
    std::fs::write(&short, &text).expect("a file");
    let out = folder.path().join("told");
    let output = palpate_train()
        .args(["rollout", "--campaign", "told", "--url", &url, "--operator"])
        .arg(found["operator"].as_str().expect("a socket"))
        .arg("--world")
        .arg(&short)
        .arg("--out")
        .arg(&out)
        .output()
        .expect("the command starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));

    let campaign: Campaign = studio.get("/campaigns/told").expect("the campaign");
    let outcome = campaign.trials[0].attempts[0].outcome.as_ref().expect("what came of it");
    let record = std::fs::read_to_string(outcome.record.as_ref().expect("a record")).expect("the record");
    let record: Vec<Value> = record.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let head = &record[0]["trial"];
    assert_eq!(head["half_width_m"], HALF_WIDTH_M, "{head}");
    let num_steps = record.iter().filter(|line| line["kind"] == "step").count();
    // A busy computer leaves steps out; after three it has planned anew from what it saw.
    assert!(num_steps > 3, "it moved in {num_steps} steps of 60");

    // It did what it does in that region, and not what it does in that of the world file.
    let step = record.iter().find(|line| line["kind"] == "step").expect("a step");
    let wanted: Vec<f64> = serde_json::from_value(step["wanted"].clone()).expect("numbers");
    let world = GraspConfig::from_toml("world", &text, &station().robot).expect("a world");
    let told = apart(&wanted, &first_targets(&world, &record, HALF_WIDTH_M));
    let elsewhere = apart(&wanted, &first_targets(&world, &record, world.task.half_width_m));
    assert!(told < 1e-9 && elsewhere > 1e-5, "{told} where it was told, {elsewhere} in the world's region");
}
