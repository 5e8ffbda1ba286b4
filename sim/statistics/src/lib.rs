//! Statistics of trials that end in success or failure: how sure a rate is, whether two policies differ, and when to stop.
//!
//! | question | function |
//! |---|---|
//! | In which interval does the rate lie? | [`wilson`] to show, [`clopper_pearson`] to claim |
//! | How often do k trials in a row succeed? | [`pass_hat_k`] |
//! | In which interval does a mean of few numbers lie? | [`student`] |
//! | Do two policies differ on the same starts? | [`mcnemar_exact`] |
//! | Do two policies differ on starts of their own? | [`barnard_exact`] |
//! | Do two people score alike? | [`cohens_kappa`] |
//! | May a comparison stop before its last trial? | [`SequentialTest`] |
//!
//! Everything is deterministic; nothing here draws a random number.

mod agreement;
mod comparison;
mod mean;
mod rate;
mod sequential;

pub use agreement::cohens_kappa;
pub use comparison::{barnard_exact, mcnemar_exact};
pub use mean::{Mean, student};
pub use rate::{Interval, clopper_pearson, pass_hat_k, wilson};
pub use sequential::{Decision, Operating, Pairs, SequentialTest};

/// Numbers that no trials can have.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StatisticsError {
    /// More successes than trials.
    #[error("{successes} successes of {trials} trials; expected at most as many successes as trials")]
    Successes {
        /// Successes.
        successes: u64,
        /// Trials.
        trials: u64,
    },
    /// A probability outside its range.
    #[error("{what} is {value}, expected more than 0 and less than 1")]
    Probability {
        /// Which.
        what: &'static str,
        /// What was given.
        value: f64,
    },
    /// More trials than the computation is meant for, or none.
    #[error("{what} is {value}, expected 1 to {max}")]
    Count {
        /// Which.
        what: &'static str,
        /// What was given.
        value: u64,
        /// The most.
        max: u64,
    },
}

/// `value` if it is a probability, 0 and 1 excluded.
fn probability(what: &'static str, value: f64) -> Result<f64, StatisticsError> {
    if value > 0.0 && value < 1.0 { Ok(value) } else { Err(StatisticsError::Probability { what, value }) }
}

/// Refuses more successes than trials.
fn check_successes(successes: u64, trials: u64) -> Result<(), StatisticsError> {
    if successes <= trials { Ok(()) } else { Err(StatisticsError::Successes { successes, trials }) }
}
