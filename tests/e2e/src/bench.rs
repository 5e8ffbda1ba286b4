//! Emulated devices in the test's own process, so that it sees the station's own time and every step of its motion.

use std::{
    net::{IpAddr, Ipv4Addr},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context as _, bail};
use palpate_drivers::priority;
use palpate_emulator::{
    ArmPorts, DevicePorts, EmulatedStation, Faults, LoggedStep, PortsConfig, StationControl, StationSnapshot,
    serve_devices,
};

use crate::{Turn, root};

/// One ms of the station's own time.
pub const MS: u64 = 1_000_000;
/// A joint that is slower than this stands, rad/s: what is left is a servo settling.
const STANDS_RAD_PER_S: f64 = 0.15;
/// Whatever is waited for comes long before this, unless it never does.
const PATIENCE: Duration = Duration::from_secs(120);

/// Emulated devices and a handle on them; they end when this is dropped.
pub struct Bench {
    /// What is truly going on, and what is wrong.
    pub control: StationControl,
    found: DevicePorts,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    _links: tempfile::TempDir,
    _turn: Turn,
}

impl Bench {
    /// The devices of the small emulated world, ready for whoever opens them; they keep `turn` until they end.
    pub fn start(turn: Turn) -> anyhow::Result<Self> {
        let links = tempfile::tempdir()?;
        let config = PortsConfig {
            dir: links.path().join("devices"),
            arm_ip: IpAddr::V4(Ipv4Addr::LOCALHOST),
            arm_ports: ArmPorts::Any,
        };
        let mut emulated = EmulatedStation::new(&root().join("assets/truth/small.toml"), 3)?;
        let control = emulated.control();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let (found_there, found) = mpsc::sync_channel(1);
        let thread = thread::spawn(move || {
            // Real devices wait for nobody.
            priority::real_time();
            // Nobody waits any more if the test gave up.
            let mut ready = |ports: &DevicePorts| drop(found_there.send(ports.clone()));
            let mut notice = |text: String| eprintln!("emulation: {text}");
            if let Err(err) = serve_devices(&mut emulated, &config, &stopped, &mut ready, &mut notice) {
                eprintln!("the emulated devices ended: {err}");
            }
        });
        let found = found.recv_timeout(PATIENCE).context("the emulated devices did not come up")?;
        Ok(Self { control, found, stop, thread: Some(thread), _links: links, _turn: turn })
    }

    /// Arguments that name the station and say where its devices are.
    pub fn station_args(&self) -> Vec<String> {
        let lines = self.found.links.iter().map(|(id, link)| format!("{id}={}", link.display()));
        let arm = &self.found.arm_ports;
        let arm = format!("xarm={}:{}/{}", self.found.arm_ip, arm.command, arm.real);
        let ports = lines.chain([arm]).flat_map(|port| ["--port".to_owned(), port]);
        ["--station".to_owned(), self.control.station().id.clone()].into_iter().chain(ports).collect()
    }

    /// Says what is wrong from now on, as a file of faults; the text is empty for nothing.
    pub fn set_faults(&self, text: &str) -> anyhow::Result<()> {
        let faults = Faults::parse("faults", text, self.control.station())?;
        Ok(self.control.set_faults(faults)?)
    }

    /// Place of a joint in the station's order.
    pub fn dof(&self, joint: &str) -> anyhow::Result<usize> {
        let mut joints = self.control.station().robot.dofs();
        joints.position(|known| known.name == joint).with_context(|| format!("no joint {joint}"))
    }

    /// The station's own time.
    pub fn now_ns(&self) -> u64 {
        self.control.snapshot().device_ns
    }

    /// Waits until the station is as wanted; gives its own time.
    pub fn wait_until(&self, what: &str, wanted: impl Fn(&StationSnapshot) -> bool) -> anyhow::Result<u64> {
        let begun = Instant::now();
        loop {
            let snapshot = self.control.snapshot();
            if wanted(&snapshot) {
                return Ok(snapshot.device_ns);
            }
            if begun.elapsed() > PATIENCE {
                bail!("never {what}: {snapshot:?}");
            }
            thread::sleep(Duration::from_millis(1));
        }
    }

    /// Waits until no motor has torque; gives the station's own time.
    pub fn wait_until_limp(&self) -> anyhow::Result<u64> {
        self.wait_until("limp", |now| !now.torque_on.contains(&true))
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let failed = thread.join().is_err();
            assert!(!failed || thread::panicking(), "the emulation failed");
        }
    }
}

/// Since when all of `dofs` have stood still, up to the last of `steps`, in the station's own time. Steps before `from_ns`
/// do not count; `None` if a joint still moves at the end.
pub fn still_from_ns(steps: &[LoggedStep], dofs: &[usize], from_ns: u64) -> Option<u64> {
    let moves = |step: &LoggedStep| dofs.iter().any(|&dof| step.velocities[dof].abs() > STANDS_RAD_PER_S);
    let later = &steps[steps.partition_point(|step| step.device_ns < from_ns)..];
    let still = later.iter().rposition(moves).map_or(0, |last| last + 1);
    later.get(still).map(|step| step.device_ns)
}
