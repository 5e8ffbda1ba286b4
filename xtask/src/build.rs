//! Builds the `palpate` binary with the page inside.

use std::path::PathBuf;

use crate::{paths, shell, wasm};

/// Builds `target/release/palpate`.
pub(crate) fn release() -> anyhow::Result<PathBuf> {
    release_with("build")?;
    Ok(paths::target().join("release").join("palpate"))
}

/// Looks whether the same would compile, without optimising and linking it: those take ten minutes on two cores, and what
/// they could find is what the tests' own build of `palpate` finds.
pub(crate) fn check_release() -> anyhow::Result<()> {
    release_with("check")
}

fn release_with(command: &str) -> anyhow::Result<()> {
    let page_dir = wasm::build_page()?;
    let mut cargo = shell::cargo(&paths::root());
    cargo
        .args([command, "--package", "palpate_server", "--bin", "palpate", "--release"])
        .env("PALPATE_UI_DIST", page_dir);
    shell::run(&mut cargo)
}
