//! An emulated station, a control loop before it, and operators.

use std::{
    collections::BTreeMap,
    net::{IpAddr, Ipv4Addr},
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use palpate_control::{AuditFile, AuditLine, AuditRotation, Claim, Control, ControlConfig, Ending, Handle};
use palpate_drivers::{PortOverride, Ports};
use palpate_emulator::{
    ArmPorts, DevicePorts, EmulatedStation, Faults, LoggedStep, PortsConfig, StationControl, serve_devices,
};
use palpate_robot_model::Station;
use palpate_wire::{
    api::Source,
    proto::{
        Acquire, Arm, ControlReply, ControlRequest, ControlState, Heartbeat, LiveFrame, Stop, Targets,
        control_request::Request, control_state::Phase, device_status::Link,
    },
};

/// Whatever is waited for comes long before this, unless it never does.
const PATIENCE: Duration = Duration::from_secs(120);
/// Pages send heartbeats at 20 Hz; here somewhat faster, because the machine has other things to do.
const HEARTBEAT: Duration = Duration::from_millis(25);

/// Emulated stations take all of a core: tests with one run one after another.
fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Everything; ends when it is dropped.
pub(crate) struct Bench {
    control: Option<Control>,
    pub(crate) handle: Handle,
    station: Arc<Station>,
    ports: Ports,
    pub(crate) emulated: StationControl,
    pub(crate) dir: tempfile::TempDir,
    frames: Arc<Mutex<Frames>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    _turn: MutexGuard<'static, ()>,
}

/// What was published.
#[derive(Default)]
struct Frames {
    newest: Option<LiveFrame>,
    count: u64,
}

impl Bench {
    /// A station whose devices are all found and ready.
    pub(crate) fn new() -> Self {
        Self::of(station())
    }

    /// The same that waits longer for its operator: for what takes long and is not about operators that fall silent. The
    /// threads of a test stand still for a moment now and then, where those of a station do not.
    pub(crate) fn patient() -> Self {
        let mut station = station();
        (station.safety.heartbeat_ttl_s, station.safety.disarm_after_s) = (1.0, 2.0);
        Self::of(station)
    }

    fn of(station: Station) -> Self {
        let turn = turn();
        let dir = tempfile::tempdir().expect("a folder");
        let stop = Arc::new(AtomicBool::new(false));
        let (found, ports) = mpsc::sync_channel(1);
        let config = PortsConfig {
            dir: dir.path().join("devices"),
            arm_ip: IpAddr::V4(Ipv4Addr::LOCALHOST),
            arm_ports: ArmPorts::Any,
        };
        let thread = thread::spawn({
            let stop = Arc::clone(&stop);
            move || {
                let truth = assets().join("truth/small.toml");
                let mut emulated =
                    EmulatedStation::new(&truth, 3).expect("the shipped truth can be emulated");
                let control = emulated.control();
                let mut ready = |ports: &DevicePorts| {
                    found.send((control.clone(), ports.clone())).expect("the test waits");
                };
                let mut notice = |text: String| eprintln!("emulation: {text}");
                serve_devices(&mut emulated, &config, &stop, &mut ready, &mut notice)
                    .expect("devices are served");
            }
        });
        let (emulated, device_ports) = ports.recv_timeout(PATIENCE).expect("the devices come up");
        let station = Arc::new(station);
        let frames = Arc::new(Mutex::new(Frames::default()));
        let ports = overrides(&station, &device_ports);
        let control = start_control(&dir, station.clone(), ports.clone(), &emulated, &frames);
        let handle = control.handle();
        let bench = Self {
            control: Some(control),
            handle,
            station,
            ports,
            emulated,
            dir,
            frames,
            stop,
            thread: Some(thread),
            _turn: turn,
        };
        bench.wait_for("every device to be ready", |state| {
            state.devices.iter().all(|device| device.link() == Link::Ready)
        });
        // Boards take their first zero in half a second.
        bench.wait_for_frame("a zero of every board", |frame| {
            frame.raw.iter().filter(|raw| **raw != 0.0).count() * 2 > frame.raw.len()
        });
        bench
    }

    /// Ends the control loop, as a server that is told to end does.
    pub(crate) fn end_control(&mut self) -> Ending {
        let mut control = self.control.take().expect("it runs");
        let ending = control.end(PATIENCE);
        assert!(control.finish(PATIENCE), "the loop's thread ends");
        ending
    }

    /// Starts the control loop again, as a server on the same data does.
    pub(crate) fn restart_control(&mut self) {
        *self.frames.lock().unwrap_or_else(PoisonError::into_inner) = Frames::default();
        let (station, ports) = (self.station.clone(), self.ports.clone());
        let control = start_control(&self.dir, station, ports, &self.emulated, &self.frames);
        self.handle = control.handle();
        self.control = Some(control);
        self.wait_for("every device to be ready", |state| {
            state.devices.iter().all(|device| device.link() == Link::Ready)
        });
    }

    pub(crate) fn frame(&self) -> Option<LiveFrame> {
        self.frames.lock().unwrap_or_else(PoisonError::into_inner).newest.clone()
    }

    pub(crate) fn num_frames(&self) -> u64 {
        self.frames.lock().unwrap_or_else(PoisonError::into_inner).count
    }

    /// Waits until a published frame is as wanted.
    pub(crate) fn wait_for_frame(&self, what: &str, wanted: impl Fn(&LiveFrame) -> bool) -> LiveFrame {
        let begun = Instant::now();
        loop {
            let frame = self.frame();
            if let Some(frame) = frame.clone().filter(&wanted) {
                return frame;
            }
            assert!(begun.elapsed() < PATIENCE, "never {what}: {frame:?}");
            thread::sleep(Duration::from_millis(2));
        }
    }

    /// Waits until the published state is as wanted.
    pub(crate) fn wait_for(&self, what: &str, wanted: impl Fn(&ControlState) -> bool) -> ControlState {
        let frame = self.wait_for_frame(what, |frame| frame.control.as_ref().is_some_and(&wanted));
        frame.control.expect("it was looked at")
    }

    pub(crate) fn wait_for_phase(&self, phase: Phase) -> ControlState {
        self.wait_for(&format!("{phase:?}"), |state| state.phase() == phase)
    }

    /// Waits until the emulated station is as wanted; gives its own time.
    pub(crate) fn wait_until(
        &self,
        what: &str,
        wanted: impl Fn(&palpate_emulator::StationSnapshot) -> bool,
    ) -> u64 {
        let begun = Instant::now();
        loop {
            let snapshot = self.emulated.snapshot();
            if wanted(&snapshot) {
                return snapshot.device_ns;
            }
            assert!(begun.elapsed() < PATIENCE, "never {what}: {snapshot:?} {:?}", self.frame());
            thread::sleep(Duration::from_millis(1));
        }
    }

    pub(crate) fn set_faults(&self, text: &str) {
        let faults = Faults::parse("faults", text, self.emulated.station()).expect("the faults are known");
        self.emulated.set_faults(faults).expect("the station can have them");
    }

    pub(crate) fn dof(&self, joint: &str) -> usize {
        let mut joints = self.handle.station().robot.dofs();
        joints.position(|known| known.name == joint).expect("the joint is known")
    }

    pub(crate) fn audit(&self) -> Vec<AuditLine> {
        let text =
            std::fs::read_to_string(self.dir.path().join("audit.jsonl")).expect("there is an audit log");
        text.lines().map(|line| serde_json::from_str(line).expect("each line is one object")).collect()
    }

    /// Waits until the audit log has a line that contains `text`.
    pub(crate) fn wait_for_audit(&self, text: &str) -> AuditLine {
        let begun = Instant::now();
        loop {
            if let Some(line) = self.audit().into_iter().find(|line| line.what.contains(text)) {
                return line;
            }
            assert!(begun.elapsed() < PATIENCE, "never {text:?} in {:?}", self.audit());
            thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.control = None;
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let failed = thread.join().is_err();
            assert!(!failed || thread::panicking(), "the emulation failed");
        }
    }
}

fn start_control(
    dir: &tempfile::TempDir,
    station: Arc<Station>,
    ports: Ports,
    emulated: &StationControl,
    frames: &Arc<Mutex<Frames>>,
) -> Control {
    let (placing, frames) = (emulated.clone(), Arc::clone(frames));
    let config = ControlConfig {
        ports,
        station,
        source: Source::Emulated,
        sessions_dir: dir.path().join("sessions"),
        audit: AuditFile::open(&dir.path().join("audit.jsonl"), AuditRotation::default())
            .expect("there is room for an audit log"),
        wanted_path: dir.path().join("wanted.json"),
        latch_path: dir.path().join("stop.txt"),
        place_object: Some(Box::new(move |object| {
            placing.place_object(Some(object)).map_err(|error| error.to_string())
        })),
    };
    let publish = Box::new(move |frame| {
        let mut frames = frames.lock().unwrap_or_else(PoisonError::into_inner);
        frames.newest = Some(frame);
        frames.count += 1;
    });
    Control::start(config, publish).expect("the control loop starts")
}

/// One connection. With a heartbeat, somebody is there who holds the page open.
pub(crate) struct Operator {
    connection: Arc<Mutex<Connection>>,
    alive: Arc<AtomicBool>,
    heart: Option<JoinHandle<()>>,
}

struct Connection {
    handle: Handle,
    number: u64,
    sequence: u64,
    lease: u64,
}

impl Connection {
    fn ask(&mut self, request: Request) -> ControlReply {
        self.sequence += 1;
        let request = ControlRequest { sequence: self.sequence, lease: self.lease, request: Some(request) };
        let reply = self.handle.request(self.number, request);
        assert_eq!(reply.sequence, self.sequence);
        self.lease = reply.lease;
        reply
    }
}

impl Operator {
    /// A page that has just been opened.
    pub(crate) fn watcher(bench: &Bench, number: u64) -> Self {
        let connection = Connection { handle: bench.handle.clone(), number, sequence: 0, lease: 0 };
        Self {
            connection: Arc::new(Mutex::new(connection)),
            alive: Arc::new(AtomicBool::new(false)),
            heart: None,
        }
    }

    /// Somebody in control.
    pub(crate) fn in_control(bench: &Bench, number: u64) -> Self {
        let mut operator = Self::watcher(bench, number);
        operator.take_control(false);
        operator
    }

    /// Somebody in control of an armed station.
    pub(crate) fn armed(bench: &Bench, number: u64) -> Self {
        let operator = Self::in_control(bench, number);
        operator.arm(bench);
        operator
    }

    pub(crate) fn take_control(&mut self, take_over: bool) {
        let operator = format!("operator {}", self.connection().number);
        self.accepted(Request::Acquire(Acquire { operator, take_over }));
        self.alive.store(true, Ordering::Relaxed);
        let (connection, alive) = (Arc::clone(&self.connection), Arc::clone(&self.alive));
        self.heart = Some(thread::spawn(move || {
            while alive.load(Ordering::Relaxed) {
                let mut connection = connection.lock().unwrap_or_else(PoisonError::into_inner);
                // Between the two looks the operator may have gone.
                if alive.load(Ordering::Relaxed) {
                    connection.ask(Request::Heartbeat(Heartbeat {}));
                }
                drop(connection);
                thread::sleep(HEARTBEAT);
            }
        }));
    }

    /// Asks for torque until it is there. On a machine that is too busy to read joints or to hear of the operator in time
    /// the station refuses, or disarms again; for other reasons it must not.
    pub(crate) fn arm(&self, bench: &Bench) {
        let begun = Instant::now();
        loop {
            let reply = self.ask(Request::Arm(Arm {}));
            let problem = if reply.accepted {
                // The second frame from now on was made after the reply.
                let seen = bench.num_frames() + 1;
                while bench.num_frames() <= seen {
                    assert!(begun.elapsed() < PATIENCE, "no more frames");
                    thread::sleep(Duration::from_millis(2));
                }
                let state = bench.wait_for("armed or not", |state| {
                    matches!(state.phase(), Phase::Armed | Phase::Disarmed | Phase::Stopped)
                });
                if state.phase() == Phase::Armed {
                    return;
                }
                state.reason
            } else {
                reply.problem
            };
            let busy = ["was last read", "nothing is known", "nothing was heard", "stood still", "answer"];
            let is_busy = problem.is_empty() || busy.iter().any(|text| problem.contains(text));
            assert!(is_busy && begun.elapsed() < PATIENCE, "not armed: {problem}");
            thread::sleep(Duration::from_millis(50));
        }
    }

    /// The page is gone, at this moment of the emulated station's time.
    pub(crate) fn vanish(&mut self, bench: &Bench) -> u64 {
        let connection = self.connection();
        self.alive.store(false, Ordering::Relaxed);
        let now_ns = bench.emulated.snapshot().device_ns;
        bench.handle.connection_lost(connection.number);
        now_ns
    }

    pub(crate) fn lease(&self) -> u64 {
        self.connection().lease
    }

    /// What an HTTP request of this operator's page carries.
    pub(crate) fn claim(&self) -> Claim {
        claim(self.lease())
    }

    pub(crate) fn ask(&self, request: Request) -> ControlReply {
        self.connection().ask(request)
    }

    pub(crate) fn accepted(&self, request: Request) -> ControlReply {
        let reply = self.ask(request);
        assert!(reply.accepted, "{}", reply.problem);
        reply
    }

    pub(crate) fn refused(&self, request: Request) -> String {
        let reply = self.ask(request);
        assert!(!reply.accepted && !reply.problem.is_empty(), "{reply:?}");
        reply.problem
    }

    pub(crate) fn stop(&self) {
        self.accepted(Request::Stop(Stop {}));
    }

    fn connection(&self) -> MutexGuard<'_, Connection> {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Operator {
    fn drop(&mut self) {
        self.alive.store(false, Ordering::Relaxed);
        if let Some(heart) = self.heart.take() {
            let _failed = heart.join();
        }
    }
}

/// A request that carries the number `lease`.
pub(crate) fn claim(lease: u64) -> Claim {
    Claim { lease, peer: "a test".into() }
}

pub(crate) fn targets(dofs: &[usize], positions: &[f64]) -> Request {
    let dofs = dofs.iter().map(|&dof| u32::try_from(dof).expect("few joints")).collect();
    Request::Targets(Targets { dofs, positions: positions.to_vec() })
}

/// When all joints stand still for the first time from `from_ns` on, in the station's own time.
pub(crate) fn still_from_ns(steps: &[LoggedStep], from_ns: u64) -> Option<u64> {
    let stands = |step: &&LoggedStep| step.velocities.iter().all(|velocity| velocity.abs() < 0.15);
    steps.iter().filter(|step| step.device_ns >= from_ns).find(stands).map(|step| step.device_ns)
}

pub(crate) fn assets() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets")
}

fn station() -> Station {
    let dir = assets().join("stations");
    Station::read("xarm6_leap.toml", |path| std::fs::read(dir.join(path)).map_err(|err| err.to_string()))
        .expect("the shipped station reads")
}

/// Where the emulated devices are, by the ids of the station file.
fn overrides(station: &Station, found: &DevicePorts) -> Ports {
    let links: BTreeMap<&str, &PathBuf> =
        found.links.iter().map(|(name, link)| (name.as_str(), link)).collect();
    let port = |id: &str| match links.get(id) {
        Some(link) => PortOverride::Serial((*link).clone()),
        None => PortOverride::Arm {
            address: found.arm_ip,
            command_port: found.arm_ports.command,
            report_port: found.arm_ports.real,
        },
    };
    station.devices.iter().map(|device| (device.id.clone(), port(&device.id))).collect()
}
