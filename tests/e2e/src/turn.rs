//! Who may use the machine: what runs in real time needs all of it, everything else can share.

use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

static TURN: RwLock<()> = RwLock::new(());

/// For a test that takes as long as it takes: beside others of its kind, while nothing runs in real time.
pub fn together() -> RwLockReadGuard<'static, ()> {
    // A test that failed before has nothing to do with the next one.
    TURN.read().unwrap_or_else(PoisonError::into_inner)
}

/// For a station that runs in real time: a machine that is busy with something else would make it hold.
pub fn alone() -> RwLockWriteGuard<'static, ()> {
    TURN.write().unwrap_or_else(PoisonError::into_inner)
}
