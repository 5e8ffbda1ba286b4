//! Builds the `palpate` binary with the page inside.

use std::{path::PathBuf, process::Command};

use crate::{paths, shell, wasm};

/// Builds `target/release/palpate`.
pub(crate) fn release() -> anyhow::Result<PathBuf> {
    shell::run(&mut cargo_build()?)?;
    Ok(built())
}

/// The same, with what other programs leave of the machine.
pub(crate) fn release_beside_others() -> anyhow::Result<PathBuf> {
    let mut cargo = cargo_build()?;
    // Lines of its progress would come between those of others.
    shell::run(&mut shell::idle(cargo.arg("--quiet")))?;
    Ok(built())
}

fn cargo_build() -> anyhow::Result<Command> {
    let page_dir = wasm::build_page()?;
    let mut cargo = shell::cargo(&paths::root());
    cargo
        .args(["build", "--package", "palpate_server", "--bin", "palpate", "--release"])
        .env("PALPATE_UI_DIST", page_dir);
    Ok(cargo)
}

fn built() -> PathBuf {
    paths::target().join("release").join("palpate")
}
