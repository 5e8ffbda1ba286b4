//! What long work shares: a place to report progress and a flag that asks it to stop.

use std::sync::atomic::{AtomicBool, Ordering};

/// Receives progress. Implemented by the command line's bar and by the server's job table.
pub trait Progress: Sync {
    /// `fraction` of the whole is done, in 0..=1; `stage` says what is being done now, for people.
    fn report(&self, fraction: f64, stage: &str);
}

/// Discards progress.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn report(&self, _fraction: f64, _stage: &str) {}
}

/// Asks a job to stop; checked between units of work.
#[derive(Debug, Default)]
pub struct Cancel(AtomicBool);

impl Cancel {
    /// Asks the job to stop.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether somebody asked.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
