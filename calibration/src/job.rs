//! The calibration job.

use palpate_robot_model::TactileLayout;
use palpate_sim::{
    SensorModel,
    job::{Cancel, Progress},
    replay::ContactTrace,
};
use palpate_wire::api::CalibrationReport;

/// What to do.
#[derive(Clone, Debug)]
pub struct CalibrationConfig {
    /// Which search.
    pub method: Method,
    /// Which takes to keep for judging.
    pub hold_out: HoldOut,
    /// Values of alpha tried by the exact search before refinement, or on the grid's axis.
    pub num_alphas: usize,
    /// Values of each lambda on the grid.
    pub num_lambdas: usize,
    /// Bootstrap resamples of takes for the 95 % intervals.
    pub bootstrap_resamples: usize,
    /// Seed of the bootstrap.
    pub seed: u64,
}

impl Default for CalibrationConfig {
    fn default() -> Self {
        Self {
            method: Method::Exact,
            hold_out: HoldOut::Auto,
            num_alphas: 20,
            num_lambdas: 20,
            bootstrap_resamples: 2000,
            seed: 0,
        }
    }
}

/// Which search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// One sort per alpha finds the best threshold over all real values.
    Exact,
    /// The paper's grid over (lambda_con, alpha, lambda_pre).
    Grid,
}

/// Which takes to keep for judging.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HoldOut {
    /// About a third of the takes, every object among both halves where possible.
    Auto,
    /// These takes, by id.
    Takes(Vec<String>),
}

/// A take, replayed: what calibration compares.
#[derive(Clone, Debug)]
pub struct PairedTake {
    /// Id of the take within its session.
    pub id: String,
    /// Id of the object.
    pub object: String,
    /// Host time of each joint frame since the take's start, s.
    pub frame_times_s: Vec<f64>,
    /// Replayed contact.
    pub contact: ContactTrace,
    /// Real activation in effect at each frame, `[frame * num_channels + channel]`.
    pub real_active: Vec<bool>,
}

/// What a calibration found.
#[derive(Clone, Debug)]
pub struct CalibrationOutcome {
    /// The report, as the command line prints it and the page shows it.
    pub report: CalibrationReport,
    /// The fitted model.
    pub model: SensorModel,
}

/// A calibration that cannot be run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// The session holds nothing to fit.
    #[error("{0}")]
    Input(String),
    /// Somebody cancelled.
    #[error("cancelled")]
    Cancelled,
}

/// Fits theta on the takes that are not held out and judges it on all of them.
pub fn calibrate(
    config: &CalibrationConfig,
    layout: &TactileLayout,
    nominal: &SensorModel,
    takes: &[PairedTake],
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<CalibrationOutcome, CalibrationError> {
    let _ = (config, layout, nominal, takes, progress, cancel);
    todo!()
}
