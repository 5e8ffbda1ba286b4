//! What `cargo xtask test` set up, and the session that the tests share.

use std::{
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

use anyhow::{Context as _, bail};
use serde_json::Value;

/// Where `cargo xtask test` put what these tests start.
pub struct Tools {
    /// The `palpate` binary with the page inside.
    pub palpate: PathBuf,
    /// A Python with the packages of `python/requirements.txt` and the Python client.
    pub python: PathBuf,
    /// The folder of the browser tests, with playwright-core installed.
    pub browser_tests: PathBuf,
    /// Where screenshots and reports are kept.
    pub artifacts: PathBuf,
    /// The xtask binary.
    pub xtask: PathBuf,
}

impl Tools {
    /// The tools; `None` where `PALPATE_SKIP` names `e2e`.
    ///
    /// # Panics
    /// If they are missing: a test that cannot run has not passed.
    pub fn find() -> Option<Self> {
        if skip::leaves_out("e2e") {
            return None;
        }
        let tools = Self::from_env();
        assert!(
            tools.is_some(),
            "the end-to-end tests need their set-up: run `cargo xtask test`, or set PALPATE_SKIP=e2e to leave them out"
        );
        tools
    }

    /// The tools, for a test that opens the page; `None` where `PALPATE_SKIP` names `e2e` or `browser`.
    ///
    /// # Panics
    /// As [`Self::find`].
    pub fn find_with_browser() -> Option<Self> {
        if skip::leaves_out("browser") { None } else { Self::find() }
    }

    fn from_env() -> Option<Self> {
        let path = |name: &str| std::env::var_os(name).map(PathBuf::from);
        Some(Self {
            palpate: path("PALPATE_BIN")?,
            python: path("PALPATE_PYTHON")?,
            browser_tests: path("PALPATE_BROWSER_TESTS")?,
            artifacts: path("PALPATE_ARTIFACTS")?,
            xtask: path("PALPATE_XTASK")?,
        })
    }

    /// A `palpate` command to be completed with arguments.
    pub fn palpate(&self) -> Command {
        Command::new(&self.palpate)
    }
}

/// The checkout's root.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Runs `command`, which must succeed, and reads its standard output as one JSON document.
pub fn run_json(command: &mut Command) -> anyhow::Result<Value> {
    let output = command.output().with_context(|| format!("failed to start {command:?}"))?;
    if !output.status.success() {
        bail!("{command:?}: {}\n{}", output.status, String::from_utf8_lossy(&output.stderr));
    }
    serde_json::from_slice(&output.stdout).with_context(|| {
        format!("{command:?} printed no JSON document: {}", String::from_utf8_lossy(&output.stdout))
    })
}

/// The data folder with the emulated demo session `sessions/demo`, recorded once for all tests.
pub fn demo_session(tools: &Tools) -> anyhow::Result<PathBuf> {
    static DATA: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let data = DATA.get_or_init(|| record_demo(tools).map_err(|err| format!("{err:#}")));
    data.clone().map_err(anyhow::Error::msg)
}

/// Records it anew in each run, in a folder beside the tests' pictures: a temporary folder in a static would never be removed,
/// because statics are not dropped.
fn record_demo(tools: &Tools) -> anyhow::Result<PathBuf> {
    let dir = tools.artifacts.join("demo");
    if dir.exists() {
        std::fs::remove_dir_all(&dir).with_context(|| format!("failed to remove {dir:?}"))?;
    }
    std::fs::create_dir_all(dir.join("sessions"))?;
    let output = tools
        .palpate()
        .arg("emulate")
        .arg("--truth")
        .arg(root().join("assets/truth/demo.toml"))
        .arg("--out")
        .arg(dir.join("sessions/demo"))
        .output()?;
    if !output.status.success() {
        bail!("failed to record the demo session: {}", String::from_utf8_lossy(&output.stderr));
    }
    Ok(dir)
}
