//! Records a whole calibration session from the truth world.

use std::path::Path;

use palpate_recording::{RecordingError, Session};
use palpate_sim::job::{Cancel, Progress};

/// An emulation that cannot be run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EmulationError {
    /// The truth file is wrong.
    #[error("{file}: {place}: {problem}")]
    Truth {
        /// Which file.
        file: String,
        /// Where in it.
        place: String,
        /// What is wrong and what to do.
        problem: String,
    },
    /// The station or the disk.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Somebody cancelled.
    #[error("cancelled")]
    Cancelled,
}

/// Records the session that the truth file at `truth_path` describes into `out_dir`, which must not exist.
/// Same truth, same seed: same bytes.
pub fn record_session(
    truth_path: &Path,
    out_dir: &Path,
    seed: u64,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Session, EmulationError> {
    let _ = (truth_path, out_dir, seed, progress, cancel);
    todo!()
}
