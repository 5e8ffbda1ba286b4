//! Builds the `palpate` binary with the page inside.

use std::path::PathBuf;

use crate::{paths, shell, wasm};

const PROGRAM: [&str; 4] = ["--package", "palpate_server", "--bin", "palpate"];

/// Builds `target/release/palpate`.
pub(crate) fn release() -> anyhow::Result<PathBuf> {
    let page_dir = wasm::build_page(false)?;
    let mut cargo = shell::cargo(&paths::root());
    cargo.args(["build", "--release"]).args(PROGRAM).env("PALPATE_UI_DIST", page_dir);
    shell::run(&mut cargo)?;
    Ok(paths::target().join("release").join("palpate"))
}

/// Looks whether the fuzz targets compile, which are a workspace of their own. Running them needs a nightly compiler.
pub(crate) fn check_fuzz_targets() -> anyhow::Result<()> {
    let manifest = paths::root().join("fuzz/Cargo.toml");
    let mut cargo = shell::cargo(&paths::root());
    cargo.args(["check", "--locked", "--manifest-path"]).arg(manifest);
    shell::run(cargo.env("CARGO_TARGET_DIR", paths::target()))
}

/// Looks whether `palpate` compiles by itself: a release has the features that it asks for, and lacks those that only other
/// crates of the workspace ask for. In the profile of the tests, with which it shares most of its work; what optimising and
/// linking could find, the tests' own build finds.
pub(crate) fn check_alone() -> anyhow::Result<()> {
    shell::run(shell::cargo(&paths::root()).arg("check").args(PROGRAM))
}
