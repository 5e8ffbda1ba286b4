//! Somebody takes control and moves the robot; others watch.

use palpate_emulator::Push;
use palpate_wire::proto::{
    Acquire, Arm, Heartbeat, LeadThrough, Release, Tare, control_request::Request, control_state::Phase,
};

use crate::bench::{Bench, Operator, targets};

#[test]
fn an_operator_moves_a_finger_and_everybody_sees_it() {
    let bench = Bench::new();
    let operator = Operator::armed(&bench, 1);
    let dof = bench.dof("index_mcp_forward");
    let from = bench.emulated.snapshot().positions[dof];
    let to = from + 0.3;
    operator.accepted(targets(&[dof], &[to]));
    bench.wait_until("there", |now| (now.positions[dof] - to).abs() < 0.05);
    let frame =
        bench.wait_for_frame("seen there", |frame| (f64::from(frame.joint_positions[dof]) - to).abs() < 0.05);
    let state = frame.control.expect("the station can be commanded");
    assert_eq!((state.phase(), state.holder.as_str()), (Phase::Armed, "operator 1"));
    assert!((f64::from(state.commanded[dof]) - to).abs() < 1e-3);
    // Everything else a page shows is there too.
    let station = bench.handle.station();
    assert_eq!(frame.joint_positions.len(), station.robot.num_dofs());
    assert_eq!(frame.raw.len(), station.layout.num_channels());
    assert_eq!(frame.rates_hz.len(), 1 + station.layout.streams.len());
    assert!(frame.rates_hz.iter().all(|rate| *rate > 5.0), "{:?}", frame.rates_hz);
    assert!(state.loop_hz > 50.0 && state.loop_mean_hz > 50.0, "{} {}", state.loop_hz, state.loop_mean_hz);
    assert!(state.latency_ms > 0.0 && state.latency_p95_ms > 0.0);
    assert_eq!(state.devices.len(), station.devices.len());
    assert!(bench.num_frames() > 10);
    // The arm moves as well.
    let dof = bench.dof("joint1");
    operator.accepted(targets(&[dof], &[0.1]));
    bench.wait_until("the arm there", |now| (now.positions[dof] - 0.1).abs() < 0.005);
    operator.accepted(Request::Release(Release {}));
    bench.wait_until("limp", |now| !now.torque_on.contains(&true));
    bench.wait_for("free", |state| state.holder.is_empty());
    bench.wait_for_audit("take control");
    bench.wait_for_audit("move joints");
    assert_eq!(bench.wait_for_audit("give control back").who, "operator 1");
}

#[test]
fn a_second_page_watches_and_cannot_command() {
    let bench = Bench::new();
    let operator = Operator::armed(&bench, 1);
    let watcher = Operator::watcher(&bench, 2);
    let dof = bench.dof("middle_pip");
    assert!(watcher.refused(targets(&[dof], &[0.4])).contains("watch only"));
    watcher.refused(Request::Arm(Arm {}));
    watcher.refused(Request::Heartbeat(Heartbeat {}));
    watcher.refused(Request::Tare(Tare {}));
    let acquire = |take_over| Request::Acquire(Acquire { operator: "second".to_owned(), take_over });
    assert!(watcher.refused(acquire(false)).contains("operator 1"));
    bench.wait_for_phase(Phase::Armed);
    // A person may take over; the first is told so, and joints let go.
    assert_ne!(watcher.accepted(acquire(true)).lease, operator.lease());
    assert!(operator.refused(targets(&[dof], &[0.4])).contains("take control"));
    bench.wait_until("limp", |now| !now.torque_on.contains(&true));
}

#[test]
fn what_makes_no_sense_is_refused_and_moves_nothing() {
    let bench = Bench::new();
    let operator = Operator::armed(&bench, 1);
    let dof = bench.dof("ring_pip");
    bench.emulated.log_motion(20_000);
    assert!(operator.refused(targets(&[dof], &[f64::NAN])).contains("ring_pip"));
    assert!(operator.refused(targets(&[dof], &[f64::INFINITY])).contains("ring_pip"));
    assert!(operator.refused(targets(&[dof], &[9.0])).contains("limit"));
    assert!(operator.refused(targets(&[0, dof], &[0.2, -9.0])).contains("limit"));
    assert!(operator.refused(targets(&[dof, dof], &[0.2])).contains("one position for each"));
    assert!(operator.refused(targets(&[1000], &[0.2])).contains("1000"));
    bench.wait_for_phase(Phase::Armed);
    let log = bench.emulated.take_motion_log();
    let fastest =
        log.steps.iter().flat_map(|step| &step.velocities).fold(0.0, |most: f64, v| most.max(v.abs()));
    assert!(fastest < 0.3, "{fastest} rad/s");
}

#[test]
fn an_arm_that_is_led_by_hand_yields_and_then_holds_where_it_is() {
    let bench = Bench::new();
    let operator = Operator::armed(&bench, 1);
    let dof = bench.dof("joint1");
    operator.accepted(Request::LeadThrough(LeadThrough { on: true }));
    bench.wait_for("yielding", |state| state.lead_through);
    bench.wait_until("in manual mode", |now| now.arm.mode == 2);
    bench.emulated.push("joint1", Push::Speed(0.2)).unwrap();
    bench.wait_until("pushed", |now| now.positions[dof] > 0.1);
    bench.emulated.push("joint1", Push::NONE).unwrap();
    operator.accepted(Request::LeadThrough(LeadThrough { on: false }));
    bench.wait_for("holding itself", |state| !state.lead_through && state.phase() == Phase::Armed);
    bench.wait_until("out of manual mode", |now| now.arm.mode != 2);
    let led_to = bench.emulated.snapshot().positions[dof];
    assert!(led_to > 0.1);
    // It follows commands again, from there.
    operator.accepted(targets(&[dof], &[led_to - 0.05]));
    bench.wait_until("there", |now| (now.positions[dof] - led_to + 0.05).abs() < 0.01);
}

#[test]
fn a_tare_sets_the_readings_to_zero_and_is_logged() {
    let bench = Bench::new();
    let mut operator = Operator::watcher(&bench, 1);
    operator.take_control(false);
    operator.accepted(Request::Tare(Tare {}));
    let line = bench.wait_for_audit("took the zero");
    assert_eq!(line.who, "operator 1");
    let boards = bench.handle.station().devices.iter().filter(|device| device.dofs().is_empty()).count();
    assert!(line.what.contains(&format!("of {boards} tactile boards")), "{}", line.what);
    let frame = bench.frame().expect("frames are published");
    let noise: f32 = frame.raw.iter().map(|raw| raw.abs()).sum::<f32>() / frame.raw.len() as f32;
    assert!(noise < 30.0, "{noise}");
}
