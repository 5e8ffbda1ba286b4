//! Each rule of leases, heartbeats, arming and targets, with its times.

use palpate_safety::{Lease, Phase, Refusal, Supervisor, disarm_begins_s};

use crate::bench::{ARM, Bench, FINGER, MS, RAIL, station, station_with, station_with_lower};

#[test]
fn one_operator_at_a_time_and_numbers_that_only_count_up() {
    let mut supervisor = Supervisor::new(&station());
    let first = supervisor.acquire(0, "Ada", false).unwrap();
    let refused = supervisor.acquire(1_000 * MS, "Ben", false).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "\"Ada\" has control for another 5.0 s; ask them to give it back, or take over"
    );
    let second = supervisor.acquire(1_000 * MS, "Ben", true).unwrap();
    assert_eq!((first, second), (Lease(1), Lease(2)));
    let refused = supervisor.heartbeat(1_001 * MS, 1_001 * MS, first).unwrap_err();
    assert_eq!(refused.to_string(), "lease 1 has ended, \"Ben\" has control now; take control again");
    supervisor.release(1_002 * MS, second).unwrap();
    assert!(supervisor.release(1_003 * MS, second).is_err());
    assert_eq!(supervisor.acquire(1_004 * MS, "Ada", false).unwrap(), Lease(3));
    assert_eq!(supervisor.acquire(1_005 * MS, " \n", true).unwrap_err(), Refusal::NoName);
}

#[test]
fn a_lease_lives_six_seconds_from_its_last_heartbeat() {
    let mut supervisor = Supervisor::new(&station());
    let lease = supervisor.acquire(0, "Ada", false).unwrap();
    supervisor.heartbeat(5_999 * MS, 5_999 * MS, lease).unwrap();
    supervisor.heartbeat(11_998 * MS, 11_998 * MS, lease).unwrap();
    assert_eq!(supervisor.status(17_997 * MS).holder, "Ada");
    assert_eq!(supervisor.status(17_998 * MS).holder, "");
    assert!(supervisor.heartbeat(17_998 * MS, 17_998 * MS, lease).is_err());
    assert_eq!(supervisor.acquire(17_998 * MS, "Ben", false).unwrap(), Lease(2));
}

#[test]
fn arming_starts_where_the_joints_are_and_forgets_old_targets() {
    let (mut bench, lease) = Bench::armed([0.2, 0.3, 0.05]);
    bench.aim(lease, &[(FINGER, 1.0)]).unwrap();
    bench.run(100, Some(lease));
    bench.supervisor.disarm(bench.now_ns, lease).unwrap();
    assert_eq!(bench.phase(), Phase::Disarming);
    assert!(!bench.run(200, Some(lease)).torque());
    assert_eq!((bench.phase(), bench.reason()), (Phase::Disarmed, String::new()));
    // Somebody moves the limp finger.
    bench.telemetry = false;
    bench.now_ns += 10 * MS;
    for (dof, position) in [0.2, -0.25, 0.05].into_iter().enumerate() {
        bench.read(dof, position, 0.0, Some(false));
    }
    bench.supervisor.measured(bench.now_ns, &bench.measured);
    bench.supervisor.arm(bench.now_ns, lease).unwrap();
    assert_eq!(bench.turn(10, Some(lease)).positions(), [0.2, -0.25, 0.05]);
    bench.telemetry = true;
    assert_eq!(bench.run(2_000, Some(lease)).positions(), [0.2, -0.25, 0.05], "the old target is gone");
}

#[test]
fn speeds_rise_from_zero_over_the_ease_in() {
    let mut bench = Bench::new(&station(), [0.0; 3]);
    let lease = bench.supervisor.acquire(bench.now_ns, "Ada", false).unwrap();
    bench.supervisor.arm(bench.now_ns, lease).unwrap();
    assert_eq!(bench.phase(), Phase::Arming);
    let refused = bench.aim(lease, &[(FINGER, 1.2)]).unwrap_err();
    assert_eq!(refused, "the station is still being armed; wait until the motors hold");
    bench.turn(10, Some(lease));
    bench.turn(10, Some(lease));
    assert_eq!(bench.phase(), Phase::Armed);
    bench.aim(lease, &[(FINGER, 1.2)]).unwrap();
    for step in 1..=50_u32 {
        let velocity = bench.turn(10, Some(lease)).velocities()[FINGER];
        // 3 rad/s in one second.
        let most = 0.03 * f64::from(step);
        assert!((velocity - most).abs() < 1e-9, "{velocity} rad/s after {step} steps, expected {most}");
    }
}

#[test]
fn arming_needs_every_joint_fresh_within_limits_and_no_fault() {
    let mut bench = Bench::new(&station(), [0.0; 3]);
    let lease = bench.supervisor.acquire(bench.now_ns, "Ada", false).unwrap();
    let arm = |bench: &mut Bench| match bench.supervisor.arm(bench.now_ns, lease) {
        Ok(()) => String::new(),
        Err(refusal) => refusal.to_string(),
    };
    let refresh = |bench: &mut Bench, finger: f64| {
        for (dof, position) in [0.0, finger, 0.0].into_iter().enumerate() {
            bench.read(dof, position, 0.0, Some(false));
        }
        bench.supervisor.measured(bench.now_ns, &bench.measured);
    };
    bench.now_ns += 251 * MS;
    assert_eq!(arm(&mut bench), "cannot be armed: joint \"arm\" was last read 0.25 s ago; check its device");
    bench.measured.lost(&[FINGER]);
    bench.supervisor.measured(bench.now_ns, &bench.measured);
    assert!(bench.reason().starts_with("cannot be armed: "), "{}", bench.reason());
    refresh(&mut bench, f64::NAN);
    assert_eq!(
        arm(&mut bench),
        "cannot be armed: joint \"finger\" reports positions that are no numbers; check its device"
    );
    bench.now_ns += MS;
    refresh(&mut bench, 1.26);
    assert_eq!(
        arm(&mut bench),
        "cannot be armed: joint \"finger\" is at 1.2600 rad, above its limit of 1.2000 rad; move it back by hand"
    );
    bench.now_ns += MS;
    bench.measured.set_fault("u2d2", Some(FINGER), "overload; clear the fault");
    refresh(&mut bench, 1.24);
    assert_eq!(
        arm(&mut bench),
        "cannot be armed: device \"u2d2\", joint \"finger\": overload; clear the fault"
    );
    bench.measured.set_fault("u2d2", None, "");
    bench.now_ns += MS;
    refresh(&mut bench, 1.24);
    assert_eq!(arm(&mut bench), "");
    let setpoint = bench.run(1_500, Some(lease));
    assert_eq!(setpoint.positions()[FINGER], 1.24, "encoder errors neither jump nor move by themselves");
    bench.aim(lease, &[(FINGER, 1.2)]).unwrap();
    assert!((bench.run(500, Some(lease)).positions()[FINGER] - 1.2).abs() < 1e-6);
}

#[test]
fn motors_that_never_hold_are_given_up() {
    let mut bench = Bench::new(&station(), [0.0; 3]);
    let lease = bench.supervisor.acquire(bench.now_ns, "Ada", false).unwrap();
    bench.supervisor.arm(bench.now_ns, lease).unwrap();
    bench.telemetry = false;
    for _ in 0..500 {
        assert_eq!(bench.phase(), Phase::Arming);
        bench.now_ns += 10 * MS;
        for dof in 0..3 {
            bench.read(dof, 0.0, 0.0, Some(dof != RAIL));
        }
        bench.now_ns -= 10 * MS;
        bench.turn(10, Some(lease));
    }
    assert_eq!(bench.phase(), Phase::Disarmed);
    assert!(bench.reason().starts_with("the motor of joint \"rail\" does not hold"), "{}", bench.reason());
}

#[test]
fn without_heartbeats_it_holds_after_150_ms_and_disarms_in_time_for_500() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.aim(lease, &[(FINGER, 1.2)]).unwrap();
    assert_eq!(bench.run(140, None).velocities()[FINGER], 3.0);
    assert_eq!(bench.phase(), Phase::Armed);
    assert!(bench.turn(10, None).velocities()[FINGER] < 3.0);
    assert_eq!(bench.phase(), Phase::Holding);
    let held = bench.run(80, None);
    assert!(held.torque() && held.velocities() == [0.0; 3], "{held:?}");
    assert!(bench.aim(lease, &[(FINGER, 0.0)]).unwrap_err().starts_with("the station holds: "));
    // Back in time: it follows again, but not what was wanted before.
    bench.run(50, Some(lease));
    assert_eq!((bench.phase(), bench.run(500, Some(lease)).positions()), (Phase::Armed, held.positions()));
    // Motors need some of the 500 ms to let go.
    assert!(bench.run(390, None).torque());
    assert!(!bench.turn(10, None).torque());
    assert_eq!(bench.phase(), Phase::Disarmed);
    assert_eq!(bench.reason(), "nothing was heard of the operator for 0.40 s; arm again");
    // The lease is still theirs, and a late heartbeat revives nothing.
    bench.supervisor.heartbeat(bench.now_ns, bench.now_ns, lease).unwrap();
    assert!(!bench.run(100, Some(lease)).torque());
}

#[test]
fn an_operator_whose_connection_was_closed_is_not_waited_for() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.aim(lease, &[(FINGER, 1.2)]).unwrap();
    assert_eq!(bench.run(100, Some(lease)).velocities()[FINGER], 3.0);
    bench.supervisor.operator_gone(bench.now_ns, Lease(lease.0 + 1));
    assert_eq!(bench.phase(), Phase::Armed, "that one moves nothing");
    bench.supervisor.operator_gone(bench.now_ns, lease);
    assert_eq!(bench.phase(), Phase::Holding);
    // 3 rad/s at 40 rad/s2.
    assert!(bench.run(70, None).velocities()[FINGER] > 0.0);
    let held = bench.turn(10, None);
    assert!(held.torque() && held.velocities() == [0.0; 3], "{held:?}");
    assert!(bench.run(310, None).torque());
    assert!(!bench.turn(10, None).torque(), "400 ms after the last heartbeat");
    // Whoever comes next finds nothing of that.
    let next = bench.supervisor.acquire(bench.now_ns, "Eve", true).unwrap();
    bench.supervisor.arm(bench.now_ns, next).unwrap();
    bench.run(100, Some(next));
    assert_eq!(bench.phase(), Phase::Armed, "{}", bench.reason());
}

#[test]
fn there_is_time_to_hold_before_disarming_however_short_the_times_are() {
    let begins_s = |disarm_after_s: &str| {
        let to = format!("[safety]\ndisarm_after_s = {disarm_after_s}");
        disarm_begins_s(&station_with("[safety]", &to).safety)
    };
    assert_eq!([begins_s("2.0"), begins_s("0.3"), begins_s("0.26")], [1.9, 0.25, 0.25]);
}

#[test]
fn arming_waits_for_motors_that_still_let_go() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.supervisor.disarm(bench.now_ns, lease).unwrap();
    bench.telemetry = false;
    // An arm switches off later than servos do.
    let turn = |bench: &mut Bench, arm_on: bool, servos_on: bool| {
        bench.now_ns += 10 * MS;
        for (dof, torque_on) in [arm_on, servos_on, servos_on].into_iter().enumerate() {
            bench.read(dof, 0.05, 0.0, Some(torque_on));
        }
        bench.now_ns -= 10 * MS;
        bench.turn(10, Some(lease))
    };
    assert!(!turn(&mut bench, true, true).torque());
    bench.supervisor.arm(bench.now_ns, lease).unwrap();
    for _ in 0..12 {
        assert!(!turn(&mut bench, true, false).torque());
        assert_eq!(bench.phase(), Phase::Arming);
    }
    let first = turn(&mut bench, false, false);
    assert!(first.torque() && first.positions() == [0.05; 3], "{first:?}");
    turn(&mut bench, false, true);
    assert_eq!(bench.phase(), Phase::Arming);
    // A motor that comes up, drops out and comes up is no motor that let go.
    turn(&mut bench, true, false);
    assert_eq!(bench.phase(), Phase::Arming, "{}", bench.reason());
    turn(&mut bench, true, true);
    assert_eq!(bench.phase(), Phase::Armed, "{}", bench.reason());
    turn(&mut bench, false, true);
    assert!(bench.reason().contains("\"arm\" let go"), "{}", bench.reason());

    // One that somebody else holds on is not waited for without end, and stopping ends the wait.
    bench.run(100, Some(lease));
    turn(&mut bench, true, false);
    bench.supervisor.arm(bench.now_ns, lease).unwrap();
    turn(&mut bench, true, false);
    bench.supervisor.stop(bench.now_ns, "Eve");
    assert!(!turn(&mut bench, true, false).torque());
    bench.supervisor.reset_stop(bench.now_ns, lease).unwrap();
    bench.supervisor.arm(bench.now_ns, lease).unwrap();
    let num_turns = (0..300).take_while(|_| !turn(&mut bench, true, false).torque()).count();
    assert!((100..250).contains(&num_turns), "{num_turns}");
}

#[test]
fn a_heartbeat_that_comes_too_late_does_not_undo_the_disarming() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.now_ns += 500 * MS;
    bench.supervisor.heartbeat(bench.now_ns, bench.now_ns, lease).unwrap();
    assert_eq!(bench.phase(), Phase::Disarming);
}

#[test]
fn targets_beyond_limits_senseless_stale_or_of_nobody_are_refused() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    for (targets, expected) in [
        (
            vec![(FINGER, 1.3)],
            "joint \"finger\": the target 1.3000 rad is above its limit of 1.2000 rad; nothing was moved",
        ),
        (
            vec![(RAIL, -0.01)],
            "joint \"rail\": the target -0.0100 m is below its limit of 0.0000 m; nothing was moved",
        ),
        (
            vec![(ARM, 1.0), (FINGER, f64::NAN)],
            "joint \"finger\": the target is NaN, expected a finite number of rad",
        ),
        (vec![(ARM, f64::INFINITY)], "joint \"arm\": the target is inf, expected a finite number of rad"),
        (vec![(ARM, 1.0), (3, 0.0)], "there is no joint 3, expected 0 to 2"),
    ] {
        assert_eq!(bench.aim(lease, &targets).unwrap_err(), expected);
    }
    bench.supervisor.targets(bench.now_ns, lease, 10, &[]).unwrap();
    let stale = bench.supervisor.targets(bench.now_ns, lease, 10, &[(ARM, 1.0)]).unwrap_err();
    assert_eq!(stale, Refusal::StaleSequence { sequence: 10, newest: 10 });
    assert!(bench.supervisor.targets(bench.now_ns, Lease(77), 11, &[(ARM, 1.0)]).is_err());
    assert_eq!(bench.run(500, Some(lease)).positions(), [0.0; 3], "no part of a refused request is done");
}

#[test]
fn joints_that_are_not_named_keep_their_target() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.aim(lease, &[(FINGER, 0.5)]).unwrap();
    bench.aim(lease, &[(RAIL, 0.02)]).unwrap();
    let setpoint = bench.run(3_000, Some(lease));
    let expected = [0.0, 0.5, 0.02];
    for (position, expected) in setpoint.positions().iter().zip(expected) {
        assert!((position - expected).abs() < 1e-6, "{setpoint:?}");
    }
}

#[test]
fn whoever_takes_over_arms_for_themselves() {
    let (mut bench, ada) = Bench::armed([0.0; 3]);
    bench.aim(ada, &[(FINGER, 1.2)]).unwrap();
    bench.run(100, Some(ada));
    let ben = bench.supervisor.acquire(bench.now_ns, "Ben", true).unwrap();
    assert_eq!(bench.phase(), Phase::Disarming);
    assert!(bench.aim(ada, &[(FINGER, 0.0)]).is_err());
    let setpoint = bench.run(200, Some(ben));
    assert!(!setpoint.torque());
    assert!(bench.reason().starts_with("\"Ben\" took over from \"Ada\""), "{}", bench.reason());
    bench.supervisor.arm(bench.now_ns, ben).unwrap();
    assert!(bench.run(1_200, Some(ben)).torque());
}

#[test]
fn the_skin_stays_within_the_workspace_and_finds_back() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    // Reached out and turned down, the pad would be at z = 0.5 - 0.5 sin 1.5.
    bench.aim(lease, &[(RAIL, 0.1)]).unwrap();
    bench.run(3_000, Some(lease));
    bench.aim(lease, &[(ARM, 1.5)]).unwrap();
    let setpoint = bench.run(6_000, Some(lease));
    assert_eq!(bench.phase(), Phase::Holding);
    assert!(
        bench.reason().starts_with("patch \"pad\" would leave the workspace: z = "),
        "{}",
        bench.reason()
    );
    let [arm, finger, rail] = setpoint.positions() else { panic!("three joints") };
    let low_m = 0.5 - (0.4 + rail + 0.005) * arm.sin();
    assert!(*finger == 0.0 && (0.1..0.11).contains(&low_m), "{low_m} m");
    assert!(setpoint.torque() && setpoint.velocities() == [0.0; 3]);
    bench.aim(lease, &[(ARM, 0.2)]).unwrap();
    let setpoint = bench.run(4_000, Some(lease));
    assert!((setpoint.positions()[ARM] - 0.2).abs() < 1e-6, "{setpoint:?}");
    assert_eq!(bench.phase(), Phase::Armed);
}

#[test]
fn the_links_stay_within_the_workspace_too() {
    // The finger's joint is 0.3 m out, with a ball of 0.2 m around it: with the arm at 0.8 rad, the ball would be at
    // z = 0.5 - 0.3 sin 0.8 - 0.2 = 0.085; the pad, with the finger turned up, is far from there.
    let station = station_with_lower("<sphere radius=\"0.2\"/>");
    let mut bench = Bench::new(&station, [0.0, -0.5, 0.0]);
    let lease = bench.supervisor.acquire(bench.now_ns, "Ada", false).unwrap();
    bench.supervisor.arm(bench.now_ns, lease).unwrap();
    bench.run(1_100, Some(lease));
    bench.aim(lease, &[(ARM, 0.8)]).unwrap();
    let setpoint = bench.run(4_000, Some(lease));
    assert_eq!(bench.phase(), Phase::Holding);
    assert!(
        bench.reason().starts_with("link \"lower\" would leave the workspace: z = 0."),
        "{}",
        bench.reason()
    );
    let low_m = 0.5 - 0.3 * setpoint.positions()[ARM].sin() - 0.2;
    assert!((0.1..0.11).contains(&low_m), "{low_m} m");
    bench.aim(lease, &[(ARM, 0.2)]).unwrap();
    assert!((bench.run(4_000, Some(lease)).positions()[ARM] - 0.2).abs() < 1e-6);
}

#[test]
fn a_station_without_a_workspace_has_its_joints_limits_only() {
    let line = "workspace = { min_m = [-1.0, -1.0, 0.1], max_m = [1.0, 1.0, 1.2] }\n";
    let mut bench = Bench::new(&station_with(line, ""), [1.4, 0.0, 0.1]);
    let lease = bench.supervisor.acquire(bench.now_ns, "Ada", false).unwrap();
    bench.supervisor.arm(bench.now_ns, lease).unwrap();
    bench.run(1_200, Some(lease));
    bench.aim(lease, &[(ARM, 1.5)]).unwrap();
    assert!((bench.run(1_000, Some(lease)).positions()[ARM] - 1.5).abs() < 1e-6);
}

#[test]
fn a_setpoint_is_valid_for_150_ms_and_a_loop_that_stalls_longer_disarms() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    let setpoint = bench.turn(10, Some(lease));
    assert_eq!(setpoint.valid_until_ns(), bench.now_ns + 150 * MS);
    assert!(bench.turn(150, Some(lease)).torque());
    bench.now_ns += 75 * MS;
    bench.supervisor.heartbeat(bench.now_ns, bench.now_ns, lease).unwrap();
    assert!(!bench.turn(76, Some(lease)).torque());
    assert_eq!(bench.reason(), "the control loop stood still for 0.15 s; arm again");
}

#[test]
fn who_did_what_is_in_the_audit_log() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    bench.aim(lease, &[(FINGER, 2.0)]).unwrap_err();
    for _ in 0..3 {
        bench.aim(lease, &[(FINGER, 0.1)]).unwrap();
    }
    bench.run(600, None);
    bench.supervisor.stop(bench.now_ns, "Eve");
    assert_eq!(
        bench.audit(),
        [
            "Ada: take control",
            "Ada: arm",
            "Ada: move joints: refused, joint \"finger\": the target 2.0000 rad is above its limit of 1.2000 rad; nothing \
             was moved",
            "Ada: move joints",
            "station: hold: nothing is heard of the operator; motion goes on with new targets once the page is back",
            "station: disarm: nothing was heard of the operator for 0.40 s; arm again",
            "Eve: STOP",
        ]
    );
    assert!(bench.audit().is_empty());
}

#[test]
fn a_heartbeat_counts_from_when_it_came_in_however_late_it_is_looked_at() {
    let (mut bench, lease) = Bench::armed([0.0; 3]);
    let last_ns = bench.now_ns;
    bench.run(140, None);
    // Ten of them waited in a queue since the operator was last heard.
    for waited_ms in 0..10 {
        let received_ns = last_ns + waited_ms * MS;
        bench.supervisor.heartbeat(bench.now_ns, received_ns, lease).unwrap();
    }
    bench.run(30, None);
    assert_eq!(bench.phase(), Phase::Holding, "170 ms after the operator was heard");
    bench.supervisor.heartbeat(bench.now_ns, bench.now_ns + 1_000 * MS, lease).unwrap();
    bench.run(140, None);
    assert_eq!(bench.phase(), Phase::Armed);
    bench.run(30, None);
    assert_eq!(bench.phase(), Phase::Holding, "a heartbeat of the future counts from now");
}
