//! Compiles the page to WebAssembly.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, bail};

use crate::{page, paths, shell};

const TARGET: &str = "wasm32-unknown-unknown";
const DEBIAN_CARGO: &str = "/usr/bin/cargo";
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";

/// Builds the page into `target/page` and gives that folder. With `lints`, what is compiled is linted too, with warnings denied,
/// where there is a clippy for that; Debian's toolchain has none. Such a page is for tests: clippy switches off rustc's own
/// optimisations.
pub(crate) fn build_page(lints: bool) -> anyhow::Result<PathBuf> {
    let wasm = compile(lints)?;
    let bound = paths::target().join("web").join("bound");
    bind(&wasm, &bound)?;
    page::assemble(&bound, &page_dir())
}

/// Where the page is built into.
pub(crate) fn page_dir() -> PathBuf {
    paths::target().join("page")
}

fn compile(lints: bool) -> anyhow::Result<PathBuf> {
    let target_dir = paths::target().join("web");
    let mut command = match toolchain()? {
        Toolchain::Rustup => {
            let mut cargo = shell::cargo(&paths::root());
            if lints {
                shell::lint_while_building(&mut cargo)?;
            }
            cargo
        }
        Toolchain::Debian => {
            if lints {
                eprintln!(
                    "left out: lints of the page's own code, because rustup has no target {TARGET} here"
                );
            }
            debian_cargo()?
        }
    };
    command
        .args(["build", "--package", "palpate_ui", "--lib", "--profile", "web", "--target", TARGET])
        .env("CARGO_TARGET_DIR", &target_dir);
    shell::run(&mut command).context("failed to compile the page")?;
    Ok(target_dir.join(TARGET).join("web").join("palpate_ui.wasm"))
}

enum Toolchain {
    /// The checkout's own toolchain has the wasm target.
    Rustup,
    /// Debian's toolchain compiles the standard library from its source.
    Debian,
}

/// Rustup's wasm target where there is one or can be one, else Debian's toolchain; `PALPATE_WASM_TOOLCHAIN=debian` asks
/// for the latter right away.
fn toolchain() -> anyhow::Result<Toolchain> {
    let wants_debian = std::env::var_os("PALPATE_WASM_TOOLCHAIN").is_some_and(|name| name == "debian");
    if !wants_debian && rustup_has_target() {
        return Ok(Toolchain::Rustup);
    }
    if !wants_debian
        && shell::exists("rustup")
        && shell::run(Command::new("rustup").args(["target", "add", TARGET]).current_dir(paths::root()))
            .is_ok()
        && rustup_has_target()
    {
        return Ok(Toolchain::Rustup);
    }
    eprintln!("compiling {TARGET} with Debian's toolchain and the standard library's source");
    if !debian_has_source() {
        shell::install_debian_packages(
            &["rustc-web", "cargo-web", "libstd-rust-web-dev", "rust-web-src"],
            "compiling the page without rustup's wasm target",
        )?;
    }
    if !debian_has_source() {
        bail!(
            "no way to compile for {TARGET}: run `rustup target add {TARGET}` where rustup reaches its server"
        );
    }
    Ok(Toolchain::Debian)
}

fn rustup_has_target() -> bool {
    let mut rustc = Command::new("rustc");
    rustc.current_dir(paths::root()).args(["--print", "target-libdir", "--target", TARGET]);
    shell::output(&mut rustc).is_ok_and(|dir| Path::new(&dir).exists())
}

fn debian_has_source() -> bool {
    Path::new(DEBIAN_CARGO).exists()
        && shell::output(Command::new(DEBIAN_RUSTC).args(["--print", "sysroot"])).is_ok_and(|sysroot| {
            Path::new(&sysroot).join("lib/rustlib/src/rust/library/std/Cargo.toml").exists()
        })
}

fn debian_cargo() -> anyhow::Result<Command> {
    let mut rustc = Command::new("rustc");
    rustc.current_dir(paths::root());
    let sysroot = shell::output(rustc.args(["--print", "sysroot"]))?;
    let mut rustc = Command::new("rustc");
    rustc.current_dir(paths::root());
    let version = shell::output(rustc.arg("-vV"))?;
    let host = version
        .lines()
        .find_map(|line| line.strip_prefix("host: "))
        .context("`rustc -vV` does not name the host")?;
    let linker = Path::new(&sysroot).join("lib/rustlib").join(host).join("bin/rust-lld");
    let mut command = shell::cargo_at(DEBIAN_CARGO, &paths::root());
    command
        .env("RUSTC", DEBIAN_RUSTC)
        .env("RUSTC_BOOTSTRAP", "1")
        .env_remove("RUSTUP_TOOLCHAIN")
        .env("CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER", linker)
        .args(["-Z", "build-std=std,panic_abort"]);
    Ok(command)
}

/// Makes the JavaScript that loads the module; the library is the same version as the crate in Cargo.lock.
fn bind(wasm: &Path, out_dir: &Path) -> anyhow::Result<()> {
    if out_dir.exists() {
        std::fs::remove_dir_all(out_dir).with_context(|| format!("failed to remove {out_dir:?}"))?;
    }
    wasm_bindgen_cli_support::Bindgen::new()
        .input_path(wasm)
        .web(true)?
        .typescript(false)
        .remove_name_section(true)
        .remove_producers_section(true)
        .generate(out_dir)
        .context("failed to bind the page to JavaScript")
}
