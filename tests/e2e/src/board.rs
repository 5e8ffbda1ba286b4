//! A tactile board on a pseudo-terminal whose reading jumps at moments that are noted when the bytes leave.

use std::{
    ffi::OsString,
    fs::File,
    os::{fd::OwnedFd, unix::ffi::OsStringExt as _},
    path::PathBuf,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use palpate_device_protocol::lines::encode_twintac;
use rustix::{
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{OptionalActions, tcgetattr, tcsetattr},
};

/// A line each, as the real boards send them.
const PERIOD: Duration = Duration::from_millis(10);
/// Every channel at rest, raw units.
const REST: f64 = 8000.0;
/// The reading stays for at least this long; then it jumps at another moment each time, so that no rhythm of what is behind
/// it is met.
const STAY: Duration = Duration::from_millis(1500);
const MOST_LONGER_MS: u64 = 97;
/// At first it is left at rest, of which the station takes its zero.
const FIRST_STAY: Duration = Duration::from_secs(6);

/// A board that sends until it is dropped.
pub struct Board {
    /// Where it can be opened.
    pub port: PathBuf,
    jumps: Arc<Mutex<Vec<Jump>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    // Held open, so that the line lives before somebody opens it and after.
    _client: File,
}

/// One jump of the reading.
#[derive(Clone, Copy, Debug)]
pub struct Jump {
    /// When the first line that shows it was written, ms since 1970.
    pub unix_ms: f64,
    /// Whether the reading is up from then on.
    pub up: bool,
}

impl Board {
    /// A board of `num_channels`, of which `channel` reads `by` more every other time.
    pub fn start(num_channels: usize, channel: usize, by: f64) -> anyhow::Result<Self> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let port = PathBuf::from(OsString::from_vec(ptsname(&master, Vec::new())?.into_bytes()));
        let mut settings = tcgetattr(&master)?;
        settings.make_raw();
        tcsetattr(&master, OptionalActions::Now, &settings)?;
        let client = File::open(&port)?;
        let (jumps, stop) = (Arc::<Mutex<Vec<Jump>>>::default(), Arc::new(AtomicBool::new(false)));
        let thread = thread::spawn({
            let (jumps, stop) = (Arc::clone(&jumps), Arc::clone(&stop));
            move || send(&master, &jumps, &stop, num_channels, channel, by)
        });
        Ok(Self { port, jumps, stop, thread: Some(thread), _client: client })
    }

    /// All jumps so far.
    pub fn jumps(&self) -> Vec<Jump> {
        self.jumps.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn send(
    master: &OwnedFd,
    jumps: &Mutex<Vec<Jump>>,
    stop: &AtomicBool,
    num_channels: usize,
    channel: usize,
    by: f64,
) {
    let mut values = vec![REST; num_channels];
    let (mut up, mut next_jump) = (false, Instant::now() + FIRST_STAY);
    let mut next_line = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        let jumps_now = Instant::now() >= next_jump;
        if jumps_now {
            up = !up;
            values[channel] = if up { REST + by } else { REST };
        }
        let line = encode_twintac(&values);
        let unix_ms = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64() * 1e3;
        // A line that nobody reads fills up; whoever opens it later misses what was before.
        let _full = rustix::io::write(master, line.as_bytes());
        if jumps_now {
            let mut jumps = jumps.lock().unwrap_or_else(PoisonError::into_inner);
            jumps.push(Jump { unix_ms, up });
            let longer = (jumps.len() as u64 * 37) % MOST_LONGER_MS;
            next_jump = Instant::now() + STAY + Duration::from_millis(longer);
        }
        next_line += PERIOD;
        thread::sleep(next_line.saturating_duration_since(Instant::now()));
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _failed = thread.join();
        }
    }
}
