//! The audit log: who did what and what the station made of it, one JSON object a line, appended for ever.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    },
    thread::{self, JoinHandle},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use palpate_wire::wording::counted;
use serde::{Deserialize, Serialize};

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

/// Writes lines from a thread of its own, so that a slow disk holds nobody up.
#[derive(Debug)]
pub(crate) struct AuditLog {
    lines: Option<SyncSender<Entry>>,
    thread: Option<JoinHandle<()>>,
    problem: Arc<Mutex<String>>,
    num_lost: u64,
    /// Wall-clock time at which the station's time began, since 1970.
    began: Duration,
}

impl AuditLog {
    /// Appends to the file at `path`, which is made with its folders if need be. `now_ns` is the station's time now.
    pub(crate) fn open(path: &Path, now_ns: u64) -> io::Result<Self> {
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            fs::create_dir_all(folder)?;
        }
        let file = OpenOptions::new().create(true).append(true).open(path)?;
        let (lines, received) = sync_channel(MOST_WAITING);
        let problem = Arc::new(Mutex::new(String::new()));
        let thread = thread::Builder::new().name("audit-log".to_owned()).spawn({
            let (path, problem) = (path.to_path_buf(), Arc::clone(&problem));
            move || write_lines(file, &path, &received, &problem)
        })?;
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let began = since_1970.saturating_sub(Duration::from_nanos(now_ns));
        Ok(Self { lines: Some(lines), thread: Some(thread), problem, num_lost: 0, began })
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
        if let Some(Err(TrySendError::Full(_) | TrySendError::Disconnected(_))) =
            self.lines.as_ref().map(|lines| lines.try_send(Entry { line, is_trouble }))
        {
            self.num_lost += 1;
        }
    }

    /// Why lines are missing from the log; empty when none are.
    pub(crate) fn problem(&self) -> String {
        let problem = self.problem.lock().unwrap_or_else(PoisonError::into_inner).clone();
        match (problem.is_empty(), self.num_lost) {
            (false, _) => problem,
            (true, 0) => String::new(),
            (true, lost) => {
                format!("the audit log lost {}, because the disk is too slow", counted(lost, "line"))
            }
        }
    }
}

impl Drop for AuditLog {
    fn drop(&mut self) {
        // The thread writes what is waiting and ends once nobody can send any more.
        self.lines = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of the audit log panicked");
        }
    }
}

fn write_lines(file: File, path: &PathBuf, lines: &Receiver<Entry>, problem: &Mutex<String>) {
    let mut sink = BufWriter::new(file);
    while let Ok(first) = lines.recv() {
        let entries: Vec<Entry> = std::iter::once(first).chain(lines.try_iter()).collect();
        let written = entries
            .iter()
            .try_for_each(|entry| {
                serde_json::to_writer(&mut sink, &entry.line).map_err(io::Error::from)?;
                sink.write_all(b"\n")
            })
            .and_then(|()| sink.flush());
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
                "failed to write the audit log {path:?}: {err}; free some space, or check that the folder can be written"
            ),
        };
        let mut known = problem.lock().unwrap_or_else(PoisonError::into_inner);
        if *known != now {
            if !now.is_empty() {
                tracing::error!("{now}");
            }
            *known = now;
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
            let mut log = AuditLog::open(&path, 0).unwrap();
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
