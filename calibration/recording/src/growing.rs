//! A session that grows: takes are recorded one by one, reviewed, and accepted or set aside.
//!
//! ```text
//! sessions/monday/
//!     session.toml          accepted takes: what calibration reads
//!     recording.toml        every take and where it stands: what recording needs to go on
//!     take-01.mcap          accepted, or waiting for a decision
//!     take-02.mcap.partial  being recorded
//!     discarded/            takes that were set aside; nothing here is ever deleted
//! ```
//!
//! `recording.toml` is written before a file moves, so that it says where each file belongs: opening the session again
//! finishes what a crash interrupted. No two takes have one name. If `recording.toml` itself was cut off, opening the
//! session makes the list again from the takes in the folder.

use std::{
    fs::{self, File},
    path::{Path, PathBuf},
};

use palpate_reports::TakeVerdict;
use palpate_robot_model::Station;
use serde::{Deserialize, Serialize};

use crate::{
    LiveTake, RecordingError, Session, SessionFile, SessionTake, TakeMeta, close_partial,
    files::{replace_file, sync_folder},
    session::RECORDING_FILE,
};

mod names;
mod resume;
mod salvage;

pub use resume::SessionHold;

const RECORDING_FORMAT: u32 = 1;
/// Last line of `recording.toml`: without it the file was cut off, or written before this line was.
const LAST_LINE: &str = "# The list ends here.\n";
const DISCARDED: &str = "discarded";
const PARTIAL: &str = ".partial";
/// Held while a process records into the folder.
const LOCK_FILE: &str = ".recording.lock";

/// `recording.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordingFile {
    /// Version of the format; 1.
    pub format: u32,
    /// Id of the plan that the session follows.
    pub plan: String,
    /// Who records; may be empty.
    #[serde(default)]
    pub operator: String,
    /// The plan's steps, in order, so that a plan that was changed since is noticed; then those that were added. A session
    /// may have the latter alone.
    #[serde(rename = "step", default)]
    pub steps: Vec<PlannedStep>,
    /// Every take that was started, in order.
    #[serde(rename = "take", default)]
    pub takes: Vec<RecordedTake>,
}

/// A step of the plan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedStep {
    /// Object id.
    pub object: String,
    /// Primitive id.
    pub primitive: String,
    /// Why it was added to the plan's own steps, e.g. what a diagnosis wants to tell apart; absent for those of the plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub added_because: Option<String>,
}

/// A take that was started.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedTake {
    /// File name, in the session's folder or in `discarded`.
    pub file: String,
    /// Index of its step.
    pub step: usize,
    /// Where it stands.
    pub state: TakeState,
    /// Why it ended early; empty if it did not.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub broken_off: String,
    /// Whether it can be read; unknown before it is checked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readable: Option<bool>,
    /// Counts what was set aside: the highest is the newest. 0 where it was not.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub set_aside: u32,
    /// Remarks made after it was recorded; those made meanwhile are spans of the take.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Its quality check, once it was made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<TakeVerdict>,
}

impl RecordedTake {
    /// Id of the take: the file's stem.
    pub fn id(&self) -> &str {
        self.file.strip_suffix(".mcap").unwrap_or(&self.file)
    }
}

/// Where a take stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TakeState {
    /// Being recorded.
    Recording,
    /// Complete; neither accepted nor set aside.
    Review,
    /// Part of the session.
    Accepted,
    /// In the folder `discarded`.
    Discarded,
}

/// What a session follows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionPlan {
    /// Id of the plan.
    pub plan: String,
    /// Its steps, in order, then those that are added to them.
    pub steps: Vec<PlannedStep>,
}

/// How a take ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TakeEnd {
    /// Id of the take.
    pub take: String,
    /// What went wrong while its end was written; empty if nothing did.
    pub problem: String,
}

/// A session that is being recorded. One process at a time has it open.
#[derive(Debug)]
pub struct GrowingSession {
    session: Session,
    recording: RecordingFile,
    /// Unlocked when it is dropped, by whatever end of the process.
    _lock: File,
}

impl GrowingSession {
    /// The accepted takes, as everything else sees them.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Every take and where it stands.
    pub fn recording(&self) -> &RecordingFile {
        &self.recording
    }

    /// Where the take called `id` lies now.
    pub fn take_path(&self, id: &str) -> Result<PathBuf, RecordingError> {
        Ok(self.path_of(&self.recording.takes[self.index(id)?]))
    }

    /// Starts a take of step `step_idx`. It lies under a name of its own until [`GrowingSession::end_take`].
    pub fn start_take(
        &mut self,
        step_idx: usize,
        station: &Station,
        meta: &TakeMeta,
        start_unix_ns: u64,
    ) -> Result<LiveTake, RecordingError> {
        if step_idx >= self.recording.steps.len() {
            let problem = format!("there is no step {}, only {}", step_idx + 1, self.recording.steps.len());
            return Err(RecordingError::content(self.recording_path(), "step", problem));
        }
        let file = self.free_name(step_idx);
        // The name is written down first: whatever happens now, the take will be found.
        let mut changed = self.recording.clone();
        changed.takes.push(RecordedTake {
            file: file.clone(),
            step: step_idx,
            state: TakeState::Recording,
            broken_off: String::new(),
            readable: None,
            set_aside: 0,
            notes: Vec::new(),
            verdict: None,
        });
        self.save(changed)?;
        let live = LiveTake::create(&self.partial_path(&file), station, meta, start_unix_ns);
        if live.is_err() {
            let mut changed = self.recording.clone();
            changed.takes.pop();
            // Its own failure matters more than that the name is lost to this session.
            let _ = fs::remove_file(self.partial_path(&file));
            let _ = self.save(changed);
        }
        live
    }

    /// Ends a take of this session, which waits for a decision then. `broken_off` says why it ended early, if it did.
    ///
    /// Where its end cannot be written, what was recorded is kept all the same and [`TakeEnd::problem`] says so; an
    /// error means that the file could not be made a take at all.
    pub fn end_take(&mut self, live: LiveTake, broken_off: &str) -> Result<TakeEnd, RecordingError> {
        let partial = live.path().to_owned();
        let found = self.recording.takes.iter().position(|take| self.partial_path(&take.file) == partial);
        let Some(take_idx) = found else {
            return Err(RecordingError::content(partial, "take", "belongs to another session"));
        };
        let mut problems = Vec::new();
        let finished =
            live.finish().and_then(|file| file.sync_all().map_err(RecordingError::io("write", &partial)));
        if let Err(error) = finished {
            problems.push(chain(&error));
            if let Err(error) = close_partial(&partial) {
                let mut changed = self.recording.clone();
                let take = &mut changed.takes[take_idx];
                take.broken_off = format!("{}; it cannot be read", problems.join("; "));
                take.readable = Some(false);
                self.put_aside(changed, take_idx)?;
                return Err(error);
            }
        }
        let take = &self.recording.takes[take_idx];
        let id = take.id().to_owned();
        move_file(&partial, &self.session.dir.join(&take.file))?;
        let mut changed = self.recording.clone();
        let take = &mut changed.takes[take_idx];
        take.state = TakeState::Review;
        take.broken_off = if broken_off.is_empty() { problems.join("; ") } else { broken_off.to_owned() };
        // The take is on disk: that the list could not be written (a full disk) is told, and mended on resuming.
        if let Err(error) = self.save(changed.clone()) {
            problems.push(chain(&error));
            self.recording = changed;
        }
        Ok(TakeEnd { take: id, problem: problems.join("; ") })
    }

    /// Makes the take part of the session.
    pub fn accept(&mut self, id: &str) -> Result<(), RecordingError> {
        let take_idx = self.index(id)?;
        let take = &self.recording.takes[take_idx];
        if take.state == TakeState::Accepted {
            return Ok(());
        }
        if take.state != TakeState::Review {
            return Err(self.refused(id, "only a take that waits for a decision can be accepted"));
        }
        let rival = self
            .recording
            .takes
            .iter()
            .find(|other| other.state == TakeState::Accepted && other.step == take.step);
        if let Some(rival) = rival {
            let problem = format!("{:?} is accepted for this step already; set it aside first", rival.id());
            return Err(self.refused(id, &problem));
        }
        let mut changed = self.recording.clone();
        changed.takes[take_idx].state = TakeState::Accepted;
        self.save(changed)
    }

    /// Moves the take to the folder `discarded`, whether it was accepted or not.
    pub fn set_aside(&mut self, id: &str) -> Result<(), RecordingError> {
        let take_idx = self.index(id)?;
        match self.recording.takes[take_idx].state {
            TakeState::Review | TakeState::Accepted => self.put_aside(self.recording.clone(), take_idx),
            TakeState::Recording => Err(self.refused(id, "it is being recorded; stop it first")),
            TakeState::Discarded => Err(self.refused(id, "it is set aside already")),
        }
    }

    /// Takes a take that was set aside back; it waits for a decision then.
    pub fn restore(&mut self, id: &str) -> Result<(), RecordingError> {
        let take_idx = self.index(id)?;
        let take = &self.recording.takes[take_idx];
        if take.state != TakeState::Discarded {
            return Err(self.refused(id, "it is not set aside"));
        }
        let (from, to) = (self.discarded_path(&take.file), self.session.dir.join(&take.file));
        let mut changed = self.recording.clone();
        changed.takes[take_idx].state = TakeState::Review;
        changed.takes[take_idx].set_aside = 0;
        let before = self.recording.clone();
        self.save(changed)?;
        move_file(&from, &to).inspect_err(|_| {
            // If not even this can be written, resuming finds the file where it is.
            let _ = self.save(before);
        })
    }

    /// The take that was set aside last, is there still, and is a take.
    pub fn last_set_aside(&self) -> Option<&RecordedTake> {
        let discarded = self
            .recording
            .takes
            .iter()
            .filter(|take| take.state == TakeState::Discarded && take.readable != Some(false));
        discarded.max_by_key(|take| take.set_aside).filter(|take| self.discarded_path(&take.file).is_file())
    }

    /// Keeps a remark about a take that is recorded.
    pub fn note(&mut self, id: &str, text: &str) -> Result<(), RecordingError> {
        let take_idx = self.index(id)?;
        let mut changed = self.recording.clone();
        changed.takes[take_idx].notes.push(text.to_owned());
        self.save(changed)
    }

    /// Keeps what the quality check of a take found.
    pub fn set_verdict(
        &mut self,
        id: &str,
        verdict: TakeVerdict,
        readable: bool,
    ) -> Result<(), RecordingError> {
        let take_idx = self.index(id)?;
        let mut changed = self.recording.clone();
        changed.takes[take_idx].verdict = Some(verdict);
        changed.takes[take_idx].readable = Some(readable);
        self.save(changed)
    }

    /// Adds a step behind the others.
    pub fn add_step(&mut self, step: PlannedStep) -> Result<(), RecordingError> {
        let mut changed = self.recording.clone();
        changed.steps.push(step);
        self.save(changed)
    }

    /// Takes an added step off the list again. Takes of it that were set aside stay in the folder `discarded`, and are
    /// listed no more.
    pub fn remove_step(&mut self, step_idx: usize) -> Result<(), RecordingError> {
        let refused = |problem: &str| {
            let place = format!("step {}", step_idx + 1);
            Err(RecordingError::content(self.recording_path(), place, problem.to_owned()))
        };
        if self.recording.steps.get(step_idx).is_none_or(|step| step.added_because.is_none()) {
            return refused("only a step that was added to the plan's can be taken off");
        }
        let mut changed = self.recording.clone();
        changed.takes.retain(|take| take.step != step_idx || take.state != TakeState::Discarded);
        if changed.takes.iter().any(|take| take.step == step_idx) {
            return refused("has a take; set it aside first");
        }
        changed.steps.remove(step_idx);
        for take in changed.takes.iter_mut().filter(|take| take.step > step_idx) {
            take.step -= 1;
        }
        self.save(changed)
    }

    fn index(&self, id: &str) -> Result<usize, RecordingError> {
        self.recording
            .takes
            .iter()
            .position(|take| take.id() == id)
            .ok_or_else(|| self.refused(id, "the session has no such take"))
    }

    fn refused(&self, id: &str, problem: &str) -> RecordingError {
        RecordingError::content(self.recording_path(), format!("take {id:?}"), problem)
    }

    fn put_aside(&mut self, mut changed: RecordingFile, take_idx: usize) -> Result<(), RecordingError> {
        let set_aside = next_set_aside(&mut changed);
        let take = &mut changed.takes[take_idx];
        let partial = take.state == TakeState::Recording;
        take.state = TakeState::Discarded;
        take.set_aside = set_aside;
        let from = if partial { self.partial_path(&take.file) } else { self.session.dir.join(&take.file) };
        let to = self.discarded_path(&take.file);
        let before = self.recording.clone();
        self.save(changed)?;
        let discarded = self.session.dir.join(DISCARDED);
        let moved = fs::create_dir_all(&discarded)
            .map_err(RecordingError::io("make", &discarded))
            .and_then(|()| move_file(&from, &to));
        moved.inspect_err(|_| {
            // If not even this can be written, resuming finds the file where it is.
            let _ = self.save(before);
        })
    }

    /// Writes `recording.toml` and what follows from it.
    fn save(&mut self, recording: RecordingFile) -> Result<(), RecordingError> {
        let path = self.recording_path();
        let text = toml::to_string(&recording)
            .map_err(|error| RecordingError::content(&path, "file", error.to_string()))?;
        replace_file(&path, &(text + LAST_LINE))?;
        self.recording = recording;
        let takes = accepted_takes(&self.recording);
        if takes != self.session.file.takes || !self.session.dir.join("session.toml").is_file() {
            let before = std::mem::replace(&mut self.session.file.takes, takes);
            self.session.save().inspect_err(|_| self.session.file.takes = before)?;
        }
        Ok(())
    }

    fn path_of(&self, take: &RecordedTake) -> PathBuf {
        match take.state {
            TakeState::Recording => self.partial_path(&take.file),
            TakeState::Review | TakeState::Accepted => self.session.dir.join(&take.file),
            TakeState::Discarded => self.discarded_path(&take.file),
        }
    }

    fn recording_path(&self) -> PathBuf {
        self.session.dir.join(RECORDING_FILE)
    }

    fn partial_path(&self, file: &str) -> PathBuf {
        self.session.dir.join(format!("{file}{PARTIAL}"))
    }

    fn discarded_path(&self, file: &str) -> PathBuf {
        self.session.dir.join(DISCARDED).join(file)
    }
}

/// The accepted takes in the order of the plan, as `session.toml` lists them.
fn accepted_takes(recording: &RecordingFile) -> Vec<SessionTake> {
    let mut accepted: Vec<&RecordedTake> =
        recording.takes.iter().filter(|take| take.state == TakeState::Accepted).collect();
    accepted.sort_by_key(|take| take.step);
    let object = |take: &RecordedTake| recording.steps.get(take.step).map(|step| step.object.clone());
    accepted
        .into_iter()
        .map(|take| SessionTake {
            file: take.file.clone(),
            object: object(take).unwrap_or_default(),
            accepted: true,
        })
        .collect()
}

/// The number of a take that is set aside now: higher than that of every other.
fn next_set_aside(recording: &mut RecordingFile) -> u32 {
    let newest = |recording: &RecordingFile| {
        recording.takes.iter().map(|take| take.set_aside).max().unwrap_or_default()
    };
    if newest(recording) == u32::MAX {
        // Nobody sets so many takes aside; somebody wrote the number by hand. The order is what matters.
        let mut numbers: Vec<u32> = recording.takes.iter().map(|take| take.set_aside).collect();
        numbers.sort_unstable();
        numbers.dedup();
        for take in recording.takes.iter_mut().filter(|take| take.set_aside > 0) {
            let rank = numbers.iter().filter(|&&number| number > 0 && number <= take.set_aside).count();
            take.set_aside = u32::try_from(rank).unwrap_or(u32::MAX - 1);
        }
    }
    newest(recording).saturating_add(1)
}

/// Renames a file; what is at `to` already is never replaced.
fn move_file(from: &Path, to: &Path) -> Result<(), RecordingError> {
    // Only this process writes here, so that nothing can appear between the question and the answer.
    if to.symlink_metadata().is_ok() {
        let problem = format!("a file is there already; move it away, so that {from:?} can take its place");
        return Err(RecordingError::content(to, "file", problem));
    }
    fs::rename(from, to).map_err(RecordingError::io("rename", from))?;
    sync_folder(from);
    sync_folder(to);
    Ok(())
}

fn chain(error: &RecordingError) -> String {
    match std::error::Error::source(error) {
        Some(source) => format!("{error}: {source}"),
        None => error.to_string(),
    }
}

fn is_zero(count: &u32) -> bool {
    *count == 0
}

/// The session's file before anything is accepted.
fn new_session_file(station: &str, recorded: &str) -> SessionFile {
    SessionFile { format: 1, station: station.to_owned(), recorded: recorded.to_owned(), takes: Vec::new() }
}
