//! The emulated station in a thread, for tests of drivers with their threads and ports.

use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use palpate_emulator::{ArmPorts, DevicePorts, EmulatedStation, PortsConfig, StationControl, serve_devices};

use crate::context::DeviceContext;
use crate::event::{DeviceEvent, Link};

/// Whatever is waited for comes long before this, unless it never does.
const PATIENCE: Duration = Duration::from_secs(60);
/// A test that looks away for long loses no event.
const MAX_EVENTS: usize = 100_000;

/// Devices on free ports and in a folder of their own. They end when this is dropped.
pub(crate) struct Emulated {
    pub(crate) ports: DevicePorts,
    /// What is true of the devices.
    pub(crate) control: StationControl,
    dir: tempfile::TempDir,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Emulated {
    pub(crate) fn start() -> Self {
        let dir = tempfile::tempdir().expect("a folder");
        let stop = Arc::new(AtomicBool::new(false));
        let (sender, ports) = mpsc::sync_channel(1);
        let config = PortsConfig {
            dir: dir.path().to_path_buf(),
            arm_ip: IpAddr::V4(Ipv4Addr::LOCALHOST),
            arm_ports: ArmPorts::Any,
        };
        let thread = std::thread::spawn({
            let stop = Arc::clone(&stop);
            move || {
                let truth = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/truth/demo.toml");
                let mut station = EmulatedStation::new(&truth, 3).expect("the demonstration's station");
                let control = station.control();
                let mut ready = |ports: &DevicePorts| {
                    sender.send((ports.clone(), control.clone())).expect("the test waits");
                };
                let mut notice = |text: String| eprintln!("emulation: {text}");
                serve_devices(&mut station, &config, &stop, &mut ready, &mut notice).expect("served");
            }
        });
        let (ports, control) = ports.recv_timeout(PATIENCE).expect("the devices come up");
        Self { ports, control, dir, stop, thread: Some(thread) }
    }

    /// Path of a serial line.
    pub(crate) fn line(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// Says what is wrong from now on.
    pub(crate) fn set_faults(&self, text: &str) {
        // The file is looked at by its time of change, which some file systems count in coarse steps.
        std::thread::sleep(Duration::from_millis(20));
        let new = self.dir.path().join("faults.new");
        std::fs::write(&new, text).expect("a file");
        std::fs::rename(new, self.dir.path().join("faults.toml")).expect("its name");
    }
}

impl Drop for Emulated {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _failed = thread.join();
        }
    }
}

/// A device's thread with everything around it.
pub(crate) struct Driven {
    pub(crate) context: DeviceContext,
    events: Receiver<DeviceEvent>,
    /// What has come so far.
    pub(crate) seen: Vec<DeviceEvent>,
    thread: Option<JoinHandle<()>>,
}

impl Driven {
    pub(crate) fn start(id: &str, run: impl FnMut(&DeviceContext) + Send + 'static) -> Self {
        let (sender, events) = mpsc::sync_channel(MAX_EVENTS);
        let context = DeviceContext::for_tests(id, sender);
        let thread = std::thread::spawn({
            let context = context.clone();
            move || context.keep_running(run)
        });
        Self { context, events, seen: Vec::new(), thread: Some(thread) }
    }

    /// Waits for an event and gives it.
    pub(crate) fn wait_for(
        &mut self,
        what: &str,
        mut is_it: impl FnMut(&DeviceEvent) -> bool,
    ) -> DeviceEvent {
        let begun = Instant::now();
        while let Some(left) = PATIENCE.checked_sub(begun.elapsed()) {
            let Ok(event) = self.events.recv_timeout(left) else { break };
            self.seen.push(event.clone());
            if is_it(&event) {
                return event;
            }
        }
        panic!("never {what}: {:?}", self.context.health.snapshot(self.context.clock.now_ns()));
    }

    /// Waits until the link is told to be this, and gives what is wrong with it.
    pub(crate) fn wait_for_link(&mut self, wanted: Link) -> String {
        let found = self.wait_for(
            &format!("{wanted:?}"),
            |event| matches!(event, DeviceEvent::Link { link, .. } if *link == wanted),
        );
        match found {
            DeviceEvent::Link { problem, .. } => problem,
            _ => String::new(),
        }
    }

    /// Takes what has come without waiting for more, and forgets it.
    pub(crate) fn forget(&mut self) {
        while self.events.try_recv().is_ok() {}
        self.seen.clear();
    }

    /// Ends the thread.
    pub(crate) fn end(&mut self) {
        self.context.stop.set();
        if let Some(thread) = self.thread.take() {
            assert!(thread.join().is_ok(), "the device's thread panicked");
        }
    }
}

impl Drop for Driven {
    fn drop(&mut self) {
        self.context.stop.set();
        if let Some(thread) = self.thread.take() {
            let _panicked = thread.join();
        }
    }
}

/// Emulated stations take all of a core: those of tests run one after another.
pub(crate) fn one_at_a_time() -> std::sync::MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}
