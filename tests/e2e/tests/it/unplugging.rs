//! Every device in turn loses its cable while an operator moves the robot.

use std::{
    thread,
    time::{Duration, Instant},
};

use anyhow::Context as _;
use e2e::{MS, Tools, still_from_ns, targets};
use palpate_emulator::Push;
use palpate_wire::proto::{
    ControlState, DeviceStatus, Disarm, control_request::Request, control_state::Phase, device_status::Link,
};

use crate::scene::{Scene, all_ready, fault};

/// A reading is old, and the hold begins, after 250 ms; then joints brake within their limits, and servos come to rest
/// 150 ms behind that. The rest is for bus, emulation, and a machine that has something else to do.
const HOLD_NS: u64 = 250 * MS + 225 * MS + 200 * MS;
/// Readings that old take the torque off, and so does a device that is lost.
const LIMP_NS: u64 = 500 * MS + 300 * MS;
/// A joint at 3 rad/s goes so far, rad, in the 100 ms until its torque is off.
const BRAKING_RAD: f64 = 0.3;
/// What the others send while one is gone, of what they sent before.
const KEPT_RATE: f32 = 0.8;
/// How far a joint may go while it is armed, rad: encoders, and a servo that takes up its load.
const STARTS_WITHIN_RAD: f64 = 0.05;

#[test]
fn every_device_may_be_unplugged_while_the_robot_moves_and_comes_back_by_itself() {
    let Some(tools) = Tools::find() else { return };
    let scene = Scene::armed(&tools).unwrap();
    let devices: Vec<(usize, String, bool)> = (scene.bench.control.station().devices.iter().enumerate())
        .map(|(idx, device)| (idx, device.id.clone(), !device.dofs().is_empty()))
        .collect();
    for (idx, id, moves) in devices {
        let begun = Instant::now();
        lose_and_find(&scene, idx, &id, moves).unwrap_or_else(|err| {
            panic!("{id}: {err:#}\n{:?}\n{:?}", scene.watcher.newest(), scene.bench.control.snapshot())
        });
        eprintln!("{id}: took {:.1} s", begun.elapsed().as_secs_f64());
    }
}

fn lose_and_find(scene: &Scene, idx: usize, id: &str, moves: bool) -> anyhow::Result<()> {
    let Scene { watcher, bench, operator, .. } = scene;
    let others = |state: &ControlState| -> Vec<DeviceStatus> {
        let rest = state.devices.iter().enumerate().filter(|(other, _)| *other != idx);
        rest.map(|(_, device)| device.clone()).collect()
    };
    let before = watcher.wait_for("full rates", |state| {
        all_ready(state) && state.devices.iter().all(|device| device.rate_hz > 0.9 * device.rate_mean_hz)
    })?;
    // Between its two ends for longer than all of this takes.
    scene.set_in_motion()?;
    bench.set_faults(&fault("unplug", id, ""))?;
    let gone_ns = bench.now_ns();
    let state = watcher.wait_for(&format!("{id} lost"), |state| state.devices[idx].link() == Link::Lost)?;
    anyhow::ensure!(!state.devices[idx].problem.is_empty(), "nobody says what to do: {state:?}");
    eprintln!("{id}: {}", state.devices[idx].problem);

    if moves {
        // Nobody moves a robot that cannot be seen as a whole.
        let state = watcher.wait_for_phase(Phase::Disarmed)?;
        anyhow::ensure!(state.reason.contains(id) || state.reason.contains("joint"), "{:?}", state.reason);
        let carrier = &bench.control.station().carrier_dofs;
        let all = 0..bench.control.station().robot.num_dofs();
        let (lost, kept): (Vec<usize>, Vec<usize>) =
            all.partition(|dof| carrier.contains(dof) == (id == "xarm"));
        let limp_ns = bench.wait_until("the joints that can be reached limp", |now| {
            !kept.iter().any(|&dof| now.torque_on[dof])
        })?;
        bench.wait_until("past all limits", |now| now.device_ns > gone_ns + HOLD_NS)?;
        let log = bench.control.take_motion_log();
        anyhow::ensure!(log.num_dropped == 0, "the motion was not logged as a whole");
        let still_ns = still_from_ns(&log.steps, &lost, gone_ns).map(|at_ns| at_ns - gone_ns);
        let still_ms = still_ns.map(|ns| ns / MS);
        // Limp fingers fall: what counts is how far they went before.
        let mut driven = log.steps.iter().filter(|step| (gone_ns..=limp_ns).contains(&step.device_ns));
        let first = driven.next().context("no step between the two")?;
        let last = driven.next_back().unwrap_or(first);
        let way = |dof: &usize| (last.positions[*dof] - first.positions[*dof]).abs();
        let way_rad = kept.iter().map(way).fold(0.0, f64::max);
        eprintln!(
            "{id}: its joints still after {still_ms:?} ms, the others limp after {} ms and {way_rad:.3} rad",
            (limp_ns - gone_ns) / MS
        );
        let in_time = still_ns.is_some_and(|still_ns| still_ns <= HOLD_NS);
        anyhow::ensure!(in_time, "its own joints stood still after {still_ms:?} ms");
        anyhow::ensure!(way_rad < BRAKING_RAD, "another joint went on for {way_rad:.3} rad");
        anyhow::ensure!(limp_ns - gone_ns <= LIMP_NS, "limp after {} ms", (limp_ns - gone_ns) / MS);
    } else {
        // Motion needs no sense of touch.
        anyhow::ensure!(state.phase() == Phase::Armed, "{:?} {:?}", state.phase(), state.reason);
        let dof = bench.dof("index_pip")?;
        for position in [0.3, 0.5] {
            operator.must(targets(&[(dof, position)]))?;
            bench.wait_until("there", |now| (now.positions[dof] - position).abs() < 0.05)?;
        }
    }
    // Rates are those of the last second, which has to be one without the device.
    bench.wait_until("a second later", |now| now.device_ns > gone_ns + 1500 * MS)?;
    watcher.wait_for("the rates of the others", |state| {
        let pairs = others(&before).into_iter().zip(others(state));
        pairs.into_iter().all(|(then, now)| now.rate_hz > KEPT_RATE * then.rate_hz)
    })?;
    let state = watcher.wait_for("any state", |_| true)?;
    for (then, now) in others(&before).iter().zip(others(&state)) {
        let undisturbed = now.link() == Link::Ready && now.reconnects == then.reconnects;
        anyhow::ensure!(undisturbed, "{} is disturbed: {now:?} after {then:?}", now.id);
    }

    bench.set_faults("")?;
    let reconnects = before.devices[idx].reconnects;
    watcher.wait_for(&format!("{id} back"), |state| {
        all_ready(state) && state.devices[idx].reconnects > reconnects
    })?;
    if !moves {
        operator.must(Request::Disarm(Disarm {}))?;
    }
    watcher.wait_for("ready to be armed", |state| {
        state.phase() == Phase::Disarmed && !state.reason.contains("cannot be armed")
    })?;
    bench.wait_until("all limp", |now| !now.torque_on.contains(&true))?;
    starts_from_where_it_is(scene)
}

/// Somebody bends a limp finger away from where it was told to go; arming then moves nothing.
fn starts_from_where_it_is(scene: &Scene) -> anyhow::Result<()> {
    let Scene { watcher, bench, operator, .. } = scene;
    let joint = "index_pip";
    let dof = bench.dof(joint)?;
    let before = bench.control.snapshot().positions[dof];
    let (speed, far) = if before > 0.6 { (-1.0, before - 0.3) } else { (1.0, before + 0.3) };
    bench.control.push(joint, Push::Speed(speed))?;
    bench.wait_until("bent by hand", |now| (now.positions[dof] - far) * speed > 0.0)?;
    bench.control.push(joint, Push::NONE)?;
    // Nothing holds it, so it may swing on for a moment.
    bench.wait_until("at rest", |now| now.velocities.iter().all(|velocity| velocity.abs() < 0.02))?;
    let at_rest = bench.control.snapshot().positions;
    bench.control.log_motion(60_000);
    operator.arm(watcher)?;
    thread::sleep(Duration::from_millis(500));
    let log = bench.control.take_motion_log();
    for (dof, rest) in at_rest.iter().enumerate() {
        let far = log.steps.iter().map(|step| (step.positions[dof] - rest).abs()).fold(0.0, f64::max);
        anyhow::ensure!(far < STARTS_WITHIN_RAD, "joint {dof} went {far:.3} rad by arming alone");
    }
    let goal = if at_rest[dof] > 0.6 { at_rest[dof] - 0.2 } else { at_rest[dof] + 0.2 };
    operator.must(targets(&[(dof, goal)]))?;
    bench.wait_until("moved as told", |now| (now.positions[dof] - goal).abs() < 0.05)?;
    Ok(())
}
