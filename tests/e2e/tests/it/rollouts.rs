//! What happens to the robot when the policy that has control fails, and what the record of the rollout says of it. Times are
//! those of the devices.

use std::{
    path::PathBuf,
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, bail};
use e2e::{Bench, MS, Studio, Tools, Watcher, beside_a_station, root, still_from_ns};
use palpate_wire::proto::{ControlState, control_state::Phase};
use serde_json::{Value, json};

use crate::scene::{all_ready, fault};

/// A policy that is alive lets heartbeats go on for so long after it was last heard of.
const ALIVE_MS: u64 = 120;
/// Without a heartbeat for so long the station brakes.
const HEARTBEAT_MS: u64 = 150;
/// The hand's goals brake from 3 rad/s at 40 rad/s2, the arm's from 0.6 rad/s at 5 rad/s2; a turn of the loop and a cycle of
/// the bus come before.
const BRAKING_MS: u64 = 120 + 20;
/// Servos with soft gains come to rest so much later than their goals do.
const LAG_MS: u64 = 150;
/// A fault of a device takes the torque off: it is noticed, joints brake, and 300 ms later they are limp; the rest is for bus,
/// emulation, and a machine that has something else to do.
const LIMP_MS: u64 = 100 + BRAKING_MS + 300 + 300;
/// A rollout that ends a trial by itself notices, holds for half a second, and gives control back well within this.
const MOST_MS: u64 = 5000;
/// The servos' own watchdog.
const WATCHDOG_MS: u64 = 250;
/// Whatever is waited for comes long before this, unless it never does.
const PATIENCE: Duration = Duration::from_secs(120);
/// When faults come, s into a trial: the fingers of the script have begun to close.
const FAULT_S: f64 = 2.3;

/// Devices, a studio on them, and rollouts of a script one after the other.
struct Scene {
    // Dropped in this order: nobody talks to what is gone.
    watcher: Watcher,
    studio: Studio,
    data: tempfile::TempDir,
    bench: Bench,
    world: PathBuf,
    num_rollouts: usize,
}

/// A rollout of one trial, in a process of its own.
struct Rollout {
    process: Child,
    out: PathBuf,
}

impl Scene {
    fn start(tools: &Tools) -> anyhow::Result<Self> {
        let bench = Bench::start(beside_a_station())?;
        let data = tempfile::tempdir()?;
        let studio = Studio::serve(tools, data.path(), bench.station_args())?;
        let watcher = Watcher::connect(&studio)?;
        watcher.wait_for("every device to be ready", all_ready)?;
        // Shorter trials: on a station that holds no finger back, nothing is lifted in the end.
        let text = std::fs::read_to_string(root().join("assets/grasp/xarm6_leap.toml"))?;
        let world = data.path().join("world.toml");
        std::fs::write(&world, text.replace("episode_s = 10.0", "episode_s = 4.0"))?;
        Ok(Self { watcher, studio, data, bench, world, num_rollouts: 0 })
    }

    /// Starts a rollout, and waits until its trial is where faults come: the fingers move.
    fn roll(&mut self, inject: Option<&str>) -> anyhow::Result<Rollout> {
        self.num_rollouts += 1;
        let out = self.data.path().join(format!("rollout{}", self.num_rollouts));
        let mut command = Command::new(env!("CARGO_BIN_EXE_rollout"));
        command.current_dir(root()).args(["--placed", "--json", "--take-over", "--url", &self.studio.url]);
        command.arg("--world").arg(&self.world).arg("--out").arg(&out);
        if let Some(inject) = inject {
            command.args(["--inject", &format!("{inject}={FAULT_S}")]);
        }
        let process = command.stdin(Stdio::null()).stdout(Stdio::null()).spawn()?;
        let mut rollout = Rollout { process, out };
        rollout.wait_until_s(FAULT_S - 0.1)?;
        self.bench.control.log_motion(60_000);
        if inject.is_none() {
            let finger = self.bench.dof("index_mcp_forward")?;
            self.bench.wait_until("moving", |now| now.velocities[finger].abs() > 0.5)?;
        }
        Ok(rollout)
    }

    /// What the robot did after `since_ns`, in ms of the devices' time: until no goal changed any more, until all joints stood,
    /// until no motor had torque.
    fn end(&self, since_ns: u64) -> anyhow::Result<[u64; 3]> {
        let limp_ns = self.bench.wait_until_limp()?;
        let log = self.bench.control.take_motion_log();
        anyhow::ensure!(log.num_dropped == 0, "the log is not whole");
        let held_ns = log.last_goal_ns().context("there were no goals")?;
        let all: Vec<usize> = (0..log.steps[0].positions.len()).collect();
        let until_limp: Vec<_> = log.steps.into_iter().filter(|step| step.device_ns <= limp_ns).collect();
        let still_ns =
            still_from_ns(&until_limp, &all, since_ns).context("they do not stand before they are limp")?;
        Ok([held_ns, still_ns, limp_ns].map(|at_ns| at_ns.saturating_sub(since_ns) / MS))
    }

    fn disarmed(&self) -> anyhow::Result<ControlState> {
        self.watcher.wait_for_phase(Phase::Disarmed)
    }
}

impl Rollout {
    /// Whole lines of its trial's record so far.
    fn record(&self) -> Vec<Value> {
        let text = std::fs::read_to_string(self.out.join("trial-0000.jsonl")).unwrap_or_default();
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }

    /// Waits until its trial has come so far.
    fn wait_until_s(&mut self, time_s: f64) -> anyhow::Result<()> {
        let begun = Instant::now();
        let is_there = |line: &Value| line["time_s"].as_f64().is_some_and(|at_s| at_s >= time_s);
        while !self.record().iter().any(is_there) {
            if let Some(status) = self.process.try_wait()? {
                bail!("the rollout ended before {time_s} s of its trial: {status}");
            }
            if begun.elapsed() > PATIENCE {
                bail!("the trial never came to {time_s} s");
            }
            thread::sleep(Duration::from_millis(10));
        }
        Ok(())
    }

    fn signal(&self, signal: &str) -> anyhow::Result<()> {
        let status = Command::new("kill").arg(signal).arg(self.process.id().to_string()).status()?;
        anyhow::ensure!(status.success(), "kill {signal}: {status}");
        Ok(())
    }

    /// Waits until it has ended by itself; gives its outcome and the record of the trial.
    fn outcome(mut self) -> anyhow::Result<(Value, Vec<Value>)> {
        let begun = Instant::now();
        let status = loop {
            if let Some(status) = self.process.try_wait()? {
                break status;
            }
            anyhow::ensure!(begun.elapsed() < PATIENCE, "the rollout does not end");
            thread::sleep(Duration::from_millis(10));
        };
        anyhow::ensure!(status.success(), "the rollout failed: {status}");
        let text = std::fs::read_to_string(self.out.join("outcomes.jsonl"))?;
        let outcome: Value = serde_json::from_str(text.lines().next().context("there is no outcome")?)?;
        let record = self.record();
        let last = record.last().context("the record is empty")?;
        anyhow::ensure!(last["outcome"] == outcome, "the record ends with {last}, the outcome is {outcome}");
        Ok((outcome, record))
    }
}

impl Drop for Rollout {
    fn drop(&mut self) {
        // One that has ended already is only waited for.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn reasons(outcome: &Value) -> String {
    let reasons = outcome["reasons"].as_array().into_iter().flatten().filter_map(Value::as_str);
    reasons.collect::<Vec<_>>().join("; ")
}

#[test]
fn a_policy_that_is_killed_freezes_or_hangs_makes_the_robot_hold_and_go_limp() {
    let Some(tools) = Tools::find() else { return };
    let mut scene = Scene::start(&tools).unwrap();
    // Only missing heartbeats tell of the last two.
    let silent_ms = HEARTBEAT_MS + BRAKING_MS;
    let cases = [("-KILL", None, 150), ("-STOP", None, silent_ms), ("", Some("hang"), ALIVE_MS + silent_ms)];
    for (signal, inject, most_held_ms) in cases {
        let mut rollout = scene.roll(inject).unwrap();
        let what = inject.unwrap_or(signal);
        if inject.is_some() {
            rollout.wait_until_s(FAULT_S - 0.05).unwrap();
        }
        // A policy that hangs does so within two steps of here.
        let (gone_ns, sooner_ms) = (scene.bench.now_ns(), if inject.is_some() { 100 } else { 0 });
        if inject.is_none() {
            rollout.signal(signal).unwrap();
        }
        let [held_ms, still_ms, limp_ms] = scene.end(gone_ns).unwrap();
        eprintln!(
            "policy {what}: goals stand after {held_ms} ms, joints after {still_ms} ms, limp after {limp_ms} ms"
        );
        let most_held_ms = most_held_ms + sooner_ms;
        assert!(held_ms <= most_held_ms, "{what}: told to move for {held_ms} ms");
        assert!(still_ms <= most_held_ms + LAG_MS, "{what}: stood after {still_ms} ms");
        let most_limp_ms = 500 + sooner_ms + if inject.is_some() { ALIVE_MS } else { 0 };
        assert!(limp_ms <= most_limp_ms, "{what}: limp after {limp_ms} ms");
        let state = scene.disarmed().unwrap();
        assert!(state.reason.contains("operator"), "{what}: {}", state.reason);
        // A record without an outcome is that of a trial that was broken off; what was written is whole.
        let record = rollout.record();
        assert_eq!(record[0]["kind"], "trial", "{what}");
        assert!(record.iter().all(|line| line["kind"] != "outcome"), "{what}");
        let text = std::fs::read_to_string(rollout.out.join("outcomes.jsonl")).unwrap();
        assert_eq!(text, "", "{what}");
    }
}

#[test]
fn what_a_policy_does_wrong_ends_as_the_safety_layer_has_it_and_is_recorded_as_what_it_was() {
    let Some(tools) = Tools::find() else { return };
    let mut scene = Scene::start(&tools).unwrap();

    // No number ever reaches a motor that is none; the trial ends after half a second of refusals.
    let rollout = scene.roll(Some("nan")).unwrap();
    let before_ns = scene.bench.now_ns();
    let limp_ms = (scene.bench.wait_until_limp().unwrap() - before_ns) / MS;
    eprintln!("NaN: limp after {limp_ms} ms");
    assert!(limp_ms <= MOST_MS, "limp after {limp_ms} ms");
    let (outcome, record) = rollout.outcome().unwrap();
    assert_eq!(outcome["suggested"], "ES", "{outcome}");
    assert!(
        reasons(&outcome).contains("the safety layer refused") && reasons(&outcome).contains("NaN"),
        "{outcome}"
    );
    assert!(outcome["refused"].as_u64().unwrap() >= 10, "{outcome}");
    let is_none = |line: &&Value| line["kind"] == "step" && line["wanted"][0].is_null();
    assert!(record.iter().find(is_none).is_some(), "the record says what was wanted");
    let through =
        record.iter().filter(|line| line["kind"] == "frame").flat_map(|line| line["let_through"].as_array());
    assert!(through.flatten().all(Value::is_number));
    let log = scene.bench.control.take_motion_log();
    assert!(log.steps.iter().flat_map(|step| &step.goals).flatten().all(|goal| goal.is_finite()));

    // Jumps become motions within the limits of every joint.
    let rollout = scene.roll(Some("jumps")).unwrap();
    let (outcome, record) = rollout.outcome().unwrap();
    assert_ne!(outcome["suggested"], "success", "{outcome}");
    let limits = scene.bench.control.station().safety.joints.clone();
    let frames: Vec<&Value> = record
        .iter()
        .filter(|line| {
            line["kind"] == "frame" && line["let_through"].as_array().is_some_and(|all| !all.is_empty())
        })
        .collect();
    let mut fastest = 0.0_f64;
    for pair in frames.windows(2) {
        let number = |frame: &Value, dof: usize| frame["let_through"][dof].as_f64().unwrap();
        let within_s = pair[1]["station_s"].as_f64().unwrap() - pair[0]["station_s"].as_f64().unwrap();
        for (dof, limits) in limits.iter().enumerate() {
            let way = (number(pair[1], dof) - number(pair[0], dof)).abs();
            // A frame shows what the turn of the loop before it made.
            let most = limits.velocity * (within_s + 0.011) + 1e-4;
            assert!(way <= most, "joint {dof} was led {way} rad in {within_s} s");
            fastest = fastest.max(way / within_s / limits.velocity);
        }
    }
    let jump = |pair: &[&Value]| {
        let of = |step: &Value| step["wanted"][0].as_f64().unwrap_or_default();
        (of(pair[1]) - of(pair[0])).abs() > 1.0
    };
    let steps: Vec<&Value> = record.iter().filter(|line| line["kind"] == "step").collect();
    assert!(steps.windows(2).any(jump), "the policy jumped");
    eprintln!("jumps: at most {fastest:.2} of a joint's speed was let through");

    // A policy that does not keep up leaves steps out, and the hand waits for it where it was sent last.
    let (outcome, _) = scene.roll(Some("slow")).unwrap().outcome().unwrap();
    assert!(outcome["deadline_misses"].as_u64().unwrap() >= 5, "{outcome}");
    assert!(outcome["skipped_steps"].as_u64().unwrap() >= 10, "{outcome}");
    assert!(!["ES", "void"].contains(&outcome["suggested"].as_str().unwrap()), "{outcome}");

    // The button of the arm: a trial that was stopped.
    let rollout = scene.roll(None).unwrap();
    scene.bench.set_faults("[[fault]]\nkind = \"emergency_stop\"\n").unwrap();
    let pressed_ns = scene.bench.now_ns();
    let limp_ms = (scene.bench.wait_until_limp().unwrap() - pressed_ns) / MS;
    eprintln!("emergency stop: limp after {limp_ms} ms");
    assert!(limp_ms <= LIMP_MS, "limp after {limp_ms} ms");
    let (outcome, _) = rollout.outcome().unwrap();
    assert_eq!(outcome["suggested"], "ES", "{outcome}");
    assert!(reasons(&outcome).to_lowercase().contains("emergency stop"), "{outcome}");
}

#[test]
fn a_trial_without_its_board_or_its_studio_is_void() {
    let Some(tools) = Tools::find() else { return };
    let mut scene = Scene::start(&tools).unwrap();
    let rollout = scene.roll(None).unwrap();
    scene.bench.set_faults(&fault("unplug", "twintac2", "")).unwrap();
    let unplugged_ns = scene.bench.now_ns();
    // The station needs no touch to move; the rollout gives control back, which disarms.
    let limp_ns = scene.bench.wait_until_limp().unwrap();
    let limp_ms = (limp_ns - unplugged_ns) / MS;
    eprintln!("board unplugged: limp after {limp_ms} ms");
    assert!(limp_ms <= MOST_MS, "limp after {limp_ms} ms");
    let (outcome, _) = rollout.outcome().unwrap();
    assert_eq!(outcome["suggested"], "void", "{outcome}");
    assert!(reasons(&outcome).contains("twintac2 is lost"), "{outcome}");
    scene.bench.set_faults("").unwrap();
    scene.watcher.wait_for("every device to be ready", all_ready).unwrap();

    let rollout = scene.roll(None).unwrap();
    let hand: Vec<usize> = {
        let station = scene.bench.control.station();
        (0..station.robot.num_dofs()).filter(|dof| !station.carrier_dofs.contains(dof)).collect()
    };
    let Scene { studio, bench, data: _data, .. } = scene;
    studio.kill().unwrap();
    let killed_ns = bench.now_ns();
    bench.wait_until("a second later", |now| now.device_ns > killed_ns + 1000 * MS).unwrap();
    let log = bench.control.take_motion_log();
    let still_ms = (still_from_ns(&log.steps, &hand, killed_ns).expect("the servos stop") - killed_ns) / MS;
    eprintln!("studio killed: servos still after {still_ms} ms");
    assert!(still_ms <= WATCHDOG_MS, "servos stood after {still_ms} ms");
    let (outcome, _) = rollout.outcome().unwrap();
    assert_eq!(outcome["suggested"], "void", "{outcome}");
    assert!(reasons(&outcome).contains("connection to the studio"), "{outcome}");
}

/// A rollout of a campaign, in a process of its own.
struct Night {
    process: Child,
    out: PathBuf,
}

impl Night {
    fn start(scene: &Scene, url: &str, more: &[&str]) -> anyhow::Result<Self> {
        let out = scene.data.path().join("night");
        let mut command = Command::new(env!("CARGO_BIN_EXE_rollout"));
        command
            .current_dir(root())
            .args(["--campaign", "night", "--placed", "--json", "--url", url])
            .args(more);
        command.arg("--world").arg(&scene.world).arg("--out").arg(&out);
        let process = command.stdin(Stdio::null()).stdout(Stdio::null()).spawn()?;
        Ok(Self { process, out })
    }

    /// Lines of the record of an attempt, so far.
    fn record(&self, trial: u32, attempt: u32) -> Vec<Value> {
        let path = self.out.join(format!("trial-{trial:04}-{attempt}.jsonl"));
        let text = std::fs::read_to_string(path).unwrap_or_default();
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }

    /// Waits until the policy has moved the hand for half a second.
    fn wait_until_moving(&mut self, trial: u32, attempt: u32) -> anyhow::Result<()> {
        let begun = Instant::now();
        let moves = |line: &Value| line["time_s"].as_f64().is_some_and(|at_s| at_s >= 0.5);
        while !self.record(trial, attempt).iter().any(moves) {
            if let Some(status) = self.process.try_wait()? {
                bail!("the rollout ended before trial {trial} moved: {status}");
            }
            anyhow::ensure!(begun.elapsed() < PATIENCE, "trial {trial} never moves");
            thread::sleep(Duration::from_millis(10));
        }
        Ok(())
    }

    /// Waits until it has ended by itself; whether it went well.
    fn ended(&mut self) -> anyhow::Result<bool> {
        let begun = Instant::now();
        loop {
            if let Some(status) = self.process.try_wait()? {
                return Ok(status.success());
            }
            anyhow::ensure!(begun.elapsed() < PATIENCE, "the rollout does not end");
            thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Night {
    fn drop(&mut self) {
        // One that has ended already is only waited for.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn a_campaign_goes_on_where_it_was_whoever_was_restarted() {
    let Some(tools) = Tools::find() else { return };
    let mut scene = Scene::start(&tools).unwrap();
    let text = std::fs::read_to_string(&scene.world).unwrap();
    std::fs::write(&scene.world, text.replace("episode_s = 4.0", "episode_s = 1.5")).unwrap();
    // A channel that is on says which policies are told so.
    let channel = &scene.bench.control.station().layout.channels[0].id;
    let drifts = format!("[[fault]]\nkind = \"drift\"\nchannel = \"{channel}\"\nraw_per_s = 5000.0\n");
    scene.bench.set_faults(&drifts).unwrap();
    let plan = json!({
        "name": "Night", "starts": 2, "half_width_m": 0.02, "seed": 4, "objects": [{ "id": "cube", "group": "seen" }],
        "policies": [
            { "id": "close", "source": "script:{object}" },
            { "id": "silenced", "source": "no such file", "is_silenced": true },
        ],
    });
    scene.studio.post("/campaigns", &plan).unwrap();
    let url = scene.studio.url.clone();
    let campaign = |studio: &Studio| studio.get("/campaigns/night").unwrap();
    let suggested = |studio: &Studio, trial: usize| -> Vec<Value> {
        let attempts = campaign(studio)["trials"][trial - 1]["attempts"].take();
        attempts.as_array().into_iter().flatten().map(|attempt| attempt["outcome"].clone()).collect()
    };

    // A source that is nothing is found out before anything begins.
    assert!(!Night::start(&scene, &url, &[]).unwrap().ended().unwrap());
    assert_eq!(campaign(&scene.studio)["trials"][0]["state"], "waiting");
    std::fs::remove_dir_all(scene.data.path().join("night")).unwrap();
    let start = |scene: &Scene| Night::start(scene, &url, &["--policy", "silenced=script:cube"]).unwrap();

    // The rollout is killed: what became of its trial is told by the next one, which goes on with the next trial.
    let mut night = start(&scene);
    night.wait_until_moving(1, 0).unwrap();
    night.process.kill().unwrap();
    drop(night);
    assert_eq!(campaign(&scene.studio)["trials"][0]["state"], "running");
    let mut night = start(&scene);
    night.wait_until_moving(2, 0).unwrap();
    let told = suggested(&scene.studio, 1);
    assert!(told.len() == 1 && told[0]["suggested"] == "void", "{told:?}");
    assert!(reasons(&told[0]).contains("process was gone"), "{told:?}");

    // The studio is killed: the rollout tells it how the trial ended once it is back, and moves nothing by itself.
    let address = scene.studio.address().to_owned();
    let (station, data) = (scene.bench.station_args(), scene.data.path().to_owned());
    scene.studio.signal("KILL").unwrap();
    scene.studio.ended(PATIENCE).unwrap();
    // Its zero shall not be what the channel has drifted to, at the end of its range after 13 s.
    scene.bench.set_faults("").unwrap();
    scene.studio = Studio::serve_at(&tools, &address, &data, station).unwrap();
    scene.watcher = Watcher::connect(&scene.studio).unwrap();
    assert!(!night.ended().unwrap(), "it asks to be started again");
    let told = suggested(&scene.studio, 2);
    assert!(told.len() == 1 && told[0]["suggested"] == "void", "{told:?}");
    scene.watcher.wait_for("every device to be ready", all_ready).unwrap();
    scene.bench.set_faults(&drifts).unwrap();
    drop(night);

    // Somebody wants a break: the trial that runs is the last one until they are back.
    let mut night = start(&scene);
    night.wait_until_moving(3, 0).unwrap();
    scene.studio.post("/campaigns/night/pause", &json!({})).unwrap();
    assert!(night.ended().unwrap());
    drop(night);
    let states = |studio: &Studio| -> Vec<Value> {
        let trials = campaign(studio)["trials"].take();
        trials.as_array().into_iter().flatten().map(|trial| trial["state"].clone()).collect()
    };
    assert_eq!(states(&scene.studio), ["unscored", "unscored", "unscored", "waiting"]);
    assert!(start(&scene).ended().unwrap(), "nothing is made while it is paused");
    assert_eq!(states(&scene.studio)[3], "waiting");
    scene.studio.post("/campaigns/night/resume", &json!({})).unwrap();

    // What was scored void is repeated where that is asked for.
    let void = json!({ "attempt": 0, "verdict": "void", "scorer": "Ada" });
    scene.studio.post("/campaigns/night/trials/2/score", &void).unwrap();
    let mut night =
        Night::start(&scene, &url, &["--policy", "silenced=script:cube", "--repeat-void"]).unwrap();
    assert!(night.ended().unwrap());
    assert_eq!(states(&scene.studio), ["unscored", "unscored", "unscored", "unscored"]);
    let attempts: Vec<usize> = (1..=4).map(|trial| suggested(&scene.studio, trial).len()).collect();
    assert_eq!(attempts, [1, 2, 1, 1], "nothing was made twice");

    // Each trial was made with the policy and the start of the plan, and only the one that may feel felt.
    let document = campaign(&scene.studio);
    for (trial, attempt) in [(1, 0), (2, 0), (2, 1), (3, 0), (4, 0)] {
        let (planned, record) = (&document["trials"][trial as usize - 1], night.record(trial, attempt));
        let head = &record[0]["trial"];
        assert_eq!((&head["trial"], &head["attempt"]), (&json!(trial), &json!(attempt)));
        let start = &planned["start"];
        assert_eq!(head["start"]["offset_m"], json!([start["x_m"], start["y_m"]]));
        let is_silenced = planned["policy"] == "silenced";
        assert_eq!(head["is_silenced"], is_silenced, "trial {trial}");
        let feels = |kind: &str| {
            let mut lines = record.iter().filter(|line| line["kind"] == kind);
            lines.any(|line| line["active"].as_array().is_some_and(|active| !active.is_empty()))
        };
        assert!(!is_silenced || !feels("step"), "trial {trial} felt what it must not");
        // Attempts that were cut off may have ended before a frame of theirs arrived.
        if !matches!((trial, attempt), (1 | 2, 0)) {
            assert!(feels("frame"), "the channel is on in trial {trial}");
            assert_eq!(feels("step"), !is_silenced, "trial {trial}");
        }
    }
    let text = std::fs::read_to_string(night.out.join("outcomes.jsonl")).unwrap();
    assert_eq!(text.lines().count(), 4, "the one that was killed has no line");
    let begun = std::fs::read_to_string(data.join("campaigns/night/log.jsonl")).unwrap();
    assert_eq!(begun.matches("\"begun\"").count(), 5);
}
