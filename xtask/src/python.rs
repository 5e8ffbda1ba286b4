//! The Python environment of the third-party checks and of the Python client's tests.

use std::{path::PathBuf, process::Command};

use anyhow::Context as _;

use crate::{paths, shell};

/// Makes the virtual environment where it is missing, and gives its interpreter, which has pip and may lack every package.
pub(crate) fn bare() -> anyhow::Result<PathBuf> {
    let dir = dir();
    let python = dir.join("bin").join("python");
    // It comes last.
    if dir.join("bin").join("pip").exists() {
        return Ok(python);
    }
    if !shell::exists("python3") {
        shell::install_debian_packages(
            &["python3", "python3-venv"],
            "checking takes with third-party readers and testing the Python client",
        )?;
    }
    let mut venv = Command::new("python3");
    venv.args(["-m", "venv"]).arg(&dir);
    if shell::run(&mut venv).is_err() {
        shell::install_debian_packages(&["python3-venv"], "making a Python environment")?;
        shell::run(&mut venv)?;
    }
    Ok(python)
}

/// Makes or updates the virtual environment with all packages, and gives its interpreter.
pub(crate) fn interpreter() -> anyhow::Result<PathBuf> {
    let python = bare()?;
    let requirements = paths::root().join("tests/e2e/python/requirements.txt");
    let stamp = dir().join("requirements.txt");
    let client = paths::root().join("clients/python");
    let read = |path: &PathBuf| std::fs::read(path).with_context(|| format!("failed to read {path:?}"));
    // The client itself is installed in place: of its files, only this one is read when it is.
    let wanted = [read(&requirements)?, read(&client.join("pyproject.toml"))?].concat();
    if std::fs::read(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(python);
    }
    shell::run(
        Command::new(&python)
            .args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--requirement"])
            .arg(&requirements),
    )
    .context("failed to install the Python packages of tests/e2e/python/requirements.txt")?;
    shell::run(
        Command::new(&python)
            .args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"])
            .args(["--no-deps", "--no-build-isolation", "--editable"])
            .arg(&client),
    )
    .context("failed to install the Python client of clients/python")?;
    std::fs::write(&stamp, wanted)?;
    Ok(python)
}

fn dir() -> PathBuf {
    paths::target().join("tools").join("python")
}
