//! The search for theta: the paper's grid, and the exact search that needs one sort per alpha.
//!
//! The objective is the paper's: channel-frames in which simulated and real activation differ (L1). It falls into two
//! independent parts, because `lambda_con` acts on proximity channels only and `(alpha, lambda_pre)` on pressure
//! channels only. For a fixed alpha each part compares precomputed scores with one threshold, so that the objective is
//! a step function of it that changes at the scores alone: [`Ranked`] sorts them once and knows it for every real
//! threshold. [`exact()`] therefore searches alpha only; [`grid()`] is the paper's method, and counts every point afresh.
//!
//! Each part is a sum over channels, and a channel's signal depends on geometry and on the theta of its own stream alone. So
//! where streams have one theta each, a search of each stream on its own channels finds the same as a search of all of them
//! at once would.
//!
//! Admissible thresholds are those of a sensor model file: `lambda_con` up to [`palpate_sim::replay::NEAR_M`] and
//! `lambda_pre` from zero (a negative one would make every taxel active without any touch).

mod axes;
mod exact;
mod fit;
mod grid;
mod ranked;
mod signals;

pub use axes::{GridAxes, alpha_axis};
pub(crate) use exact::REFINEMENT_ROUNDS;
pub use exact::{ExactResult, TriedAlpha, exact};
pub(crate) use fit::{FittedStreams, fit_streams};
pub use grid::{GridResult, grid, l1_of_readings};
pub use ranked::{BestThreshold, Ranked};
pub use signals::FitData;

use palpate_sim::job::{Cancel, Progress};

use crate::CalibrationError;

/// Where a search reports to and who may stop it.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Receives progress over the part of the job that the search is.
    pub progress: &'a dyn Progress,
    /// Asks it to stop.
    pub cancel: &'a Cancel,
    /// Fractions of the whole job at which the search starts and ends.
    pub span: [f64; 2],
}

impl Watch<'_> {
    /// Reports that `done` of `total` units are done; an error if somebody asked to stop.
    pub(crate) fn step(&self, done: usize, total: usize, stage: &str) -> Result<(), CalibrationError> {
        if self.cancel.is_cancelled() {
            return Err(CalibrationError::Cancelled);
        }
        let [start, end] = self.span;
        self.progress.report(start + (end - start) * done as f64 / total.max(1) as f64, stage);
        Ok(())
    }

    pub(crate) fn within(self, span: [f64; 2]) -> Self {
        Self { span, ..self }
    }
}
