//! The audit log: who did what and what the station made of it, one JSON object a line. A file that is full is kept beside
//! the one that is written ([`files`]).

mod files;

use std::{
    fs, io,
    path::Path,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use palpate_reports::wording::counted;
use serde::{Deserialize, Serialize};

use files::LogFile;
pub use files::{AuditPage, AuditPosition, read_audit};

/// Lines that may wait for the disk. A station writes a few a minute; who fills this is out of order.
const MOST_WAITING: usize = 4096;

/// One line of the log.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditLine {
    /// When, RFC 3339 with milliseconds, UTC.
    pub time: String,
    /// Who: the operator, or `station` for what the station did by itself.
    pub who: String,
    /// From where it was asked for: the connection and the peer's address; empty for what nobody asked for.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub connection: String,
    /// What happened, in words.
    pub what: String,
}

/// Whoever asked for something, as the log names them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Who {
    /// The operator's name, or what is known instead.
    pub(crate) name: String,
    /// The connection; empty for what nobody asked for.
    pub(crate) connection: String,
}

impl Who {
    /// Nobody: the station by itself, or a part of it called `name`.
    pub(crate) fn part(name: &str) -> Self {
        Self { name: name.to_owned(), connection: String::new() }
    }
}

/// A line and how loudly it is logged.
#[derive(Debug)]
struct Entry {
    line: AuditLine,
    is_trouble: bool,
}

/// How large the log's file grows before another one is begun, and how many full ones are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AuditRotation {
    /// A file is full from here on, bytes.
    pub max_bytes: u64,
    /// Full files that are kept; the oldest go.
    pub keep: usize,
}

impl Default for AuditRotation {
    /// A gigabyte in all: decades of a station that writes some lines a minute.
    fn default() -> Self {
        Self { max_bytes: 16 << 20, keep: 64 }
    }
}

/// What the writing thread is told.
#[derive(Debug)]
enum Told {
    Line(Entry),
    /// Everything before is written when this is answered.
    Flush(SyncSender<()>),
}

/// The file of the audit log, which a thread of its own writes, so that a slow disk holds nobody up. Clones write to the same
/// file; the thread ends, and everything is written, when the last of them is dropped.
#[derive(Clone, Debug)]
pub struct AuditFile {
    writer: Arc<Writer>,
}

#[derive(Debug)]
struct Writer {
    told: Option<SyncSender<Told>>,
    thread: Option<JoinHandle<()>>,
    problem: Arc<Mutex<String>>,
    num_lost: AtomicU64,
}

impl AuditFile {
    /// Appends to the file at `path`, which is made with its folders if need be. Full files become `NAME-NNNNNN.jsonl`
    /// beside it.
    pub fn open(path: &Path, rotation: AuditRotation) -> io::Result<Self> {
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            fs::create_dir_all(folder)?;
        }
        let file = LogFile::open(path, rotation)?;
        let (told, received) = sync_channel(MOST_WAITING);
        let problem = Arc::new(Mutex::new(String::new()));
        let thread = thread::Builder::new().name("audit-log".to_owned()).spawn({
            let problem = Arc::clone(&problem);
            move || write_lines(file, &received, &problem)
        })?;
        let writer = Writer { told: Some(told), thread: Some(thread), problem, num_lost: AtomicU64::new(0) };
        Ok(Self { writer: Arc::new(writer) })
    }

    /// Notes that `who` did `what` now, asked for from `connection`. Never waits.
    pub fn note(&self, who: &str, connection: &str, what: &str) {
        let (who, connection, what) = (who.to_owned(), connection.to_owned(), what.to_owned());
        let line = AuditLine { time: rfc3339_now(), who, connection, what };
        self.append(Entry { line, is_trouble: false });
    }

    /// Lines that never reached the file, because too many waited.
    pub fn num_lost(&self) -> u64 {
        self.writer.num_lost.load(Ordering::Relaxed)
    }

    /// Waits until everything that was noted is written, for `patience` at most; says whether it is.
    pub fn flush(&self, patience: Duration) -> bool {
        let (reply, written) = sync_channel(1);
        let Some(told) = &self.writer.told else { return false };
        // The queue is full for a moment at most, unless the disk stands still.
        let deadline = Instant::now() + patience;
        let mut flush = Told::Flush(reply);
        loop {
            match told.try_send(flush) {
                Ok(()) => break,
                Err(TrySendError::Disconnected(_)) => return false,
                Err(TrySendError::Full(back)) if Instant::now() < deadline => {
                    flush = back;
                    thread::sleep(Duration::from_millis(1));
                }
                Err(TrySendError::Full(_)) => return false,
            }
        }
        written.recv_timeout(deadline.saturating_duration_since(Instant::now())).is_ok()
    }

    /// Why lines are missing from the log; empty when none are.
    pub fn problem(&self) -> String {
        let problem = self.writer.problem.lock().unwrap_or_else(PoisonError::into_inner).clone();
        match (problem.is_empty(), self.num_lost()) {
            (false, _) => problem,
            (true, 0) => String::new(),
            (true, lost) => {
                format!("the audit log lost {}, because the disk is too slow", counted(lost, "line"))
            }
        }
    }

    fn append(&self, entry: Entry) {
        if let Some(Err(TrySendError::Full(_) | TrySendError::Disconnected(_))) =
            self.writer.told.as_ref().map(|told| told.try_send(Told::Line(entry)))
        {
            self.writer.num_lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        // The thread writes what is waiting and ends once nobody can send any more.
        self.told = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of the audit log panicked");
        }
    }
}

/// The control loop's way to the log: its lines have the station's time.
#[derive(Debug)]
pub(crate) struct AuditLog {
    file: AuditFile,
    /// Wall-clock time at which the station's time began, since 1970.
    began: Duration,
}

/// What the control loop has noted is waited for this long when it ends.
const FLUSH_PATIENCE: Duration = Duration::from_secs(30);

impl AuditLog {
    /// Writes to `file`. `now_ns` is the station's time now.
    pub(crate) fn new(file: AuditFile, now_ns: u64) -> Self {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { file, began: since_1970.saturating_sub(Duration::from_nanos(now_ns)) }
    }

    /// Notes that `who` did `what` at the station's time `at_ns`. Never waits.
    pub(crate) fn note(&mut self, at_ns: u64, who: &str, what: &str) {
        self.append(at_ns, &Who::part(who), what, false);
    }

    /// Notes what somebody did from a connection at the station's time `at_ns`. Never waits.
    pub(crate) fn note_by(&mut self, at_ns: u64, who: &Who, what: &str) {
        self.append(at_ns, who, what, false);
    }

    /// Notes trouble at the station's time `at_ns`. Never waits.
    pub(crate) fn warn(&mut self, at_ns: u64, who: &str, what: &str) {
        self.append(at_ns, &Who::part(who), what, true);
    }

    fn append(&mut self, at_ns: u64, who: &Who, what: &str, is_trouble: bool) {
        let time = rfc3339_utc(self.began + Duration::from_nanos(at_ns));
        let line = AuditLine {
            time,
            who: who.name.clone(),
            connection: who.connection.clone(),
            what: what.to_owned(),
        };
        self.file.append(Entry { line, is_trouble });
    }

    /// Why lines are missing from the log; empty when none are.
    pub(crate) fn problem(&self) -> String {
        self.file.problem()
    }
}

impl Drop for AuditLog {
    fn drop(&mut self) {
        if !self.file.flush(FLUSH_PATIENCE) {
            tracing::error!("the end of the audit log is not written: the disk stands still");
        }
    }
}

fn write_lines(mut file: LogFile, received: &Receiver<Told>, problem: &Mutex<String>) {
    while let Ok(first) = received.recv() {
        let (mut entries, mut flushes) = (Vec::new(), Vec::new());
        for told in std::iter::once(first).chain(received.try_iter()) {
            match told {
                Told::Line(entry) => entries.push(entry),
                Told::Flush(reply) => flushes.push(reply),
            }
        }
        let written =
            entries.iter().try_for_each(|entry| file.write(&entry.line)).and_then(|()| file.flush());
        // Logged here and not where they are made: whatever prints the log may be slow, and the control loop must not be.
        for Entry { line: AuditLine { who, connection, what, .. }, is_trouble } in &entries {
            match is_trouble {
                true => tracing::warn!(who, connection, what, "audit"),
                false => tracing::info!(who, connection, what, "audit"),
            }
        }
        let now = match written {
            Ok(()) => String::new(),
            Err(err) => format!(
                "failed to write the audit log {:?}: {err}; free some space, or check that the folder can be written",
                file.path
            ),
        };
        {
            let mut known = problem.lock().unwrap_or_else(PoisonError::into_inner);
            if *known != now {
                if !now.is_empty() {
                    tracing::error!("{now}");
                }
                *known = now;
            }
        }
        for reply in flushes {
            // Whoever asked may have lost patience.
            let _ = reply.try_send(());
        }
    }
}

/// The time of day, as RFC 3339 has it.
pub(crate) fn rfc3339_now() -> String {
    rfc3339_utc(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default())
}

/// A time since 1970 as RFC 3339 has it, e.g. `2026-03-02T09:30:00.125Z`.
fn rfc3339_utc(since_1970: Duration) -> String {
    let seconds = since_1970.as_secs();
    let (days, of_day) = (seconds / 86_400, seconds % 86_400);
    // Days to a date of the Gregorian calendar, with years that begin in March so that the leap day comes last.
    let shifted = days + 719_468;
    let (era, of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let march_month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * march_month + 2) / 5 + 1;
    let month = if march_month < 10 { march_month + 3 } else { march_month - 9 };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    format!(
        "{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}.{:03}Z",
        of_day / 3600,
        of_day / 60 % 60,
        of_day % 60,
        since_1970.subsec_millis()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_the_calendar() {
        for (seconds, expected) in [
            (0, "1970-01-01T00:00:00.250Z"),
            (951_782_400, "2000-02-29T00:00:00.250Z"),
            (1_709_251_199, "2024-02-29T23:59:59.250Z"),
            (1_772_443_800, "2026-03-02T09:30:00.250Z"),
            (4_107_542_400, "2100-03-01T00:00:00.250Z"),
        ] {
            assert_eq!(rfc3339_utc(Duration::from_secs(seconds) + Duration::from_millis(250)), expected);
        }
    }

    #[test]
    fn lines_are_appended_and_survive_whatever_is_in_them() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("new").join("audit.jsonl");
        for round in 0..2_u64 {
            let file = AuditFile::open(&path, AuditRotation::default()).unwrap();
            let mut log = AuditLog::new(file, 0);
            log.note(round, "Ada \"A.\"", "armed\nthe station");
            assert_eq!(log.problem(), "");
        }
        let text = fs::read_to_string(&path).unwrap();
        let lines: Vec<AuditLine> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(lines.len(), 2);
        for line in lines {
            assert_eq!((line.who.as_str(), line.what.as_str()), ("Ada \"A.\"", "armed\nthe station"));
            assert!(line.time.ends_with('Z') && line.time.starts_with("20"), "{}", line.time);
        }
    }
}
