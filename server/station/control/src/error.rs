//! What can go wrong with running a station.

use std::{io, path::PathBuf};

use palpate_drivers::DriverError;
use palpate_motion::PlanError;

/// A station that cannot be run, or what cannot be done with one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ControlError {
    /// It cannot be done now; says why and what to do.
    #[error("{0}")]
    Refused(String),
    /// Only the operator may do it; says who that is and what to do.
    #[error("{0}")]
    NotOperator(String),
    /// Too many requests wait.
    #[error("the control loop has too many requests to answer; try again in a moment")]
    Busy,
    /// There is no such thing; says what there is.
    #[error("{0}")]
    Unknown(String),
    /// A file or folder.
    #[error("failed to {action} {path:?}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// On which path.
        path: PathBuf,
        /// Why not.
        #[source]
        source: io::Error,
    },
    /// A plan of the station.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The devices of the station.
    #[error(transparent)]
    Devices(#[from] DriverError),
    /// A thread that could not be started.
    #[error("failed to start the thread {name:?}")]
    Thread {
        /// Which.
        name: &'static str,
        /// Why not.
        #[source]
        source: io::Error,
    },
    /// The control loop does not answer.
    #[error(
        "the control loop did not answer for {seconds} s; the machine is overloaded, stop the robot by its switch"
    )]
    NoAnswer {
        /// For so long.
        seconds: u64,
    },
    /// The control loop has ended.
    #[error("the control loop has ended and let go of the robot; start the studio again")]
    Ended,
}
