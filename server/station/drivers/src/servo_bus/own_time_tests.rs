//! The driver of the servos against the emulated hand in the hand's own time: no threads, no clock of the computer, every
//! request seen, and answers lost where a test wants it.

use std::collections::VecDeque;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, MutexGuard};

use palpate_device_protocol::dynamixel::control_table::{Register, TORQUE_ENABLE};
use palpate_device_protocol::dynamixel::{BROADCAST_ID, Decoder, Request, code};
use palpate_emulator::{EmulatedStation, Faults, StationControl};
use palpate_robot_model::DeviceKind;

use super::*;
use crate::clock::HostClock;
use crate::context::Goal;
use crate::event::DeviceEvent;
use crate::servo_bus::line::Port;
use crate::servo_bus::registers::Condition;

const MS_NS: u64 = 1_000_000;
const PERIOD_NS: u64 = 10 * MS_NS;
const HOLD_NS: u64 = 350 * MS_NS;
/// Time between two looks for an answer.
const STEP_NS: u64 = 20_000;
/// Ten bits a byte at 4 Mbit/s.
const BYTE_NS: u64 = 2_500;

/// A request that was on the line.
#[derive(Clone, Debug)]
struct Sent {
    at_ns: u64,
    request: Request,
}

/// Whether the answer of a servo (by id) to a request is lost.
type Loses = Box<dyn Fn(&Request, u8) -> bool + Send>;

/// Everything on the line.
struct Wiring {
    station: EmulatedStation,
    now_ns: Arc<AtomicU64>,
    sent: Vec<Sent>,
    loses: Loses,
    /// Answers that came and were not read.
    answers: VecDeque<u8>,
}

impl Wiring {
    fn now_ns(&self) -> u64 {
        self.now_ns.load(Ordering::Relaxed)
    }

    /// Takes what has arrived, but for what is lost.
    fn receive(&mut self) {
        let bytes = self.station.line_output(0, self.now_ns());
        let Some(last) = self.sent.last() else { return };
        for packet in Decoder::default().feed(&bytes) {
            let is_lost = if packet.is_fast_status() {
                // One that stays silent silences the packet of all.
                (0..16).any(|id| (self.loses)(&last.request, id))
            } else {
                packet.instruction == code::STATUS && (self.loses)(&last.request, packet.id)
            };
            if !is_lost {
                self.answers.extend(packet.encode().expect("it was one"));
            }
        }
    }
}

/// The host's end of the line.
struct OwnTimePort {
    wiring: Arc<Mutex<Wiring>>,
    timeout: Duration,
}

impl OwnTimePort {
    fn wiring(&self) -> MutexGuard<'_, Wiring> {
        self.wiring.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl io::Write for OwnTimePort {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut wiring = self.wiring();
        let at_ns = wiring.now_ns.fetch_add(BYTE_NS * bytes.len() as u64, Ordering::Relaxed);
        for packet in Decoder::default().feed(bytes) {
            let request = Request::from_packet(&packet).expect("the driver sends requests");
            wiring.sent.push(Sent { at_ns, request });
        }
        let now_ns = wiring.now_ns();
        wiring.station.line_input(0, bytes, now_ns);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl io::Read for OwnTimePort {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let mut wiring = self.wiring();
        let until_ns = wiring.now_ns() + self.timeout.as_nanos() as u64;
        loop {
            wiring.receive();
            if !wiring.answers.is_empty() {
                let count = bytes.len().min(wiring.answers.len());
                for (slot, byte) in bytes.iter_mut().zip(wiring.answers.drain(..count)) {
                    *slot = byte;
                }
                return Ok(count);
            }
            if wiring.now_ns() >= until_ns {
                return Err(io::ErrorKind::TimedOut.into());
            }
            wiring.now_ns.fetch_add(STEP_NS, Ordering::Relaxed);
        }
    }
}

impl Port for OwnTimePort {
    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        self.timeout = timeout;
        Ok(())
    }

    fn discard_input(&mut self) -> io::Result<bool> {
        let mut wiring = self.wiring();
        wiring.receive();
        let is_late = !wiring.answers.is_empty();
        wiring.answers.clear();
        Ok(is_late)
    }
}

/// What is around the bus.
struct Rig {
    wiring: Arc<Mutex<Wiring>>,
    control: StationControl,
    context: DeviceContext,
    events: Receiver<DeviceEvent>,
    /// Kept for ever, so that a bus can outlive what a test does with the rig.
    plan: &'static BusPlan,
    now_ns: Arc<AtomicU64>,
    next_ns: u64,
    /// How far the goals are from where the joints were at the start.
    moved_rad: f64,
    start: Vec<f64>,
}

impl Rig {
    fn new() -> Self {
        let truth = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/truth/demo.toml");
        let station = EmulatedStation::new(&truth, 7).expect("the demonstration's station");
        let config = station.station().devices.iter().find_map(|device| match &device.kind {
            DeviceKind::Dynamixel(bus) => Some(bus.clone()),
            _ => None,
        });
        let plan = BusPlan::new(&config.expect("it has servos"), PathBuf::from("/dev/own-time"), HOLD_NS);
        let plan: &'static BusPlan = Box::leak(Box::new(plan.expect("a plan")));
        let now_ns = Arc::new(AtomicU64::new(0));
        let (events, received) = std::sync::mpsc::sync_channel(100_000);
        let context = DeviceContext {
            clock: HostClock::by_hand(Arc::clone(&now_ns)),
            ..DeviceContext::for_tests("u2d2", events)
        };
        let control = station.control();
        let wiring = Wiring {
            station,
            now_ns: Arc::clone(&now_ns),
            sent: Vec::new(),
            loses: Box::new(|_, _| false),
            answers: VecDeque::new(),
        };
        Self {
            wiring: Arc::new(Mutex::new(wiring)),
            control,
            context,
            events: received,
            plan,
            now_ns,
            next_ns: 0,
            moved_rad: 0.0,
            start: Vec::new(),
        }
    }

    fn wiring(&self) -> MutexGuard<'_, Wiring> {
        self.wiring.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    fn open(&self) -> Bus<'static> {
        let port = OwnTimePort { wiring: Arc::clone(&self.wiring), timeout: Duration::ZERO };
        let line = Line::over(Box::new(port), self.plan.baud, &self.context.clock);
        let mut bus = Bus::new(&self.context, self.plan, line);
        bus.find(&self.context).expect("the servos are there");
        bus
    }

    fn now_ns(&self) -> u64 {
        self.now_ns.load(Ordering::Relaxed)
    }

    fn set_goal(&self, torque: bool, positions: &[f64]) {
        let valid_until_ns = self.now_ns() + 150 * MS_NS;
        let positions = positions.into();
        self.context.goals.set(Goal { torque, lead_through: false, positions, valid_until_ns, disarms: 0 });
    }

    fn set_faults(&self, text: &str) {
        let mut wiring = self.wiring();
        let faults = Faults::parse("faults.toml", text, wiring.station.station()).expect("faults");
        let now_ns = wiring.now_ns();
        wiring.station.set_faults(faults, now_ns);
    }

    fn lose(&self, loses: impl Fn(&Request, u8) -> bool + Send + 'static) {
        self.wiring().loses = Box::new(loses);
    }

    /// Whether the servo of each id is truly on.
    fn on(&self) -> Vec<bool> {
        // What was written last is seen after a step of the station.
        let now_ns = self.now_ns.fetch_add(MS_NS, Ordering::Relaxed) + MS_NS;
        self.wiring().station.advance(now_ns);
        let on = self.control.snapshot().torque_on;
        self.plan.servos.iter().map(|servo| on[servo.dof]).collect()
    }

    /// Requests from `from_ns` on.
    fn sent_since(&self, from_ns: u64) -> Vec<Sent> {
        self.wiring().sent.iter().filter(|sent| sent.at_ns >= from_ns).cloned().collect()
    }
}

/// When something was written, and to which servos what.
type Written = (u64, Vec<(u8, Vec<u8>)>);

/// The sync writes to `register`.
fn sync_writes(sent: &[Sent], register: &Register) -> Vec<Written> {
    let writes = sent.iter().filter_map(|sent| match &sent.request.instruction {
        Instruction::SyncWrite { address, data, .. } if *address == register.address => {
            Some((sent.at_ns, data.clone()))
        }
        _ => None,
    });
    writes.collect()
}

/// When all servos were told to switch their torque off.
fn told_off(sent: &[Sent]) -> Vec<u64> {
    let all = |data: &[(u8, Vec<u8>)]| data.len() == 16 && data.iter().all(|(_, bytes)| bytes == &[0]);
    let writes = sync_writes(sent, &TORQUE_ENABLE).into_iter();
    writes.filter(|(_, data)| all(data)).map(|(at_ns, _)| at_ns).collect()
}

/// One cycle, with the goal that `torque` asks for, and the pause after it.
fn cycle(rig: &mut Rig, bus: &mut Bus<'_>, torque: bool) {
    let goal: Vec<f64> = rig.start.iter().map(|at| at + rig.moved_rad).collect();
    rig.set_goal(torque, &goal);
    rig.next_ns = rig.next_ns.max(rig.now_ns()) + PERIOD_NS;
    bus.cycle(&rig.context, rig.next_ns).expect("the port works");
    if rig.now_ns() < rig.next_ns {
        rig.now_ns.store(rig.next_ns, Ordering::Relaxed);
    }
}

fn cycles(rig: &mut Rig, bus: &mut Bus<'_>, torque: bool, num: usize) {
    (0..num).for_each(|_| cycle(rig, bus, torque));
}

/// Limp, and with goals that begin where the joints are.
fn stand_by(rig: &mut Rig, bus: &mut Bus<'_>) {
    rig.start = vec![0.0; 1 + rig.plan.servos.iter().map(|servo| servo.dof).max().unwrap_or(0)];
    cycles(rig, bus, false, 20);
    while let Ok(event) = rig.events.try_recv() {
        if let DeviceEvent::Joints { dofs, positions, .. } = event {
            for (&dof, position) in dofs.iter().zip(positions) {
                rig.start[dof] = position;
            }
        }
    }
}

/// A hand whose servos are all armed.
fn armed() -> (Rig, Bus<'static>) {
    let mut rig = Rig::new();
    let mut bus = rig.open();
    stand_by(&mut rig, &mut bus);
    cycles(&mut rig, &mut bus, true, 4);
    assert!(bus.armed && rig.on().iter().all(|on| *on), "{}: {:?}", bus.arm_problem, rig.on());
    (rig, bus)
}

fn asks_for_condition(request: &Request) -> bool {
    matches!(request.instruction,
        Instruction::Read { address, .. } | Instruction::SyncRead { address, .. } if address == Condition::ADDRESS)
}

#[test]
fn a_servo_whose_answer_to_arming_was_lost_is_told_to_let_go_in_the_cycle_of_a_stop() {
    let mut rig = Rig::new();
    let mut bus = rig.open();
    stand_by(&mut rig, &mut bus);
    cycle(&mut rig, &mut bus, true);
    assert!(rig.on().iter().all(|on| !on) && bus.arming.is_some(), "first the goals");
    rig.lose(|request, id| id == 5 && asks_for_condition(request));
    cycle(&mut rig, &mut bus, true);
    assert!(rig.on().iter().all(|on| *on) && !bus.armed, "all have torque, and one could not say so");
    assert!(!bus.servos[5].armed && !bus.servos[5].torque_on);
    let stop_ns = rig.now_ns();
    cycle(&mut rig, &mut bus, false);
    assert!(rig.on().iter().all(|on| !on), "{:?}", rig.on());
    assert!(bus.servos[5].torque_on, "it counts as on until it says that it is off");
    cycles(&mut rig, &mut bus, false, 4);
    let told = told_off(&rig.sent_since(stop_ns));
    assert_eq!(told.len(), 5, "in as many cycles: {told:?}");
    assert!(told.windows(2).all(|pair| pair[1] - pair[0] < 2 * PERIOD_NS), "{told:?}");
    rig.lose(|_, _| false);
    cycle(&mut rig, &mut bus, false);
    assert!(!bus.servos[5].torque_on);
    cycles(&mut rig, &mut bus, false, 30);
    let told = told_off(&rig.sent_since(stop_ns + 60 * MS_NS));
    assert!((2..=4).contains(&told.len()), "and every 0.1 s from then on: {told:?}");
}

#[test]
fn arming_that_never_succeeds_leaves_nobody_on() {
    let mut rig = Rig::new();
    let mut bus = rig.open();
    stand_by(&mut rig, &mut bus);
    cycle(&mut rig, &mut bus, true);
    rig.lose(|request, id| id == 5 && asks_for_condition(request));
    let begun_ns = rig.now_ns();
    while bus.arm_problem.is_empty() {
        cycle(&mut rig, &mut bus, true);
        assert!(rig.now_ns() - begun_ns < 500 * MS_NS, "it is given up some time");
    }
    assert!(bus.arm_problem.contains("does not switch its torque on"), "{}", bus.arm_problem);
    assert!(rig.on().iter().all(|on| !on), "{:?}", rig.on());
}

#[test]
fn a_servo_that_hears_but_cannot_be_heard_is_told_to_let_go_while_others_are_driven() {
    let (mut rig, mut bus) = armed();
    rig.lose(|_, id| id == 5);
    while bus.servos[5].is_ready() {
        cycle(&mut rig, &mut bus, true);
        assert!(rig.on().iter().all(|on| *on), "nothing is known to be wrong yet");
    }
    cycles(&mut rig, &mut bus, true, 1);
    let others = rig.on();
    assert!(!others[5] && others.iter().filter(|on| **on).count() == 15, "{others:?}");
    // Somebody else's program, or a bit that was read wrongly, switches it on again.
    rig.wiring().sent.clear();
    cycles(&mut rig, &mut bus, true, 40);
    let sent = rig.sent_since(0);
    let told: Vec<_> = sync_writes(&sent, &TORQUE_ENABLE).into_iter().map(|(_, data)| data).collect();
    assert!(told.len() >= 7 && told.iter().all(|data| data[..] == [(5, vec![0])]), "{told:?}");
    cycle(&mut rig, &mut bus, false);
    assert!(rig.on().iter().all(|on| !on));
    assert_eq!(told_off(&rig.sent_since(rig.next_ns - PERIOD_NS)).len(), 1, "it is told with all the others");
}

#[test]
fn a_servo_that_restarts_is_told_to_let_go_too() {
    let (mut rig, mut bus) = armed();
    rig.set_faults("[[fault]]\nkind = \"overload\"\njoint = \"thumb_mcp\"\n");
    cycles(&mut rig, &mut bus, true, 40);
    rig.set_faults("");
    rig.context.clear_fault.store(true, Ordering::Relaxed);
    cycles(&mut rig, &mut bus, true, 1);
    assert!(matches!(bus.servos[14].presence, Presence::Restarting { .. }), "{:?}", bus.servos[14].presence);
    let stop_ns = rig.now_ns();
    cycles(&mut rig, &mut bus, false, 5);
    assert_eq!(told_off(&rig.sent_since(stop_ns)).len(), 5, "all of them, as ever");
}

#[test]
fn a_panic_of_the_thread_leaves_no_servo_on() {
    let (mut rig, bus) = armed();
    rig.context.panics.store(true, Ordering::Relaxed);
    let rig = std::thread::spawn(move || {
        let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            let mut bus = bus;
            cycle(&mut rig, &mut bus, true);
        }));
        assert!(caught.is_err(), "it panicked");
        rig
    });
    let rig = rig.join().expect("caught");
    assert!(rig.on().iter().all(|on| !on), "{:?}", rig.on());
    assert_eq!(told_off(&rig.sent_since(rig.next_ns - PERIOD_NS)).len(), 5);
}

#[test]
fn a_line_that_is_given_up_leaves_no_servo_on() {
    let (mut rig, mut bus) = armed();
    // Nobody can be heard any more, and everybody still hears.
    rig.lose(|_, _| true);
    cycle(&mut rig, &mut bus, true);
    drop(bus);
    assert!(rig.on().iter().all(|on| !on), "{:?}", rig.on());
}

#[test]
fn servos_that_were_left_stiff_are_told_to_let_go_before_any_is_looked_for() {
    let (rig, bus) = armed();
    // As after a kill: nothing of the driver is dropped.
    std::mem::forget(bus);
    let begun_ns = rig.now_ns();
    let _bus = rig.open();
    let sent = rig.sent_since(begun_ns);
    assert!(told_off(&sent[..5]).len() == 5, "{:?}", &sent[..5]);
}

/// Goals of the others while a servo is away and comes back.
fn check_goals(sent: &[Sent], most_apart_ns: u64) {
    let goals = sync_writes(sent, &GOAL_POSITION);
    assert!(goals.len() > 10);
    for pair in goals.windows(2) {
        let (from_ns, to_ns) = (pair[0].0, pair[1].0);
        assert!(to_ns - from_ns <= most_apart_ns, "no goal from {from_ns} to {to_ns} ns");
        let single = sent
            .iter()
            .filter(|sent| (from_ns..to_ns).contains(&sent.at_ns) && sent.request.id != BROADCAST_ID);
        assert!(single.count() <= 1, "more than one request to one servo from {from_ns} to {to_ns} ns");
    }
}

#[test]
fn goals_reach_the_others_in_every_cycle_while_a_servo_loses_its_power_and_comes_back() {
    let (mut rig, mut bus) = armed();
    let no_power = "[[fault]]\nkind = \"no_power\"\njoint = \"index_pip\"\n";
    // The line has been at work for a while, so that it knows how long answers take.
    cycles(&mut rig, &mut bus, true, 300);
    let begun_ns = rig.now_ns();
    rig.set_faults(no_power);
    let mut num_cycles = 0;
    while bus.servos[2].is_ready() {
        rig.moved_rad += 0.001;
        cycle(&mut rig, &mut bus, true);
        num_cycles += 1;
    }
    assert!(num_cycles <= 60, "{num_cycles} cycles until it was missed");
    rig.set_faults("");
    while !bus.servos[2].is_ready() {
        rig.moved_rad += 0.0005;
        cycle(&mut rig, &mut bus, true);
        num_cycles += 1;
        assert!(num_cycles < 500, "it is found and set up: {:?}", bus.servos[2]);
    }
    cycles(&mut rig, &mut bus, true, 20);
    let sent = rig.sent_since(begun_ns);
    check_goals(&sent, 2 * PERIOD_NS);
    // The set-up took many requests, and the first of them said that it shall let go.
    let to_it: Vec<&Request> =
        sent.iter().map(|sent| &sent.request).filter(|request| request.id == 2).collect();
    let first_write = to_it.iter().find_map(|request| match &request.instruction {
        Instruction::Write { address, data } => Some((*address, data.clone())),
        _ => None,
    });
    assert_eq!(first_write, Some((TORQUE_ENABLE.address, vec![0])));
    assert!(to_it.len() > 8, "{to_it:?}");
    let on = rig.on();
    assert!(!on[2] && on.iter().filter(|on| **on).count() == 15, "the others went on, and it waits: {on:?}");
    let others = bus.servos.iter().filter(|servo| servo.plan.id != 2);
    for servo in others {
        let at_rad = servo.position_rad(rig.now_ns(), 50 * MS_NS).expect("read");
        let goal_rad = rig.start[servo.plan.dof] + rig.moved_rad;
        assert!((servo.plan.joint_rad(at_rad) - goal_rad).abs() < 0.06, "{}", servo.plan.name());
    }
}

#[test]
fn a_stop_in_the_middle_of_a_set_up_reaches_the_others_within_a_cycle() {
    let (mut rig, mut bus) = armed();
    rig.set_faults("[[fault]]\nkind = \"no_power\"\njoint = \"index_pip\"\n");
    while bus.servos[2].is_ready() {
        cycle(&mut rig, &mut bus, true);
    }
    rig.set_faults("");
    let begun_ns = rig.now_ns();
    // Three requests of the set-up are through.
    let to_it = |rig: &Rig| rig.sent_since(begun_ns).iter().filter(|sent| sent.request.id == 2).count();
    while bus.servos[2].identity.is_none() || bus.servos[2].setup.is_none() || to_it(&rig) < 4 {
        cycle(&mut rig, &mut bus, true);
        assert!(rig.now_ns() - begun_ns < 3000 * MS_NS, "it is found: {:?}", bus.servos[2]);
    }
    assert!(bus.servos[2].setup.is_some() && bus.armed);
    let stop_ns = rig.now_ns();
    cycle(&mut rig, &mut bus, false);
    let told = told_off(&rig.sent_since(stop_ns));
    assert!(told.first().is_some_and(|told_ns| told_ns - stop_ns <= PERIOD_NS), "{told:?}");
    assert!(rig.on().iter().all(|on| !on));
}

#[test]
fn the_condition_of_a_servo_that_does_not_tell_it_is_asked_once_a_cycle() {
    let (mut rig, mut bus) = armed();
    cycles(&mut rig, &mut bus, true, 200);
    rig.lose(|request, id| id == 7 && asks_for_condition(request));
    let begun_ns = rig.now_ns();
    cycles(&mut rig, &mut bus, true, 100);
    check_goals(&rig.sent_since(begun_ns), 2 * PERIOD_NS);
}
