//! Builds the `palpate` binary with the page inside.

use std::path::PathBuf;

use crate::{paths, shell, wasm};

/// Builds `target/release/palpate`.
pub(crate) fn release() -> anyhow::Result<PathBuf> {
    let page_dir = wasm::build_page(false)?;
    let mut cargo = shell::cargo(&paths::root());
    cargo
        .args(["build", "--release"])
        .args(["--package", "palpate_server", "--bin", "palpate"])
        .env("PALPATE_UI_DIST", page_dir);
    shell::run(&mut cargo)?;
    Ok(paths::target().join("release").join("palpate"))
}
