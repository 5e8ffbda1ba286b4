//! Runs the test programs: those with browsers first, alone, then all others. Of these, those that watch a clock take turns,
//! and those that compute have what the former leave of the processor.
//!
//! A station in real time waits most of the time, and needs the processor at once when it wakes. What computes gives way to
//! it at once where Linux schedules it as idle, in the same session (each session has its share, whatever runs in it). A
//! test that fails is run a second time when everything else has ended: a station on a busy machine may be late once,
//! and in an hour so may another. What fails twice is wrong, and so is a run in which more than two fail. A test that
//! needed its second time is named at the end.

use std::{
    io::{BufRead as _, BufReader, Read, Write as _},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{Mutex, PoisonError},
    thread,
};

use anyhow::{Context as _, bail};
use serde_json::Value;

use crate::shell;

/// How a test program spends its time, in the order in which they are begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    /// With browsers, which need all of the processor and are in a session of their own: before everything else, alone.
    Draws,
    /// With stations in real time, or servers that somebody waits for: one after another.
    WatchesAClock,
    /// For a cluster, most of the time: beside all that follow.
    Waits,
    /// Computes for minutes: before the others, so that the run does not end with one of them alone.
    Long,
    /// All others.
    Computes,
}

/// Kinds of test programs that do not just compute: package, and target where only that one of the package is of this kind.
const KINDS: [(&str, Option<&str>, Kind); 11] = [
    ("e2e", None, Kind::Draws),
    ("palpate_control", None, Kind::WatchesAClock),
    ("palpate_drivers", None, Kind::WatchesAClock),
    ("palpate_emulator", None, Kind::WatchesAClock),
    ("palpate_people", None, Kind::WatchesAClock),
    ("palpate_server", None, Kind::WatchesAClock),
    ("palpate_train", Some("hand"), Kind::Draws),
    ("palpate_jobs", None, Kind::Waits),
    ("palpate_blind", None, Kind::Long),
    ("palpate_train", None, Kind::Long),
    ("palpate_cloning", None, Kind::Long),
];

/// How many tests of a run may have a second time. More failures are no accident, and nothing is run again.
const MAX_RETRIES: usize = 2;

/// Tests that passed at their second time in this run.
static LATE: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// How a test program is run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// What it prints is shown as it comes.
    Shown,
    /// Beside others: what it prints is shown when it has ended.
    Beside,
    /// Beside others, with what they leave of the processor.
    Idle,
}

/// A test program.
#[derive(Debug)]
struct Program {
    package: String,
    target: String,
    executable: PathBuf,
    /// Folder of its package, where it runs.
    dir: PathBuf,
}

/// How a test program ended that did not pass.
struct Failed<'a> {
    program: &'a Program,
    /// What it printed.
    output: String,
}

/// Runs the tests that `cargo` builds, a command `cargo test`, and those of `examples`, a command `cargo test --doc`, last:
/// only those whose name contains `filter`. `env` sets what they need.
pub(crate) fn run(
    mut cargo: Command,
    mut examples: Command,
    env: impl Fn(&mut Command) + Sync,
    filter: Option<&str>,
) -> anyhow::Result<()> {
    let listed = shell::output(cargo.args(["--no-run", "--quiet", "--message-format=json"]))?;
    let programs = programs(&listed)?;
    let of = |wanted: fn(Kind) -> bool| {
        let mut some: Vec<&Program> = programs.iter().filter(|program| wanted(program.kind())).collect();
        some.sort_by_key(|program| program.kind());
        some
    };
    let queue = |kinds: fn(Kind) -> bool, way: Way| (Mutex::new(of(kinds).into_iter()), way);
    let drawing = queue(|kind| kind == Kind::Draws, Way::Shown);
    let watching = queue(|kind| kind == Kind::WatchesAClock, Way::Beside);
    let waiting = queue(|kind| kind == Kind::Waits, Way::Beside);
    let computing = queue(|kind| kind >= Kind::Long, Way::Idle);
    let mut failed = in_order(&drawing, &env, filter)?;
    let lanes = [&watching, &waiting, &computing, &computing];
    thread::scope(|scope| {
        let env = &env;
        let begun = lanes.map(|programs| scope.spawn(move || in_order(programs, env, filter)));
        for lane in begun {
            failed.extend(lane.join().unwrap_or_else(|_| bail!("a thread that runs tests panicked"))?);
        }
        Ok::<_, anyhow::Error>(())
    })?;
    again(&failed, &env)?;
    examples.args(filter.map(|filter| ["--", filter]).into_iter().flatten());
    env(&mut examples);
    shell::run(&mut examples)
}

/// Runs what comes next of `programs` until there is no more; gives those that did not pass.
fn in_order<'a>(
    (programs, way): &(Mutex<std::vec::IntoIter<&'a Program>>, Way),
    env: &(impl Fn(&mut Command) + Sync),
    filter: Option<&str>,
) -> anyhow::Result<Vec<Failed<'a>>> {
    let mut failed = Vec::new();
    let next = || programs.lock().unwrap_or_else(PoisonError::into_inner).next();
    while let Some(program) = next() {
        failed.extend(program.attempt(env, filter.as_slice(), *way)?);
    }
    Ok(failed)
}

/// Names the tests that needed a second time.
pub(crate) fn report() {
    match LATE.lock().unwrap_or_else(PoisonError::into_inner).as_slice() {
        [] => eprintln!("no test needed a second time"),
        late => eprintln!("FLAKY, passed at the second time: {}", late.join(", ")),
    }
}

/// Runs the tests that failed once more, alone; fails where too many did, or one does again.
fn again(failed: &[Failed<'_>], env: &(impl Fn(&mut Command) + Sync)) -> anyhow::Result<()> {
    let mut names = Vec::with_capacity(failed.len());
    for one in failed {
        let of_program = failed_tests(&one.output);
        // A process that was killed has no list of failed tests.
        if of_program.is_empty() {
            bail!("{} failed; see above", one.program.name());
        }
        names.push(of_program);
    }
    let late: Vec<String> = names.iter().flatten().cloned().collect();
    if late.is_empty() {
        return Ok(());
    }
    if late.len() > MAX_RETRIES {
        bail!("{} tests failed, see above: {}", late.len(), late.join(", "));
    }
    eprintln!("failed once, and run again alone: {}", late.join(", "));
    for (one, names) in failed.iter().zip(&names) {
        let mut args = vec!["--exact", "--test-threads=1"];
        args.extend(names.iter().map(String::as_str));
        if one.program.attempt(env, &args, Way::Shown)?.is_some() {
            bail!("tests failed twice; see above");
        }
    }
    LATE.lock().unwrap_or_else(PoisonError::into_inner).extend(late);
    Ok(())
}

impl Program {
    fn name(&self) -> String {
        format!("{} {}", self.package, self.target)
    }

    fn kind(&self) -> Kind {
        let known = KINDS.iter().find(|(package, target, _)| {
            *package == self.package && target.is_none_or(|target| target == self.target)
        });
        known.map_or(Kind::Computes, |(.., kind)| *kind)
    }

    /// Runs it; `None` if it passes.
    fn attempt(
        &self,
        env: &(impl Fn(&mut Command) + Sync),
        args: &[&str],
        way: Way,
    ) -> anyhow::Result<Option<Failed<'_>>> {
        let is_live = way == Way::Shown;
        // Other systems have no such command, and their tests take longer.
        let mut command = if way == Way::Idle && shell::exists("chrt") {
            let mut chrt = Command::new("chrt");
            chrt.args(["--idle", "0"]).arg(&self.executable);
            chrt
        } else {
            Command::new(&self.executable)
        };
        command.args(args).current_dir(&self.dir).env("CARGO_MANIFEST_DIR", &self.dir);
        env(&mut command);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        shell::timed_as(&self.name(), || {
            let mut child =
                command.spawn().with_context(|| format!("failed to start {:?}", self.executable))?;
            let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
            let (output, errors) = thread::scope(|scope| {
                let errors = scope.spawn(|| stderr.map_or_else(String::new, |from| read(from, |_| ())));
                let show_live = |line: &str| {
                    if is_live {
                        show(line);
                    }
                };
                show_live(&format!("\n== {}\n", self.name()));
                (
                    stdout.map_or_else(String::new, |from| read(from, show_live)),
                    errors.join().unwrap_or_default(),
                )
            });
            let status = child.wait().with_context(|| format!("failed to wait for {}", self.name()))?;
            // In one piece: another program prints too.
            show(&if is_live { errors } else { format!("\n== {}\n{output}{errors}", self.name()) });
            Ok((!status.success()).then_some(Failed { program: self, output }))
        })
    }
}

/// What comes from `from`, each line given to `line_read` as it comes.
fn read(from: impl Read, line_read: impl Fn(&str)) -> String {
    let (mut from, mut all, mut line) = (BufReader::new(from), String::new(), Vec::new());
    loop {
        line.clear();
        match from.read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return all,
            Ok(_) => {}
        }
        let text = String::from_utf8_lossy(&line);
        line_read(&text);
        all.push_str(&text);
    }
}

fn show(text: &str) {
    // Whoever reads may have gone; the tests go on.
    let mut screen = std::io::stdout().lock();
    let _ = screen.write_all(text.as_bytes()).and_then(|()| screen.flush());
}

/// The test programs in what `cargo test --no-run --message-format=json` printed.
fn programs(listed: &str) -> anyhow::Result<Vec<Program>> {
    let mut programs = Vec::new();
    for line in listed.lines().filter(|line| line.starts_with('{')) {
        let message: Value = serde_json::from_str(line).context("cargo printed a line that is no JSON")?;
        let text = |value: &Value| value.as_str().map(str::to_owned);
        let (Some(executable), true) =
            (text(&message["executable"]), message["profile"]["test"] == Value::Bool(true))
        else {
            continue;
        };
        let manifest = text(&message["manifest_path"]).context("a test program has no package")?;
        let dir = Path::new(&manifest).parent().context("a package has a folder")?.to_owned();
        // `path+file:///x/sim#palpate_sim@0.1.0`; where the folder has the package's name, that is left out.
        let id = text(&message["package_id"]).context("a test program has no package")?;
        let fragment = id.rsplit('#').next().unwrap_or_default();
        let package = match fragment.split_once('@') {
            Some((name, _)) => name.to_owned(),
            None => dir.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
        };
        let target = text(&message["target"]["name"]).context("a test program has no name")?;
        programs.push(Program { package, target, executable: executable.into(), dir });
    }
    if programs.is_empty() {
        bail!("cargo listed no test program");
    }
    Ok(programs)
}

/// The names under the last `failures:` of what a test program printed.
fn failed_tests(stdout: &str) -> Vec<String> {
    let mut listed = Vec::new();
    for line in stdout.lines() {
        if line == "failures:" {
            listed.clear();
        } else if let Some(name) = line.strip_prefix("    ").filter(|name| !name.contains(' ')) {
            listed.push(name.to_owned());
        } else if line.starts_with("test result: FAILED") {
            return listed;
        } else if !line.is_empty() {
            listed.clear();
        }
    }
    Vec::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failed_tests_are_read_from_the_last_list() {
        let printed = "running 2 tests\ntest a::b ... ok\ntest a::c ... FAILED\n\nfailures:\n\n\
            ---- a::c stdout ----\nthread panicked:\n    not a name\n    neither\nmore\n\nfailures:\n    a::c\n    d\n\n\
            test result: FAILED. 1 passed; 2 failed; 0 ignored\n";
        assert_eq!(failed_tests(printed), ["a::c", "d"]);
        // A program that was killed.
        assert!(failed_tests("running 2 tests\ntest a::b ... ok\n").is_empty());
        assert!(failed_tests("test result: ok. 2 passed; 0 failed\n").is_empty());
    }

    #[test]
    fn programs_are_read_from_what_cargo_lists() {
        let line = |id: &str, target: &str, test: bool| {
            serde_json::json!({
                "reason": "compiler-artifact", "package_id": id, "manifest_path": "/x/tests/e2e/Cargo.toml",
                "target": { "name": target }, "profile": { "test": test }, "executable": "/x/target/it-1",
            })
            .to_string()
        };
        let listed = [
            line("path+file:///x/tests/e2e#0.1.0", "it", true),
            line("path+file:///x/policy/train#palpate_train@0.1.0", "hand", true),
            line("path+file:///x/policy/train#palpate_train@0.1.0", "it", true),
            line("path+file:///x/server#palpate_server@0.1.0", "palpate", false),
        ];
        let programs = programs(&listed.join("\n")).expect("programs");
        let found: Vec<_> = programs.iter().map(|program| (program.name(), program.kind())).collect();
        let expected =
            [("e2e it", Kind::Draws), ("palpate_train hand", Kind::Draws), ("palpate_train it", Kind::Long)];
        assert_eq!(found, expected.map(|(name, kind)| (name.to_owned(), kind)));
        assert!(super::programs("warning: nothing\n").is_err());
    }
}
