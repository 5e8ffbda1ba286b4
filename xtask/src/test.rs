//! Every test, and what CI runs.

use std::path::PathBuf;

use clap::Args;

use crate::{browser, build, mujoco, paths, python, shell, skip, slurm, twice, wasm};

/// Properties see the same cases every time here, so that a red run can be repeated; `cargo test` tries new ones.
const PROPTEST_SEED: &str = "20261121";

#[derive(Args)]
pub(crate) struct TestArgs {
    /// Only tests whose name contains this
    filter: Option<String>,
}

/// Sets everything up, then runs every test of the workspace, the browser's included.
pub(crate) fn run(args: &TestArgs) -> anyhow::Result<()> {
    skip::check()?;
    let python = python::interpreter()?;
    if !skip::names("browser") {
        browser::install()?;
    }
    slurm::install()?;
    if !shell::exists("curl") {
        shell::install_debian_packages(&["curl"], "carrying out the examples of the HTTP API")?;
    }
    let page = wasm::build_page()?;
    let grasp_world = grasp_world()?;
    let artifacts = paths::target().join("e2e");
    std::fs::create_dir_all(&artifacts)?;
    let skipped = artifacts.join("skipped.txt");
    let left_out =
        if grasp_world.is_none() { "mujoco the grasp world, and all that is trained in it\n" } else { "" };
    std::fs::write(&skipped, left_out)?;
    // Every crate is built once, with the features that all of them together need; `palpate` too, as its own tests start it.
    let cargo_test = || {
        let mut cargo = shell::cargo(&paths::root());
        cargo.args(["test", "--workspace", "--exclude", "xtask"]).env("PALPATE_UI_DIST", &page);
        if let Some(dir) = &grasp_world {
            mujoco::add(&mut cargo, dir);
        }
        cargo
    };
    let xtask = std::env::current_exe()?;
    // By itself, with the features that the running xtask was built with.
    if args.filter.is_none() {
        shell::run(shell::cargo(&paths::root()).args(["test", "--package", "xtask"]))?;
    }
    // A step of its own, so that one sees what building takes and what running takes.
    shell::run(cargo_test().arg("--no-run"))?;
    let tests = || {
        let mut cargo = cargo_test();
        cargo
            .env("PALPATE_BIN", paths::target().join("debug").join("palpate"))
            .env("PALPATE_PYTHON", &python)
            .env("PALPATE_BROWSER_TESTS", browser::folder())
            .env("PALPATE_SKIPPED", &skipped)
            .env("PALPATE_ARTIFACTS", &artifacts)
            .env("PALPATE_XTASK", &xtask)
            .env("PROPTEST_RNG_SEED", PROPTEST_SEED);
        cargo
    };
    let tested = twice::run(tests, args.filter.as_deref());
    eprintln!("screenshots and reports: {}", artifacts.display());
    skip::report(&skipped);
    twice::report();
    tested
}

/// Formatting, lints with warnings denied, every test, and the release build.
pub(crate) fn check() -> anyhow::Result<()> {
    let root = paths::root();
    skip::check()?;
    shell::run(shell::cargo(&root).args(["fmt", "--all", "--check"]))?;
    let mut lints = shell::cargo(&root);
    lints.args(["clippy", "--workspace", "--all-targets"]);
    if let Some(dir) = grasp_world()? {
        mujoco::add(&mut lints, &dir);
    }
    shell::run(lints.args(["--", "--deny", "warnings"]))?;
    let tested = run(&TestArgs { filter: None });
    let built = tested.and_then(|()| build::release().map(|_| ()));
    shell::print_long_steps();
    built
}

/// The folder of MuJoCo's library; none where what needs it is left out.
fn grasp_world() -> anyhow::Result<Option<PathBuf>> {
    if skip::names("mujoco") { Ok(None) } else { mujoco::link_dir().map(Some) }
}
