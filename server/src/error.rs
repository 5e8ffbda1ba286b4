//! One error for the command line and the server: what happened, and whose turn it is.

use std::{fmt::Write as _, io, path::PathBuf};

use palpate_blind::BlindError;
use palpate_calibration::CalibrationError;
use palpate_control::ControlError;
use palpate_diagnosis::DiagnosisError;
use palpate_drivers::DriverError;
use palpate_export::ExportError;
use palpate_jobs::JobsError;
use palpate_people::PeopleError;
use palpate_recording::RecordingError;
use palpate_robot_model::ModelError;
use palpate_sim::SensorModelError;
use palpate_trials::TrialsError;
use palpate_truth::EmulationError;

/// Anything that can go wrong with a command or a request.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An argument of the caller makes no sense, whatever the data.
    #[error("{0}")]
    Argument(String),
    /// The data given cannot be used.
    #[error("{0}")]
    Content(String),
    /// A take, session or import.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A robot, layout, object or station file.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A sensor model file.
    #[error(transparent)]
    SensorModel(#[from] SensorModelError),
    /// The emulator.
    #[error(transparent)]
    Emulation(#[from] EmulationError),
    /// The calibration.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The diagnosis.
    #[error(transparent)]
    Diagnosis(#[from] DiagnosisError),
    /// The live station.
    #[error(transparent)]
    Control(#[from] ControlError),
    /// The devices of a station.
    #[error(transparent)]
    Devices(#[from] DriverError),
    /// The jobs of the data folder.
    #[error(transparent)]
    Jobs(#[from] JobsError),
    /// The campaigns of the data folder.
    #[error(transparent)]
    Trials(#[from] TrialsError),
    /// The people of the data folder.
    #[error(transparent)]
    People(#[from] PeopleError),
    /// An export.
    #[error(transparent)]
    Export(#[from] ExportError),
    /// Nothing of that name.
    #[error("no {what} {id:?}; {hint}")]
    NotFound {
        /// What was looked for, e.g. `session`.
        what: &'static str,
        /// Its id.
        id: String,
        /// Where to look.
        hint: &'static str,
    },
    /// Whoever asks may not.
    #[error("{0}")]
    NotPermitted(String),
    /// Asked for too often.
    #[error("{what}; try again in {after_s} s")]
    TooOften {
        /// What was asked for.
        what: &'static str,
        /// Seconds to wait.
        after_s: u64,
    },
    /// There is no live station.
    #[error(
        "no station \"live\"; start the studio with --station or --emulate, or open the station of a session"
    )]
    NoStation,
    /// In the way of something that exists.
    #[error("{0}")]
    Conflict(String),
    /// There is something of that name already.
    #[error("{0}")]
    Exists(String),
    /// A program that the work needs is not there.
    #[error("{0}")]
    NotInstalled(String),
    /// A body of another content type than the server takes.
    #[error("{0}")]
    MediaType(String),
    /// More than the server takes.
    #[error("{0}")]
    TooLarge(String),
    /// Too much of it at once; later it will work.
    #[error("{0}")]
    Busy(String),
    /// The disk has no room for it.
    #[error("{0}")]
    DiskFull(String),
    /// Another error as a client may read it, who knows no path of this computer.
    #[error("{message}")]
    Shown {
        /// Class of the error that it was.
        class: Class,
        /// The error and its causes.
        message: String,
    },
    /// The operating system refused.
    #[error("failed to {action} {path:?}")]
    Io {
        /// What was tried, e.g. `write`.
        action: &'static str,
        /// On which path.
        path: PathBuf,
        /// Why not.
        #[source]
        source: io::Error,
    },
    /// Somebody cancelled.
    #[error("cancelled")]
    Cancelled,
    /// A fault of this program.
    #[error("{0}")]
    Internal(String),
}

/// A blind bench fails as whatever it is made of would.
impl From<BlindError> for Error {
    fn from(err: BlindError) -> Self {
        match err {
            BlindError::Emulation(source) => source.into(),
            BlindError::Model(source) => source.into(),
            BlindError::Recording(source) => source.into(),
            BlindError::Cancelled => Self::Cancelled,
            BlindError::NoCase(_) => Self::Argument(err.to_string()),
            other => Self::Content(other.to_string()),
        }
    }
}

/// Whose turn it is after an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// The caller's: the arguments.
    BadArgument,
    /// The caller's: the data.
    BadContent,
    /// The caller's: there is no such thing.
    NotFound,
    /// The caller's: there is no live station.
    NoStation,
    /// The caller's: something is in the way.
    Conflict,
    /// The caller's: another name.
    Exists,
    /// The operator's of this machine: it lacks a program.
    NotInstalled,
    /// The caller's: another idempotency key.
    KeyReused,
    /// The caller's: another content type.
    MediaType,
    /// The caller's: less of it.
    TooLarge,
    /// The caller's: later.
    Busy,
    /// The operator's of the station: nobody else may.
    NotOperator,
    /// The caller's: who they are is not known.
    NotLoggedIn,
    /// An admin's: the caller may not.
    NotPermitted,
    /// The caller's: much later.
    TooOften,
    /// The operator's of this machine: it needs space.
    DiskFull,
    /// Nobody's.
    Cancelled,
    /// The operator's of this machine.
    Failed,
}

impl Error {
    /// `failed to {action} {path}`.
    pub fn io(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { action, path, source }
    }

    /// Whose turn it is.
    pub fn class(&self) -> Class {
        match self {
            Self::Argument(_) => Class::BadArgument,
            Self::Content(_) | Self::Model(_) | Self::SensorModel(_) => Class::BadContent,
            Self::Recording(err) | Self::Emulation(EmulationError::Recording(err)) => recording_class(err),
            Self::Emulation(EmulationError::Cancelled)
            | Self::Calibration(CalibrationError::Cancelled)
            | Self::Diagnosis(DiagnosisError::Cancelled)
            | Self::Cancelled => Class::Cancelled,
            Self::Emulation(EmulationError::Truth { .. }) => Class::BadContent,
            Self::Calibration(CalibrationError::Input(_)) | Self::Diagnosis(DiagnosisError::Input(_)) => {
                Class::BadContent
            }
            Self::NoStation => Class::NoStation,
            Self::NotFound { .. } | Self::Control(ControlError::Unknown(_)) => Class::NotFound,
            Self::Control(ControlError::Refused(_)) => Class::Conflict,
            Self::Control(ControlError::NotOperator(_)) => Class::NotOperator,
            Self::Control(ControlError::Busy) => Class::Busy,
            Self::Control(ControlError::Plan(_)) => Class::BadContent,
            Self::Control(ControlError::Io { action, source, .. }) => io_class(action, source),
            Self::Devices(err) | Self::Control(ControlError::Devices(err)) => match err {
                DriverError::Thread { .. } => Class::Failed,
                _ => Class::BadContent,
            },
            Self::Jobs(err) => match err {
                JobsError::NotFound(_) => Class::NotFound,
                JobsError::Conflict(_) => Class::Conflict,
                JobsError::KeyReused(_) => Class::KeyReused,
                JobsError::Argument(_) => Class::BadArgument,
                JobsError::Content { .. } => Class::BadContent,
                JobsError::Io { action, source, .. } => io_class(action, source),
                _ => Class::Failed,
            },
            Self::Trials(err) => match err {
                TrialsError::UnknownCampaign(_) | TrialsError::UnknownTrial { .. } => Class::NotFound,
                TrialsError::Argument(_) => Class::BadArgument,
                TrialsError::Conflict(_) => Class::Conflict,
                TrialsError::Content { .. } => Class::BadContent,
                TrialsError::File(err) => recording_class(err),
                TrialsError::Io { action, source, .. } => io_class(action, source),
                _ => Class::Failed,
            },
            Self::People(err) => match err {
                PeopleError::Argument(_) => Class::BadArgument,
                PeopleError::NotFound { .. } => Class::NotFound,
                PeopleError::Conflict(_) => Class::Conflict,
                PeopleError::WrongLogin => Class::NotLoggedIn,
                PeopleError::Database { .. } => Class::BadContent,
                _ => Class::Failed,
            },
            Self::Export(err) => match err {
                ExportError::Argument(_) => Class::BadArgument,
                ExportError::Recording(err) => recording_class(err),
                ExportError::Content { .. } => Class::BadContent,
                ExportError::Exists { .. } => Class::Exists,
                ExportError::Io { action, source, .. } => io_class(action, source),
                ExportError::Cancelled => Class::Cancelled,
                _ => Class::Failed,
            },
            Self::NotPermitted(_) => Class::NotPermitted,
            Self::TooOften { .. } => Class::TooOften,
            Self::Conflict(_) => Class::Conflict,
            Self::Exists(_) => Class::Exists,
            Self::NotInstalled(_) => Class::NotInstalled,
            Self::MediaType(_) => Class::MediaType,
            Self::TooLarge(_) => Class::TooLarge,
            Self::Busy(_) => Class::Busy,
            Self::DiskFull(_) => Class::DiskFull,
            Self::Shown { class, .. } => *class,
            Self::Io { action, source, .. } => io_class(action, source),
            // The enums of other crates may grow.
            Self::Emulation(_)
            | Self::Calibration(_)
            | Self::Diagnosis(_)
            | Self::Control(_)
            | Self::Internal(_) => Class::Failed,
        }
    }

    /// Exit code of the command line: 2 where the caller can mend it, 1 otherwise.
    pub fn exit_code(&self) -> u8 {
        match self.class() {
            Class::Cancelled | Class::Failed | Class::Busy | Class::TooOften | Class::DiskFull => 1,
            _ => 2,
        }
    }
}

fn recording_class(err: &RecordingError) -> Class {
    match err {
        RecordingError::Io { action, source, .. } => io_class(action, source),
        _ => Class::BadContent,
    }
}

/// A path that does not exist, or is of the wrong kind, was given by the caller; a full disk was not.
fn io_class(action: &str, source: &io::Error) -> Class {
    match source.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory | io::ErrorKind::IsADirectory => {
            Class::BadArgument
        }
        io::ErrorKind::AlreadyExists => Class::Exists,
        io::ErrorKind::InvalidData | io::ErrorKind::UnexpectedEof if action == "read" => Class::BadContent,
        _ => Class::Failed,
    }
}

/// `err` and its causes on one line, outermost first.
pub fn chain(err: &dyn std::error::Error) -> String {
    let mut text = err.to_string();
    let mut cause = err.source();
    while let Some(err) = cause {
        let _ = write!(text, ": {err}");
        cause = err.source();
    }
    text.replace('\n', " ")
}
