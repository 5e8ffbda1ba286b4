//! The physics library of the grasp world.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, bail};

use crate::{paths, python, shell};

/// Where builds look for the library: the folder that holds `libmujoco.so`.
const LINK_DIR: &str = "MUJOCO_DYNAMIC_LINK_DIR";

/// The version that the bindings in Cargo.lock are made for.
const VERSION: &str = "3.17.0";

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
    let python = python::bare()?;
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

/// Has `cargo` build the grasp world and what trains in it, and lets what it runs find the library.
pub(crate) fn add(cargo: &mut Command, link_dir: &Path) {
    let_find(cargo.args(["--features", "palpate_grasp/mujoco,palpate_train/mujoco"]), link_dir);
}

/// Lets what `command` builds or starts find the library.
pub(crate) fn let_find(command: &mut Command, link_dir: &Path) {
    command.env(LINK_DIR, link_dir).env("LD_LIBRARY_PATH", link_dir);
}
