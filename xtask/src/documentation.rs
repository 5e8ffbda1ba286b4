//! The documentation's pages, from what the tests were built of. `cargo doc` would check every dependency anew for them,
//! which takes longer than all else that it does.
//!
//! cargo starts rustdoc once for each library, to test its examples. Here it starts this program in rustdoc's place, which
//! has rustdoc make the pages as well. Programs without a library have no examples, and no pages.

use std::{
    env,
    ffi::{OsStr, OsString},
    process::{Command, ExitCode},
};

use anyhow::Context as _;

use crate::{paths, shell};

/// Names rustdoc to this program when it stands in for it.
const RUSTDOC: &str = "PALPATE_RUSTDOC";
/// What rustdoc is given for tests only, and how many values follow.
const OF_TESTS: [(&str, usize); 4] =
    [("--test", 0), ("--no-run", 0), ("--test-run-directory", 1), ("--test-args", 1)];

/// Has `cargo test --doc` also look whether the documentation's links lead somewhere.
pub(crate) fn make_pages_too(cargo: &mut Command) -> anyhow::Result<()> {
    let rustdoc = shell::tool_of_toolchain("rustdoc")?;
    cargo.env("RUSTDOC", env::current_exe()?).env(RUSTDOC, rustdoc);
    Ok(())
}

/// The rustdoc that this program was started in place of, if it was.
pub(crate) fn stood_in_for() -> Option<OsString> {
    env::var_os(RUSTDOC)
}

/// Does what `rustdoc` was started for, and makes the pages beside testing examples.
pub(crate) fn stand_in(rustdoc: &OsStr) -> anyhow::Result<ExitCode> {
    let args: Vec<OsString> = env::args_os().skip(1).collect();
    let start = |args: &[OsString], more: &[&str]| {
        Command::new(rustdoc).args(args).args(more).spawn().context("failed to start rustdoc")
    };
    let mut asked_for = start(&args, &[])?;
    let mut passed = true;
    if args.iter().any(|arg| arg == "--test") {
        let out = paths::target().join("doc");
        let out = out.to_str().context("the target folder's name is no text")?;
        let denied = ["--deny", "warnings", "--allow", "rustdoc::private_intra_doc_links"];
        let more = [&["--document-private-items", "--out-dir", out], denied.as_slice()].concat();
        passed = start(&without_tests(&args), &more)?.wait()?.success();
    }
    passed &= asked_for.wait()?.success();
    Ok(if passed { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn without_tests(args: &[OsString]) -> Vec<OsString> {
    let (mut kept, mut args) = (Vec::new(), args.iter());
    while let Some(arg) = args.next() {
        match OF_TESTS.iter().find(|(name, _)| arg == name) {
            Some((_, values)) => args.by_ref().take(*values).for_each(drop),
            None => kept.push(arg.clone()),
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_are_made_without_what_is_for_tests() {
        let args = |text: &str| text.split(' ').map(OsString::from).collect::<Vec<_>>();
        let given = "--edition=2024 --test src/lib.rs --test-run-directory /x --extern a --test-args filter";
        assert_eq!(without_tests(&args(given)), args("--edition=2024 src/lib.rs --extern a"));
    }
}
