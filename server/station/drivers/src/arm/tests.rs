//! The arm's driver with its threads and sockets, against the emulated box.

use std::thread;

use super::*;
use crate::emulated::{Driven, Emulated, one_at_a_time};

/// Setpoints of these tests are valid for long, so that a slow machine does not let them expire.
const VALID_NS: u64 = 600_000_000_000;

fn driven(emulated: &Emulated, report_port: u16) -> Driven {
    let address = |port: u16| SocketAddr::new(emulated.ports.arm_ip, port);
    let setup = ArmSetup {
        commands: address(emulated.ports.arm_ports.command),
        reports: address(report_port),
        dofs: Arc::from([0, 1, 2, 3, 4, 5]),
        joints: (1..=6).map(|number| format!("joint{number}")).collect(),
        limits: Limits { rad_per_sec: vec![0.6; 6], rad_per_sec2: vec![5.0; 6] },
        hold_ns: 250_000_000,
    };
    let driven = Driven::start("xarm", move |context| run(context, &setup));
    // Who commands begins without torque, as the safety layer does.
    set(&driven, false, false, &[]);
    driven
}

fn set(driven: &Driven, torque: bool, lead_through: bool, positions: &[f64]) {
    let valid_until_ns = driven.context.clock.now_ns() + VALID_NS;
    driven.context.goals.set(Goal {
        torque,
        lead_through,
        positions: positions.into(),
        valid_until_ns,
        disarms: 0,
    });
}

/// The next reading of the joints.
fn joints(driven: &mut Driven) -> (Vec<f64>, bool) {
    match driven.wait_for("joints", |event| matches!(event, DeviceEvent::Joints { .. })) {
        DeviceEvent::Joints { positions, torque_on, .. } => (positions, torque_on.iter().all(|on| *on)),
        _ => (Vec::new(), false),
    }
}

fn wait_for_torque(driven: &mut Driven, wanted: bool) {
    driven.wait_for("torque", |event| {
        matches!(event, DeviceEvent::Joints { torque_on, .. } if torque_on.iter().all(|on| *on == wanted))
    });
}

fn wait_until_at(driven: &mut Driven, wanted: &[f64]) {
    let is_there = |positions: &[f64]| positions.iter().zip(wanted).all(|(at, to)| (at - to).abs() < 1e-3);
    driven.wait_for(
        "there",
        |event| matches!(event, DeviceEvent::Joints { positions, .. } if is_there(positions)),
    );
}

#[test]
fn an_arm_is_armed_moved_stopped_unplugged_and_armed_again() {
    let _turn = one_at_a_time();
    let emulated = Emulated::start();
    let mut arm = driven(&emulated, emulated.ports.arm_ports.real);
    arm.wait_for_link(Link::Ready);
    let (start, torque_on) = joints(&mut arm);
    assert!(start.len() == 6 && !torque_on);
    set(&arm, true, false, &start);
    wait_for_torque(&mut arm, true);
    let there: Vec<f64> = start.iter().map(|at| at + 0.1).collect();
    set(&arm, true, false, &there);
    wait_until_at(&mut arm, &there);
    // Velocities come from positions here; nothing was faster than the limit allows.
    let fastest = arm.seen.iter().filter_map(|event| match event {
        DeviceEvent::Joints { velocities, .. } => velocities.iter().copied().reduce(f64::max),
        _ => None,
    });
    assert!(fastest.fold(0.0, f64::max) > 0.1, "it moved without a velocity");
    set(&arm, false, false, &[]);
    wait_for_torque(&mut arm, false);
    // Armed and on its way when somebody pulls the cable.
    set(&arm, true, false, &there);
    wait_for_torque(&mut arm, true);
    emulated.set_faults("[[fault]]\nkind = \"unplug\"\ndevice = \"xarm\"\n");
    let problem = arm.wait_for_link(Link::Lost);
    assert!(problem.contains("control box") || problem.contains("connect"), "{problem}");
    emulated.set_faults("");
    arm.wait_for_link(Link::Ready);
    // It is still told to hold torque, and does not before it is armed anew.
    wait_for_torque(&mut arm, false);
    (0..50).for_each(|_| assert!(!joints(&mut arm).1));
    set(&arm, false, false, &[]);
    thread::sleep(Duration::from_millis(100));
    set(&arm, true, false, &there);
    wait_for_torque(&mut arm, true);
    arm.end();
    let health = arm.context.health.snapshot(arm.context.clock.now_ns());
    assert_eq!((health.reconnects, health.bad_frames), (1, 0));
}

#[test]
fn errors_of_the_box_are_told_and_cleared_on_request() {
    let _turn = one_at_a_time();
    let emulated = Emulated::start();
    let mut arm = driven(&emulated, emulated.ports.arm_ports.real);
    arm.wait_for_link(Link::Ready);
    let (start, _) = joints(&mut arm);
    for (fault, expected) in [("emergency_stop", "emergency stop button"), ("collision", "collision")] {
        set(&arm, true, false, &start);
        wait_for_torque(&mut arm, true);
        emulated.set_faults(&format!("[[fault]]\nkind = \"{fault}\"\n"));
        arm.wait_for("explained", |event| {
            matches!(event, DeviceEvent::Link { link: Link::Fault, problem, .. } if problem.contains(expected))
        });
        wait_for_torque(&mut arm, false);
        emulated.set_faults("");
        set(&arm, false, false, &[]);
        // The button is released when the box has read its file of faults: asked until then.
        loop {
            arm.context.clear_fault.store(true, std::sync::atomic::Ordering::Relaxed);
            let event = arm.wait_for("anything", |_| true);
            if matches!(event, DeviceEvent::Link { link: Link::Ready, .. }) {
                break;
            }
        }
    }
    arm.end();
}

#[test]
fn lead_through_is_entered_and_left() {
    let _turn = one_at_a_time();
    let emulated = Emulated::start();
    let mut arm = driven(&emulated, emulated.ports.arm_ports.real);
    arm.wait_for_link(Link::Ready);
    let (start, _) = joints(&mut arm);
    set(&arm, true, true, &start);
    wait_for_torque(&mut arm, true);
    let there: Vec<f64> = start.iter().map(|at| at + 0.05).collect();
    // Setpoints do not move an arm that yields.
    set(&arm, true, true, &there);
    (0..30).for_each(|_| {
        let (at, _) = joints(&mut arm);
        assert!(at.iter().zip(&start).all(|(at, start)| (at - start).abs() < 1e-4));
    });
    set(&arm, true, false, &there);
    wait_until_at(&mut arm, &there);
    arm.end();
}

/// Until the box says something of itself.
fn wait_for_arm(emulated: &Emulated, is_it: impl Fn(&palpate_emulator::StationSnapshot) -> bool) {
    let begun = std::time::Instant::now();
    loop {
        let now = emulated.control.snapshot();
        if is_it(&now) {
            return;
        }
        assert!(begun.elapsed() < Duration::from_secs(30), "never: {:?} {:?}", now.arm, now.torque_on);
        thread::sleep(Duration::from_millis(2));
    }
}

/// An arm that yields to hands.
fn led(emulated: &Emulated) -> Driven {
    let mut arm = driven(emulated, emulated.ports.arm_ports.real);
    arm.wait_for_link(Link::Ready);
    let (start, _) = joints(&mut arm);
    set(&arm, true, true, &start);
    wait_for_torque(&mut arm, true);
    wait_for_arm(emulated, |now| now.arm.mode == 2 && matches!(now.arm.state, 1 | 2) && now.torque_on[0]);
    arm
}

#[test]
fn an_arm_in_lead_through_is_stopped_and_off_after_an_orderly_end() {
    let _turn = one_at_a_time();
    let emulated = Emulated::start();
    let mut arm = led(&emulated);
    arm.end();
    let now = emulated.control.snapshot();
    assert_eq!(now.arm.state, 4);
    assert!(now.torque_on[..6].iter().all(|on| !on));
}

#[test]
fn an_arm_in_lead_through_is_stopped_and_off_after_a_panic_and_not_switched_on_again_by_itself() {
    let _turn = one_at_a_time();
    let emulated = Emulated::start();
    let mut arm = led(&emulated);
    arm.context.panics.store(true, std::sync::atomic::Ordering::Relaxed);
    let problem = arm.wait_for_link(Link::Lost);
    assert!(problem.contains("driver failed") && problem.contains("started again"), "{problem}");
    // Said before the driver is: the next one has nothing left to stop.
    wait_for_arm(&emulated, |now| now.arm.state == 4 && now.torque_on[..6].iter().all(|on| !on));
    arm.wait_for_link(Link::Ready);
    // Lead-through is still asked for.
    (0..50).for_each(|_| assert!(!joints(&mut arm).1));
    assert_eq!(emulated.control.snapshot().arm.state, 4);
    set(&arm, false, false, &[]);
    thread::sleep(Duration::from_millis(100));
    let (start, _) = joints(&mut arm);
    set(&arm, true, false, &start);
    wait_for_torque(&mut arm, true);
    arm.end();
}

#[test]
fn a_warning_that_somebody_asks_to_clear_while_the_arm_is_away_stays() {
    use std::io::Write as _;
    let _turn = one_at_a_time();
    let emulated = Emulated::start();
    let mut arm = driven(&emulated, emulated.ports.arm_ports.real);
    arm.wait_for_link(Link::Ready);
    // Another client says something that the box does not know.
    let address = SocketAddr::new(emulated.ports.arm_ip, emulated.ports.arm_ports.command);
    let mut other = std::net::TcpStream::connect(address).expect("the box listens");
    other.write_all(&[0, 1, 0, 2, 0, 1, 0x7B]).expect("it reads");
    wait_for_arm(&emulated, |now| now.arm.warning != 0);
    emulated.set_faults("[[fault]]\nkind = \"unplug\"\ndevice = \"xarm\"\n");
    arm.wait_for_link(Link::Lost);
    arm.context.clear_fault.store(true, Ordering::Relaxed);
    emulated.set_faults("");
    arm.wait_for_link(Link::Ready);
    (0..50).for_each(|_| drop(joints(&mut arm)));
    assert_ne!(emulated.control.snapshot().arm.warning, 0, "nobody has seen it");
    arm.context.clear_fault.store(true, Ordering::Relaxed);
    wait_for_arm(&emulated, |now| now.arm.warning == 0);
    arm.end();
}

#[test]
fn every_report_stream_will_do_and_gives_what_it_has() {
    let _turn = one_at_a_time();
    let emulated = Emulated::start();
    let ports = emulated.ports.arm_ports;
    for (port, has_clock, has_temperature) in
        [(ports.realtime, true, false), (ports.rich, false, true), (ports.normal, false, false)]
    {
        let mut arm = driven(&emulated, port);
        arm.wait_for_link(Link::Ready);
        let (start, _) = joints(&mut arm);
        set(&arm, true, false, &start);
        wait_for_torque(&mut arm, true);
        let there: Vec<f64> = start.iter().map(|at| at + 0.02).collect();
        set(&arm, true, false, &there);
        wait_until_at(&mut arm, &there);
        let mut last_ns = 0;
        for event in &arm.seen {
            if let DeviceEvent::Joints { received_ns, host_ns, device_ns, .. } = event {
                assert!(host_ns <= received_ns && *host_ns >= last_ns && device_ns.is_some() == has_clock);
                last_ns = *host_ns;
            }
        }
        arm.end();
        let health = arm.context.health.snapshot(arm.context.clock.now_ns());
        let temperature = health.motors[0].temperature_c;
        assert_eq!(temperature.is_some_and(|celsius| (20.0..60.0).contains(&celsius)), has_temperature);
        assert!(health.motors[0].identity.contains("v1.12.10"), "{:?}", health.motors[0]);
    }
}

#[test]
fn an_arm_that_is_let_go_while_it_moves_is_stopped_and_switched_off() {
    let _turn = one_at_a_time();
    let emulated = Emulated::start();
    let mut arm = driven(&emulated, emulated.ports.arm_ports.real);
    arm.wait_for_link(Link::Ready);
    let (start, _) = joints(&mut arm);
    set(&arm, true, false, &start);
    wait_for_torque(&mut arm, true);
    let far: Vec<f64> = start.iter().map(|at| at + 0.5).collect();
    set(&arm, true, false, &far);
    arm.wait_for("under way", |event| {
        matches!(event, DeviceEvent::Joints { positions, .. } if (positions[0] - start[0]).abs() > 0.02)
    });
    arm.end();
    // Another client sees it stopped and without power.
    let mut witness = driven(&emulated, emulated.ports.arm_ports.rich);
    let (at, torque_on) = joints(&mut witness);
    assert!(!torque_on && (at[0] - start[0]).abs() < 0.45, "{at:?}");
    let (later, _) = joints(&mut witness);
    assert!(at.iter().zip(&later).all(|(at, later)| (at - later).abs() < 1e-6));
}
