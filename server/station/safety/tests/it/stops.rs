//! Stops, faults, lost telemetry and the arm in the operator's hands.

use palpate_safety::Phase;

use crate::bench::{ARM, Bench, FINGER, MS};

#[test]
fn a_stop_needs_no_lease_and_stays_until_it_is_reset_and_armed_again() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.aim(lease, &[(FINGER, 1.2)]).unwrap();
    bench.run(100, Some(lease));
    bench.supervisor.stop(bench.now_ns, "a passer-by");
    assert!(!bench.turn(10, Some(lease)).torque());
    assert_eq!(bench.phase(), Phase::Stopped);
    let refused = bench.supervisor.arm(bench.now_ns, lease).unwrap_err().to_string();
    assert_eq!(refused, "stopped by \"a passer-by\"; make sure that all is well, then reset the stop");
    assert!(bench.aim(lease, &[(FINGER, 1.0)]).is_err());
    assert!(!bench.run(1_000, Some(lease)).torque());
    bench.supervisor.reset_stop(bench.now_ns, lease).unwrap();
    assert_eq!(bench.phase(), Phase::Disarmed);
    assert!(!bench.run(1_000, Some(lease)).torque(), "reset does not arm");
    assert!(bench.supervisor.reset_stop(bench.now_ns, lease).is_err());
    bench.supervisor.arm(bench.now_ns, lease).unwrap();
    assert!(bench.run(1_000, Some(lease)).torque());
}

/// Joints that report `torque_on` and `velocity` at the bench's time.
fn report(bench: &mut Bench, torque_on: Option<bool>, velocity: f64) {
    for dof in 0..3 {
        bench.read(dof, 0.0, velocity, torque_on);
    }
    bench.supervisor.measured(bench.now_ns, &bench.measured);
}

#[test]
fn a_stop_is_confirmed_by_readings_taken_after_it() {
    let (mut bench, _) = Bench::armed([0.0; 3]);
    bench.telemetry = false;
    report(&mut bench, Some(false), 0.0);
    bench.supervisor.stop(bench.now_ns, "Ada");
    let confirmed = |bench: &Bench| bench.supervisor.status(bench.now_ns).stop_confirmed;
    bench.now_ns += 5 * MS;
    assert!(!confirmed(&bench), "what was read before the stop says nothing");
    report(&mut bench, Some(true), 0.0);
    assert!(!confirmed(&bench), "torque is on, and stillness takes 100 ms to show");
    report(&mut bench, Some(false), 1.0);
    bench.now_ns += 5 * MS;
    report(&mut bench, Some(false), 1.0);
    assert!(confirmed(&bench), "torque is off");
    bench.now_ns += 251 * MS;
    assert!(!confirmed(&bench), "what is not seen now is not known to have stopped");
}

#[test]
fn stillness_confirms_a_stop_after_100_ms() {
    let (mut bench, _) = Bench::armed([0.0; 3]);
    bench.telemetry = false;
    bench.supervisor.stop(bench.now_ns, "Ada");
    let stopped_ns = bench.now_ns;
    for _ in 0..3 {
        bench.now_ns += 10 * MS;
        report(&mut bench, Some(true), 0.2);
    }
    while !bench.supervisor.status(bench.now_ns).stop_confirmed {
        bench.now_ns += 10 * MS;
        report(&mut bench, Some(true), 0.01);
        assert!(bench.now_ns < stopped_ns + 1_000 * MS, "never confirmed");
    }
    // Still from 40 ms after the stop on.
    assert_eq!(bench.now_ns - stopped_ns, 140 * MS);
    bench.now_ns += 10 * MS;
    bench.measured.lost(&[ARM]);
    report(&mut bench, None, 0.0);
    bench.measured.lost(&[ARM]);
    bench.supervisor.measured(bench.now_ns, &bench.measured);
    assert!(!bench.supervisor.status(bench.now_ns).stop_confirmed);
}

#[test]
fn a_fault_a_lost_device_and_a_motor_that_lets_go_disarm() {
    type Harm = fn(&mut Bench);
    let harms: [(Harm, &str, u64); 3] = [
        (
            |bench| bench.measured.set_fault("u2d2", Some(FINGER), "overload"),
            "device \"u2d2\", joint \"finger\": overload",
            300,
        ),
        (|bench| bench.measured.lost(&[FINGER]), "the device of joint \"finger\" is gone", 300),
        (
            |bench| {
                bench.now_ns += MS;
                bench.read(FINGER, 0.1, 0.0, Some(false));
            },
            "the motor of joint \"finger\" let go",
            100,
        ),
    ];
    for (harm, expected, catch_up_ms) in harms {
        let (mut bench, lease) = Bench::armed([0.0; 3]);
        bench.aim(lease, &[(FINGER, 1.2), (ARM, 1.0)]).unwrap();
        let before = bench.run(200, Some(lease));
        harm(&mut bench);
        bench.supervisor.measured(bench.now_ns, &bench.measured);
        assert_eq!(bench.phase(), Phase::Disarming);
        let braking = bench.turn(10, Some(lease));
        assert!(braking.torque() && braking.velocities()[ARM] < before.velocities()[ARM]);
        while bench.turn(10, Some(lease)).velocities().iter().any(|&velocity| velocity != 0.0) {}
        assert!(bench.run(catch_up_ms - 10, Some(lease)).torque(), "motors catch up with their goals");
        assert!(!bench.turn(10, Some(lease)).torque());
        assert!(bench.reason().starts_with(expected), "{}", bench.reason());
    }
}

#[test]
fn disarming_while_all_is_well_lets_go_once_motors_have_caught_up() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.aim(lease, &[(FINGER, 1.2), (ARM, 1.0)]).unwrap();
    bench.run(200, Some(lease));
    bench.supervisor.disarm(bench.now_ns, lease).unwrap();
    while bench.turn(10, Some(lease)).velocities().iter().any(|&velocity| velocity != 0.0) {}
    assert!(bench.run(90, Some(lease)).torque());
    assert!(!bench.turn(10, Some(lease)).torque());
}

#[test]
fn without_telemetry_it_holds_then_disarms() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.aim(lease, &[(ARM, 1.0)]).unwrap();
    bench.turn(10, Some(lease));
    bench.telemetry = false;
    bench.run(250, Some(lease));
    assert_eq!(bench.phase(), Phase::Armed);
    bench.turn(10, Some(lease));
    assert_eq!(
        (bench.phase(), bench.reason().as_str()),
        (Phase::Holding, "nothing is read of joint \"arm\"; check its device")
    );
    assert!(bench.run(140, Some(lease)).torque());
    assert!(bench.reason().contains("was last read 0.40 s ago"), "{}", bench.reason());
    assert!(bench.run(150, Some(lease)).torque(), "goals may come late, and motors catch up with them");
    assert!(!bench.run(200, Some(lease)).torque());
}

#[test]
fn the_arm_in_the_operators_hands_does_not_jump_when_it_holds_again() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.supervisor.lead_through(bench.now_ns, lease, true).unwrap();
    assert!(bench.turn(10, Some(lease)).lead_through());
    assert!(bench.aim(lease, &[(ARM, 0.1)]).unwrap_err().starts_with("joint \"arm\" yields to your hands"));
    bench.aim(lease, &[(FINGER, 0.3)]).unwrap();
    bench.telemetry = false;
    let lead = |bench: &mut Bench, position: f64, velocity: f64| {
        bench.now_ns += 10 * MS;
        bench.read(ARM, position, velocity, Some(true));
        let finger = bench.last.as_ref().map_or(0.0, |last| last.positions()[FINGER]);
        bench.read(FINGER, finger, 0.0, Some(true));
        bench.read(2, 0.0, 0.0, Some(true));
        bench.now_ns -= 10 * MS;
        bench.turn(10, Some(lease))
    };
    for step in 1..=50 {
        let position = f64::from(step) * 0.01;
        assert_eq!(lead(&mut bench, position, 1.0).positions()[ARM], position);
    }
    bench.supervisor.lead_through(bench.now_ns, lease, false).unwrap();
    assert!(lead(&mut bench, 0.52, 1.0).lead_through(), "it still moves");
    assert_eq!(bench.reason(), "let go of the arm; it holds once it stands still");
    let mut setpoint = lead(&mut bench, 0.53, 0.0);
    for _ in 0..10 {
        assert!(setpoint.lead_through());
        setpoint = lead(&mut bench, 0.53, 0.0);
    }
    assert!(!setpoint.lead_through() && setpoint.positions()[ARM] == 0.53, "{setpoint:?}");
    assert_eq!(bench.phase(), Phase::Arming);
    lead(&mut bench, 0.53, 0.0);
    assert_eq!(bench.phase(), Phase::Armed);
    bench.aim(lease, &[(ARM, 0.6)]).unwrap();
    assert!((bench.last.as_ref().unwrap().positions()[FINGER] - 0.3).abs() < 1e-6);
}

#[test]
fn an_arm_led_beyond_its_limits_does_not_hold_there() {
    let (mut bench, lease) = Bench::armed([1.4, -0.5, 0.0]);
    bench.supervisor.lead_through(bench.now_ns, lease, true).unwrap();
    bench.telemetry = false;
    let at = |bench: &mut Bench, position: f64, lease| {
        for _ in 0..12 {
            bench.now_ns += 10 * MS;
            for (dof, position) in [position, -0.5, 0.0].into_iter().enumerate() {
                bench.read(dof, position, 0.0, Some(true));
            }
            bench.now_ns -= 10 * MS;
            bench.turn(10, lease);
        }
    };
    at(&mut bench, 1.6, Some(lease));
    bench.supervisor.lead_through(bench.now_ns, lease, false).unwrap();
    at(&mut bench, 1.6, Some(lease));
    assert!(
        bench.reason().starts_with("joint \"arm\" is at 1.6000 rad, above its limit"),
        "{}",
        bench.reason()
    );
    assert!(bench.last.as_ref().unwrap().lead_through());
    // With the operator gone it neither holds there nor goes anywhere.
    at(&mut bench, 1.6, None);
    at(&mut bench, 1.6, None);
    assert_eq!(bench.phase(), Phase::Disarmed);
    assert!(bench.reason().contains("above its limit"), "{}", bench.reason());
}

#[test]
fn an_operator_who_is_gone_leads_nothing() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.supervisor.lead_through(bench.now_ns, lease, true).unwrap();
    bench.run(140, None);
    assert!(bench.last.as_ref().unwrap().lead_through());
    let setpoint = bench.turn(10, None);
    assert!(setpoint.torque() && !setpoint.lead_through());
    assert_eq!(bench.phase(), Phase::Holding);
}

#[test]
fn shutting_down_brakes_lets_go_and_is_confirmed_by_readings_alone() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.aim(lease, &[(FINGER, 1.2)]).unwrap();
    let moving = bench.run(200, Some(lease));
    assert!(moving.velocities()[FINGER] > 1.0);
    bench.supervisor.shut_down(bench.now_ns);
    assert!(bench.supervisor.heartbeat(bench.now_ns, bench.now_ns, lease).is_err(), "the lease is void");
    let braking = bench.turn(10, None);
    assert!(braking.torque() && braking.velocities()[FINGER] > 0.0, "it brakes before it lets go");
    assert_eq!(bench.supervisor.not_let_go(bench.now_ns).len(), 3, "torque is on");
    bench.telemetry = false;
    for _ in 0..40 {
        // Readings go on to say that motors hold.
        for dof in 0..3 {
            bench.read(dof, braking.positions()[dof], 0.0, Some(true));
        }
        bench.turn(10, None);
    }
    assert!(!bench.turn(10, None).torque());
    assert_eq!(
        bench.supervisor.not_let_go(bench.now_ns).len(),
        3,
        "a motor that holds at rest has not let go"
    );
    for dof in [ARM, FINGER] {
        bench.read(dof, 0.0, 0.0, Some(false));
    }
    bench.turn(10, None);
    assert_eq!(bench.supervisor.not_let_go(bench.now_ns), ["rail"]);
    bench.read(2, 0.0, 0.0, Some(false));
    bench.turn(10, None);
    assert!(bench.supervisor.not_let_go(bench.now_ns).is_empty());
    bench.now_ns += 300 * MS;
    assert_eq!(bench.supervisor.not_let_go(bench.now_ns).len(), 3, "what is not read now is not known");
}
