//! Fits the sensor model to recorded takes and says how well it fits.
//!
//! [`calibrate`] is the job: paired takes in, [`palpate_wire::api::CalibrationReport`] and a sensor model out.
//! [`metrics`] are the paper's, [`sweep`] holds its grid search and the exact search, [`report`] writes the
//! self-contained HTML. Pure: takes, clocks, random seeds and paths come from the caller.

pub mod metrics;
mod job;
pub mod report;
pub mod sweep;

pub use job::{CalibrationConfig, CalibrationError, CalibrationOutcome, HoldOut, Method, PairedTake, calibrate};
