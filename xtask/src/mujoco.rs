//! The physics library of the grasp world, and what is built and tested with it.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, bail};

use crate::{browser, paths, python, shell, twice};

/// Where builds look for the library: the folder that holds `libmujoco.so`.
const LINK_DIR: &str = "MUJOCO_DYNAMIC_LINK_DIR";

/// The version that the bindings in Cargo.lock are made for.
const VERSION: &str = "3.17.0";

/// Crates with a `mujoco` feature, and the learners, which one of them uses: tested with the whole workspace instead, their
/// tensor library would be built a second time.
const CRATES: &[&str] = &[
    "palpate_cloning",
    "palpate_encoder",
    "palpate_grasp",
    "palpate_ppo",
    "palpate_rollout",
    "palpate_train",
];

/// The folder of the library: the one that `MUJOCO_DYNAMIC_LINK_DIR` names, or else one below `target/tools`, fetched
/// from PyPI (pip checks the wheel's hash) unless it is there.
pub(crate) fn link_dir() -> anyhow::Result<PathBuf> {
    if let Some(dir) = std::env::var_os(LINK_DIR) {
        let dir = PathBuf::from(dir);
        let has_library =
            ["libmujoco.so", "libmujoco.dylib", "mujoco.lib"].iter().any(|name| dir.join(name).is_file());
        if !dir.is_absolute() || !has_library {
            bail!(
                "{LINK_DIR} is {dir:?}, expected the absolute path of the folder that holds libmujoco.so of MuJoCo \
                 {VERSION}; unset it to have the library fetched"
            );
        }
        return Ok(dir);
    }
    let dir = paths::target().join("tools").join(format!("mujoco-{VERSION}"));
    let link = dir.join("libmujoco.so");
    if link.is_file() {
        return Ok(dir);
    }
    if !cfg!(all(target_os = "linux", target_arch = "x86_64")) {
        bail!(
            "the grasp world needs the library of MuJoCo {VERSION}, which is fetched on x86-64 Linux only; install \
             that version and set {LINK_DIR} to the folder of its library"
        );
    }
    fetch(&dir).with_context(|| {
        format!(
            "failed to fetch the library of MuJoCo {VERSION} from PyPI; without a way there, install that version and \
             set {LINK_DIR} to the folder that holds libmujoco.so"
        )
    })?;
    // The name that linkers look for comes last: it vouches for the rest.
    std::fs::hard_link(dir.join(format!("libmujoco.so.{VERSION}")), &link)
        .with_context(|| format!("failed to create {link:?}"))?;
    Ok(dir)
}

/// Downloads the wheel and leaves its library in `dir`.
fn fetch(dir: &Path) -> anyhow::Result<()> {
    let python = python::interpreter()?;
    let scratch = dir.join("wheel");
    std::fs::create_dir_all(&scratch).with_context(|| format!("failed to create {scratch:?}"))?;
    // The library does not depend on the Python version of its wheel, so one wheel serves all.
    shell::run(
        Command::new(&python)
            .args(["-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"])
            .args([
                "--only-binary=:all:",
                "--python-version",
                "3.11",
                "--implementation",
                "cp",
                "--abi",
                "cp311",
            ])
            .args(["--platform", "manylinux_2_28_x86_64", "--require-hashes", "--requirement"])
            .arg(paths::root().join("xtask/requirements-mujoco.txt"))
            .arg("--dest")
            .arg(&scratch),
    )?;
    let wheel = std::fs::read_dir(&scratch)?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .find(|path| path.extension().is_some_and(|ending| ending == "whl"))
        .context("pip downloaded no wheel")?;
    shell::run(Command::new(&python).args(["-m", "zipfile", "--extract"]).arg(&wheel).arg(&scratch))?;
    let library = format!("libmujoco.so.{VERSION}");
    let (from, to) = (scratch.join("mujoco").join(&library), dir.join(&library));
    std::fs::rename(&from, &to).with_context(|| format!("the wheel holds no {from:?}"))?;
    std::fs::remove_dir_all(&scratch)?;
    Ok(())
}

/// A cargo that builds the crates of the grasp world with it.
fn cargo(action: &str, link_dir: &Path) -> Command {
    let mut cargo = shell::cargo(&paths::root());
    cargo.arg(action).env(LINK_DIR, link_dir);
    for name in CRATES {
        cargo.args(["--package", name]);
    }
    cargo.args(["--features", "mujoco"]);
    cargo
}

/// Lints of the grasp world, warnings denied.
pub(crate) fn lint() -> anyhow::Result<()> {
    let mut cargo = cargo("clippy", &link_dir()?);
    shell::run(cargo.args(["--all-targets", "--", "--deny", "warnings"]))
}

/// Tests of the grasp world; with `filter` only those whose name contains it.
pub(crate) fn test(
    palpate: &Path,
    artifacts: &Path,
    skipped: &Path,
    filter: Option<&str>,
) -> anyhow::Result<()> {
    let dir = link_dir()?;
    let tests = || {
        let mut cargo = cargo("test", &dir);
        // The physical station is driven by a studio.
        cargo.env("PALPATE_BIN", palpate).env("PALPATE_SKIPPED", skipped);
        // So is its page.
        cargo.env("PALPATE_BROWSER_TESTS", browser::folder()).env("PALPATE_ARTIFACTS", artifacts);
        // Test binaries know where the library is; those of documentation examples do not.
        cargo.env("LD_LIBRARY_PATH", &dir).env("PROPTEST_RNG_SEED", crate::test::PROPTEST_SEED);
        cargo
    };
    twice::run(tests, filter)
}
