//! The box as a client sees it: frames in, frames out, joints that move.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use palpate_device_protocol::xarm::{Command, Frame, Protocol, Reply, ReportDecoder, ReportKind};
use palpate_recording::load_station;
use palpate_robot_model::Station;
use proptest::prelude::*;

use super::*;

const START_RAD: [f64; 6] = [0.0, 0.0, -1.2, 0.0, 1.2, 0.0];
const STEP_S: f64 = 1e-3;

fn station() -> Arc<Station> {
    static STATION: OnceLock<Arc<Station>> = OnceLock::new();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/stations/xarm6_leap.toml");
    Arc::clone(STATION.get_or_init(|| Arc::new(load_station(&file).expect("the shipped station"))))
}

fn new_box() -> ArmBox {
    let station = station();
    let positions = vec![0.0; station.robot.num_dofs()];
    ArmBox::new(ArmModel::new(station, positions).expect("an arm"), START_RAD.to_vec())
}

fn ask(arm: &mut ArmBox, command: &Command) -> (StateFlags, Reply) {
    let request = command.to_frame(7, Protocol::KeepAlive).expect("a frame");
    let answer = arm.answer(&request).expect("an answer");
    assert_eq!(
        (answer.transaction, answer.protocol, answer.register),
        (7, request.protocol, request.register)
    );
    Reply::from_frame(&answer).expect("a reply")
}

fn flags(arm: &mut ArmBox, command: &Command) -> StateFlags {
    ask(arm, command).0
}

fn make_ready(arm: &mut ArmBox, mode: u8) {
    ask(arm, &Command::MotionEnable { joint: 8, on: 1 });
    ask(arm, &Command::SetMode { mode, detection: None });
    assert_eq!(flags(arm, &Command::SetState { state: 0 }), StateFlags::default());
}

fn wait(arm: &mut ArmBox, secs: f64) {
    (0..(secs / STEP_S) as usize).for_each(|_| arm.step(STEP_S));
}

fn state(arm: &mut ArmBox) -> u8 {
    match ask(arm, &Command::GetState {}).1 {
        Reply::State { state } => state,
        other => panic!("{other:?}"),
    }
}

fn errors(arm: &mut ArmBox) -> (u8, u8) {
    match ask(arm, &Command::GetError {}).1 {
        Reply::Error { error, warning } => (error, warning),
        other => panic!("{other:?}"),
    }
}

fn move_joints(joint: usize, by_rad: f64, speed_rad_per_sec: f64) -> Command {
    let mut joint_rad = report::slots(&START_RAD);
    joint_rad[joint] += by_rad;
    Command::MoveJoints { joint_rad, speed_rad_per_sec, acc_rad_per_sec2: 10.0, time_secs: 0.0 }
}

fn servo(joint: usize, by_rad: f64) -> Command {
    let mut joint_rad = report::slots(&START_RAD);
    joint_rad[joint] += by_rad;
    Command::ServoJoints { joint_rad, speed_rad_per_sec: 0.0, acc_rad_per_sec2: 0.0, time_secs: 0.0 }
}

#[test]
fn flange_is_where_the_vendor_says() {
    let arm = new_box();
    // The vendor's examples: joints (rad), position (mm), roll, pitch, yaw.
    for (joints_rad, position_mm, rpy_rad) in [
        ([0.0; 6], [207.0, 0.0, 112.0], [std::f64::consts::PI, 0.0, 0.0]),
        ([0.1, -0.2, -0.3, 0.4, 0.5, 0.6], [302.0018, 22.3986, 195.277], [-3.00462, 0.133_222, -0.842_954]),
        (
            [0.0, 0.081_803, -0.641_154, 0.0, 0.559_351, 0.0],
            [400.0, 0.0, 199.9983],
            [std::f64::consts::PI, 0.0, 0.0],
        ),
    ] {
        let pose = arm.model.base_from_flange(&joints_rad);
        for (found, expected) in pose.translation.vector.iter().zip(position_mm) {
            assert!((found * 1e3 - expected).abs() < 0.01, "{pose} against {position_mm:?}");
        }
        let [roll, pitch, yaw] = rpy_rad;
        let expected = nalgebra::UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        assert!(pose.rotation.angle_to(&expected) < 1e-4, "{pose} against {rpy_rad:?}");
    }
}

#[test]
fn nothing_moves_before_it_is_enabled_in_a_mode_and_ready() {
    let mut arm = new_box();
    assert_eq!((state(&mut arm), flags(&mut arm, &Command::GetState {})), (4, StateFlags::NOT_READY));
    let motion = move_joints(0, 0.5, 1.0);
    assert!(flags(&mut arm, &motion).contains(StateFlags::NOT_READY));
    ask(&mut arm, &Command::MotionEnable { joint: 8, on: 1 });
    assert!(flags(&mut arm, &motion).contains(StateFlags::NOT_READY), "state 4");
    make_ready(&mut arm, mode::SERVO);
    assert!(flags(&mut arm, &motion).contains(StateFlags::NOT_READY), "another mode");
    wait(&mut arm, 0.5);
    assert_eq!(arm.joints_rad, START_RAD);
}

#[test]
fn queued_motions_run_one_after_another_within_their_speed() {
    let mut arm = new_box();
    make_ready(&mut arm, mode::POSITION);
    assert_eq!(ask(&mut arm, &move_joints(0, 0.4, 0.5)).1, Reply::Queued { num_commands: 1 });
    assert_eq!(ask(&mut arm, &move_joints(1, 0.2, 0.5)).1, Reply::Queued { num_commands: 2 });
    let mut most = 0.0_f64;
    for _ in 0..500 {
        arm.step(STEP_S);
        most = most.max(arm.rad_per_sec[0].abs());
    }
    assert!((most - 0.5).abs() < 0.01, "{most}");
    assert_eq!((state(&mut arm), arm.joints_rad[1]), (1, 0.0));
    wait(&mut arm, 2.0);
    assert_eq!(state(&mut arm), 2);
    assert!(
        (arm.joints_rad[0]).abs() < 1e-6 && (arm.joints_rad[1] - 0.2).abs() < 1e-6,
        "{:?}",
        arm.joints_rad
    );
}

#[test]
fn a_pause_holds_and_a_stop_forgets() {
    let mut arm = new_box();
    make_ready(&mut arm, mode::POSITION);
    ask(&mut arm, &move_joints(0, 1.0, 0.5));
    wait(&mut arm, 0.5);
    ask(&mut arm, &Command::SetState { state: 3 });
    wait(&mut arm, 0.3);
    let paused_rad = arm.joints_rad[0];
    wait(&mut arm, 0.5);
    assert_eq!((state(&mut arm), arm.joints_rad[0]), (3, paused_rad));
    assert_eq!(flags(&mut arm, &Command::SetState { state: 0 }), StateFlags::default());
    wait(&mut arm, 0.3);
    assert!(arm.joints_rad[0] > paused_rad + 0.05);
    ask(&mut arm, &Command::SetState { state: 4 });
    wait(&mut arm, 0.3);
    let stopped_rad = arm.joints_rad[0];
    ask(&mut arm, &Command::SetState { state: 0 });
    wait(&mut arm, 1.0);
    assert_eq!((state(&mut arm), arm.joints_rad[0]), (2, stopped_rad), "the rest of the way is forgotten");
}

#[test]
fn a_line_is_straight_and_where_no_joints_reach_an_error() {
    let mut arm = new_box();
    make_ready(&mut arm, mode::POSITION);
    let start = arm.model.base_from_flange(&arm.joints_rad);
    let line = |z_m: f64| {
        let mut pose = kinematics::to_pose(&start);
        pose.position_m[2] += z_m;
        Command::MoveLine { pose, speed_m_per_sec: 0.1, acc_m_per_sec2: 1.0, time_secs: 0.0, tail: None }
    };
    ask(&mut arm, &line(-0.08));
    let mut most_m_per_sec = 0.0_f64;
    for _ in 0..1500 {
        arm.step(STEP_S);
        let now = arm.model.base_from_flange(&arm.joints_rad);
        let off = (now.translation.vector - start.translation.vector).xy().norm();
        assert!(off < 1e-5 && now.rotation.angle_to(&start.rotation) < 1e-4, "{off} m off the line");
        most_m_per_sec = most_m_per_sec.max(arm.tool_twist()[2].abs());
    }
    let end = arm.model.base_from_flange(&arm.joints_rad);
    assert!((end.translation.z - start.translation.z + 0.08).abs() < 1e-6, "{end}");
    assert!((most_m_per_sec - 0.1).abs() < 0.01, "{most_m_per_sec}");
    ask(&mut arm, &line(2.0));
    wait(&mut arm, 0.1);
    assert_eq!((errors(&mut arm).0, state(&mut arm)), (error::KINEMATICS, 4));
}

#[test]
fn servo_mode_chases_its_target_at_once_within_the_arms_limits() {
    let mut arm = new_box();
    make_ready(&mut arm, mode::SERVO);
    assert_eq!(flags(&mut arm, &servo(0, 1.0)), StateFlags::default());
    let mut most = (0.0_f64, 0.0_f64);
    for _ in 0..1500 {
        arm.step(STEP_S);
        most = (most.0.max(arm.rad_per_sec[0].abs()), most.1.max(arm.rad_per_sec2[0].abs()));
    }
    assert!((arm.joints_rad[0] - 1.0).abs() < 1e-3, "{:?}", arm.joints_rad);
    assert!(most.0 <= MOST_RAD_PER_SEC + 1e-9 && most.0 > 2.0 && most.1 <= 20.0 + 1e-6, "{most:?}");
    let refused = flags(&mut arm, &servo(1, 3.0));
    assert!(refused.contains(StateFlags::ERROR));
    assert_eq!((errors(&mut arm).0, state(&mut arm)), (error::JOINT_LIMIT, 4));
}

#[test]
fn joint_velocities_last_as_long_as_they_say_and_end_at_a_limit() {
    let mut arm = new_box();
    make_ready(&mut arm, mode::JOINT_VELOCITY);
    let velocity = |rad_per_sec: f64, duration_secs| Command::JointVelocity {
        joint_rad_per_sec: report::slots(&[rad_per_sec]),
        sync: 1,
        duration_secs,
    };
    ask(&mut arm, &velocity(0.5, Some(0.4)));
    wait(&mut arm, 1.0);
    assert!((arm.joints_rad[0] - 0.2).abs() < 0.02, "{:?}", arm.joints_rad);
    ask(&mut arm, &velocity(3.0, None));
    wait(&mut arm, 3.0);
    let upper_rad = arm.model.limits(0).unwrap().upper;
    assert_eq!((errors(&mut arm).0, arm.joints_rad[0]), (error::JOINT_LIMIT, upper_rad));
}

#[test]
fn the_stop_button_cuts_power_until_it_is_released_and_cleared() {
    let mut arm = new_box();
    make_ready(&mut arm, mode::POSITION);
    ask(&mut arm, &move_joints(0, 1.0, 0.5));
    wait(&mut arm, 0.5);
    arm.press_stop(true);
    arm.step(STEP_S);
    let stopped_rad = arm.joints_rad[0];
    wait(&mut arm, 0.5);
    assert_eq!(arm.joints_rad[0], stopped_rad, "brakes hold at once");
    assert_eq!(flags(&mut arm, &Command::ClearError {}), StateFlags(0x50), "still pressed");
    arm.press_stop(false);
    arm.step(STEP_S);
    assert_eq!(errors(&mut arm), (error::EMERGENCY_STOP, 0), "released is not cleared");
    ask(&mut arm, &Command::ClearError {});
    assert!(flags(&mut arm, &Command::SetState { state: 0 }).contains(StateFlags::NOT_READY), "not enabled");
    make_ready(&mut arm, mode::POSITION);
    ask(&mut arm, &move_joints(0, 0.0, 0.5));
    wait(&mut arm, 2.0);
    assert!(arm.joints_rad[0].abs() < 1e-6);
}

#[test]
fn a_collision_stops_the_arm_with_its_error() {
    let mut arm = new_box();
    make_ready(&mut arm, mode::POSITION);
    ask(&mut arm, &move_joints(0, 1.0, 0.5));
    wait(&mut arm, 0.5);
    arm.collide();
    wait(&mut arm, 0.3);
    assert_eq!((errors(&mut arm), state(&mut arm)), ((error::COLLISION, 0), 4));
    assert!(flags(&mut arm, &move_joints(0, 0.0, 0.5)).contains(StateFlags::ERROR));
    ask(&mut arm, &Command::SetState { state: 0 });
    assert_eq!(state(&mut arm), 4, "an error keeps it stopped");
}

#[test]
fn the_fence_and_reduced_mode_bound_motion() {
    let mut arm = new_box();
    make_ready(&mut arm, mode::POSITION);
    ask(&mut arm, &Command::SetReducedJointSpeed { speed_rad_per_sec: 0.2 });
    ask(&mut arm, &Command::SetReduced { on: 1 });
    ask(&mut arm, &move_joints(0, 1.0, 2.0));
    wait(&mut arm, 1.0);
    assert!((arm.rad_per_sec[0] - 0.2).abs() < 1e-6, "{:?}", arm.rad_per_sec);
    let bounds_mm = [2000, -2000, 150, -150, 2000, 0];
    ask(&mut arm, &Command::SetBoundary { bounds_mm });
    ask(&mut arm, &Command::SetFence { on: 1 });
    wait(&mut arm, 4.0);
    assert_eq!(errors(&mut arm).0, error::BOUNDARY);
    let y_mm = arm.model.base_from_flange(&arm.joints_rad).translation.y * 1e3;
    assert!((150.0..160.0).contains(&y_mm), "{y_mm}");
}

#[test]
fn reports_have_their_sizes_and_say_what_is() {
    let mut arm = new_box();
    make_ready(&mut arm, mode::SERVO);
    ask(&mut arm, &Command::SetTcpLoad { mass_kg: 0.61, center_m: [0.0, 0.0, 0.053] });
    make_ready(&mut arm, mode::SERVO);
    ask(&mut arm, &servo(2, 0.3));
    wait(&mut arm, 0.1);
    for (port, kind, size) in [
        (ReportPort::Normal, ReportKind::Normal, 145),
        (ReportPort::Rich, ReportKind::Normal, 587),
        (ReportPort::Real, ReportKind::Real, 135),
        (ReportPort::Realtime, ReportKind::Realtime, 804),
    ] {
        let bytes = arm.report(port, 1_000_000);
        assert_eq!(bytes.len(), size, "{port:?}");
        let seen = &ReportDecoder::new(kind).feed(&bytes)[0];
        assert_eq!((seen.declared_size as usize, seen.state, seen.mode), (size, 1, 1), "{port:?}");
        assert!((seen.joint_rad[2] - arm.joints_rad[2]).abs() < 1e-6);
        if let Some(safety) = seen.safety {
            assert_eq!(seen.ready(6), Some(true));
            assert!((safety.load_kg - 0.61).abs() < 1e-6 && (safety.load_center_m[2] - 0.053).abs() < 1e-6);
        }
        if let Some(realtime) = &seen.realtime {
            assert_eq!(realtime.box_time_us, 1000);
            assert!((realtime.joint_rad_per_sec[2] - arm.rad_per_sec[2]).abs() < 1e-5);
        }
    }
}

#[test]
fn unknown_registers_and_wrong_contents_are_answered_as_invalid() {
    let mut arm = new_box();
    let mut answer = |register: u8, content: &[u8]| {
        let request =
            Frame { transaction: 1, protocol: Protocol::Plain, register, content: content.to_vec() };
        let answer = arm.answer(&request).expect("an answer");
        (StateFlags(answer.content[0]).contains(StateFlags::INVALID), arm.warning)
    };
    assert_eq!(answer(0xC8, &[1, 2]), (true, warning::UNKNOWN_COMMAND));
    assert_eq!(answer(0x1D, &[1, 2, 3]), (true, warning::BAD_PARAMETER));
    // A target that is no number.
    let content: Vec<u8> = [f32::NAN; 10].iter().flat_map(|value| value.to_le_bytes()).collect();
    assert!(answer(0x1D, &content).0 && answer(0x18, &content).0);
    assert!(arm.answer(&Frame::heartbeat()).is_none());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]
    /// Whatever clients ask: no panic, every request is answered, joints stay finite and within their limits, and every
    /// stream goes on.
    #[test]
    fn any_requests_leave_the_arm_within_its_limits(
        requests in proptest::collection::vec(
            (prop_oneof![3 => 1_u8..0x60, 1 => any::<u8>()], prop_oneof![
                proptest::collection::vec(any::<u8>(), 0..60),
                proptest::collection::vec(0_u8..9, 1..3),
                proptest::collection::vec(-4.0_f32..4.0, 9..12)
                    .prop_map(|values| values.iter().flat_map(|value| value.to_le_bytes()).collect()),
            ]), 1..40),
        made_ready in any::<bool>(),
    ) {
        let mut arm = new_box();
        if made_ready {
            make_ready(&mut arm, mode::POSITION);
        }
        for (register, content) in requests {
            let request = Frame { transaction: 3, protocol: Protocol::Plain, register, content };
            prop_assert!(arm.answer(&request).is_some());
            wait(&mut arm, 0.01);
            prop_assert!(arm.joints_rad.iter().all(|angle| angle.is_finite()), "{:?}", arm.joints_rad);
            prop_assert_eq!(arm.model.beyond_limits(&arm.joints_rad), None);
        }
        for port in ReportPort::ALL {
            prop_assert!(!arm.report(port, 0).is_empty());
        }
    }
}
