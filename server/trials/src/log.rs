//! What happened in a campaign, as lines that are only added.

use std::{
    fs::{File, OpenOptions},
    io::{Read as _, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
};

use palpate_wire::api::{RolloutOutcome, TrialVerdict};
use serde::{Deserialize, Serialize};

use crate::TrialsError;

/// Largest log that is read, bytes: ten thousand trials with notes have some megabytes.
const MAX_LOG_BYTES: u64 = 256 << 20;

/// One line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Entry {
    /// When, RFC 3339.
    pub(crate) time: String,
    /// Who.
    pub(crate) who: String,
    /// What.
    #[serde(flatten)]
    pub(crate) change: Change,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "what", rename_all = "snake_case")]
pub(crate) enum Change {
    /// The object is placed and a rollout begins: another attempt of the trial.
    Begun { trial: u32, attempt: u32 },
    /// The rollout has ended.
    Ended { trial: u32, attempt: u32, outcome: RolloutOutcome },
    /// Whoever it was gave a verdict.
    Scored { trial: u32, attempt: u32, verdict: TrialVerdict, note: String },
    /// They took it back.
    Unscored { trial: u32, attempt: u32 },
    /// Scorers differed; this counts.
    Settled { trial: u32, attempt: u32, verdict: TrialVerdict, note: String },
    /// No trial begins until it is resumed.
    Paused,
    /// Trials begin again.
    Resumed,
    /// No trial is made any more.
    Closed,
    /// Trials go on.
    Reopened,
}

/// The log of a campaign, open for adding.
#[derive(Debug)]
pub(crate) struct Log {
    path: PathBuf,
    file: File,
    /// Bytes of whole lines.
    len: u64,
}

impl Log {
    /// Opens the log at `path`, and gives what it holds. Half a line at its end is what a power cut left of a change that
    /// nobody was told of; it is taken away.
    pub(crate) fn open(path: &Path) -> Result<(Self, Vec<Entry>), TrialsError> {
        let failed = |action| TrialsError::io(action, path);
        let mut options = OpenOptions::new();
        let mut file =
            options.read(true).write(true).create(true).truncate(false).open(path).map_err(failed("open"))?;
        let (entries, len) = read(path, &mut file)?;
        file.set_len(len).and_then(|()| file.seek(SeekFrom::Start(len))).map_err(failed("write"))?;
        Ok((Self { path: path.to_owned(), file, len }, entries))
    }

    /// Reads the log at `path` without changing it. A log that does not exist is empty.
    pub(crate) fn read(path: &Path) -> Result<Vec<Entry>, TrialsError> {
        match File::open(path) {
            Ok(mut file) => Ok(read(path, &mut file)?.0),
            Err(err) if err.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
            Err(err) => Err(TrialsError::io("read", path)(err)),
        }
    }

    /// Adds `entry`; it is on disk when this returns. After an error the log is as it was.
    pub(crate) fn add(&mut self, entry: &Entry) -> Result<(), TrialsError> {
        let mut line = serde_json::to_vec(entry).map_err(|err| TrialsError::Argument(err.to_string()))?;
        line.push(b'\n');
        let written = self.file.write_all(&line).and_then(|()| self.file.sync_data());
        match written {
            Ok(()) => {
                self.len += line.len() as u64;
                Ok(())
            }
            Err(err) => {
                // If this fails too, the half line goes when the log is opened next.
                drop(self.file.set_len(self.len).and_then(|()| self.file.seek(SeekFrom::Start(self.len))));
                Err(TrialsError::io("write", &self.path)(err))
            }
        }
    }
}

/// The entries of `file`, and how many bytes of it are whole lines.
fn read(path: &Path, file: &mut File) -> Result<(Vec<Entry>, u64), TrialsError> {
    let mut bytes = Vec::new();
    file.take(MAX_LOG_BYTES + 1).read_to_end(&mut bytes).map_err(TrialsError::io("read", path))?;
    if bytes.len() as u64 > MAX_LOG_BYTES {
        let problem = format!("is larger than {MAX_LOG_BYTES} bytes, which is the most that is read");
        return Err(TrialsError::Content { path: path.to_owned(), problem });
    }
    let whole = bytes.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
    if whole < bytes.len() {
        tracing::warn!(
            ?path,
            bytes = bytes.len() - whole,
            "left out half a line at the end of a campaign's log"
        );
    }
    let mut entries = Vec::new();
    for (idx, line) in bytes[..whole].split_inclusive(|&byte| byte == b'\n').enumerate() {
        let entry = serde_json::from_slice(line).map_err(|err| TrialsError::Content {
            path: path.to_owned(),
            problem: format!("line {} is no entry of a campaign's log ({err}); restore the file", idx + 1),
        })?;
        entries.push(entry);
    }
    Ok((entries, whole as u64))
}
