//! What can be exported: takes of sessions, and trials of rollouts.

mod rollout;
mod session;

use std::path::{Path, PathBuf};

use palpate_recording::Session;
use serde::Serialize;
use sha2::{Digest as _, Sha256};

use crate::ExportError;

/// What every episode of a data set shares.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Setup {
    /// Id of the station.
    pub(crate) station: String,
    /// Nominal rate, Hz: of the joint log, or of the policy's steps.
    pub(crate) rate_hz: f64,
    /// Names, in the station's order.
    pub(crate) joints: Vec<String>,
    /// Tactile streams, in the layout's order.
    pub(crate) streams: Vec<StreamSetup>,
    /// What raw readings are.
    pub(crate) raw: RawKind,
}

/// A tactile stream.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct StreamSetup {
    pub(crate) id: String,
    /// Unit of raw readings.
    pub(crate) raw_unit: String,
    /// Nominal rate, Hz.
    pub(crate) rate_hz: f64,
    /// Ids, in the layout's order.
    pub(crate) channels: Vec<String>,
}

/// What raw readings are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum RawKind {
    /// As the device gave them.
    AsRead,
    /// Less the reference value of the channel.
    LessReference,
}

/// One recording, at the rates of its logs.
#[derive(Clone, Debug)]
pub(crate) struct Episode {
    pub(crate) setup: Setup,
    /// What was done, in words.
    pub(crate) task: String,
    pub(crate) joints: Log<f64>,
    /// What joints were told; empty where that was not recorded.
    pub(crate) commands: Log<f64>,
    /// Streams of the setup.
    pub(crate) streams: Vec<Touch>,
    /// Where the object is, as [`POSE_NAMES`]: one pose of one that stands still. Empty where nobody says so.
    pub(crate) object_poses: Log<f64>,
    /// What it came to, where that is known.
    pub(crate) outcome: Option<Outcome>,
    pub(crate) origin: Origin,
}

/// Values over time.
#[derive(Clone, Debug, Default)]
pub(crate) struct Log<T> {
    /// Increasing, ns since the recording's start.
    pub(crate) times_ns: Vec<u64>,
    /// `num_samples x width`, row-major.
    pub(crate) values: Vec<T>,
}

/// Numbers of an object's pose in the base frame: where its origin is, m, and a unit quaternion, scalar first.
pub(crate) const POSE_NAMES: [&str; 7] = ["x", "y", "z", "qw", "qx", "qy", "qz"];

/// A tactile stream over time.
#[derive(Clone, Debug, Default)]
pub(crate) struct Touch {
    pub(crate) active: Log<bool>,
    /// `num_samples x num_channels`, row-major; empty where the hardware gives events only.
    pub(crate) raw: Vec<f32>,
}

/// What an episode came to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Outcome {
    pub(crate) success: bool,
    /// `empty_grasp`, `slip` or `emergency_stop`; `None` for a success.
    pub(crate) failure_mode: Option<String>,
    /// Who says so.
    pub(crate) judged_by: &'static str,
}

/// The file that an episode is a copy of.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Origin {
    /// Folder, e.g. `demo`.
    pub(crate) folder: String,
    /// File in it.
    pub(crate) file: String,
    pub(crate) sha256: String,
    /// `mcap_take` or `rollout_record`.
    pub(crate) format: &'static str,
    /// Id of the object.
    pub(crate) object: String,
    /// What was done with it, e.g. `tap`.
    pub(crate) primitive: String,
}

/// A recording that was not exported, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LeftOut {
    /// Its file.
    pub file: PathBuf,
    /// Why.
    pub reason: String,
}

/// A folder to export.
pub(crate) enum Source {
    Session(Session),
    Rollout(PathBuf),
}

/// One recording that is yet to be read.
pub(crate) struct Waiting<'a> {
    source: &'a Source,
    /// Index of the take, or of the record.
    idx: usize,
    pub(crate) path: PathBuf,
}

impl Source {
    /// Opens the folder of a session or of a rollout.
    pub(crate) fn open(dir: &Path) -> Result<Self, ExportError> {
        if dir.join("session.toml").exists() {
            return Ok(Self::Session(Session::open(dir)?));
        }
        if !dir.is_dir() {
            return Err(ExportError::content(dir, "is no folder; give a session or the --out of a rollout"));
        }
        if rollout::records(dir)?.is_empty() {
            let problem =
                "holds neither session.toml nor trial-0000.jsonl; give a session or the --out of a rollout";
            return Err(ExportError::content(dir, problem));
        }
        Ok(Self::Rollout(dir.to_owned()))
    }

    /// Its recordings, in order; those that are set aside go to `left_out`.
    pub(crate) fn recordings(&self, left_out: &mut Vec<LeftOut>) -> Result<Vec<Waiting<'_>>, ExportError> {
        let waiting = |(idx, path)| Waiting { source: self, idx, path };
        match self {
            Self::Rollout(dir) => Ok(rollout::records(dir)?.into_iter().enumerate().map(waiting).collect()),
            Self::Session(session) => {
                let takes = session.file.takes.iter().enumerate();
                let (accepted, others): (Vec<_>, Vec<_>) = takes.partition(|(_, entry)| entry.accepted);
                left_out.extend(others.into_iter().map(|(_, entry)| LeftOut {
                    file: session.take_path(entry),
                    reason: "the take is not accepted in session.toml".to_owned(),
                }));
                Ok(accepted
                    .into_iter()
                    .map(|(idx, entry)| waiting((idx, session.take_path(entry))))
                    .collect())
            }
        }
    }
}

impl Waiting<'_> {
    /// Reads it; `Err` of the inner result says why it is no episode.
    pub(crate) fn read(&self) -> Result<Result<Episode, LeftOut>, ExportError> {
        match self.source {
            Source::Session(session) => session::read(session, self.idx, &self.path).map(Ok),
            Source::Rollout(_) => rollout::read(&self.path),
        }
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Name of the folder that holds `path`.
fn folder_name(path: &Path) -> String {
    let folder = path.parent().map(Path::to_owned).unwrap_or_default();
    // `sessions/..` and `.` have no name of their own.
    file_name(&folder.canonicalize().unwrap_or(folder))
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// An id as people write it: `press_hold` is "press hold".
fn words(id: &str) -> String {
    id.replace(['_', '-'], " ")
}
