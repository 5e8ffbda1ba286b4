//! Pseudo-terminals, sockets and the clock for an [`EmulatedStation`]: one thread that waits for whatever comes first.

mod arm_sockets;
mod terminal;

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::faults::Faults;
use super::{ARM, EmulatedStation, ReportPort};
use arm_sockets::ArmSockets;
use terminal::Terminal;

/// Longest wait, so that a client that opens a line is noticed soon.
const LONGEST_WAIT: Duration = Duration::from_millis(2);
/// The file of faults is looked at this often.
const FAULTS_EVERY: Duration = Duration::from_millis(100);
/// Ports that the arm could not have again are tried this often.
const LISTEN_EVERY: Duration = Duration::from_millis(200);
/// Time that may be made up for after a pause of the process; what is missing beyond it has not happened.
const MOST_BEHIND: Duration = Duration::from_millis(500);
/// The same where bodies are simulated, which costs more: a computer that is too slow for them leaves time out instead of
/// making up for it for ever, and makes up for as much as this at a time.
const MOST_BEHIND_WITH_BODIES: Duration = Duration::from_millis(100);
const MOST_A_TURN_WITH_BODIES: Duration = Duration::from_millis(10);
/// After a turn that left the station behind, others have the processor for this share of the time that it took.
const GIVES_WAY_SHARE: u32 = 8;
/// That time was left out is said this often.
const TELL_EVERY: Duration = Duration::from_secs(1);
/// The file of faults in the folder of the links.
const FAULTS_FILE: &str = "faults.toml";

/// Where the devices shall be found.
#[derive(Clone, Debug)]
pub struct PortsConfig {
    /// Folder of the links to the pseudo-terminals, and of `faults.toml`.
    pub dir: PathBuf,
    /// Address of the arm's box.
    pub arm_ip: IpAddr,
    /// Ports of the arm's box.
    pub arm_ports: ArmPorts,
}

/// Which TCP ports the arm's box shall have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ArmPorts {
    /// Those of the real box; the port of requests needs a permission on most systems.
    #[default]
    Standard,
    /// Any that are free; [`DevicePorts`] says which.
    Any,
}

/// TCP ports of the arm's box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArmPortNumbers {
    /// Requests and responses.
    pub command: u16,
    /// Reports at 250 Hz.
    pub realtime: u16,
    /// Short reports at 5 Hz.
    pub normal: u16,
    /// Long reports at 5 Hz.
    pub rich: u16,
    /// Reports at 100 Hz.
    pub real: u16,
}

impl ArmPortNumbers {
    /// Those of the real box.
    pub const STANDARD: Self = Self {
        command: 502,
        realtime: ReportPort::Realtime.number(),
        normal: ReportPort::Normal.number(),
        rich: ReportPort::Rich.number(),
        real: ReportPort::Real.number(),
    };

    /// Where a kind of report comes from.
    pub fn report(&self, port: ReportPort) -> u16 {
        match port {
            ReportPort::Realtime => self.realtime,
            ReportPort::Normal => self.normal,
            ReportPort::Rich => self.rich,
            ReportPort::Real => self.real,
        }
    }

    fn report_mut(&mut self, port: ReportPort) -> &mut u16 {
        match port {
            ReportPort::Realtime => &mut self.realtime,
            ReportPort::Normal => &mut self.normal,
            ReportPort::Rich => &mut self.rich,
            ReportPort::Real => &mut self.real,
        }
    }
}

/// Where the devices are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DevicePorts {
    /// Link of each serial line by its name.
    pub links: Vec<(String, PathBuf)>,
    /// Address of the arm's box.
    pub arm_ip: IpAddr,
    /// Ports of the arm's box; they stay the same when it is unplugged and comes back.
    pub arm_ports: ArmPortNumbers,
}

/// Why the devices cannot be reached.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PortsError {
    /// A folder, link or terminal.
    #[error("failed to {action} {path:?}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// On which path.
        path: PathBuf,
        /// Why not.
        #[source]
        source: io::Error,
    },
    /// Something else is where a link shall be.
    #[error(
        "{path:?} is in the way: it is no link of an emulated device; remove it or choose another folder"
    )]
    InTheWay {
        /// The path.
        path: PathBuf,
    },
    /// A port of the arm.
    #[error("failed to listen on {address}{hint}")]
    Listen {
        /// Address and port.
        address: SocketAddr,
        /// What to do, if that is known.
        hint: &'static str,
        /// Why not.
        #[source]
        source: io::Error,
    },
    /// Waiting for bytes.
    #[error("failed to wait for the devices' clients")]
    Wait(#[source] io::Error),
}

impl PortsError {
    fn io(action: &'static str, path: &Path, source: impl Into<io::Error>) -> Self {
        Self::Io { action, path: path.to_path_buf(), source: source.into() }
    }
}

/// Runs `station` in real time until `stop` is set: makes the links, listens, says on `ready` where everything is, and
/// removes the links at the end. Reads what is wrong from `faults.toml` in the folder of the links, whenever it changes;
/// `notice` gets what an operator should know.
pub fn serve_devices(
    station: &mut EmulatedStation,
    config: &PortsConfig,
    stop: &AtomicBool,
    ready: &mut dyn FnMut(&DevicePorts),
    notice: &mut dyn FnMut(String),
) -> Result<(), PortsError> {
    std::fs::create_dir_all(&config.dir)
        .map_err(|source| PortsError::io("make the folder", &config.dir, source))?;
    let sockets = ArmSockets::open(config.arm_ip, config.arm_ports)?;
    let arm_ports = sockets.numbers()?;
    let mut terminals = Vec::new();
    for name in station.lines() {
        terminals.push(Some(Terminal::open(&config.dir.join(name))?));
    }
    let links = station.lines().iter().map(|name| (name.clone(), config.dir.join(name))).collect();
    let mut ports = Ports {
        config,
        arm_ports,
        terminals,
        sockets: Some(sockets),
        listening_failed: None,
        faults: FaultsFile { path: config.dir.join(FAULTS_FILE), modified: None, looked: None },
        epoch: Instant::now(),
        now_ns: 0,
        left_out: LeftOut::default(),
    };
    ports.read_faults(station, notice);
    ports.plug(station, notice)?;
    ready(&DevicePorts { links, arm_ip: config.arm_ip, arm_ports });
    while !stop.load(Ordering::Relaxed) {
        ports.wait(station)?;
        let turn = Instant::now();
        ports.read_clock(station, notice);
        ports.read_faults(station, notice);
        ports.plug(station, notice)?;
        ports.exchange(station);
        if ports.behind() > LONGEST_WAIT && station.has_bodies() {
            // The caller may run at real-time priority.
            std::thread::sleep(turn.elapsed() / GIVES_WAY_SHARE);
        }
    }
    Ok(())
}

struct Ports<'a> {
    config: &'a PortsConfig,
    arm_ports: ArmPortNumbers,
    /// `None` for a line that is unplugged.
    terminals: Vec<Option<Terminal>>,
    /// `None` while the arm is unplugged.
    sockets: Option<ArmSockets>,
    /// When listening on the arm's ports was last in vain.
    listening_failed: Option<Instant>,
    faults: FaultsFile,
    /// When the station's time began.
    epoch: Instant,
    now_ns: u64,
    left_out: LeftOut,
}

/// Time that has not happened, because the computer was too slow or stood still.
#[derive(Default)]
struct LeftOut {
    total: Duration,
    untold: Duration,
    told: Option<Instant>,
}

struct FaultsFile {
    path: PathBuf,
    modified: Option<SystemTime>,
    looked: Option<Instant>,
}

impl Ports<'_> {
    /// Until bytes come or something is due.
    fn wait(&self, station: &EmulatedStation) -> Result<(), PortsError> {
        let until_due = station.next_ns().map_or(LONGEST_WAIT, |due_ns| {
            Duration::from_nanos(due_ns.saturating_sub(self.now_ns)).min(LONGEST_WAIT)
        });
        let mut fds: Vec<PollFd<'_>> = Vec::new();
        for terminal in self.terminals.iter().flatten().filter(|terminal| terminal.has_client()) {
            fds.push(PollFd::new(terminal.fd(), PollFlags::IN));
        }
        if let Some(sockets) = &self.sockets {
            sockets.for_each_fd(&mut |fd| fds.push(PollFd::from_borrowed_fd(fd, PollFlags::IN)));
        }
        let timeout = Timespec { tv_sec: 0, tv_nsec: i64::from(until_due.subsec_nanos()) };
        match poll(&mut fds, Some(&timeout)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(source) => Err(PortsError::Wait(source.into())),
        }
    }

    /// How far the station's time is behind the clock.
    fn behind(&self) -> Duration {
        self.epoch.elapsed().saturating_sub(Duration::from_nanos(self.now_ns))
    }

    fn read_clock(&mut self, station: &EmulatedStation, notice: &mut dyn FnMut(String)) {
        let (most_behind, most_a_turn) = match station.has_bodies() {
            true => (MOST_BEHIND_WITH_BODIES, MOST_A_TURN_WITH_BODIES),
            false => (MOST_BEHIND, MOST_BEHIND),
        };
        let behind = self.behind();
        if behind > most_behind {
            let skipped = behind - LONGEST_WAIT;
            self.epoch += skipped;
            self.left_out.total += skipped;
            self.left_out.untold += skipped;
        }
        station.note_clock(behind, self.left_out.total);
        if !self.left_out.untold.is_zero()
            && self.left_out.told.is_none_or(|told| told.elapsed() >= TELL_EVERY)
        {
            let untold_s = std::mem::take(&mut self.left_out.untold).as_secs_f64();
            self.left_out.told = Some(Instant::now());
            notice(format!("the emulation fell behind and left out {untold_s:.1} s"));
        }
        let most_ns = self.now_ns + most_a_turn.as_nanos() as u64;
        self.now_ns = self.now_ns.max((self.epoch.elapsed().as_nanos() as u64).min(most_ns));
    }

    /// Takes what clients sent and gives them what is due.
    fn exchange(&mut self, station: &mut EmulatedStation) {
        let now_ns = self.now_ns;
        for (line, terminal) in self.terminals.iter_mut().enumerate() {
            let Some(terminal) = terminal else { continue };
            let received = terminal.read();
            if !received.is_empty() {
                station.line_input(line, &received, now_ns);
            }
            let bytes = station.line_output(line, now_ns);
            terminal.write(&bytes);
        }
        let reports = station.reports(now_ns);
        if let Some(sockets) = &mut self.sockets {
            sockets.exchange(station, now_ns, &reports);
        }
    }

    /// Reads the file of faults if it changed; a wrong one changes nothing and is noticed.
    fn read_faults(&mut self, station: &mut EmulatedStation, notice: &mut dyn FnMut(String)) {
        if self.faults.looked.is_some_and(|looked| looked.elapsed() < FAULTS_EVERY) {
            return;
        }
        self.faults.looked = Some(Instant::now());
        let path = &self.faults.path;
        let modified = std::fs::metadata(path).and_then(|metadata| metadata.modified()).ok();
        if modified == self.faults.modified {
            return;
        }
        self.faults.modified = modified;
        let faults = match std::fs::read_to_string(path) {
            Ok(text) => Faults::parse(&path.display().to_string(), &text, station.station()),
            // Without a file nothing is wrong.
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Faults::default()),
            Err(error) => {
                notice(format!("failed to read {path:?}: {error}"));
                return;
            }
        };
        match faults {
            Ok(faults) => station.set_faults(faults, self.now_ns),
            Err(error) => notice(error.to_string()),
        }
    }

    /// Takes unplugged devices away and brings others back.
    fn plug(
        &mut self,
        station: &mut EmulatedStation,
        notice: &mut dyn FnMut(String),
    ) -> Result<(), PortsError> {
        for (name, terminal) in station.lines().iter().zip(&mut self.terminals) {
            let unplugged = station.faults().unplugged(name);
            if unplugged {
                *terminal = None;
            } else if terminal.is_none() {
                *terminal = Some(Terminal::open(&self.config.dir.join(name))?);
            }
        }
        if station.faults().unplugged(ARM) {
            if let Some(sockets) = self.sockets.take() {
                sockets.close(station);
            }
        } else if self.sockets.is_none()
            && self.listening_failed.is_none_or(|failed| failed.elapsed() >= LISTEN_EVERY)
        {
            // Clients look for it where it was. Somebody else may have one of the ports for the moment.
            match ArmSockets::listen(self.config.arm_ip, &self.arm_ports) {
                Ok(sockets) => {
                    self.sockets = Some(sockets);
                    self.listening_failed = None;
                }
                Err(error) => {
                    if self.listening_failed.replace(Instant::now()).is_none() {
                        notice(format!("the arm does not come back yet: {error}"));
                    }
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
