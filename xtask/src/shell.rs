//! Running other programs.

use std::{
    os::unix::process::CommandExt as _,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context as _, bail};

/// What took longer than [`LONG`], in order.
static LONG_STEPS: Mutex<Vec<(String, Duration)>> = Mutex::new(Vec::new());
const LONG: Duration = Duration::from_secs(5);

/// Says where the time since `begun` went.
pub(crate) fn print_long_steps(begun: Instant) {
    let steps = LONG_STEPS.lock().unwrap_or_else(PoisonError::into_inner);
    for (line, taken) in steps.iter() {
        let line: String = line.chars().take(110).collect();
        eprintln!("{:6.0} s  {line}", taken.as_secs_f64());
    }
    eprintln!("{:6.0} s  in all", begun.elapsed().as_secs_f64());
}

/// Runs `command`, showing its output; fails when it does.
pub(crate) fn run(command: &mut Command) -> anyhow::Result<()> {
    let line = describe(command);
    eprintln!("$ {line}");
    timed_as(&line, || {
        let status =
            command.stdin(Stdio::null()).status().with_context(|| format!("failed to start {line}"))?;
        if !status.success() {
            bail!("{line}: {status}");
        }
        Ok(())
    })
}

/// Runs `command` in place of this process: signals reach it, and whoever waits for this process waits until it has ended.
/// Returns only if it cannot be started.
pub(crate) fn become_command(command: &mut Command) -> anyhow::Result<()> {
    let line = describe(command);
    eprintln!("$ {line}");
    Err(command.stdin(Stdio::null()).exec()).with_context(|| format!("failed to start {line}"))
}

/// Does `work` and notes under `name` how long that took.
pub(crate) fn timed_as<T>(name: &str, work: impl FnOnce() -> anyhow::Result<T>) -> anyhow::Result<T> {
    let begun = Instant::now();
    let result = work();
    let taken = begun.elapsed();
    if taken >= LONG {
        LONG_STEPS.lock().unwrap_or_else(PoisonError::into_inner).push((name.to_owned(), taken));
    }
    result
}

/// What `command` prints, trimmed; fails when it does.
pub(crate) fn output(command: &mut Command) -> anyhow::Result<String> {
    let line = describe(command);
    let output = command.stdin(Stdio::null()).output().with_context(|| format!("failed to start {line}"))?;
    if !output.status.success() {
        bail!("{line}: {}\n{}", output.status, String::from_utf8_lossy(&output.stderr));
    }
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Whether `program` can be started at all.
pub(crate) fn exists(program: &str) -> bool {
    Command::new(program)
        .arg("--version")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok()
}

/// A cargo of the checkout's own toolchain, free of the variables of the cargo that started us.
pub(crate) fn cargo(dir: &Path) -> Command {
    cargo_at("cargo", dir)
}

/// The cargo at `program`, likewise.
pub(crate) fn cargo_at(program: &str, dir: &Path) -> Command {
    let mut command = Command::new(program);
    command.current_dir(dir);
    for (name, _) in std::env::vars_os() {
        let Some(text) = name.to_str() else { continue };
        if text.starts_with("CARGO_PKG_") || text.starts_with("CARGO_MANIFEST") || text == "CARGO" {
            command.env_remove(name);
        }
    }
    command
}

/// Has `cargo` lint what it builds of the workspace, with warnings denied: one pass over the code serves both.
///
/// What it builds is kept apart from what cargo builds without lints, and is not for shipping: clippy switches off rustc's own
/// optimisations, though not LLVM's.
pub(crate) fn lint_while_building(cargo: &mut Command) -> anyhow::Result<()> {
    let clippy = tool_of_toolchain("clippy-driver").context("run: rustup component add clippy")?;
    // As `cargo clippy -- --deny warnings` has it, which compiles nothing that could be run.
    cargo.env("RUSTC_WORKSPACE_WRAPPER", clippy);
    cargo.env("CLIPPY_ARGS", "--deny__CLIPPY_HACKERY__warnings__CLIPPY_HACKERY__");
    Ok(())
}

/// The program `name` of the checkout's own toolchain.
pub(crate) fn tool_of_toolchain(name: &str) -> anyhow::Result<PathBuf> {
    let mut rustc = Command::new("rustc");
    let sysroot = output(rustc.args(["--print", "sysroot"]).current_dir(crate::paths::root()))?;
    let tool = Path::new(&sysroot).join("bin").join(name);
    if !tool.exists() {
        bail!("the Rust toolchain lacks {tool:?}");
    }
    Ok(tool)
}

/// Held by whoever installs Debian packages: one at a time can.
static DEBIAN: Mutex<()> = Mutex::new(());

/// Installs Debian packages, or says which command a person must run.
pub(crate) fn install_debian_packages(packages: &[&str], purpose: &str) -> anyhow::Result<()> {
    let _turn = DEBIAN.lock().unwrap_or_else(PoisonError::into_inner);
    let by_hand = format!("apt-get install --no-install-recommends {}", packages.join(" "));
    let is_root = output(Command::new("id").arg("-u")).is_ok_and(|uid| uid == "0");
    if !is_root || !exists("apt-get") {
        bail!("{purpose} needs packages that are not installed; as root, run: {by_hand}");
    }
    let apt = |args: &[&str]| {
        let mut command = Command::new("apt-get");
        command.env("DEBIAN_FRONTEND", "noninteractive").args(args);
        run(&mut command)
    };
    // A stale package list is the usual reason for a failure, so it is refreshed only then.
    let mut args = vec!["install", "-y", "-qq", "--no-install-recommends"];
    args.extend(packages);
    apt(&args)
        .or_else(|_| apt(&["update", "-qq"]).and_then(|()| apt(&args)))
        .with_context(|| format!("{purpose} needs packages that could not be installed; run: {by_hand}"))
}

fn describe(command: &Command) -> String {
    let mut line = command.get_program().to_string_lossy().into_owned();
    for arg in command.get_args() {
        line.push(' ');
        line.push_str(&arg.to_string_lossy());
    }
    line
}
