//! What happens to the robot when somebody is killed, or somebody asks for what must not be. The studio is
//! a process of its own; times are those of the devices.

use std::{
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::Context as _;
use e2e::{Bench, MS, Operator, Studio, Tools, Watcher, beside_a_station, still_from_ns, targets};
use palpate_wire::proto::{
    ClearFault, DeviceStatus, Heartbeat, Targets, control_request::Request, control_state::Phase,
    device_status::Link,
};
use serde_json::{Value, json};

use crate::scene::{Scene, all_ready, far_targets, recording, session_request};

/// The arm's goals brake from 0.6 rad/s at 5 rad/s2, those of the hand from 3 rad/s at 40 rad/s2; a turn of the loop and a
/// cycle of the bus come before.
const BRAKING_MS: u64 = 120 + 20;
/// Small servos with soft gains come to rest so much later than their goals do.
const LAG_MS: u64 = 150;
/// Bus, emulation, and a machine that has something else to do.
const SLACK_NS: u64 = 200 * MS;
/// Whatever is waited for comes long before this, unless it never does.
const PATIENCE: Duration = Duration::from_secs(120);
/// Time after which the servos' own watchdog must have stopped them.
const WATCHDOG_NS: u64 = 250 * MS;

/// An operator in a process of its own, who has set joints in motion.
struct Client(Child);

impl Client {
    fn start(studio: &Studio, wanted: &[(usize, f64)]) -> anyhow::Result<Self> {
        let wanted = wanted.iter().map(|(dof, position)| format!("{dof}={position}"));
        let mut command = Command::new(env!("CARGO_BIN_EXE_operator"));
        Ok(Self(command.arg(&studio.url).args(wanted).stdin(Stdio::null()).spawn()?))
    }

    fn signal(&self, signal: &str) -> anyhow::Result<()> {
        let status = Command::new("kill").arg(signal).arg(self.0.id().to_string()).status()?;
        anyhow::ensure!(status.success(), "kill {signal}: {status}");
        Ok(())
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        // One that has ended already is only waited for.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// What the robot did after its operator's process got `signal`, in ms of the devices' time: until no goal changed any
/// more, until all joints stood, until no motor had torque.
fn after_the_clients_end(tools: &Tools, signal: &str) -> anyhow::Result<[u64; 3]> {
    let bench = Bench::start(beside_a_station())?;
    let data = tempfile::tempdir()?;
    let studio = Studio::serve(tools, data.path(), bench.station_args())?;
    let watcher = Watcher::connect(&studio)?;
    watcher.wait_for("every device to be ready", all_ready)?;
    let wanted = far_targets(&bench)?;
    bench.control.log_motion(60_000);
    let client = Client::start(&studio, &wanted)?;
    // The hand is in full motion, and the arm nearly so.
    bench.wait_until("moving", |now| now.velocities[wanted[0].0] > 0.4)?;
    let gone_ns = bench.now_ns();
    client.signal(signal)?;
    let limp_ns = bench.wait_until_limp()?;
    let log = bench.control.take_motion_log();
    anyhow::ensure!(log.num_dropped == 0, "the log is not whole");
    let held_ns = log.last_goal_ns().context("there were no goals")?;
    let all: Vec<usize> = (0..log.steps[0].positions.len()).collect();
    let until_limp: Vec<_> = log.steps.into_iter().filter(|step| step.device_ns <= limp_ns).collect();
    let still_ns =
        still_from_ns(&until_limp, &all, gone_ns).context("they do not stand before they are limp")?;
    let state = watcher.wait_for_phase(Phase::Disarmed)?;
    anyhow::ensure!(state.reason.contains("operator"), "{}", state.reason);
    let after = [held_ns, still_ns, limp_ns].map(|at_ns| at_ns.saturating_sub(gone_ns) / MS);
    let [held, still, limp] = after;
    eprintln!(
        "client got {signal}: goals stand after {held} ms, joints after {still} ms, limp after {limp} ms"
    );
    Ok(after)
}

#[test]
fn a_client_killed_while_moving_makes_the_robot_hold_and_go_limp() {
    let Some(tools) = Tools::find() else { return };
    let [held_ms, still_ms, limp_ms] = after_the_clients_end(&tools, "-KILL").unwrap();
    assert!(held_ms <= 150, "told to move for {held_ms} ms");
    assert!(still_ms <= 150 + LAG_MS, "stood after {still_ms} ms");
    assert!(limp_ms <= 500, "limp after {limp_ms} ms");
}

#[test]
fn a_client_that_falls_silent_with_its_connection_open_makes_the_robot_hold_and_go_limp() {
    let Some(tools) = Tools::find() else { return };
    let [held_ms, still_ms, limp_ms] = after_the_clients_end(&tools, "-STOP").unwrap();
    // Only missing heartbeats tell: braking begins 150 ms after the last one.
    assert!(held_ms <= 150 + BRAKING_MS, "told to move for {held_ms} ms");
    assert!(still_ms <= 150 + BRAKING_MS + LAG_MS, "stood after {still_ms} ms");
    assert!(limp_ms <= 500, "limp after {limp_ms} ms");
}

#[test]
fn a_studio_killed_while_moving_leaves_servos_that_stop_themselves() {
    let Some(tools) = Tools::find() else { return };
    let scene = Scene::armed(&tools).unwrap();
    scene.set_in_motion().unwrap();
    let (all, hand) = scene.dofs();
    let Scene { studio, bench, data, .. } = scene;
    studio.kill().unwrap();
    let killed_ns = bench.now_ns();
    bench.wait_until("a second later", |now| now.device_ns > killed_ns + 1000 * MS).unwrap();
    let log = bench.control.take_motion_log();
    assert_eq!(log.num_dropped, 0);
    let hand_ns = still_from_ns(&log.steps, &hand, killed_ns).expect("the servos stop") - killed_ns;
    let all_ns = still_from_ns(&log.steps, &all, killed_ns).expect("the arm stops") - killed_ns;
    eprintln!("studio killed: servos still after {} ms, arm after {} ms", hand_ns / MS, all_ns / MS);
    assert!(hand_ns <= WATCHDOG_NS, "servos stood after {} ms", hand_ns / MS);
    assert!(all_ns <= WATCHDOG_NS + SLACK_NS, "the arm stood after {} ms", all_ns / MS);

    // A studio that is started again finds everything, and moves nothing by itself.
    bench.control.log_motion(60_000);
    let studio = Studio::serve(&tools, data.path(), bench.station_args()).unwrap();
    let watcher = Watcher::connect(&studio).unwrap();
    watcher.wait_for("every device to be ready", all_ready).unwrap();
    let log = bench.control.take_motion_log();
    assert!(log.steps.iter().flat_map(|step| &step.velocities).all(|velocity| velocity.abs() < 0.15));
    let mut operator = Operator::connect(&studio).unwrap();
    operator.take_control("Ada").unwrap();
    operator.arm(&watcher).unwrap();
    let dof = bench.dof("index_pip").unwrap();
    operator.must(targets(&[(dof, 0.45)])).unwrap();
    bench.wait_until("there", |now| (now.positions[dof] - 0.45).abs() < 0.05).unwrap();
}

#[test]
fn a_studio_that_stands_still_for_a_second_leaves_servos_that_stop_themselves_and_says_so() {
    let Some(tools) = Tools::find() else { return };
    let scene = Scene::armed(&tools).unwrap();
    scene.set_in_motion().unwrap();
    let (all, hand) = scene.dofs();
    scene.studio.signal("STOP").unwrap();
    let stopped_ns = scene.bench.now_ns();
    scene.bench.wait_until("a second later", |now| now.device_ns > stopped_ns + 1000 * MS).unwrap();
    scene.studio.signal("CONT").unwrap();
    let log = scene.bench.control.take_motion_log();
    assert_eq!(log.num_dropped, 0);
    let hand_ns = still_from_ns(&log.steps, &hand, stopped_ns).expect("the servos stop") - stopped_ns;
    let all_ns = still_from_ns(&log.steps, &all, stopped_ns).expect("the arm stops") - stopped_ns;
    eprintln!("studio stood still: servos after {} ms, arm after {} ms", hand_ns / MS, all_ns / MS);
    assert!(hand_ns <= WATCHDOG_NS, "servos stood after {} ms", hand_ns / MS);
    assert!(all_ns <= WATCHDOG_NS + SLACK_NS, "the arm stood after {} ms", all_ns / MS);

    // It does not go on by itself with what it was told before.
    let limp_ns = scene.bench.wait_until_limp().unwrap();
    let state = scene.watcher.wait_for_phase(Phase::Disarmed).unwrap();
    eprintln!("limp {} ms after it stood still: {}", (limp_ns - stopped_ns) / MS, state.reason);
    assert!(!state.reason.is_empty(), "{state:?}");
    scene.operator.arm(&scene.watcher).unwrap();
}

/// Accepts what is left of the take that was killed; gives how long that is. 0 where nothing of it is left.
fn accept_what_is_left(scene: &Scene) -> anyhow::Result<f64> {
    let step =
        || -> anyhow::Result<Value> { Ok(scene.studio.get("/recording")?["session"]["steps"][0].take()) };
    let act = |action: Value| scene.studio.post_under(scene.operator.lease(), "/recording/act", &action);
    if step()?["state"] != "review" {
        return Ok(0.0);
    }
    let wait_for = |what: &str, wanted: &dyn Fn(&Value) -> bool| -> anyhow::Result<()> {
        let begun = Instant::now();
        while !wanted(&step()?) {
            anyhow::ensure!(begun.elapsed() < PATIENCE, "the take is never {what}");
            thread::sleep(Duration::from_millis(50));
        }
        Ok(())
    };
    wait_for("checked", &|step| !step["verdict"].is_null())?;
    act(json!({ "action": "accept" }))?;
    wait_for("accepted", &|step| step["state"] == "accepted")?;
    let session = scene.studio.get("/sessions/monday")?;
    let take = &session["takes"][0];
    let path = format!("/api/v1/sessions/monday/takes/{}/trace", take["id"].as_str().unwrap_or_default());
    let request = format!("GET {path} HTTP/1.0\r\nHost: {}\r\n\r\n", scene.studio.address());
    let status = scene.studio.raw(request.as_bytes(), PATIENCE)?;
    anyhow::ensure!(status == 200, "{path} cannot be read: {status}");
    act(json!({ "action": "select", "step": 0 }))?;
    scene.watcher.wait_for("the accepted take", |state| recording(state).phase == "review")?;
    take["duration_s"].as_f64().context("the take has no duration")
}

/// Files of takes in the session, those that were put aside among them.
fn num_take_files(scene: &Scene) -> anyhow::Result<usize> {
    let session = scene.data.path().join("sessions/monday");
    let count = |dir: &std::path::Path| -> anyhow::Result<usize> {
        let names = std::fs::read_dir(dir)?.map(|entry| Ok(entry?.path()));
        let paths: std::io::Result<Vec<_>> = names.collect();
        Ok(paths?.iter().filter(|path| path.extension().is_some_and(|ending| ending == "mcap")).count())
    };
    let discarded = session.join("discarded");
    Ok(count(&session)? + if discarded.exists() { count(&discarded)? } else { 0 })
}

/// Kills the studio in the middle of a session again and again, on the same step; `PALPATE_ROUNDS=50` asks for more rounds.
#[test]
fn a_session_goes_on_after_kills_at_random_moments() {
    const LONGEST_MS: f64 = 6_000.0;
    let Some(tools) = Tools::find() else { return };
    let rounds = std::env::var("PALPATE_ROUNDS").ok().and_then(|rounds| rounds.parse().ok()).unwrap_or(4);
    let mut scene = Scene::armed(&tools).unwrap();
    scene.begin_session().unwrap();
    let (mut num_files, mut num_running, mut most_lost_s) = (0, 0, 0.0_f64);
    // Moments that lie evenly over the time of a take, in an order without a pattern: multiples of the golden ratio.
    for (round, moment) in (1..=rounds).map(|round| (round, (f64::from(round) * 0.618_034).fract())) {
        let begun_ns = scene.begin_take().unwrap();
        thread::sleep(Duration::from_millis((moment * LONGEST_MS) as u64));
        let state = scene.watcher.newest().and_then(|frame| frame.control).unwrap_or_default();
        let is_running = recording(&state).phase == "running";
        let killed_ns = scene.bench.now_ns();
        scene = scene.killed_and_started_again(&tools).unwrap();
        let kept_s = accept_what_is_left(&scene).unwrap();
        if let (Some(begun_ns), true) = (begun_ns, is_running) {
            let recorded_s = (killed_ns - begun_ns) as f64 * 1e-9;
            eprintln!("round {round}: killed {recorded_s:.2} s into a take: {kept_s:.2} s of it are kept");
            // It begins when the loop says so, a little before or after the moment that was seen from here.
            assert!(kept_s > recorded_s - 1.2, "round {round}: {kept_s} s are left of {recorded_s} s");
            (num_running, most_lost_s) = (num_running + 1, most_lost_s.max(recorded_s - kept_s));
        }
        let files = num_take_files(&scene).unwrap();
        assert!(files >= num_files, "round {round}: of {num_files} files {files} are left");
        num_files = files;
        scene.start_over().unwrap();
    }
    eprintln!("{rounds} kills, {num_running} in a running take; {most_lost_s:.2} s were lost at most");
}

/// Records the first take of the session until its motion has run for some seconds; gives when the take began, in the
/// station's own time, or `None` if the step has to start over.
fn record_some_seconds(scene: &Scene) -> anyhow::Result<Option<u64>> {
    if let Some(begun_ns) = scene.begin_take()? {
        let state = scene.watcher.wait_for("under way", |state| {
            let recording = recording(state);
            recording.phase == "review" || (recording.phase == "running" && recording.elapsed_s > 4.0)
        })?;
        if recording(&state).phase == "running" {
            return Ok(Some(begun_ns));
        }
    }
    scene.start_over()?;
    Ok(None)
}

#[test]
fn a_studio_killed_while_recording_loses_at_most_the_last_second() {
    let Some(tools) = Tools::find() else { return };
    let scene = Scene::armed(&tools).unwrap();
    scene.begin_session().unwrap();
    let begun_ns = (0..5).find_map(|_| record_some_seconds(&scene).unwrap()).expect("a take that goes on");
    let Scene { studio, bench, data, .. } = scene;
    let recorded_s = (bench.now_ns() - begun_ns) as f64 * 1e-9;
    studio.kill().unwrap();

    let studio = Studio::serve(&tools, data.path(), bench.station_args()).unwrap();
    let mut operator = Operator::connect(&studio).unwrap();
    operator.take_control("Ada").unwrap();
    let document = studio.post_under(operator.lease(), "/recording", &session_request()).unwrap();
    let step = &document["session"]["steps"][0];
    assert_eq!(step["state"], json!("review"), "{document}");
    let take = step["take"].as_str().unwrap().to_owned();
    assert!(
        document["session"]["problem"].as_str().unwrap().contains(&take) || take.contains("recovered"),
        "{document}"
    );
    let first_step = |what: &str, wanted: &dyn Fn(&Value) -> bool| {
        let begun = Instant::now();
        while !wanted(&studio.get("/recording").unwrap()["session"]["steps"][0]) {
            assert!(begun.elapsed() < PATIENCE, "the take is never {what}");
            thread::sleep(Duration::from_millis(50));
        }
    };
    first_step("checked", &|step| !step["verdict"].is_null());
    let document = studio.get("/recording").unwrap();
    assert_eq!(document["session"]["phase"], json!("review"), "{document}");
    studio.post_under(operator.lease(), "/recording/act", &json!({ "action": "accept" })).unwrap();
    first_step("accepted", &|step| step["state"] == "accepted");
    let session = studio.get("/sessions/monday").unwrap();
    let kept = &session["takes"][0];
    assert_eq!(kept["id"], json!(take), "{session}");
    let kept_s = kept["duration_s"].as_f64().unwrap();
    eprintln!("killed {recorded_s:.2} s into a take: {kept_s:.2} s of it are kept");
    // It begins when the loop says so, which is a little before or after the moment that was seen from here.
    assert!(kept_s > recorded_s - 1.2, "{kept_s} s are left of {recorded_s} s");
    let check = studio.get("/sessions/monday/check").unwrap();
    assert_eq!(check["ok"], json!(true), "{check}");
}

#[test]
fn what_must_not_be_is_refused_and_an_emergency_stop_can_be_recovered_from() {
    let Some(tools) = Tools::find() else { return };
    let scene = Scene::armed(&tools).unwrap();
    let (pip, joint1) = (scene.bench.dof("index_pip").unwrap(), scene.bench.dof("joint1").unwrap());
    let before = scene.bench.control.snapshot().positions;
    scene.bench.control.log_motion(60_000);
    for (what, request, said) in [
        ("beyond limits", targets(&[(pip, 9.0)]), "index_pip"),
        ("not a number", targets(&[(pip, f64::NAN)]), "index_pip"),
        ("without bounds", targets(&[(joint1, f64::INFINITY)]), "joint1"),
        ("no such joint", targets(&[(999, 0.0)]), "999"),
        ("uneven", Request::Targets(Targets { dofs: vec![0, 1], positions: vec![0.0] }), ""),
    ] {
        let problem = scene.operator.refused(request).unwrap();
        assert!(problem.contains(said), "{what}: {problem}");
    }
    // Somebody else, with a lease of his own making or an old one, moves nothing.
    let stranger = Operator::connect(&scene.studio).unwrap();
    let lease = scene.operator.lease();
    for lease in [0, 1, lease, lease.wrapping_sub(1), lease.wrapping_add(1)] {
        let reply = stranger.ask_under(lease, targets(&[(pip, 0.9)])).unwrap();
        assert!(!reply.accepted && !reply.problem.is_empty(), "{lease}: {reply:?}");
        assert!(!stranger.ask_under(lease, Request::Heartbeat(Heartbeat {})).unwrap().accepted);
    }
    let log = scene.bench.control.take_motion_log();
    let moved =
        log.steps.iter().any(|step| step.positions.iter().zip(&before).any(|(a, b)| (a - b).abs() > 0.02));
    assert!(!moved, "something moved");

    scene.set_in_motion().unwrap();
    scene.bench.set_faults("[[fault]]\nkind = \"emergency_stop\"\n").unwrap();
    let pressed_ns = scene.bench.now_ns();
    // That the arm stopped may be seen a moment before the reason is.
    let is_told = |device: &DeviceStatus| {
        let is_fault = device.id == "xarm" && device.link() == Link::Fault;
        is_fault && device.problem.to_lowercase().contains("emergency stop")
    };
    scene.watcher.wait_for("the arm's emergency stop", |state| state.devices.iter().any(is_told)).unwrap();
    let limp_ns = scene.bench.wait_until_limp().unwrap();
    scene.bench.wait_until("a moment later", |now| now.device_ns > limp_ns + 300 * MS).unwrap();
    let log = scene.bench.control.take_motion_log();
    // Servos without torque swing out; the arm has brakes.
    let arm = &scene.bench.control.station().carrier_dofs;
    let still_ns = still_from_ns(&log.steps, arm, pressed_ns).expect("the arm stands") - pressed_ns;
    eprintln!("emergency stop: the arm still after {} ms", still_ns / MS);
    assert!(still_ns <= (BRAKING_MS + LAG_MS) * MS + SLACK_NS, "the arm stood after {} ms", still_ns / MS);
    let problem = scene.operator.refused(Request::Arm(palpate_wire::proto::Arm {})).unwrap();
    assert!(problem.contains("xarm") || problem.to_lowercase().contains("stop"), "{problem}");

    scene.bench.set_faults("").unwrap();
    let begun = Instant::now();
    while !scene.watcher.wait_for("any state", |_| true).map(|state| all_ready(&state)).unwrap() {
        scene.operator.ask(Request::ClearFault(ClearFault { device: "xarm".to_owned() })).unwrap();
        thread::sleep(Duration::from_millis(200));
        assert!(begun.elapsed() < PATIENCE, "the fault does not clear");
    }
    scene.operator.arm(&scene.watcher).unwrap();
    let now = scene.bench.control.snapshot().positions[joint1];
    scene.operator.must(targets(&[(joint1, now - 0.1)])).unwrap();
    scene.bench.wait_until("there", |state| (state.positions[joint1] - (now - 0.1)).abs() < 0.02).unwrap();
}
