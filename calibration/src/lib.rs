//! Fits the sensor model to recorded takes and says how well it fits.
//!
//! [`calibrate`] is the job: paired takes in, [`palpate_reports::CalibrationReport`] and a sensor model out.
//! [`PairedTake::from_take`] replays a recorded take for it. [`metrics`] are the paper's, [`sweep`] holds its grid search
//! and the exact search, [`report`] writes the self-contained HTML, [`mod@bench`] measures the searches. [`contact_map`] goes
//! the other way: it learns what to make of real readings, so that they agree with a simulation. Pure: takes, clocks, random
//! seeds and paths come from the caller.

pub mod bench;
mod bootstrap;
pub mod contact_map;
mod hold_out;
mod job;
pub mod metrics;
mod paired;
pub mod report;
pub mod sweep;
mod timelines;

pub use hold_out::held_out;
pub use job::{
    CalibrationConfig, CalibrationError, CalibrationOutcome, HoldOut, Method, calibrate, stream_theta_report,
};
pub use paired::PairedTake;
pub use timelines::{StreamEvents, TakeTimeline};
