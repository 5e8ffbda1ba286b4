//! Finds where a simulator and measurements disagree, names the missing effect, adds it to the model and shows the gap
//! shrink.
//!
//! [`diagnose`] is the job: takes in, [`palpate_reports::DiagnosisReport`] and a sensor model with effects out.
//! [`engine`] does the statistics for any [`engine::Domain`]; [`tactile`] is the sense of touch.
//! Pure: takes, clocks, random seeds and paths come from the caller.

pub mod actuator;
mod config;
pub mod engine;
mod fired;
mod job;
mod measure;
mod null;
mod prepare;
mod reference;
pub mod report;
pub mod rules;
mod search;
mod show;
mod steps;
pub mod tactile;
#[cfg(test)]
mod testing;
mod withhold;

pub use config::DiagnosisConfig;
pub use job::{DiagnosisOutcome, diagnose};
pub use measure::reference;
pub use null::{NullBar, null_bar};
pub use reference::Reference;
pub use tactile::adequacy::Adequacy;

/// A diagnosis that cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DiagnosisError {
    /// The takes, the model or the configuration do not make a diagnosis: which, why, and what to do.
    #[error("{0}")]
    Input(String),
    /// Somebody cancelled.
    #[error("cancelled")]
    Cancelled,
}
