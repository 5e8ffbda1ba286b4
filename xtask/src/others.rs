//! Checks by other programs that the tests do not make, because what they need is large: each is a command of its own.

use std::{
    io::{BufRead as _, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

use anyhow::{Context as _, bail};
use clap::Args;

use crate::{build, paths, shell};

/// Packages of the light check, 400 MB.
const PARTS: [&str; 3] = ["datasets==5.2.0", "pandas==3.1.1", "pyarrow==26.0.1"];
/// The real class, with torch: 5.2 GB.
const CLASS: [&str; 1] = ["lerobot[dataset]==0.6.1"];
/// How long Foxglove's client watches, s.
const WATCH_S: &str = "10";

#[derive(Args)]
pub(crate) struct LerobotArgs {
    /// Also open it with LeRobot's own class: 5.2 GB of packages, and Python 3.12 or later
    #[arg(long)]
    class: bool,
    /// The Python to make environments with
    #[arg(long, default_value = "python3")]
    python: PathBuf,
    /// Use this `palpate` instead of building one
    #[arg(long)]
    bin: Option<PathBuf>,
}

#[derive(Args)]
pub(crate) struct FoxgloveArgs {
    /// Use this `palpate` instead of building one
    #[arg(long)]
    bin: Option<PathBuf>,
}

/// Exports the demo session and reads it with other programs' libraries.
pub(crate) fn lerobot(args: &LerobotArgs) -> anyhow::Result<()> {
    let palpate = args.bin.clone().map_or_else(build::release, Ok)?;
    let work = workplace()?;
    let (session, data_set) = (work.join("session"), work.join("data-set"));
    let demo = paths::root().join("assets/truth/demo.toml");
    let checked = (|| {
        shell::run(
            Command::new(&palpate).arg("emulate").arg("--truth").arg(&demo).arg("--out").arg(&session),
        )?;
        shell::run(
            Command::new(&palpate)
                .args(["export", "lerobot"])
                .arg(&session)
                .arg("--out")
                .arg(&data_set)
                .args(["--fps", "30", "--action", "next-state"]),
        )?;
        let script = paths::root().join("tests/e2e/python/lerobot_check.py");
        let parts = environment(&args.python, "lerobot-parts", &PARTS)?;
        shell::run(Command::new(parts).arg(&script).arg(&data_set))?;
        if args.class {
            let class = environment(&args.python, "lerobot-class", &CLASS)?;
            shell::run(Command::new(class).arg(&script).arg(&data_set).arg("--class"))?;
        }
        Ok(())
    })();
    std::fs::remove_dir_all(&work).with_context(|| format!("failed to remove {work:?}"))?;
    checked
}

/// Has Foxglove's client library watch an emulated station.
pub(crate) fn foxglove(args: &FoxgloveArgs) -> anyhow::Result<()> {
    let palpate = args.bin.clone().map_or_else(build::release, Ok)?;
    if !shell::exists("npm") {
        shell::install_debian_packages(&["nodejs", "npm"], "running Foxglove's client library")?;
    }
    let folder = paths::root().join("tests/e2e/foxglove");
    shell::run(Command::new("npm").args(["ci", "--no-audit", "--no-fund", "--silent"]).current_dir(&folder))
        .context("failed to install Foxglove's client library from npm")?;
    let work = workplace()?;
    let mut studio = Studio::start(&palpate, &work)?;
    let checked = studio.address().and_then(|url| {
        shell::run(Command::new("node").arg("check.mjs").arg(url).arg(WATCH_S).current_dir(&folder))
    });
    drop(studio);
    std::fs::remove_dir_all(&work).with_context(|| format!("failed to remove {work:?}"))?;
    checked
}

/// A studio with an emulated station, which ends with this.
struct Studio(Child);

impl Studio {
    fn start(palpate: &Path, data: &Path) -> anyhow::Result<Self> {
        let mut command = Command::new(palpate);
        command.args(["serve", "--listen", "127.0.0.1:0", "--json", "--data"]).arg(data);
        command.arg("--emulate").arg(paths::root().join("assets/truth/demo.toml"));
        let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
        Ok(Self(child.with_context(|| format!("failed to start {palpate:?}"))?))
    }

    /// The address that it prints when it is ready.
    fn address(&mut self) -> anyhow::Result<String> {
        let output = self.0.stdout.take().context("the studio's output is gone")?;
        let mut text = String::new();
        for line in BufReader::new(output).lines() {
            text += &line?;
            if let Some(url) = text.split('"').find(|word| word.starts_with("http://")) {
                return Ok(url.to_owned());
            }
        }
        bail!("the studio ended before it was ready: {text}")
    }
}

impl Drop for Studio {
    fn drop(&mut self) {
        // It is gone already, or goes now.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The interpreter of a virtual environment with `packages` in target/tools.
fn environment(python: &Path, name: &str, packages: &[&str]) -> anyhow::Result<PathBuf> {
    let dir = paths::target().join("tools").join(name);
    let interpreter = dir.join("bin/python");
    let (stamp, wanted) = (dir.join("packages.txt"), packages.join("\n"));
    if interpreter.exists() && std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(interpreter);
    }
    shell::run(Command::new(python).args(["-m", "venv"]).arg(&dir))
        .context("making a Python environment needs python3-venv; --python chooses another Python")?;
    let mut pip = Command::new(&interpreter);
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-cache-dir"])
        .args(packages);
    shell::run(&mut pip).with_context(|| format!("failed to install {}", packages.join(", ")))?;
    std::fs::write(&stamp, wanted)?;
    Ok(interpreter)
}

/// An empty folder in target, of this process alone.
fn workplace() -> anyhow::Result<PathBuf> {
    let dir = paths::target().join("tmp").join(format!("check-{}", std::process::id()));
    std::fs::create_dir_all(&dir).with_context(|| format!("failed to make {dir:?}"))?;
    Ok(dir)
}
