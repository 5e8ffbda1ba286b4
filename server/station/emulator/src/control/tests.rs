//! A station that is looked at, pushed and rearranged from outside.

use std::path::Path;

use palpate_device_protocol::dynamixel::{Instruction, Request};
use palpate_device_protocol::xarm::{Command, Protocol};

use super::*;
use crate::{EmulatedStation, Fault};

const MS_NS: u64 = 1_000_000;
const S_NS: u64 = 1000 * MS_NS;

fn station() -> EmulatedStation {
    let truth = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/truth/demo.toml");
    EmulatedStation::new(&truth, 0).expect("the demonstration's station")
}

fn dof(station: &EmulatedStation, name: &str) -> usize {
    station.station().robot.dofs().position(|joint| joint.name == name).expect("a joint of this name")
}

/// Enables the arm in `mode`.
fn enable(station: &mut EmulatedStation, mode: u8, now_ns: u64) {
    let client = station.connect();
    for command in [
        Command::MotionEnable { joint: 8, on: 1 },
        Command::SetMode { mode, detection: None },
        Command::SetState { state: 0 },
    ] {
        let frame = command.to_frame(1, Protocol::Plain).and_then(|frame| frame.encode()).expect("a frame");
        station.arm_input(client, &frame, now_ns);
    }
}

fn write(station: &mut EmulatedStation, id: u8, address: u16, data: &[u8], now_ns: u64) {
    let instruction = Instruction::Write { address, data: data.to_vec() };
    let bytes = Request { id, instruction }.encode().expect("a request");
    station.line_input(0, &bytes, now_ns);
}

#[test]
fn snapshots_tell_where_everything_truly_is_and_what_is_driven() {
    let mut station = station();
    let control = station.control();
    let start = control.snapshot();
    assert_eq!((start.device_ns, start.object.as_deref()), (0, Some("sphere_50mm")));
    assert_eq!(start.positions, station.positions());
    assert!(start.torque_on.iter().all(|on| !on));
    enable(&mut station, 2, 0);
    write(&mut station, 4, 64, &[1], 0);
    station.advance(20 * MS_NS + 300);
    let now = control.snapshot();
    assert_eq!(now.device_ns, 20 * MS_NS);
    // The fifth servo is the middle finger's first joint; the flag is per joint, in the station's order.
    let driven: Vec<usize> = (0..now.torque_on.len()).filter(|&dof| now.torque_on[dof]).collect();
    let mut expected = station.station().carrier_dofs.clone();
    expected.push(dof(&station, "middle_mcp_side"));
    expected.sort_unstable();
    assert_eq!(driven, expected);
    assert_eq!(now.arm, ArmSnapshot { mode: 2, state: 2, error: 0, warning: 0 });
}

#[test]
fn objects_come_and_go_and_nothing_else_changes() {
    let run = |objects: &[Option<&str>]| {
        let mut station = station();
        let control = station.control();
        write(&mut station, 0, 64, &[1], 0);
        write(&mut station, 0, 116, &2300_u32.to_le_bytes(), MS_NS);
        for (idx, id) in objects.iter().enumerate() {
            control.place_object(*id).expect("an object");
            station.advance((idx as u64 + 1) * 100 * MS_NS);
            assert_eq!(control.snapshot().object.as_deref(), *id);
        }
        control.snapshot()
    };
    let (one, other) = (Some("sphere_50mm"), Some("cylinder_25x100mm"));
    let (kept, changed) = (run(&[one, one, one]), run(&[other, None, one]));
    assert_eq!(kept, changed);
    assert!(kept.positions[dof(&station(), "index_mcp_side")].abs() > 0.1, "it moved meanwhile");

    let control = station().control();
    let error = control.place_object(Some("teapot")).expect_err("no teapot").to_string();
    assert!(error.contains("\"teapot\"; expected one of cylinder_25x100mm, sphere_50mm"), "{error}");
}

#[test]
fn faults_are_set_and_told_from_outside() {
    let mut station = station();
    let control = station.control();
    assert_eq!(control.faults(), Faults::default());
    let wanted = Faults { faults: vec![Fault::EmergencyStop, Fault::Stuck { joint: "index_pip".into() }] };
    control.set_faults(wanted.clone()).expect("faults");
    assert_eq!(control.faults(), wanted, "at once");
    station.advance(10 * MS_NS);
    assert_eq!((station.faults(), control.snapshot().arm.error), (&wanted, 1));
    // As the file would say it.
    let text = wanted.to_toml().expect("a file");
    assert_eq!(Faults::parse("faults.toml", &text, control.station()).expect("a file"), wanted);
    station.set_faults(Faults::default(), 20 * MS_NS);
    assert_eq!(control.faults(), Faults::default(), "the newest counts");
    let wrong = Faults { faults: vec![Fault::Unplug { device: "twintac9".into() }] };
    let error = control.set_faults(wrong).expect_err("no such board").to_string();
    assert!(error.contains("fault 1: no device \"twintac9\""), "{error}");
    assert_eq!(control.faults(), Faults::default());
}

#[test]
fn pushes_lead_the_arm_in_lead_through_alone_and_stay_within_its_limits() {
    let mut station = station();
    let control = station.control();
    let joint = dof(&station, "joint3");
    let start = station.positions()[joint];
    control.push("joint3", Push::Speed(0.5)).expect("a joint");
    // Brakes hold, and so does position mode.
    station.advance(S_NS);
    enable(&mut station, 0, S_NS);
    station.advance(2 * S_NS);
    assert_eq!(station.positions()[joint], start);
    enable(&mut station, 2, 2 * S_NS);
    station.advance(3 * S_NS);
    let led = control.snapshot();
    assert!((led.velocities[joint] - 0.5).abs() < 0.03 && led.arm.state == 1, "{led:?}");
    assert!((led.positions[joint] - start - 0.48).abs() < 0.05, "{led:?}");
    let others = led.velocities.iter().enumerate().filter(|(dof, _)| *dof != joint);
    assert!(others.clone().all(|(_, velocity)| *velocity == 0.0), "{led:?}");
    // Let go, friction stops it; too little torque does not move it.
    control.push("joint3", Push::Torque(0.9)).expect("a joint");
    station.advance(4 * S_NS);
    let (stopped, snapshot) = (station.positions()[joint], control.snapshot());
    assert_eq!((snapshot.velocities[joint], snapshot.arm.state), (0.0, 2));
    control.push("joint3", Push::Torque(-20.0)).expect("a joint");
    station.advance(10 * S_NS);
    let limits = station.station().robot.dofs().nth(joint).and_then(|joint| joint.limits).expect("limits");
    let at = control.snapshot();
    assert!(stopped > at.positions[joint], "pushed back");
    assert!((at.positions[joint] - limits.lower).abs() < 0.01 && at.arm.error == 0, "{at:?}");

    assert!(control.push("joint3", Push::Speed(f64::NAN)).is_err());
    let error = control.push("elbow", Push::NONE).expect_err("no elbow").to_string();
    assert!(error.contains("no joint \"elbow\"; expected one of joint1"), "{error}");
}

#[test]
fn a_limp_finger_follows_a_push_and_a_driven_one_resists() {
    let moved = |torque: u8| {
        let mut station = station();
        let control = station.control();
        let joint = dof(&station, "index_mcp_forward");
        write(&mut station, 1, 64, &[torque], 0);
        let start = station.positions()[joint];
        control.push("index_mcp_forward", Push::Torque(0.03)).expect("a joint");
        station.advance(300 * MS_NS);
        station.positions()[joint] - start
    };
    let (limp, driven) = (moved(0), moved(1));
    assert!(limp > 0.15 && driven > 0.001 && driven < 0.3 * limp, "{limp} {driven}");
}

#[test]
fn the_motion_log_has_every_step_in_device_time_and_is_bounded() {
    let mut station = station();
    let control = station.control();
    station.advance(50 * MS_NS);
    assert_eq!(control.take_motion_log(), MotionLog::default(), "nothing is logged unless asked for");
    control.log_motion(1000);
    write(&mut station, 1, 64, &[1], 50 * MS_NS);
    write(&mut station, 1, 112, &20_u32.to_le_bytes(), 50 * MS_NS);
    write(&mut station, 1, 116, &2500_u32.to_le_bytes(), 50 * MS_NS);
    // However far the clock jumps, no step is left out.
    station.advance(150 * MS_NS);
    let log = control.take_motion_log();
    assert_eq!((log.steps.len(), log.num_dropped), (100, 0));
    assert!(log.steps.iter().enumerate().all(|(idx, step)| step.device_ns == (51 + idx as u64) * MS_NS));
    let joint = dof(&station, "index_mcp_forward");
    for pair in log.steps.windows(2) {
        let moved = pair[1].positions[joint] - pair[0].positions[joint];
        assert!((moved - pair[1].velocities[joint] * 1e-3).abs() < 1e-9, "{moved}");
    }
    assert_eq!(log.still_since_ns(1e-6), None, "on the way");
    // Told at 50 ms, which the first logged step is the first to know.
    assert_eq!(log.last_goal_ns(), None);
    let (first, tick_rad) = (&log.steps[0], std::f64::consts::TAU / 4096.0);
    let goal = first.goals[joint].expect("torque is on");
    assert!((goal - (2500.0 - 2048.0) * tick_rad).abs() < 1e-9, "{goal}");
    assert_eq!(first.goals.iter().flatten().count(), 1, "the others are told nothing");
    // The host holds the joint where it is.
    write(&mut station, 1, 116, &2300_u32.to_le_bytes(), 150 * MS_NS);
    station.advance(2 * S_NS);
    let log = control.take_motion_log();
    assert_eq!((log.steps.len(), log.num_dropped), (1000, 850), "the newest second");
    let still_ns = log.still_since_ns(1e-3).expect("arrived");
    assert!(still_ns < 2 * S_NS, "{still_ns}");
    assert_eq!(log.last_goal_ns(), None, "told before the newest second");
    control.log_motion(1000);
    write(&mut station, 1, 116, &2400_u32.to_le_bytes(), 2 * S_NS + 100 * MS_NS);
    station.advance(2 * S_NS + 500 * MS_NS);
    let told_ns = control.take_motion_log().last_goal_ns();
    assert_eq!(told_ns, Some(2 * S_NS + 101 * MS_NS));
    control.log_motion(0);
    station.advance(3 * S_NS);
    assert_eq!(control.take_motion_log(), MotionLog::default());
}

#[test]
fn a_servo_whose_host_falls_silent_stops_within_its_watchdogs_time_by_the_stations_clock() {
    let mut station = station();
    let control = station.control();
    write(&mut station, 1, 64, &[1], 0);
    write(&mut station, 1, 112, &20_u32.to_le_bytes(), 0);
    // Five times 20 ms.
    write(&mut station, 1, 98, &[5], 0);
    control.log_motion(2000);
    let silent_ns = 200 * MS_NS;
    for ms in (0..=200).step_by(50) {
        write(&mut station, 1, 116, &2700_u32.to_le_bytes(), ms * MS_NS);
    }
    // The clock is looked at once, long after.
    station.advance(2 * S_NS);
    let log = control.take_motion_log();
    let joint = dof(&station, "index_mcp_forward");
    let speed =
        |ns: u64| log.steps.iter().find(|step| step.device_ns == ns).map(|step| step.velocities[joint]);
    assert!(speed(silent_ns + 90 * MS_NS).expect("a step") > 0.3, "still fed");
    let still_ns = log.still_since_ns(0.05).expect("it stops") - silent_ns;
    assert!((100 * MS_NS..250 * MS_NS).contains(&still_ns), "{still_ns}");
    assert!(control.snapshot().torque_on[joint], "it holds");
}
