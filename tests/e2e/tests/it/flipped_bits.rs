//! A minute in which every hundredth byte of every serial line has a wrong bit.

use std::{thread, time::Duration};

use e2e::{MS, Tools, targets};
use palpate_emulator::LineTraffic;
use palpate_wire::proto::{Arm, ControlState, control_request::Request, control_state::Phase};

use crate::scene::{Scene, all_ready, fault};

/// For how long, in the station's own time.
const MINUTE_NS: u64 = 60_000 * MS;
/// The joint is sent to and fro by this much, rad.
const REACH_RAD: f64 = 0.3;
/// And never leaves what was commanded by more, rad: a servo with soft gains overshoots a little.
const OVERSHOOT_RAD: f64 = 0.1;
/// Nobody sends the others anywhere, rad: they bear their loads, and sag where the torque goes off.
const OTHERS_RAD: f64 = 0.05;
/// Limit of the hand's joints with what a servo overshoots, rad/s.
const MOST_RAD_PER_S: f64 = 3.0 * 1.5;
/// Of the damaged answers and lines, the least share that a device's driver must have counted: the others were damaged
/// into other digits, which no line without a checksum can tell, or were not recognised as answers at all.
const LEAST_COUNTED: f64 = 0.3;
/// A board that sends rows of a matrix: a damaged row costs its frame the others too.
const ROWS_OF_FRAME: u64 = 3;
/// Rates afterwards, of those before.
const BACK_TO: f32 = 0.8;

#[test]
fn a_minute_of_wrong_bits_makes_no_wrong_motion_and_is_counted() {
    let Some(tools) = Tools::find() else { return };
    let scene = Scene::armed(&tools).unwrap();
    let Scene { operator, watcher, bench, .. } = &scene;
    let station = bench.control.station();
    let dof = bench.dof("index_pip").unwrap();
    let lines: Vec<String> =
        station.devices.iter().map(|device| device.id.clone()).filter(|id| id != "xarm").collect();
    let bad_frames = |state: &ControlState| -> Vec<u64> {
        let of = |id: &String| state.devices.iter().find(|device| device.id == *id).unwrap().bad_frames;
        lines.iter().map(of).collect()
    };
    let rates =
        |state: &ControlState| -> Vec<f32> { state.devices.iter().map(|device| device.rate_hz).collect() };
    let state = watcher
        .wait_for("full rates", |state| {
            state.devices.iter().all(|device| device.rate_hz > 0.9 * device.rate_mean_hz)
        })
        .unwrap();
    // A second may have held what an earlier one lacked.
    let full_rates: Vec<f32> =
        state.devices.iter().map(|device| device.rate_hz.min(device.rate_mean_hz)).collect();
    let counted = bad_frames(&state);
    let before = bench.control.snapshot();
    let (low, high) = (before.positions[dof] - REACH_RAD, before.positions[dof] + REACH_RAD);
    bench.control.log_motion(120_000);

    let flips: String = lines.iter().map(|id| fault("flip", id, "share = 0.01")).collect();
    bench.set_faults(&flips).unwrap();
    let begun_ns = bench.now_ns();
    let (mut accepted, mut refused, mut armed_again) = (0, 0, 0);
    while bench.now_ns() < begun_ns + MINUTE_NS {
        for position in [low, high] {
            // Where too little comes through, the safety layer holds or disarms, and says so.
            if operator.ask(targets(&[(dof, position)])).unwrap().accepted {
                accepted += 1;
            } else {
                refused += 1;
            }
            thread::sleep(Duration::from_millis(200));
        }
        let state = watcher.wait_for("any state", |_| true).unwrap();
        if state.phase() == Phase::Disarmed && operator.ask(Request::Arm(Arm {})).unwrap().accepted {
            armed_again += 1;
        }
    }
    bench.set_faults("").unwrap();
    let log = bench.control.take_motion_log();
    assert_eq!(log.num_dropped, 0);
    let num_dofs = before.positions.len();
    let most = |of: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
        (0..num_dofs).map(|dof| (0..log.steps.len()).map(|step| of(step, dof)).fold(0.0, f64::max)).collect()
    };
    let furthest = most(&|step, dof| (log.steps[step].positions[dof] - before.positions[dof]).abs());
    let fastest = most(&|step, dof| log.steps[step].velocities[dof].abs());
    let swings = log.steps.windows(2).filter(|pair| {
        let middle = before.positions[dof];
        (pair[0].positions[dof] < middle) != (pair[1].positions[dof] < middle)
    });
    eprintln!(
        "{accepted} accepted, {refused} refused, armed again {armed_again} times, {} swings\nfurthest {furthest:.3?}\n\
         fastest {fastest:.2?}",
        swings.count()
    );
    assert!(furthest[dof] < REACH_RAD + OVERSHOOT_RAD, "{furthest:?}");
    for other in (0..num_dofs).filter(|&other| other != dof) {
        assert!(furthest[other] < OTHERS_RAD, "joint {other} went {} rad", furthest[other]);
    }
    assert!(fastest.iter().all(|&fastest| fastest < MOST_RAD_PER_S), "{fastest:?}");

    // Everything is as before.
    let state = watcher
        .wait_for("every device to be ready at full rate again", |state| {
            all_ready(state) && rates(state).iter().zip(&full_rates).all(|(now, then)| *now > BACK_TO * then)
        })
        .unwrap();
    let after = bench.control.snapshot();
    for (idx, id) in lines.iter().enumerate() {
        let now = bad_frames(&state)[idx] - counted[idx];
        let [was, is]: [LineTraffic; 2] = [before.traffic[idx], after.traffic[idx]];
        let (sent, damaged) = (is.sent - was.sent, is.damaged - was.damaged);
        let bytes = is.flipped_bytes - was.flipped_bytes;
        eprintln!("{id}: {damaged} of {sent} damaged ({bytes} bytes), {now} counted");
        let rows = if id == "fsr" { ROWS_OF_FRAME } else { 1 };
        assert!(damaged > 0 && now <= damaged * rows, "{id}: {now} counted of {damaged}");
        assert!(now as f64 > LEAST_COUNTED * damaged as f64, "{id}: {now} counted of {damaged}");
    }
    if state.phase() != Phase::Armed {
        operator.arm(watcher).unwrap();
    }
    operator.must(targets(&[(dof, 0.45)])).unwrap();
    bench.wait_until("there", |now| (now.positions[dof] - 0.45).abs() < 0.05).unwrap();
}
