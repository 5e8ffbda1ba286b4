//! Trials of a comparison that are kept on disk, a file an object, so that a comparison that was cut off, or that several
//! machines have shared out by objects, goes on after what is there.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use palpate_grasp::Protocol;
use palpate_grasp::trial::{Ending, Known};
use serde::{Deserialize, Serialize};

use crate::files::{self, Source};

/// Longest file that is read, bytes: 100 arms with 10,000 trials each take 70 MB.
const MAX_BYTES: u64 = 256 << 20;

/// What trials on one object were made with: others are not theirs.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub(super) struct Record {
    pub(super) object: String,
    pub(super) protocol: Protocol,
    pub(super) arms: Vec<ArmRecord>,
    pub(super) know_shape: bool,
    pub(super) without_script: bool,
    /// Every file that the trials were made from.
    pub(super) sources: Vec<Source>,
}

/// One arm of a comparison.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub(super) struct ArmRecord {
    pub(super) name: String,
    /// What moved the robot, as the command names it.
    pub(super) policy: String,
    pub(super) known: Known,
}

#[derive(Deserialize, Serialize)]
struct KeptTrials {
    record: Record,
    /// By arm and trial.
    trials: Vec<Vec<Ending>>,
}

/// The file for trials on `object` in `folder`.
pub(super) fn path(folder: &Path, object: &str) -> PathBuf {
    folder.join(format!("{object}.json"))
}

/// Trials by arm that `path` keeps; nothing if there is no such file.
///
/// # Errors
/// Files that cannot be read, and trials that were made with something else than `record` says.
pub(super) fn read(path: &Path, record: &Record) -> anyhow::Result<Option<Vec<Vec<Ending>>>> {
    let bytes = match std::fs::metadata(path) {
        Err(err) if err.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(err) => return Err(err).with_context(|| format!("failed to read {path:?}")),
        Ok(metadata) if metadata.len() > MAX_BYTES => {
            bail!("{path:?} is larger than the {} MiB that trials can take", MAX_BYTES >> 20)
        }
        Ok(_) => std::fs::read(path).with_context(|| format!("failed to read {path:?}"))?,
    };
    let kept: KeptTrials = serde_json::from_slice(&bytes).with_context(|| {
        format!("{path:?} holds no trials of a comparison; remove it, or take another --by-object")
    })?;
    if kept.record != *record {
        bail!("{path:?} holds other trials ({}); take another --by-object", difference(&kept.record, record));
    }
    let is_whole = kept.trials.len() == record.arms.len()
        && kept.trials.iter().all(|trials| trials.len() as u64 == record.protocol.trials);
    if !is_whole {
        bail!("{path:?} does not have the trials that it says; remove it, and they are run again");
    }
    Ok(Some(kept.trials))
}

/// Keeps `trials`, by arm.
pub(super) fn write(path: &Path, record: Record, trials: &[Vec<Ending>]) -> anyhow::Result<()> {
    let kept = KeptTrials { record, trials: trials.to_vec() };
    files::write_in_one_move(path, &serde_json::to_vec(&kept)?)
}

/// In what `found` and `wanted` differ, for people.
fn difference(found: &Record, wanted: &Record) -> String {
    if found.protocol != wanted.protocol {
        let (found, wanted) = (&found.protocol, &wanted.protocol);
        return format!(
            "{} starts of seed {} within {} cm, expected {} of seed {} within {} cm",
            found.trials,
            found.seed,
            100.0 * found.half_width_m,
            wanted.trials,
            wanted.seed,
            100.0 * wanted.half_width_m
        );
    }
    let names = |record: &Record| {
        let of_arm = |arm: &ArmRecord| {
            let Known { touch, tracking, .. } = arm.known;
            let hidden = if touch { "" } else { " without touch" };
            let hidden =
                if tracking { hidden.to_owned() } else { format!("{hidden} without tracking errors") };
            format!("{}{hidden}", arm.policy)
        };
        record.arms.iter().map(of_arm).collect::<Vec<_>>().join(", ")
    };
    if found.arms != wanted.arms {
        return format!("of {}, expected {}", names(found), names(wanted));
    }
    match wanted.sources.iter().find(|source| !found.sources.contains(source)) {
        Some(source) => {
            format!("made with another {} than {} is now", source.role, source.path)
        }
        None => "other flags or files".to_owned(),
    }
}
