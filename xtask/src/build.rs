//! Builds the `palpate` binary with the page inside.

use std::path::PathBuf;

use crate::{paths, shell, wasm};

/// Builds `target/release/palpate`.
pub(crate) fn release() -> anyhow::Result<PathBuf> {
    with_profile("release", "release")
}

/// Builds `target/debug/palpate`: what tests start. Its numerical crates and dependencies are optimised.
pub(crate) fn dev() -> anyhow::Result<PathBuf> {
    with_profile("dev", "debug")
}

fn with_profile(profile: &str, folder: &str) -> anyhow::Result<PathBuf> {
    let page_dir = wasm::build_page()?;
    let mut cargo = shell::cargo(&paths::root());
    cargo
        .args(["build", "--package", "palpate_server", "--bin", "palpate", "--profile", profile])
        .env("PALPATE_UI_DIST", page_dir);
    shell::run(&mut cargo)?;
    Ok(paths::target().join(folder).join("palpate"))
}
