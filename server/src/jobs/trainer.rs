//! `palpate-train` as a child process: the program that learns, which is built apart so that the studio never links
//! MuJoCo.
//!
//! It is told to print events (`palpate_terminal::events`), and ends when this process does, for its standard input
//! then ends. What it prints besides goes to the log of the job.

use std::{
    env,
    ffi::OsString,
    fs,
    io::{self, BufRead, BufReader, Read, Write as _},
    os::unix::{fs::PermissionsExt as _, process::ExitStatusExt as _},
    path::{Path, PathBuf},
    process::{Command, ExitStatus, Stdio},
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

use palpate_sim::job::{Cancel, Progress};
use rustix::process::{Pid, Signal, kill_process};
use serde::Deserialize;
use serde_json::{Map, Value};

use crate::Error;

/// Its name.
const PROGRAM: &str = "palpate-train";
/// Longest line of an event, bytes: the report of a large set of demonstrations has some hundred kilobytes.
const MAX_LINE_BYTES: usize = 16 << 20;
/// This much of a line that is no event goes to the log, characters.
const MAX_LOGGED_CHARS: usize = 1000;
/// Whether somebody asks to stop is looked at this often.
const LOOK_PERIOD: Duration = Duration::from_millis(50);
/// A request to stop is passed on after this. Where it went to the whole process group, as studios and terminals send
/// it, the program has it already, and a second one would end it before it has left its folder in order.
const PASS_ON_AFTER: Duration = Duration::from_secs(2);

/// Where `palpate-train` is looked for.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trainer {
    /// What the configuration says; where it says nothing, it is looked for beside `palpate` and on `PATH`.
    pub(crate) configured: Option<PathBuf>,
    /// The `palpate` program.
    pub(crate) palpate: Option<PathBuf>,
}

/// Who hears of what it prints.
pub(crate) struct Listener<'a> {
    pub(crate) progress: &'a dyn Progress,
    pub(crate) metrics: &'a dyn Fn(&Value),
    pub(crate) cancel: &'a Cancel,
}

/// A line of its standard output.
#[derive(Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Event {
    Progress { fraction: f64, stage: String },
    Metrics { point: Map<String, Value> },
    Report { report: Value },
}

impl Trainer {
    /// The program, or why there is none and what to do.
    pub(crate) fn find(&self) -> Result<PathBuf, Error> {
        if let Some(path) = &self.configured {
            return match is_program(path) {
                // It is run in another folder.
                true => std::path::absolute(path).map_err(Error::io("find", path)),
                false => Err(Error::NotInstalled(format!(
                    "the configuration says that {PROGRAM} is {path:?}, and no program is there; build it with `cargo build \
                     --release -p palpate_train --features mujoco`, or change [train] binary"
                ))),
            };
        }
        let beside = self.palpate.as_deref().and_then(Path::parent).map(|folder| folder.join(PROGRAM));
        let path = env::var_os("PATH").unwrap_or_default();
        let on_path = env::split_paths(&path).filter(|folder| folder.is_absolute());
        let mut places = beside.into_iter().chain(on_path.map(|folder| folder.join(PROGRAM)));
        places.find(|place| is_program(place)).ok_or_else(|| {
            Error::NotInstalled(format!(
                "{PROGRAM} is not installed beside palpate; build it with `cargo build --release -p palpate_train --features \
                 mujoco` and put it beside palpate or on PATH, or name it in the configuration ([train] binary)"
            ))
        })
    }

    /// Runs it in the folder `dir` with `args`; gives its report, if it made one.
    pub(crate) fn run(
        &self,
        dir: &Path,
        args: &[OsString],
        listener: &Listener<'_>,
    ) -> Result<Option<Value>, Error> {
        let program = self.find()?;
        let shown: Vec<_> = args.iter().map(|arg| arg.to_string_lossy()).collect();
        println!("{PROGRAM} {}", shown.join(" "));
        let mut child = Command::new(&program)
            .arg("--events")
            .args(args)
            .current_dir(dir)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(Error::io("start", &program))?;
        // Held until it has ended.
        let _stdin = child.stdin.take();
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let pid = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
        let has_ended = AtomicBool::new(false);
        let (report, complaint) = thread::scope(|scope| {
            let asks = scope.spawn(|| {
                let mut cancelled = None;
                while !has_ended.load(Ordering::Relaxed) {
                    if listener.cancel.is_cancelled() {
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
            let complaint = scope.spawn(|| stderr.map(copy_complaints).unwrap_or_default());
            let report = stdout.map(|stdout| read_events(stdout, listener)).transpose();
            let complaint = complaint.join().unwrap_or_default();
            has_ended.store(true, Ordering::Relaxed);
            asks.thread().unpark();
            (report, complaint)
        });
        let status = child.wait().map_err(Error::io("wait for", &program))?;
        if listener.cancel.is_cancelled() {
            return Err(Error::Cancelled);
        }
        if !status.success() {
            return Err(failure(status, &complaint));
        }
        Ok(report.map_err(Error::io("read what is printed by", &program))?.flatten())
    }
}

fn is_program(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|meta| meta.is_file() && meta.permissions().mode() & 0o111 != 0)
}

fn failure(status: ExitStatus, complaint: &str) -> Error {
    match (status.signal(), complaint) {
        (Some(9), _) => Error::Internal(format!(
            "{PROGRAM} was killed (signal 9), by somebody or because memory ran out; see the log"
        )),
        (Some(signal), _) => Error::Internal(format!("{PROGRAM} ended by signal {signal}; see the log")),
        (None, "") => Error::Internal(format!(
            "{PROGRAM} ended with code {} and did not say why; see the log",
            status.code().unwrap_or(-1)
        )),
        (None, complaint) => Error::Content(complaint.to_owned()),
    }
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
                    (listener.metrics)(&Value::Object(point));
                }
            }
            Ok(Event::Report { report: found }) => report = Some(found),
            Err(_) => {
                let text: String = String::from_utf8_lossy(line).chars().take(MAX_LOGGED_CHARS).collect();
                println!("{text}");
            }
        },
        Line::TooLong => println!("a line of more than {MAX_LINE_BYTES} bytes was left out"),
    })?;
    Ok(report)
}

/// Copies what is meant for people to the log; gives the last line in which the program says why it cannot go on.
fn copy_complaints(stderr: impl Read) -> String {
    let mut complaint = String::new();
    let copied = for_each_line(stderr, MAX_LINE_BYTES, |line| {
        let Line::Whole(line) = line else { return };
        let text = String::from_utf8_lossy(line);
        // The log may be on a full disk; the work goes on.
        let _ = writeln!(io::stderr(), "{text}");
        let said = text.strip_prefix("palpate-train: ").or_else(|| text.strip_prefix("error: "));
        if let Some(said) = said {
            complaint = said.chars().take(MAX_LOGGED_CHARS).collect();
        } else if text.contains("' panicked at ") {
            complaint = text.chars().take(MAX_LOGGED_CHARS).collect();
        }
    });
    if let Err(err) = copied {
        tracing::warn!(%err, "failed to read what palpate-train says");
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
    use std::sync::{Arc, Mutex};

    use serde_json::json;

    use super::*;

    #[derive(Default)]
    struct Heard(Mutex<Vec<(f64, String)>>);

    impl Progress for Heard {
        fn report(&self, fraction: f64, stage: &str) {
            self.0.lock().unwrap().push((fraction, stage.to_owned()));
        }
    }

    struct Ran {
        result: Result<Option<Value>, Error>,
        progress: Vec<(f64, String)>,
        points: Vec<Value>,
    }

    /// Runs a shell script in place of the program.
    fn run(script: &str, cancel: &Cancel) -> Ran {
        let dir = tempfile::tempdir().unwrap();
        let program = dir.path().join(PROGRAM);
        fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        let trainer = Trainer { palpate: Some(dir.path().join("palpate")), ..Trainer::default() };
        let (heard, points) = (Heard::default(), Mutex::new(Vec::new()));
        let listener = Listener {
            progress: &heard,
            metrics: &|point| points.lock().unwrap().push(point.clone()),
            cancel,
        };
        let mut tries = 0;
        let result = loop {
            match trainer.run(dir.path(), &["tune".into(), "--seed".into()], &listener) {
                // A process that was forked meanwhile may still hold the script open for writing.
                Err(Error::Io { source, .. })
                    if source.kind() == io::ErrorKind::ExecutableFileBusy && tries < 100 =>
                {
                    tries += 1;
                    thread::sleep(Duration::from_millis(10));
                }
                result => break result,
            }
        };
        Ran { result, progress: heard.0.into_inner().unwrap(), points: points.into_inner().unwrap() }
    }

    fn refused(script: &str) -> String {
        run(script, &Cancel::default()).result.unwrap_err().to_string()
    }

    #[test]
    fn events_are_passed_on_and_garbage_is_not_mistaken_for_one() {
        let ran = run(
            r#"echo "$@" >&2
echo '{"event":"progress","fraction":0.25,"stage":"trials"}'
echo 'not JSON at all'
printf '\377\376 no text\n'
echo '{"event":"progress","fraction":"much"}'
echo '{"event":"dance"}'
echo '[1,2'
echo '{"event":"metrics","point":{"step":3,"loss":0.5,"label":"cube","list":[1]}}'
echo '{"event":"metrics","point":{"loss":0.5}}'
echo '{"event":"report","report":{"won":4}}'
printf '{"event":"progress","fraction":0.75,"stage":"the last line has no end"}'"#,
            &Cancel::default(),
        );
        assert_eq!(ran.result.unwrap(), Some(json!({ "won": 4 })));
        let expected = [(0.25, "trials".to_owned()), (0.75, "the last line has no end".to_owned())];
        assert_eq!(ran.progress, expected);
        assert_eq!(ran.points, [json!({ "step": 3, "loss": 0.5 })]);
    }

    #[test]
    fn crash_is_told_from_a_refusal_and_both_say_why() {
        let said = "echo 'some warning' >&2; echo 'palpate-train: --object is \"cueb\"' >&2; exit 1";
        assert_eq!(refused(said), "--object is \"cueb\"");
        assert!(
            refused("echo \"error: unexpected argument '--events' found\" >&2; exit 2")
                .contains("unexpected")
        );
        assert!(refused("exit 3").contains("code 3 and did not say why"));
        assert!(refused("kill -9 $$").contains("killed (signal 9)"));
        assert!(refused("kill -11 $$").contains("signal 11"));
        // A report does not make up for a crash.
        assert!(refused("echo '{\"event\":\"report\",\"report\":1}'; exit 4").contains("code 4"));
        assert_eq!(run("true", &Cancel::default()).result.unwrap(), None, "there is no report");
    }

    #[test]
    fn request_to_stop_reaches_it_and_counts_however_it_ends() {
        for script in [
            "trap 'exit 0' TERM; echo '{\"event\":\"progress\",\"fraction\":0.5,\"stage\":\"on\"}'; read line",
            "exec sleep 600",
        ] {
            let cancel = Arc::new(Cancel::default());
            let (asked, begun) = (cancel.clone(), Instant::now());
            let asks = thread::spawn(move || {
                thread::sleep(Duration::from_millis(200));
                asked.cancel();
            });
            let ran = run(script, &cancel);
            asks.join().unwrap();
            assert!(matches!(ran.result, Err(Error::Cancelled)), "{script}: {:?}", ran.result);
            assert!(begun.elapsed() < Duration::from_secs(300), "it was not waited for");
        }
    }

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

    #[test]
    fn missing_program_says_how_to_get_it() {
        let dir = tempfile::tempdir().unwrap();
        let configured = dir.path().join(PROGRAM);
        let trainer = Trainer { configured: Some(configured.clone()), ..Trainer::default() };
        let err = trainer.find().unwrap_err();
        assert!(err.to_string().contains("cargo build"), "{err}");
        assert_eq!(err.class(), crate::Class::NotInstalled);
        fs::write(&configured, "").unwrap();
        assert!(trainer.find().is_err(), "a file that cannot be run is no program");
        fs::set_permissions(&configured, fs::Permissions::from_mode(0o755)).unwrap();
        assert_eq!(trainer.find().unwrap(), configured);
        let up: PathBuf = env::current_dir().unwrap().iter().skip(1).map(|_| "..").collect();
        let relative = up.join(configured.strip_prefix("/").unwrap());
        let found = Trainer { configured: Some(relative), ..Trainer::default() }.find().unwrap();
        assert!(found.is_absolute() && found.canonicalize().unwrap() == configured.canonicalize().unwrap());
    }
}
