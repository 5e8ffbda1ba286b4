//! The line of servos against the emulated hand, through a pseudo-terminal.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use palpate_emulator::{ArmPorts, EmulatedStation, PortsConfig, serve_devices};
use palpate_robot_model::{DeviceKind, ServoBusConfig};

use super::*;
use crate::clock::HostClock;
use crate::event::DeviceEvent;
use crate::health::DeviceHealth;

/// Nothing here takes nearly as long, on any machine that can run the emulation at all.
const PATIENCE: Duration = Duration::from_secs(60);
const HOLD_NS: u64 = 350_000_000;
const VALID_NS: u64 = 150_000_000;
const MS_NS: u64 = 1_000_000;

/// An emulated hand with its driver.
struct Rig {
    dir: tempfile::TempDir,
    stop_emulator: Arc<AtomicBool>,
    emulator: Option<JoinHandle<()>>,
    context: DeviceContext,
    events: Receiver<DeviceEvent>,
    bus: Option<BusHandle>,
    config: ServoBusConfig,
    seen: Seen,
}

/// What the driver has reported.
#[derive(Default)]
struct Seen {
    joints: BTreeMap<usize, Joint>,
    link: Link,
    problem: String,
    links: Vec<Link>,
    num_readings: u64,
}

#[derive(Clone, Copy, Debug)]
struct Joint {
    position: f64,
    torque_on: bool,
    received_ns: u64,
}

impl Rig {
    fn start(change: impl FnOnce(&mut ServoBusConfig)) -> Self {
        let dir = tempfile::tempdir().expect("a folder");
        let truth = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/truth/demo.toml");
        let mut station = EmulatedStation::new(&truth, 7).expect("the demonstration's station");
        let bus = station.station().devices.iter().find_map(|device| match &device.kind {
            DeviceKind::Dynamixel(bus) => Some(bus.clone()),
            _ => None,
        });
        let mut config = bus.expect("the station has servos");
        change(&mut config);
        let stop_emulator = Arc::new(AtomicBool::new(false));
        let ports = PortsConfig {
            dir: dir.path().to_path_buf(),
            arm_ip: IpAddr::V4(Ipv4Addr::LOCALHOST),
            arm_ports: ArmPorts::Any,
        };
        let (ready, is_ready) = mpsc::sync_channel(1);
        let emulator = std::thread::spawn({
            let stop = Arc::clone(&stop_emulator);
            move || {
                let mut on_ready = |_: &_| ready.send(()).expect("somebody waits");
                let served = serve_devices(&mut station, &ports, &stop, &mut on_ready, &mut |_| {});
                served.expect("the devices are served");
            }
        });
        is_ready.recv_timeout(PATIENCE).expect("the emulated devices");
        let (events, received) = mpsc::sync_channel(100_000);
        let context = DeviceContext { index: 3, ..DeviceContext::for_tests("u2d2", events) };
        let path = dir.path().join("u2d2");
        let bus = spawn(context.clone(), &config, path, HOLD_NS).expect("a thread");
        Self {
            dir,
            stop_emulator,
            emulator: Some(emulator),
            context,
            events: received,
            bus: Some(bus),
            config,
            seen: Seen::default(),
        }
    }

    fn faults_path(&self) -> PathBuf {
        self.dir.path().join("faults.toml")
    }

    fn faults(&self, text: &str) {
        // Put in place at once, so that the emulation never reads half of it.
        let draft = self.dir.path().join("faults.draft");
        std::fs::write(&draft, text).expect("written");
        std::fs::rename(draft, self.faults_path()).expect("put in place");
    }

    fn health(&self) -> DeviceHealth {
        self.context.health.snapshot(self.context.clock.now_ns())
    }

    fn dof(&self, joint: &str) -> usize {
        self.config.servos.iter().find(|servo| servo.joint == joint).expect("a joint of the hand").dof
    }

    fn num_dofs(&self) -> usize {
        1 + self.config.servos.iter().map(|servo| servo.dof).max().unwrap_or(0)
    }

    /// Where the joints are, in the station's order; zero for those of others.
    fn positions(&self) -> Vec<f64> {
        (0..self.num_dofs())
            .map(|dof| self.seen.joints.get(&dof).map_or(0.0, |joint| joint.position))
            .collect()
    }

    /// Takes what the driver has said.
    fn listen(&mut self) {
        while let Ok(event) = self.events.try_recv() {
            match event {
                DeviceEvent::Joints {
                    device,
                    received_ns,
                    host_ns,
                    dofs,
                    positions,
                    velocities,
                    currents_a,
                    torque_on,
                    ..
                } => {
                    assert_eq!(device, 3);
                    assert!(host_ns <= received_ns && received_ns - host_ns < 1000 * MS_NS);
                    assert!(positions.len() == dofs.len() && velocities.len() == dofs.len());
                    assert!(currents_a.len() == dofs.len() && torque_on.len() == dofs.len());
                    self.seen.num_readings += 1;
                    for ((&dof, position), torque_on) in dofs.iter().zip(positions).zip(torque_on) {
                        self.seen.joints.insert(dof, Joint { position, torque_on, received_ns });
                    }
                }
                DeviceEvent::Link { link, problem, .. } => {
                    self.seen.links.push(link);
                    (self.seen.link, self.seen.problem) = (link, problem);
                }
                DeviceEvent::Tactile { .. } => panic!("servos feel nothing"),
            }
        }
    }

    /// Gives the goal that `goal` makes of what was seen, every 5 ms, until `until` holds.
    fn drive(
        &mut self,
        what: &str,
        mut goal: impl FnMut(&Self) -> Option<(bool, Vec<f64>)>,
        mut until: impl FnMut(&Self) -> bool,
    ) {
        let begun = Instant::now();
        loop {
            self.listen();
            if until(self) {
                return;
            }
            assert!(
                begun.elapsed() < PATIENCE,
                "{what} does not happen; link {:?}: {}; {:?}",
                self.seen.link,
                self.seen.problem,
                self.health()
            );
            if let Some((torque, positions)) = goal(self) {
                let valid_until_ns = self.context.clock.now_ns() + VALID_NS;
                let positions = positions.into();
                self.context.goals.set(Goal {
                    torque,
                    lead_through: false,
                    positions,
                    valid_until_ns,
                    disarms: 0,
                });
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn wait(&mut self, what: &str, until: impl FnMut(&Self) -> bool) {
        self.drive(what, |_| None, until);
    }

    fn all_torque(&self, on: bool) -> bool {
        self.seen.joints.len() == self.config.servos.len()
            && self.seen.joints.values().all(|joint| joint.torque_on == on)
    }

    /// Until all servos are found, limp, and the driver knows that whoever commands knows it.
    fn ready(&mut self) {
        let num = self.config.servos.len();
        self.wait("finding the servos", |rig| rig.seen.link == Link::Ready && rig.seen.joints.len() == num);
        let from_ns = self.context.clock.now_ns();
        self.drive(
            "standing by",
            |rig| Some((false, rig.positions())),
            |rig| rig.context.clock.now_ns() > from_ns + 100 * MS_NS,
        );
    }

    /// Switches torque on where the joints are, and gives their positions.
    fn arm(&mut self) -> Vec<f64> {
        let start = self.positions();
        let goal = start.clone();
        self.drive("arming", |_| Some((true, goal.clone())), |rig| rig.all_torque(true));
        start
    }

    /// For 300 ms no torque comes on, although it is asked for at `positions`.
    fn stays_limp(&mut self, positions: &[f64]) {
        let end_ns = self.context.clock.now_ns() + 300 * MS_NS;
        self.drive(
            "some readings",
            |_| Some((true, positions.to_vec())),
            |rig| {
                assert!(rig.seen.joints.values().all(|joint| !joint.torque_on), "torque came on by itself");
                rig.context.clock.now_ns() > end_ns
            },
        );
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        drop(self.bus.take());
        self.stop_emulator.store(true, Ordering::Relaxed);
        if let Some(emulator) = self.emulator.take() {
            let ended = emulator.join();
            assert!(ended.is_ok() || std::thread::panicking(), "the emulation panicked");
        }
    }
}

#[test]
fn servos_are_found_set_up_armed_where_they_are_and_follow() {
    let mut rig = Rig::start(|_| {});
    rig.ready();
    assert!(rig.all_torque(false), "nothing has torque before a goal has");
    let start = rig.arm();
    let pip = rig.dof("index_pip");
    assert!(rig.positions().iter().zip(&start).all(|(now, then)| (now - then).abs() < 0.05));
    // To 0.4 rad at 1 rad/s, as the safety layer would lead it there.
    let begun_ns = rig.context.clock.now_ns();
    let path = |now_ns: u64, start: &[f64]| {
        let mut goal = start.to_vec();
        goal[pip] += (now_ns.saturating_sub(begun_ns) as f64 * 1e-9).min(0.4);
        goal
    };
    rig.drive(
        "the way to the goal",
        |rig| Some((true, path(rig.context.clock.now_ns(), &start))),
        |rig| (rig.positions()[pip] - start[pip] - 0.4).abs() < 0.03,
    );
    for (dof, (now, then)) in rig.positions().iter().zip(&start).enumerate() {
        assert!(dof == pip || (now - then).abs() < 0.05, "joint {dof} moved along");
    }
    let health = rig.health();
    assert_eq!(health.motors.len(), rig.config.servos.len());
    for motor in &health.motors {
        assert_eq!(motor.identity, "XC330-M288, firmware 52", "{motor:?}");
        assert!(motor.problem.is_empty());
        assert!(motor.temperature_c.is_some_and(|temperature_c| (15.0..60.0).contains(&temperature_c)));
        assert!(motor.supply_v.is_some_and(|supply_v| (4.5..5.5).contains(&supply_v)));
        assert!(motor.current_a.is_some_and(|current_a| current_a.abs() <= 0.31));
    }
    assert!(health.rate_hz > 0.0 && health.rate_mean_hz > 0.0 && health.reconnects == 0, "{health:?}");
    // Whoever stops commanding torque gets none.
    rig.drive("disarming", |rig| Some((false, rig.positions())), |rig| rig.all_torque(false));
}

#[test]
fn joints_hold_and_then_go_limp_when_setpoints_dry_up_and_stay_so() {
    let mut rig = Rig::start(|_| {});
    rig.ready();
    let start = rig.arm();
    let valid_until_ns = rig.context.goals.newest().expect("a goal").valid_until_ns;
    rig.wait("going limp", |rig| rig.all_torque(false));
    let limp_ns = rig.seen.joints.values().map(|joint| joint.received_ns).min().expect("joints");
    assert!(limp_ns >= valid_until_ns + HOLD_NS, "torque went off before its time");
    let away = rig.positions().iter().zip(&start).map(|(now, then)| (now - then).abs()).fold(0.0, f64::max);
    assert!(away < 0.05, "moved by {away} rad without a setpoint");
    // A commander that comes back to life does not get torque before it has let go of it.
    let again_ns = rig.context.clock.now_ns() + 500 * MS_NS;
    rig.drive(
        "half a second of setpoints",
        |_| Some((true, start.clone())),
        |rig| {
            assert!(rig.all_torque(false), "torque came on by itself");
            rig.context.clock.now_ns() > again_ns
        },
    );
    rig.ready();
    rig.arm();
}

#[test]
fn a_first_goal_far_from_the_joints_is_refused() {
    let mut rig = Rig::start(|_| {});
    rig.ready();
    let mut goal = rig.positions();
    goal[rig.dof("middle_pip")] += 0.6;
    rig.drive("a refusal", |_| Some((true, goal.clone())), |rig| rig.seen.problem.contains("middle_pip"));
    assert!(
        rig.seen.problem.contains("0.60 rad away") && rig.seen.link == Link::Fault,
        "{}",
        rig.seen.problem
    );
    assert!(rig.all_torque(false));
    rig.ready();
    rig.arm();
}

#[test]
fn an_unplugged_adapter_is_lost_found_again_and_stays_limp() {
    let mut rig = Rig::start(|_| {});
    rig.ready();
    let start = rig.arm();
    rig.faults("[[fault]]\nkind = \"unplug\"\ndevice = \"u2d2\"\n");
    rig.drive("losing it", |_| Some((true, start.clone())), |rig| rig.seen.link == Link::Lost);
    assert!(rig.seen.problem.contains("plug"), "{}", rig.seen.problem);
    rig.faults("");
    rig.seen.joints.clear();
    rig.drive("finding it", |_| Some((true, start.clone())), |rig| rig.seen.link == Link::Ready);
    rig.stays_limp(&start);
    assert_eq!(rig.health().reconnects, 1);
    rig.ready();
    rig.arm();
}

#[test]
fn one_percent_of_wrong_bytes_moves_nothing_and_is_counted() {
    let mut rig = Rig::start(|_| {});
    rig.ready();
    let start = rig.arm();
    let bad_before = rig.health().bad_frames;
    rig.faults("[[fault]]\nkind = \"flip\"\ndevice = \"u2d2\"\nshare = 0.01\n");
    let until_ns = rig.context.clock.now_ns() + 4000 * MS_NS;
    let first_reading = rig.seen.num_readings;
    rig.drive(
        "four seconds of wrong bytes",
        |_| Some((true, start.clone())),
        |rig| {
            for (dof, (now, then)) in rig.positions().iter().zip(&start).enumerate() {
                assert!((now - then).abs() < 0.05, "joint {dof} is at {now}, not {then}");
            }
            rig.context.clock.now_ns() > until_ns
        },
    );
    let health = rig.health();
    assert!(health.bad_frames > bad_before + 50, "{health:?}");
    assert!(rig.seen.num_readings > first_reading + 50, "the joints are still read");
    rig.faults("");
    // All is read in one go again, and nobody has lost torque.
    let rest = rig.context.clock.now_ns() + 1000 * MS_NS;
    rig.drive("rest", |_| Some((true, start.clone())), |rig| rig.context.clock.now_ns() > rest);
    // A busy machine may still lose one now and then.
    let (mut bad, mut num) = (rig.health().bad_frames, rig.seen.num_readings);
    rig.drive(
        "100 readings without damage",
        |_| Some((true, start.clone())),
        |rig| {
            let health = rig.health();
            if health.bad_frames > bad + 5 {
                (bad, num) = (health.bad_frames, rig.seen.num_readings);
            }
            rig.seen.num_readings > num + 100
        },
    );
    assert!(rig.all_torque(true) && rig.seen.link == Link::Ready, "{}", rig.seen.problem);
}

#[test]
fn an_overloaded_servo_is_named_restarted_alone_and_works_again() {
    let mut rig = Rig::start(|_| {});
    rig.ready();
    let start = rig.arm();
    let dof = rig.dof("thumb_mcp");
    rig.faults("[[fault]]\nkind = \"overload\"\njoint = \"thumb_mcp\"\n");
    rig.drive("the fault", |_| Some((true, start.clone())), |rig| rig.seen.link == Link::Fault);
    let problem = rig.seen.problem.clone();
    assert!(problem.contains("thumb_mcp (servo 14)") && problem.contains("overload"), "{problem}");
    assert_eq!(problem.lines().count(), 1, "{problem}");
    rig.drive("its torque", |_| Some((true, start.clone())), |rig| !rig.seen.joints[&dof].torque_on);
    let named = rig.health().motors.into_iter().filter(|motor| !motor.problem.is_empty());
    assert_eq!(named.map(|motor| motor.joint).collect::<Vec<_>>(), ["thumb_mcp"]);
    rig.faults("");
    let seen_at = rig.context.clock.now_ns() + 300 * MS_NS;
    rig.drive("a pause", |_| Some((true, start.clone())), |rig| rig.context.clock.now_ns() > seen_at);
    assert_eq!(rig.seen.link, Link::Fault, "it stays until somebody clears it");
    rig.context.clear_fault.store(true, Ordering::Relaxed);
    rig.drive("recovery", |_| Some((true, start.clone())), |rig| rig.seen.link == Link::Ready);
    // The others were not touched, and the one that restarted waits until everything is armed again.
    let others = rig.seen.joints.iter().filter(|(other, _)| **other != dof);
    assert!(others.clone().all(|(_, joint)| joint.torque_on), "{:?}", rig.seen.joints);
    assert!(!rig.seen.joints[&dof].torque_on);
    rig.ready();
    rig.arm();
}

#[test]
fn a_missing_servo_is_named_and_the_others_are_read() {
    let mut rig = Rig::start(|config| config.servos[5].id = 77);
    let missing = rig.config.servos[5].clone();
    rig.wait("the others", |rig| rig.seen.joints.len() == rig.config.servos.len() - 1);
    rig.wait("a fault", |rig| rig.seen.link == Link::Fault);
    assert!(rig.seen.problem.starts_with(&format!("{} (servo 77): does not answer", missing.joint)));
    let num = rig.seen.num_readings;
    rig.wait("more readings", |rig| rig.seen.num_readings > num + 100);
    assert!(!rig.seen.joints.contains_key(&missing.dof), "nothing is made up for it");
}

#[test]
fn a_driver_that_panics_lets_go_says_so_and_is_started_again() {
    let mut rig = Rig::start(|_| {});
    rig.ready();
    let start = rig.arm();
    rig.seen.links.clear();
    rig.context.panics.store(true, Ordering::Relaxed);
    rig.drive("the failure", |_| Some((true, start.clone())), |rig| rig.seen.link == Link::Lost);
    assert!(
        rig.seen.problem.contains("driver failed") && rig.seen.problem.contains("let go"),
        "{}",
        rig.seen.problem
    );
    rig.seen.joints.clear();
    rig.drive("its return", |_| Some((true, start.clone())), |rig| rig.seen.link == Link::Ready);
    rig.stays_limp(&start);
    rig.ready();
    rig.arm();
}

#[test]
fn a_port_that_is_not_there_and_a_line_without_servos_say_what_to_do() {
    let clock = HostClock::start();
    let path = PathBuf::from("/dev/no-such-port");
    let Err(error) = Line::open(&path, 4_000_000, &clock) else { panic!("there is no such port") };
    let text = words::cannot_open(&path, &error);
    assert!(text.contains("there is no such port: plug the adapter in"), "{text}");

    let mut rig = Rig::start(|config| {
        for servo in &mut config.servos {
            servo.id += 100;
        }
    });
    rig.wait("giving up", |rig| rig.seen.link == Link::Lost);
    assert!(rig.seen.problem.contains("no servo answers") && rig.seen.problem.contains("supply"));
}
