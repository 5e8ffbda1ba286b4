//! Rollouts on the physical emulated station, and what is compared with them. A station runs in real time: its tests
//! come one after the other, and cargo runs nothing beside this binary.
#![cfg(feature = "mujoco")]

mod against_hand;
mod campaign_page;
mod campaigns;
mod jobs;
mod recorded;
mod region;
mod rollouts;
mod station;
mod training_page;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, MutexGuard, PoisonError};

static TURN: Mutex<()> = Mutex::new(());

/// For each test here, until its end.
fn turn() -> MutexGuard<'static, ()> {
    // A test that failed before has nothing to do with the next one.
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The command, at the root of the repository.
fn palpate_train() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate-train"));
    command.current_dir(root());
    command
}
