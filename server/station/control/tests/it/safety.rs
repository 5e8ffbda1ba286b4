//! What happens when somebody is gone, or says stop. Times are the emulated station's own.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::Duration,
};

use palpate_control::Caller;
use palpate_wire::proto::{
    ControlRequest, Disarm, Heartbeat, ResetStop, Stop, control_request::Request, control_state::Phase,
};

use crate::bench::{Bench, Operator, still_from_ns, targets};

const MS: u64 = 1_000_000;
/// Small servos with soft gains come to rest so much later than their goals do.
const LAG_NS: u64 = 150 * MS;
/// Bus, emulation, and a machine that has something else to do.
const SLACK_NS: u64 = 200 * MS;
/// How many times a stop is measured at most, where the computer stands still meanwhile.
const MOST_MEASURED: usize = 3;

/// Starts a motion that would take seconds, and waits until it goes.
fn set_in_motion(bench: &Bench, operator: &Operator) {
    let joints = ["joint1", "index_pip", "middle_mcp_forward"].map(|joint| bench.dof(joint));
    let now = bench.emulated.snapshot().positions;
    bench.emulated.log_motion(60_000);
    operator.accepted(targets(&joints, &[now[joints[0]] + 1.5, now[joints[1]] + 1.0, now[joints[2]] + 1.0]));
    bench.wait_until("moving", |now| now.velocities[joints[0]].abs() > 0.3);
}

#[test]
fn a_page_that_is_gone_while_moving_holds_and_disarms() {
    let bench = Bench::new();
    let mut operator = Operator::armed(&bench, 1);
    set_in_motion(&bench, &operator);
    let gone_ns = operator.vanish(&bench);
    let disarmed_ns = bench.wait_until("limp", |now| !now.torque_on.contains(&true));
    let log = bench.emulated.take_motion_log();
    assert_eq!(log.num_dropped, 0);
    let held_ns = log.last_goal_ns().expect("it was told to move");
    let still_ns = still_from_ns(&log.steps, gone_ns).expect("they stand before they are limp");
    assert!(still_ns <= disarmed_ns);
    let [to_hold, to_stand, to_disarm] =
        [held_ns, still_ns, disarmed_ns].map(|at_ns| at_ns.saturating_sub(gone_ns));
    eprintln!("goals: {} ms, still: {} ms, limp: {} ms", to_hold / MS, to_stand / MS, to_disarm / MS);
    assert!(to_hold <= 150 * MS, "told to move for {} ms more", to_hold / MS);
    assert!(to_stand <= 150 * MS + LAG_NS, "stood after {} ms", to_stand / MS);
    assert!(to_disarm <= 500 * MS, "disarmed after {} ms", to_disarm / MS);
    let state = bench.wait_for_phase(Phase::Disarmed);
    assert!(state.reason.contains("operator"), "{}", state.reason);
    bench.wait_for_audit("nothing was heard of the operator");
}

#[test]
fn a_page_that_falls_silent_is_as_good_as_gone() {
    let bench = Bench::new();
    let operator = Operator::armed(&bench, 1);
    set_in_motion(&bench, &operator);
    // It is there, and asks for something that is refused, but sends no heartbeat.
    drop(operator);
    bench.wait_for_phase(Phase::Holding);
    bench.wait_until("limp", |now| !now.torque_on.contains(&true));
    // The same operator may go on at once, and starts where the robot is.
    let mut again = Operator::watcher(&bench, 2);
    again.take_control(true);
    bench.wait_for_phase(Phase::Disarmed);
    bench.emulated.log_motion(60_000);
    again.arm(&bench);
    thread::sleep(Duration::from_millis(300));
    let log = bench.emulated.take_motion_log();
    let fastest =
        log.steps.iter().flat_map(|step| &step.velocities).fold(0.0, |most: f64, v| most.max(v.abs()));
    assert!(fastest < 1.0, "armed with a jump of {fastest} rad/s");
}

#[test]
fn anybody_stops_and_the_stop_is_confirmed_and_latched() {
    let bench = Bench::patient();
    let operator = Operator::armed(&bench, 1);
    let watcher = Operator::watcher(&bench, 2);
    set_in_motion(&bench, &operator);
    let asked_ns = bench.emulated.snapshot().device_ns;
    watcher.stop();
    let limp_ns = bench.wait_until("limp", |now| !now.torque_on.contains(&true));
    assert!(limp_ns - asked_ns <= 100 * MS + SLACK_NS, "stopped after {} ms", (limp_ns - asked_ns) / MS);
    let state = bench.wait_for("confirmed", |state| state.stop_confirmed);
    assert_eq!(state.phase(), Phase::Stopped);
    let dof = bench.dof("index_pip");
    operator.refused(targets(&[dof], &[0.3]));
    operator.refused(Request::Arm(palpate_wire::proto::Arm {}));
    operator.accepted(Request::ResetStop(ResetStop {}));
    bench.wait_for_phase(Phase::Disarmed);
    operator.arm(&bench);
    operator.accepted(targets(&[dof], &[0.3]));
    bench.wait_until("there", |now| (now.positions[dof] - 0.3).abs() < 0.05);
    operator.accepted(Request::Disarm(Disarm {}));
    bench.wait_until("limp", |now| !now.torque_on.contains(&true));
}

#[test]
fn a_flood_of_requests_holds_up_no_stop() {
    for _ in 0..MOST_MEASURED {
        let bench = Bench::patient();
        let left_out_ns = bench.emulated.snapshot().left_out_ns;
        let limp_after_ns = limp_after_a_stop_in_a_flood_ns(&bench);
        if limp_after_ns <= 100 * MS + SLACK_NS {
            return;
        }
        // Where the emulation itself stood still the whole computer did, which says nothing of the station.
        let stood_still_ns = bench.emulated.snapshot().left_out_ns - left_out_ns;
        assert!(stood_still_ns > SLACK_NS, "stopped after {} ms", limp_after_ns / MS);
        eprintln!("measured again: the computer stood still for {} ms", stood_still_ns / MS);
    }
    panic!("the computer stood still each of {MOST_MEASURED} times that it was measured");
}

/// How long after a stop no servo has torque any more while others ask for what they are refused, on the station's
/// clock.
fn limp_after_a_stop_in_a_flood_ns(bench: &Bench) -> u64 {
    let operator = Operator::armed(bench, 1);
    set_in_motion(bench, &operator);
    let flooding = AtomicBool::new(true);
    thread::scope(|scope| {
        for number in 10..14 {
            let flooding = &flooding;
            scope.spawn(move || {
                let watcher = Operator::watcher(bench, number);
                while flooding.load(Ordering::Relaxed) {
                    watcher.refused(targets(&[0], &[0.0]));
                }
            });
        }
        thread::sleep(Duration::from_millis(100));
        let asked_ns = bench.emulated.snapshot().device_ns;
        operator.stop();
        let limp_ns = bench.wait_until("limp", |now| !now.torque_on.contains(&true));
        flooding.store(false, Ordering::Relaxed);
        limp_ns - asked_ns
    })
}

#[test]
fn a_loop_that_ends_brakes_lets_go_and_says_what_readings_confirm() {
    let mut bench = Bench::new();
    let operator = Operator::armed(&bench, 1);
    set_in_motion(&bench, &operator);
    let ending = bench.end_control();
    assert!(!bench.emulated.snapshot().torque_on.contains(&true), "it is confirmed, so it is so");
    assert!(ending.is_safe() && ending.was_armed && ending.not_let_go.is_empty(), "{ending:?}");
    let log = bench.emulated.take_motion_log();
    let limp_ns = log.steps.iter().rfind(|step| step.velocities.iter().any(|v| v.abs() > 0.3));
    assert!(limp_ns.is_some(), "it moved");
    let problem = operator.refused(targets(&[0], &[0.0]));
    assert!(problem.contains("ended"), "{problem}");
    let ended: Vec<String> =
        bench.audit().into_iter().map(|line| line.what).filter(|what| what.contains("has ended")).collect();
    assert_eq!(ended, ["the control loop has ended: readings show every joint without torque"]);
}

#[test]
fn the_end_does_not_claim_what_no_reading_shows() {
    let mut bench = Bench::new();
    let _operator = Operator::armed(&bench, 1);
    bench.set_faults("[[fault]]\nkind = \"unplug\"\ndevice = \"xarm\"\n");
    let ending = bench.end_control();
    assert!(!ending.is_safe() && ending.problem.is_none(), "{ending:?}");
    assert!(ending.not_let_go.contains(&"joint1".to_owned()), "{ending:?}");
    assert!(!ending.not_let_go.contains(&"index_pip".to_owned()), "the hand has let go: {ending:?}");
    let last = bench.audit().pop().expect("there is a log");
    assert!(last.what.contains("do not confirm it for joint1"), "{last:?}");
}

#[test]
fn a_stop_is_answered_when_readings_confirm_it_and_outlives_the_program() {
    let mut bench = Bench::new();
    let operator = Operator::armed(&bench, 1);
    set_in_motion(&bench, &operator);
    let watcher = Operator::watcher(&bench, 2);
    let reply = watcher.ask(Request::Stop(Stop {}));
    assert!(reply.accepted && reply.stop_confirmed && reply.problem.is_empty(), "{reply:?}");
    let now = bench.emulated.snapshot();
    assert!(!now.torque_on.contains(&true), "{now:?}");
    bench.end_control();
    let latch = bench.dir.path().join("stop.txt");
    assert_eq!(std::fs::read_to_string(&latch).unwrap(), "control 2 from this process");
    bench.restart_control();
    let state = bench.wait_for_phase(Phase::Stopped);
    assert!(state.reason.contains("control 2"), "{}", state.reason);
    let again = Operator::in_control(&bench, 3);
    assert!(again.refused(Request::Arm(palpate_wire::proto::Arm {})).contains("stopped by"));
    again.accepted(Request::ResetStop(ResetStop {}));
    again.arm(&bench);
    again.accepted(Request::Disarm(Disarm {}));
    bench.end_control();
    assert!(!latch.exists(), "it was reset");
}

#[test]
fn a_control_loop_that_panics_lets_go_of_every_motor_and_never_says_that_it_was_confirmed() {
    let mut bench = Bench::new();
    let operator = Operator::armed(&bench, 1);
    set_in_motion(&bench, &operator);
    let panicked_ns = bench.emulated.snapshot().device_ns;
    // Whoever waits for an answer is told on the loop's own thread.
    let caller = Caller { connection: 7, peer: "a test".into(), may_operate: true };
    let request = ControlRequest { sequence: 1, lease: 0, request: Some(Request::Heartbeat(Heartbeat {})) };
    bench.handle.submit(
        &caller,
        bench.handle.now_ns(),
        request,
        Box::new(|_| panic!("a defect of the loop")),
    );
    let limp_ns = bench.wait_until("limp", |now| !now.torque_on.contains(&true));
    eprintln!("limp {} ms after the panic", (limp_ns - panicked_ns) / MS);
    // The panic's message is written before anything is let go of, here with a backtrace.
    assert!(limp_ns - panicked_ns < 500 * MS, "limp after {} ms", (limp_ns - panicked_ns) / MS);
    drop(operator);
    let ending = bench.end_control();
    assert!(!ending.is_safe(), "{ending}");

    // A control loop that is started again finds everything and moves nothing by itself.
    bench.restart_control();
    bench.emulated.log_motion(60_000);
    let operator = Operator::in_control(&bench, 2);
    operator.arm(&bench);
    let log = bench.emulated.take_motion_log();
    let fastest =
        log.steps.iter().flat_map(|step| &step.velocities).fold(0.0, |most: f64, v| most.max(v.abs()));
    assert!(fastest < 1.0, "armed with a jump of {fastest} rad/s");
}
