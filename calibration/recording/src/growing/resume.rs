//! Begins a session, or goes on with one: what a crash interrupted is finished first.

use std::{
    fs::{self, File, TryLockError},
    path::Path,
};

use super::{
    DISCARDED, GrowingSession, LOCK_FILE, PARTIAL, PlannedStep, RECORDING_FORMAT, RecordingFile, SessionPlan,
    TakeState, chain, move_file, new_session_file, next_set_aside, salvage::Listed,
};
use crate::{
    RecordingError, Session, close_partial, files,
    session::{RECORDING_FILE, check_file, folder_name},
};

/// Keeps every process from recording into a session's folder until it is dropped, e.g. while the folder is moved.
#[derive(Debug)]
pub struct SessionHold {
    /// `None` where nobody ever recorded.
    _lock: Option<File>,
}

impl GrowingSession {
    /// Begins the session at `dir` or goes on with it; the second value says in sentences what was found and mended.
    ///
    /// `station` is the station's id and `recorded` when the session begins (RFC 3339). Added steps of `plan` that the
    /// session does not have yet come behind its own. A session that follows another plan, belongs to another station, was
    /// not recorded step by step, or is open in another process is refused.
    pub fn open(
        dir: &Path,
        station: &str,
        plan: &SessionPlan,
        operator: &str,
        recorded: &str,
    ) -> Result<(Self, Vec<String>), RecordingError> {
        let recording_path = dir.join(RECORDING_FILE);
        if !recording_path.is_file() && !is_empty(dir)? {
            let problem = "is there already and was not recorded step by step, so it cannot be gone on with; choose another id";
            return Err(RecordingError::content(dir, "session", problem));
        }
        if dir.file_name().is_none() {
            return Err(RecordingError::content(
                dir,
                "session",
                "names no folder; give the folder to be made",
            ));
        }
        if plan.steps.is_empty() {
            let problem = format!("the plan {:?} has no steps; add takes to it", plan.plan);
            return Err(RecordingError::content(dir, "plan", problem));
        }
        fs::create_dir_all(dir).map_err(RecordingError::io("make", dir))?;
        let lock = lock(dir)?;
        let resumed = recording_path.is_file();
        let mut cut_off = None;
        let recording = if resumed {
            let listed = Listed::read(&recording_path)?;
            let is_cut_off = listed.is_cut_off(plan, dir)?;
            let mut recording = listed.recording;
            if is_cut_off {
                cut_off = Some(listed.bytes);
                recording.steps.clone_from(&plan.steps);
                recording.takes.retain(|take| take.step < plan.steps.len());
                if recording.plan.is_empty() {
                    recording.plan.clone_from(&plan.plan);
                }
            }
            check_plan(&recording_path, &recording, plan)?;
            recording.steps.clone_from(&plan.steps);
            recording
        } else {
            RecordingFile {
                format: RECORDING_FORMAT,
                plan: plan.plan.clone(),
                operator: operator.to_owned(),
                steps: plan.steps.clone(),
                takes: Vec::new(),
            }
        };
        // What is accepted follows from `recording.toml`; only station and time come from the session's own file.
        let file = if dir.join("session.toml").is_file() {
            Session::open(dir)?.file
        } else {
            new_session_file(station, recorded)
        };
        if file.station != station {
            let problem = format!(
                "{:?}, but this station is {station:?}; choose another id for the session",
                file.station
            );
            return Err(RecordingError::content(dir.join("session.toml"), "station", problem));
        }
        let session = Session { dir: dir.to_owned(), id: folder_name(dir), file };
        let mut growing = Self { session, recording, _lock: lock };
        let mut report = Vec::new();
        if resumed {
            if let Some(cut_off) = cut_off {
                growing.list_again(&cut_off, &mut report)?;
            }
            growing.separate_names(&mut report)?;
            growing.reconcile(&mut report)?;
        }
        let mut recording = growing.recording.clone();
        if !operator.is_empty() {
            operator.clone_into(&mut recording.operator);
        }
        growing.save(recording)?;
        check_file(&dir.join("session.toml"), &growing.session.file)?;
        Ok((growing, report))
    }

    /// The steps of the session at `dir`, those that were added included; `None` if none was begun there.
    pub fn steps_of(dir: &Path) -> Result<Option<Vec<PlannedStep>>, RecordingError> {
        let path = dir.join(RECORDING_FILE);
        if path.is_file() { Listed::read(&path).map(|listed| Some(listed.recording.steps)) } else { Ok(None) }
    }

    /// Holds the session at `dir`, whether it was recorded step by step or not; refused while a process records into it.
    pub fn hold(dir: &Path) -> Result<SessionHold, RecordingError> {
        let path = dir.join(LOCK_FILE);
        if path.symlink_metadata().is_err() {
            return Ok(SessionHold { _lock: None });
        }
        Ok(SessionHold { _lock: Some(lock(dir)?) })
    }

    /// Makes the folder what `recording.toml` says it is.
    fn reconcile(&mut self, report: &mut Vec<String>) -> Result<(), RecordingError> {
        let mut lost = Vec::new();
        for take_idx in 0..self.recording.takes.len() {
            let take = &self.recording.takes[take_idx];
            let (file, id) = (take.file.clone(), take.id().to_owned());
            let place = self.session.dir.join(&file);
            let (partial, discarded) = (self.partial_path(&file), self.discarded_path(&file));
            match take.state {
                TakeState::Recording if place.is_file() => {
                    report.push(format!("{id} is complete; it waits for a decision"));
                    self.recording.takes[take_idx].state = TakeState::Review;
                }
                TakeState::Recording if partial.is_file() => self.recover(take_idx, report)?,
                TakeState::Recording => match self.unlisted_recovered(&id) {
                    Some(recovered) => {
                        report.push(format!("{id} was recovered as {recovered}; it waits for a decision"));
                        self.put_recovered(take_idx, recovered, "what could be read of it is kept");
                    }
                    None => {
                        report.push(format!("{id} was begun, but nothing of it was written"));
                        lost.push(take_idx);
                    }
                },
                TakeState::Review | TakeState::Accepted if place.is_file() => {}
                TakeState::Review | TakeState::Accepted if discarded.is_file() => {
                    report.push(format!("{id} was about to be moved; it is back in its place"));
                    move_file(&discarded, &place)?;
                }
                TakeState::Review | TakeState::Accepted => {
                    report.push(format!(
                        "{id} is gone: {} is not there any more; record it again",
                        place.display()
                    ));
                    lost.push(take_idx);
                }
                TakeState::Discarded if discarded.is_file() => {}
                TakeState::Discarded => {
                    let from = [place, partial].into_iter().find(|path| path.is_file());
                    // If it is nowhere, somebody tidied up; the entry keeps the name from being used again.
                    if let Some(from) = from {
                        self.make_discarded()?;
                        move_file(&from, &discarded)?;
                        report.push(format!("{id} was about to be set aside; now it is"));
                    }
                }
            }
        }
        for take_idx in lost.into_iter().rev() {
            self.recording.takes.remove(take_idx);
        }
        self.sweep_partials(report)
    }

    /// A take whose recording ended with the process.
    fn recover(&mut self, take_idx: usize, report: &mut Vec<String>) -> Result<(), RecordingError> {
        let take = &self.recording.takes[take_idx];
        let (file, id) = (take.file.clone(), take.id().to_owned());
        let partial = self.partial_path(&file);
        match close_partial(&partial) {
            Ok(closed) => {
                let recovered = self.recovered_name(&id);
                move_file(&partial, &self.session.dir.join(&recovered))?;
                let seconds = closed.take.duration_s();
                let damage = closed.damage.unwrap_or_else(|| "the file is whole".to_owned());
                report.push(format!(
                    "{id} was being recorded when the program ended; {seconds:.1} s of it are kept as {recovered}, \
                     which waits for a decision ({damage})"
                ));
                self.put_recovered(take_idx, recovered, &format!("{seconds:.1} s are kept"));
            }
            Err(error) => {
                self.make_discarded()?;
                move_file(&partial, &self.discarded_path(&file))?;
                report.push(format!(
                    "{id} was being recorded when the program ended, and no take can be made of it; the file is in \
                     {DISCARDED}/{file} ({})",
                    chain(&error)
                ));
                let set_aside = next_set_aside(&mut self.recording);
                let take = &mut self.recording.takes[take_idx];
                take.state = TakeState::Discarded;
                take.set_aside = set_aside;
                take.readable = Some(false);
                take.broken_off = "the program ended before anything could be kept".to_owned();
            }
        }
        Ok(())
    }

    fn put_recovered(&mut self, take_idx: usize, file: String, kept: &str) {
        let take = &mut self.recording.takes[take_idx];
        take.file = file;
        take.state = TakeState::Review;
        take.broken_off = format!("the program ended while it was recorded; {kept}");
    }

    /// Moves partial takes that the list does not know to the folder `discarded`.
    fn sweep_partials(&mut self, report: &mut Vec<String>) -> Result<(), RecordingError> {
        let dir = self.session.dir.clone();
        let entries = fs::read_dir(&dir).map_err(RecordingError::io("list", &dir))?;
        let mut strays: Vec<String> = entries
            .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
            .filter(|name| name.starts_with("take-") && name.ends_with(PARTIAL))
            .collect();
        strays.sort();
        for name in strays {
            self.make_discarded()?;
            let names =
                std::iter::once(name.clone()).chain((2_u64..).map(|number| format!("{name}-{number}")));
            let free = names.into_iter().find(|name| self.discarded_path(name).symlink_metadata().is_err());
            move_file(&dir.join(&name), &self.discarded_path(&free.unwrap_or_default()))?;
            report.push(format!("{name} belongs to no take of this session; it is in {DISCARDED} now"));
        }
        Ok(())
    }

    pub(super) fn make_discarded(&self) -> Result<(), RecordingError> {
        let discarded = self.session.dir.join(DISCARDED);
        fs::create_dir_all(&discarded).map_err(RecordingError::io("make", &discarded))
    }
}

fn lock(dir: &Path) -> Result<File, RecordingError> {
    let path = dir.join(LOCK_FILE);
    if path.symlink_metadata().is_ok() {
        // Opening a named pipe for writing would wait for its reader.
        files::open_file(&path)?;
    }
    let file = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(&path)
        .map_err(RecordingError::io("make", &path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => {
            let problem = "is being recorded by another process; end that one, or choose another id";
            Err(RecordingError::content(dir, "session", problem))
        }
        Err(TryLockError::Error(source)) => Err(RecordingError::io("lock", &path)(source)),
    }
}

/// Whether nothing is at `dir`, or only what beginning a session leaves if it is interrupted at once.
fn is_empty(dir: &Path) -> Result<bool, RecordingError> {
    let entries = match fs::read_dir(dir) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(true),
        Err(error) => return Err(RecordingError::io("list", dir)(error)),
    };
    Ok(entries.filter_map(Result::ok).all(|entry| entry.file_name().to_string_lossy().starts_with('.')))
}

fn check_plan(path: &Path, recording: &RecordingFile, plan: &SessionPlan) -> Result<(), RecordingError> {
    if recording.plan != plan.plan {
        let problem = format!(
            "the session follows {:?}, not {:?}; go on with that plan, or choose another id",
            recording.plan, plan.plan
        );
        return Err(RecordingError::content(path, "plan", problem));
    }
    let added_since = |step: usize| {
        recording.steps.get(step).is_none()
            && (recording.steps.is_empty()
                || plan.steps.get(step).is_some_and(|step| step.added_because.is_some()))
    };
    let changed = (0..recording.steps.len().max(plan.steps.len()))
        .find(|&step| recording.steps.get(step) != plan.steps.get(step) && !added_since(step));
    if let Some(step) = changed {
        let problem =
            "the plan was changed since the session was begun; choose another id, or change the plan back";
        return Err(RecordingError::content(path, format!("step {}", step + 1), problem));
    }
    Ok(())
}
