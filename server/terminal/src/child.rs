//! A long command as a child process: another program of this project, told to print [`events`](crate::events).
//!
//! The child ends when this process does, for its standard input then ends.

use std::{
    io::{self, BufRead, BufReader, Read},
    path::Path,
    process::{Command, ExitStatus, Stdio},
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

use palpate_sim::job::{Cancel, Progress};
use rustix::process::{Pid, Signal, kill_process};
use serde::Deserialize;
use serde_json::{Map, Value};

/// Longest line of an event, bytes: the report of a large set of demonstrations has some hundred kilobytes.
const MAX_LINE_BYTES: usize = 16 << 20;
/// This much of a line that is no event goes to the log, characters.
const MAX_LOGGED_CHARS: usize = 1000;
/// Whether somebody asks to stop is looked at this often.
const LOOK_PERIOD: Duration = Duration::from_millis(50);
/// A request to stop is passed on after this. Where it went to the whole process group, as studios and terminals send
/// it, the program has it already, and a second one would end it before it has left its folder in order.
const PASS_ON_AFTER: Duration = Duration::from_secs(2);

/// Who hears of what a child prints.
pub struct Listener<'a> {
    /// Of how far it is.
    pub progress: &'a dyn Progress,
    /// Of points of its curves: numbers by name, `step` among them.
    pub metrics: &'a dyn Fn(&Map<String, Value>),
    /// Of every line that is for people.
    pub log: &'a (dyn Fn(&str) + Sync),
    /// Whether it is asked to stop.
    pub cancel: &'a Cancel,
}

/// How a child ended.
#[derive(Debug)]
pub struct Ended {
    /// Its exit status.
    pub status: ExitStatus,
    /// What came out, if it told.
    pub report: Option<Value>,
    /// Why it could not go on, if it said so: the first [`MAX_LOGGED_CHARS`] characters.
    pub complaint: String,
}

/// A line of its standard output.
#[derive(Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Event {
    Progress { fraction: f64, stage: String },
    Metrics { point: Map<String, Value> },
    Report { report: Value },
}

/// A command that runs `program` as a child; its arguments come after.
pub fn command(program: &Path) -> Command {
    let mut command = Command::new(program);
    command.arg("--events");
    command
}

/// Runs `command`, which [`command`] has begun, until it ends.
///
/// # Errors
/// It cannot be started, or what it prints cannot be read.
pub fn run(command: &mut Command, listener: &Listener<'_>) -> io::Result<Ended> {
    let program = Path::new(command.get_program()).file_name().unwrap_or_default();
    let says = format!("{}: ", program.to_string_lossy());
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
    // Held until it has ended.
    let _stdin = child.stdin.take();
    let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
    let pid = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    let (cancel, log) = (listener.cancel, listener.log);
    let has_ended = AtomicBool::new(false);
    let (report, complaint) = thread::scope(|scope| {
        let asks = scope.spawn(|| {
            let mut cancelled = None;
            while !has_ended.load(Ordering::Relaxed) {
                if cancel.is_cancelled() {
                    let since = *cancelled.get_or_insert_with(Instant::now);
                    if since.elapsed() >= PASS_ON_AFTER {
                        // It is not waited for before this thread has ended, so the number is still its own.
                        if let Some(pid) = pid {
                            let _ = kill_process(pid, Signal::TERM);
                        }
                        return;
                    }
                }
                thread::park_timeout(LOOK_PERIOD);
            }
        });
        let complaint =
            scope.spawn(|| stderr.map(|stderr| copy_complaints(stderr, &says, log)).unwrap_or_default());
        let report = stdout.map(|stdout| read_events(stdout, listener)).transpose();
        let complaint = complaint.join().unwrap_or_default();
        has_ended.store(true, Ordering::Relaxed);
        asks.thread().unpark();
        (report, complaint)
    });
    let status = child.wait()?;
    Ok(Ended { status, report: report?.flatten(), complaint })
}

/// Passes events on, and everything else to the log; gives the last report.
fn read_events(stdout: impl Read, listener: &Listener<'_>) -> io::Result<Option<Value>> {
    let mut report = None;
    for_each_line(stdout, MAX_LINE_BYTES, |line| match line {
        Line::Whole(line) => match serde_json::from_slice(line) {
            Ok(Event::Progress { fraction, stage }) => listener.progress.report(fraction, &stage),
            Ok(Event::Metrics { mut point }) => {
                point.retain(|_, value| value.is_number());
                if point.contains_key("step") {
                    (listener.metrics)(&point);
                }
            }
            Ok(Event::Report { report: found }) => report = Some(found),
            Err(_) => {
                let text: String = String::from_utf8_lossy(line).chars().take(MAX_LOGGED_CHARS).collect();
                (listener.log)(&text);
            }
        },
        Line::TooLong => {
            (listener.log)(&format!("a line of more than {MAX_LINE_BYTES} bytes was left out"));
        }
    })?;
    Ok(report)
}

/// Copies what is meant for people to the log; gives the last line in which the program says why it cannot go on: one that
/// begins with `says`, its name, or with "error".
fn copy_complaints(stderr: impl Read, says: &str, log: &dyn Fn(&str)) -> String {
    let mut complaint = String::new();
    let copied = for_each_line(stderr, MAX_LINE_BYTES, |line| {
        let Line::Whole(line) = line else { return };
        let text = String::from_utf8_lossy(line);
        log(&text);
        let said = text.strip_prefix(says).or_else(|| text.strip_prefix("error: "));
        if let Some(said) = said {
            complaint = said.chars().take(MAX_LOGGED_CHARS).collect();
        } else if text.contains("' panicked at ") {
            complaint = text.chars().take(MAX_LOGGED_CHARS).collect();
        }
    });
    if let Err(err) = copied {
        log(&format!("failed to read what the program says: {err}"));
    }
    complaint
}

enum Line<'a> {
    /// Without its end.
    Whole(&'a [u8]),
    /// It is left out.
    TooLong,
}

/// Calls `read` with every line of `input`, of which `max_bytes` are kept at most.
fn for_each_line(input: impl Read, max_bytes: usize, mut read: impl FnMut(Line<'_>)) -> io::Result<()> {
    let mut input = BufReader::new(input);
    let (mut line, mut is_too_long) = (Vec::new(), false);
    loop {
        let part = match input.fill_buf() {
            Err(err) if err.kind() == io::ErrorKind::Interrupted => continue,
            part => part?,
        };
        if part.is_empty() {
            if is_too_long {
                read(Line::TooLong);
            } else if !line.is_empty() {
                read(Line::Whole(&line));
            }
            return Ok(());
        }
        let end = part.iter().position(|&byte| byte == b'\n');
        let text = &part[..end.unwrap_or(part.len())];
        is_too_long |= line.len() + text.len() > max_bytes;
        if !is_too_long {
            line.extend_from_slice(text);
        }
        let used = end.map_or(part.len(), |end| end + 1);
        input.consume(used);
        if end.is_some() {
            read(if is_too_long { Line::TooLong } else { Line::Whole(&line) });
            line.clear();
            is_too_long = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_without_end_takes_no_memory() {
        let mut lines = Vec::new();
        let text = [vec![b'x'; 100_000], b"\nshort\n".to_vec(), vec![b'y'; 50]].concat();
        for_each_line(&text[..], 40, |line| {
            lines.push(match line {
                Line::Whole(line) => String::from_utf8_lossy(line).into_owned(),
                Line::TooLong => "too long".to_owned(),
            });
        })
        .unwrap();
        assert_eq!(lines, ["too long", "short", "too long"]);
    }
}
