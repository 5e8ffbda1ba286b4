//! Tests that fail are run a second time, alone: a station in real time on a busy machine may be late once. What fails
//! twice is wrong, and so is a run in which more than a few fail. A test that needed its second time is named at the
//! end.

use std::{
    collections::BTreeSet,
    io::{BufRead as _, BufReader, Read, Write},
    process::{Command, ExitStatus, Stdio},
    sync::{Mutex, PoisonError},
    thread,
};

use anyhow::{Context as _, bail};

use crate::shell;

/// Tests of a run that may have a second time. More failures are no accident, and nothing is run again.
const MAX_RETRIES: usize = 2;

/// Tests that passed at their second time in this run.
static LATE: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// Runs the tests of `cargo`, which makes a command `cargo test` without arguments for the tests themselves; only those
/// whose name contains `filter`.
pub(crate) fn run(cargo: impl Fn() -> Command, filter: Option<&str>) -> anyhow::Result<()> {
    let mut first = cargo();
    first.arg("--no-fail-fast").arg("--").args(filter);
    let Some(failed) = shell::timed(&mut first, attempt)? else { return Ok(()) };
    let names = failed.names()?;
    let late: Vec<String> = names.iter().cloned().collect();
    eprintln!("failed once, and run again alone: {}", late.join(", "));
    let mut second = cargo();
    // Examples of documentation have no second time; without them nothing but the tests is built.
    second.args(["--no-fail-fast", "--tests", "--", "--exact", "--test-threads=1"]).args(&late);
    if shell::timed(&mut second, attempt)?.is_some() {
        bail!("tests failed twice; see above");
    }
    LATE.lock().unwrap_or_else(PoisonError::into_inner).extend(late);
    Ok(())
}

/// Names the tests that needed a second time.
pub(crate) fn report() {
    match LATE.lock().unwrap_or_else(PoisonError::into_inner).as_slice() {
        [] => eprintln!("no test needed a second time"),
        late => eprintln!("FLAKY, passed at the second time: {}", late.join(", ")),
    }
}

/// What a run of `cargo test` that failed printed.
struct Failed {
    line: String,
    stdout: String,
    stderr: String,
}

impl Failed {
    /// The tests to run again; an error where something failed that is no test, or too much.
    fn names(&self) -> anyhow::Result<BTreeSet<String>> {
        let (names, num_summaries) = failed_tests(&self.stdout);
        let num_targets = failed_targets(&self.stderr);
        // A process that was killed, or a build that failed, has no list of failed tests.
        if num_targets != num_summaries || names.is_empty() || names.iter().any(|name| name.contains(' ')) {
            bail!("{} failed", self.line);
        }
        let num_late = LATE.lock().unwrap_or_else(PoisonError::into_inner).len();
        if num_late + names.len() > MAX_RETRIES {
            bail!(
                "{} failed: {} tests, see above; {num_late} had a second time before",
                self.line,
                names.len()
            );
        }
        Ok(names)
    }
}

/// Runs `command`, showing and keeping its output; `None` if it passes.
fn attempt(command: &mut Command, line: &str) -> anyhow::Result<Option<Failed>> {
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let mut child = child.with_context(|| format!("failed to start {line}"))?;
    let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
    let (stdout, stderr) = thread::scope(|scope| {
        let stdout =
            scope.spawn(|| stdout.map_or_else(String::new, |from| shown(from, &mut std::io::stdout())));
        let stderr = stderr.map_or_else(String::new, |from| shown(from, &mut std::io::stderr()));
        (stdout.join().unwrap_or_default(), stderr)
    });
    let status: ExitStatus = child.wait().with_context(|| format!("failed to wait for {line}"))?;
    Ok((!status.success()).then(|| Failed { line: line.to_owned(), stdout, stderr }))
}

/// What comes from `from`, passed on to `to` line by line.
fn shown(from: impl Read, to: &mut impl Write) -> String {
    let (mut from, mut all, mut line) = (BufReader::new(from), String::new(), Vec::new());
    loop {
        line.clear();
        match from.read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return all,
            Ok(_) => {}
        }
        // Whoever reads may have gone; the tests go on.
        let _ = to.write_all(&line).and_then(|()| to.flush());
        all.push_str(&String::from_utf8_lossy(&line));
    }
}

/// The names under the last `failures:` of each binary, and how many binaries have such a list.
fn failed_tests(stdout: &str) -> (BTreeSet<String>, usize) {
    let (mut names, mut listed, mut num_summaries) = (BTreeSet::new(), Vec::new(), 0);
    for line in stdout.lines() {
        if line == "failures:" {
            listed.clear();
        } else if let Some(name) = line.strip_prefix("    ").filter(|name| !name.starts_with(' ')) {
            listed.push(name.to_owned());
        } else if line.starts_with("test result: FAILED") {
            names.extend(listed.drain(..));
            num_summaries += 1;
        } else if !line.is_empty() {
            listed.clear();
        }
    }
    (names, num_summaries)
}

/// How many targets cargo says failed; 0 where it says nothing of the kind.
fn failed_targets(stderr: &str) -> usize {
    let counts = stderr.lines().filter_map(|line| {
        let rest = line.strip_prefix("error: ")?;
        rest.strip_suffix(" targets failed:").or_else(|| rest.strip_suffix(" target failed:"))?.parse().ok()
    });
    counts.max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STDOUT: &str = "running 2 tests\ntest a::b ... ok\ntest a::c ... FAILED\n\nfailures:\n\n\
        ---- a::c stdout ----\nthread panicked:\n    not a name\nmore\n\nfailures:\n    a::c\n\n\
        test result: FAILED. 1 passed; 1 failed; 0 ignored\n\nrunning 1 test\ntest d ... ok\n\n\
        test result: ok. 1 passed; 0 failed\n";

    fn failed(stdout: &str, stderr: &str) -> anyhow::Result<BTreeSet<String>> {
        Failed { line: "cargo test".to_owned(), stdout: stdout.to_owned(), stderr: stderr.to_owned() }.names()
    }

    #[test]
    fn failed_tests_are_read_from_their_lists() {
        let names = failed(STDOUT, "error: 1 target failed:\n    `-p x --test it`\n").unwrap();
        assert_eq!(names.into_iter().collect::<Vec<_>>(), ["a::c"]);
    }

    #[test]
    fn what_is_no_failed_test_is_not_run_again() {
        // A second binary was killed.
        assert!(failed(STDOUT, "error: 2 targets failed:\n    `-p x`\n    `-p y`\n").is_err());
        // Nothing was built.
        assert!(failed("", "error: could not compile `x`\n").is_err());
        let listed = |names: &str| {
            let stdout = format!("failures:\n{names}\ntest result: FAILED. 0 passed; 1 failed\n");
            failed(&stdout, "error: 1 target failed:\n")
        };
        assert!(listed("    src/lib.rs - f (line 3)\n").is_err(), "an example of documentation");
        assert!(listed("    a\n    b\n").is_ok());
        assert!(listed("    a\n    b\n    c\n").is_err(), "too many");
    }
}
