//! The browser of the page's tests.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::Context as _;

use crate::{paths, shell};

/// The folder of the browser tests.
pub(crate) fn folder() -> PathBuf {
    paths::root().join("tests/e2e/browser")
}

/// Where Mesa says that it serves EGL.
const MESA: &str = "/usr/share/glvnd/egl_vendor.d/50_mesa.json";

/// Installs Chromium, Mesa and playwright-core where they are missing.
pub(crate) fn install() -> anyhow::Result<()> {
    if !shell::exists("chromium") {
        shell::install_debian_packages(&["chromium"], "testing the page in a browser")?;
    }
    if !Path::new(MESA).exists() {
        let packages = ["libegl1", "libegl-mesa0", "libgl1-mesa-dri"];
        shell::install_debian_packages(&packages, "drawing the page without a graphics card")?;
    }
    if !shell::exists("npm") {
        shell::install_debian_packages(&["nodejs", "npm"], "driving the browser")?;
    }
    let dir = folder();
    let lock = std::fs::read(dir.join("package-lock.json"))
        .context("failed to read the browser tests' lock file")?;
    let stamp = dir.join("node_modules").join(".installed");
    if !std::fs::read(&stamp).is_ok_and(|installed| installed == lock) {
        shell::run(Command::new("npm").args(["ci", "--no-audit", "--no-fund", "--silent"]).current_dir(&dir))
            .context("failed to install playwright-core and axe-core from npm")?;
        std::fs::write(&stamp, lock)?;
    }
    Ok(())
}

/// Takes a picture of every screen of the studio at `url`.
pub(crate) fn screenshots(url: &str, out: &Path) -> anyhow::Result<()> {
    install()?;
    std::fs::create_dir_all(out).with_context(|| format!("failed to create {out:?}"))?;
    let out = out.canonicalize()?;
    shell::run(Command::new("node").arg("screenshots.mjs").arg(url).arg(out).current_dir(folder()))
}
