//! Every test, and what CI runs.

use std::{path::PathBuf, process::Command, thread, time::Instant};

use anyhow::bail;
use clap::Args;

use crate::{browser, documentation, mujoco, paths, programs, python, shell, skip, slurm, wasm};

/// Properties see the same cases every time here, so that a red run can be repeated; `cargo test` tries new ones.
const PROPTEST_SEED: &str = "20261121";

#[derive(Args)]
pub(crate) struct TestArgs {
    /// Only tests whose name contains this
    filter: Option<String>,
}

/// Sets everything up, then runs every test of the workspace, the browser's included.
pub(crate) fn run(args: &TestArgs) -> anyhow::Result<()> {
    Tests::build(args, false)?.run()
}

/// Tests that are built.
struct Tests {
    filter: Option<String>,
    /// Whether everything is linted as it is built.
    lints: bool,
    python: PathBuf,
    /// The folder of MuJoCo's library, unless what needs it is left out.
    grasp_world: Option<PathBuf>,
    artifacts: PathBuf,
    /// The list of the tests that are left out.
    skipped: PathBuf,
}

impl Tests {
    /// Installs what the tests need, and builds them.
    fn build(args: &TestArgs, lints: bool) -> anyhow::Result<Self> {
        skip::check()?;
        // Beside each other: at its end, the page keeps one core busy for a minute, and what is installed waits for the
        // network.
        let (page, tests) = thread::scope(|scope| {
            let page = scope.spawn(|| wasm::build_page(lints));
            let tests = Self::build_all_but_page(args, lints);
            (page.join().unwrap_or_else(|_| bail!("the build of the page panicked")), tests)
        });
        page?;
        tests
    }

    /// The same, where somebody else builds the page.
    fn build_all_but_page(args: &TestArgs, lints: bool) -> anyhow::Result<Self> {
        let python = install_tools()?;
        test_xtask(args, lints)?;
        let grasp_world = grasp_world()?;
        let artifacts = paths::target().join("e2e");
        std::fs::create_dir_all(&artifacts)?;
        let skipped = artifacts.join("skipped.txt");
        let left_out = if grasp_world.is_none() {
            "mujoco the grasp world, and all that is trained in it\n"
        } else {
            ""
        };
        std::fs::write(&skipped, left_out)?;
        let tests = Self { filter: args.filter.clone(), lints, python, grasp_world, artifacts, skipped };
        // A step of its own, so that one sees what building takes and what running takes.
        let mut cargo = tests.cargo()?;
        if lints {
            // Benchmarks too, which no test runs.
            cargo.arg("--all-targets");
        }
        shell::run(cargo.arg("--no-run"))?;
        Ok(tests)
    }

    /// `cargo test` of every crate but this one. Each is built once, with the features that all of them together need; so
    /// is `palpate`, as its own tests start it, without a page inside.
    fn cargo(&self) -> anyhow::Result<Command> {
        let mut cargo = shell::cargo(&paths::root());
        cargo.args(["test", "--workspace", "--exclude", "xtask"]);
        if self.lints {
            shell::lint_while_building(&mut cargo)?;
        }
        if let Some(dir) = &self.grasp_world {
            mujoco::add(&mut cargo, dir);
        }
        Ok(cargo)
    }

    fn run(&self) -> anyhow::Result<()> {
        let xtask = std::env::current_exe()?;
        let env = |command: &mut Command| {
            command
                .env("PALPATE_BIN", paths::target().join("debug").join("palpate"))
                .env("PALPATE_PYTHON", &self.python)
                .env("PALPATE_UI_DIST", wasm::page_dir())
                .env("PALPATE_BROWSER_TESTS", browser::folder())
                .env("PALPATE_SKIPPED", &self.skipped)
                .env("PALPATE_ARTIFACTS", &self.artifacts)
                .env("PALPATE_XTASK", &xtask)
                .env("PROPTEST_RNG_SEED", PROPTEST_SEED);
            if let Some(dir) = &self.grasp_world {
                mujoco::let_find(command, dir);
            }
        };
        let mut examples = self.cargo()?;
        examples.arg("--doc");
        if self.lints {
            documentation::make_pages_too(&mut examples)?;
        }
        let tested = programs::run(self.cargo()?, examples, env, self.filter.as_deref());
        eprintln!("screenshots and reports: {}", self.artifacts.display());
        skip::report(&self.skipped);
        programs::report();
        tested
    }
}

/// Tests this program by itself, with the features that it was built with.
fn test_xtask(args: &TestArgs, lints: bool) -> anyhow::Result<()> {
    if args.filter.is_some() {
        return Ok(());
    }
    let mut cargo = shell::cargo(&paths::root());
    if lints {
        shell::lint_while_building(&mut cargo)?;
    }
    shell::run(cargo.args(["test", "--package", "xtask"]))
}

/// Installs what the tests need besides compilers, and gives the Python interpreter.
fn install_tools() -> anyhow::Result<PathBuf> {
    if !skip::names("browser") {
        browser::install()?;
    }
    slurm::install()?;
    if !shell::exists("curl") {
        shell::install_debian_packages(&["curl"], "carrying out the examples of the HTTP API")?;
    }
    python::interpreter()
}

/// Formatting, lints with warnings denied, links of the documentation, and every test.
pub(crate) fn check() -> anyhow::Result<()> {
    let begun = Instant::now();
    shell::run(shell::cargo(&paths::root()).args(["fmt", "--all", "--check"]))?;
    let tested = Tests::build(&TestArgs { filter: None }, true).and_then(|tests| tests.run());
    shell::print_long_steps(begun);
    tested
}

/// The folder of MuJoCo's library; none where what needs it is left out.
fn grasp_world() -> anyhow::Result<Option<PathBuf>> {
    if skip::names("mujoco") { Ok(None) } else { mujoco::link_dir().map(Some) }
}
