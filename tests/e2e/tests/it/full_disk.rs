//! The disk takes no more while a take is recorded.

use std::{
    thread,
    time::{Duration, Instant},
};

use e2e::{MS, Operator, Studio, Tools, beside_a_station, run_json, targets};
use palpate_wire::proto::control_state::Phase;
use serde_json::{Value, json};

use crate::scene::{Scene, recording, session_request};

/// Room for some seconds of a take.
const MOST_KIB: u32 = 400;
/// Turns of the control loop that are meant, Hz, and the share that a machine that has something else to do must reach.
const LOOP_HZ: f32 = 200.0;
const LOOP_SHARE: f32 = 0.8;
/// The carried-out motion brakes within 40 rad/s2; a servo that follows it with soft gains is a little rougher.
const MOST_RAD_PER_S2: f64 = 120.0;

/// Records until the take ends; gives when it began, in the station's own time, and what the operator is told.
/// `None` if the station held or disarmed meanwhile: the step has to start over.
fn record_to_the_end(scene: &Scene) -> anyhow::Result<Option<(u64, String)>> {
    let problem = || -> anyhow::Result<String> {
        let document = scene.studio.get("/recording")?;
        Ok(document["session"]["problem"].as_str().unwrap_or_default().to_owned())
    };
    if let Some(begun_ns) = scene.begin_take()? {
        scene.watcher.wait_for("ended", |state| recording(state).phase == "review")?;
        let told = problem()?;
        if told.contains("write") {
            return Ok(Some((begun_ns, told)));
        }
        eprintln!("to start over: {told}");
    }
    scene.start_over()?;
    Ok(None)
}

#[test]
fn a_disk_that_is_full_ends_the_take_and_nothing_else() {
    let Some(tools) = Tools::find() else { return };
    let scene = Scene::armed_with(beside_a_station(), |data, station| {
        Studio::serve_on_little_space(&tools, data, station, MOST_KIB)
    })
    .unwrap();
    scene.begin_session().unwrap();
    scene.bench.control.log_motion(120_000);
    let (begun_ns, told) =
        (0..5).find_map(|_| record_to_the_end(&scene).unwrap()).expect("a take that the disk ends");
    let recorded_s = (scene.bench.now_ns() - begun_ns) as f64 * 1e-9;
    eprintln!("told after {recorded_s:.1} s: {told}");

    // It stands where it was, armed, and goes on at once.
    let state = scene.watcher.wait_for("any state", |_| true).unwrap();
    assert_eq!(state.phase(), Phase::Armed, "{}", state.reason);
    scene.watcher.wait_for("the loop's rate", |state| state.loop_hz > LOOP_SHARE * LOOP_HZ).unwrap();
    let log = scene.bench.control.take_motion_log();
    let roughest = log
        .steps
        .windows(11)
        .filter(|steps| steps[0].device_ns > begun_ns)
        .flat_map(|steps| {
            let dt_s = (steps[10].device_ns - steps[0].device_ns) as f64 * 1e-9;
            steps[0].velocities.iter().zip(&steps[10].velocities).map(move |(a, b)| (b - a).abs() / dt_s)
        })
        .fold(0.0, f64::max);
    assert!(roughest < MOST_RAD_PER_S2, "a joint changed its speed by {roughest:.0} rad/s2");
    let pip = scene.bench.dof("index_pip").unwrap();
    let here = scene.bench.control.snapshot().positions[pip];
    let goal = if here > 0.6 { here - 0.2 } else { here + 0.2 };
    scene.operator.must(targets(&[(pip, goal)])).unwrap();
    scene.bench.wait_until("moved on", |now| (now.positions[pip] - goal).abs() < 0.05).unwrap();

    // What was written until then is kept, and is a take like any other, only shorter.
    let begun = Instant::now();
    let step = loop {
        let step = scene.studio.get("/recording").unwrap()["session"]["steps"][0].clone();
        if !step["verdict"].is_null() {
            break step;
        }
        assert!(begun.elapsed() < Duration::from_secs(60), "never checked: {step}");
        thread::sleep(Duration::from_millis(50));
    };
    eprintln!("verdict: {}", step["verdict"]);
    scene
        .studio
        .post_under(scene.operator.lease(), "/recording/act", &json!({ "action": "accept" }))
        .unwrap();
    let accepted = |studio: &Studio| -> Option<Value> {
        let session = studio.get("/sessions/monday").ok()?;
        session["takes"].as_array()?.first().cloned()
    };
    let begun = Instant::now();
    let take = loop {
        if let Some(take) = accepted(&scene.studio) {
            break take;
        }
        assert!(begun.elapsed() < Duration::from_secs(60), "never accepted");
        thread::sleep(Duration::from_millis(50));
    };
    let kept_s = take["duration_s"].as_f64().unwrap();
    eprintln!("{kept_s:.2} s of {recorded_s:.2} s are kept");
    assert!(kept_s > 1.0 && kept_s > recorded_s - 2.5, "{kept_s} s of {recorded_s} s");
    let check = run_json(
        tools.palpate().args(["session", "check", "--json"]).arg(scene.data.path().join("sessions/monday")),
    )
    .unwrap();
    assert_eq!(check["ok"], json!(true), "{check}");
    let log = scene.studio.log();
    assert!(!log.contains("panicked"), "{log}");

    // On a disk with space the session goes on.
    let Scene { studio, bench, data, operator, watcher } = scene;
    drop((operator, watcher, studio));
    let studio = Studio::serve(&tools, data.path(), bench.station_args()).unwrap();
    let mut operator = Operator::connect(&studio).unwrap();
    operator.take_control("Ada").unwrap();
    let document = studio.post_under(operator.lease(), "/recording", &session_request()).unwrap();
    assert_eq!(document["session"]["steps"][0]["state"], json!("accepted"), "{document}");
    assert!(bench.now_ns() > begun_ns + MS);
}
