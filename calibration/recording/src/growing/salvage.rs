//! Reads `recording.toml`, and makes the list again from the takes that are there where it was cut off.

use std::{fs, path::Path};

use serde::Deserialize;

use super::{
    DISCARDED, GrowingSession, LAST_LINE, PARTIAL, RECORDING_FORMAT, RecordedTake, RecordingFile,
    SessionPlan, TakeState, next_set_aside,
};
use crate::{
    RecordingError, Take,
    files::{MAX_TEXT_BYTES, read_file, resolve_in},
};

/// What `recording.toml` says.
pub(super) struct Listed {
    /// As far as it can be read. The plan's id is empty if that is missing too.
    pub(super) recording: RecordingFile,
    /// Its bytes.
    pub(super) bytes: Vec<u8>,
    cut_off: bool,
    /// Whether the line that ends the list is there. Lists of earlier versions have none.
    ended: bool,
}

/// The lines above the steps.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Head {
    format: Option<u32>,
    plan: Option<String>,
    #[serde(default)]
    operator: String,
}

impl Listed {
    /// Reads the file at `path`. A file that was cut off is read as far as it goes; one that was edited wrongly is refused,
    /// so that nothing of it gets lost.
    pub(super) fn read(path: &Path) -> Result<Self, RecordingError> {
        resolve_in(path.parent().unwrap_or(Path::new("")), path)?;
        let bytes = read_file(path, MAX_TEXT_BYTES)?;
        let text = match std::str::from_utf8(&bytes) {
            Ok(text) => text,
            // Cut off within a character.
            Err(error) if error.error_len().is_none() => {
                std::str::from_utf8(&bytes[..error.valid_up_to()]).unwrap_or_default()
            }
            Err(error) => {
                let place = format!("byte {}", error.valid_up_to());
                return Err(RecordingError::content(path, place, "is not UTF-8, expected a text file"));
            }
        };
        let ended = text.ends_with(LAST_LINE);
        let (recording, cut_off) = match toml::from_str::<RecordingFile>(text) {
            Ok(recording) => (recording, false),
            Err(error) => match readable_part(text).filter(|_| !ended) {
                Some(part) => (part, true),
                None => return Err(RecordingError::toml(path, text)(error)),
            },
        };
        check(path, &recording)?;
        Ok(Self { recording, bytes, cut_off, ended })
    }

    /// Whether the end of the list is missing, judged by the plan that it should follow and by the takes in `dir`.
    pub(super) fn is_cut_off(&self, plan: &SessionPlan, dir: &Path) -> Result<bool, RecordingError> {
        let Self { recording, cut_off, ended, .. } = self;
        if *cut_off || *ended {
            return Ok(*cut_off);
        }
        let lacks_steps = recording.takes.is_empty()
            && recording.steps.len() < plan.steps.len()
            && plan.steps.starts_with(&recording.steps);
        let lacks_takes = || -> Result<bool, RecordingError> {
            let names = take_files(dir)?;
            Ok(names.iter().any(|name| {
                let file = name.strip_suffix(PARTIAL).unwrap_or(name);
                // A recovered take that was moved before that was written down belongs to a take of the list.
                let stem = file.split("-recovered").next().unwrap_or_default();
                !recording.takes.iter().any(|take| take.file == file || take.id() == stem)
            }))
        };
        Ok(lacks_steps || lacks_takes()?)
    }
}

impl GrowingSession {
    /// Puts the takes that are in the folder and not in the list into the list, and keeps the `cut_off` file.
    pub(super) fn list_again(
        &mut self,
        cut_off: &[u8],
        report: &mut Vec<String>,
    ) -> Result<(), RecordingError> {
        self.make_discarded()?;
        let discarded = self.session.dir.join(DISCARDED);
        let kept = (1_u64..).map(|number| format!("recording.toml.cut-off-{number}"));
        let kept = kept.into_iter().find(|name| discarded.join(name).symlink_metadata().is_err());
        let kept = kept.unwrap_or_default();
        let path = discarded.join(&kept);
        fs::write(&path, cut_off).map_err(RecordingError::io("write", &path))?;
        report.push(format!(
            "recording.toml was cut off, so the list was made again from the takes that are here; remarks and checks \
             may be missing; the old file is {DISCARDED}/{kept}"
        ));
        for (dir, found) in [(self.session.dir.clone(), TakeState::Review), (discarded, TakeState::Discarded)]
        {
            for name in take_files(&dir)? {
                self.list(&dir, &name, found, report);
            }
        }
        Ok(())
    }

    fn list(&mut self, dir: &Path, name: &str, found: TakeState, report: &mut Vec<String>) {
        let (file, mut state) = match (name.strip_suffix(PARTIAL), found) {
            (Some(file), TakeState::Review) => (file, TakeState::Recording),
            // Somebody else's, swept there before.
            (Some(_), _) => return,
            (None, found) => (name, found),
        };
        if self.recording.takes.iter().any(|take| take.file == file) {
            return;
        }
        let read = (state != TakeState::Recording).then(|| Take::read(&dir.join(name)));
        let Some(step) = self.step_of(file, read.as_ref().and_then(|read| read.as_ref().ok())) else {
            report.push(format!("{file} belongs to no step of the plan; it stays where it is"));
            return;
        };
        let is_taken =
            self.recording.takes.iter().any(|take| take.step == step && take.state == TakeState::Accepted);
        let was_accepted = self.session.file.takes.iter().any(|take| take.file == file && take.accepted);
        if state == TakeState::Review && was_accepted && !is_taken {
            state = TakeState::Accepted;
        }
        let set_aside = if state == TakeState::Discarded { next_set_aside(&mut self.recording) } else { 0 };
        self.recording.takes.push(RecordedTake {
            file: file.to_owned(),
            step,
            state,
            broken_off: String::new(),
            readable: read.filter(|_| state == TakeState::Discarded).map(|read| read.is_ok()),
            set_aside,
            notes: Vec::new(),
            verdict: None,
        });
    }

    /// The step of a take: what its name says, unless the take itself says that it is about another object or motion.
    fn step_of(&self, file: &str, take: Option<&Take>) -> Option<usize> {
        let digits: String = file.strip_prefix("take-")?.chars().take_while(char::is_ascii_digit).collect();
        let named = digits.parse::<usize>().ok().and_then(|number| number.checked_sub(1));
        let named = named.filter(|&step| step < self.recording.steps.len());
        let Some(meta) = take.map(|take| &take.meta) else { return named };
        let fits = |step: usize| {
            let step = &self.recording.steps[step];
            step.object == meta.object && step.primitive == meta.primitive
        };
        named.filter(|&step| fits(step)).or_else(|| (0..self.recording.steps.len()).find(|&step| fits(step)))
    }
}

/// Names of the files in `dir` that look like takes of a growing session, in order.
fn take_files(dir: &Path) -> Result<Vec<String>, RecordingError> {
    let entries = fs::read_dir(dir).map_err(RecordingError::io("list", dir))?;
    let mut names: Vec<String> = entries
        .filter_map(|entry| entry.ok().filter(|entry| entry.path().is_file())?.file_name().into_string().ok())
        .filter(|name| {
            let file = name.strip_suffix(PARTIAL).unwrap_or(name);
            file.starts_with("take-") && file.ends_with(".mcap")
        })
        .collect();
    names.sort();
    Ok(names)
}

/// What stands before the last table of a text that was cut off; `None` if more than that is wrong with it.
fn readable_part(text: &str) -> Option<RecordingFile> {
    if let Some(last_table) = text.rfind("\n[[") {
        return toml::from_str(&text[..=last_table]).ok();
    }
    let whole_lines = text.rfind('\n').map_or("", |end| &text[..=end]);
    let head: Head = toml::from_str(whole_lines).ok()?;
    // With a whole head, it is something else that is wrong.
    if whole_lines.len() == text.len() && head.plan.is_some() {
        return None;
    }
    Some(RecordingFile {
        format: head.format.unwrap_or(RECORDING_FORMAT),
        plan: head.plan.unwrap_or_default(),
        operator: head.operator,
        steps: Vec::new(),
        takes: Vec::new(),
    })
}

fn check(path: &Path, recording: &RecordingFile) -> Result<(), RecordingError> {
    if recording.format != RECORDING_FORMAT {
        let problem = format!(
            "{}, expected {RECORDING_FORMAT}; go on with the palpate that wrote it",
            recording.format
        );
        return Err(RecordingError::content(path, "format", problem));
    }
    for (take_idx, take) in recording.takes.iter().enumerate() {
        let place = format!("take {}", take_idx + 1);
        if Path::new(&take.file).file_name().is_none_or(|name| name != take.file.as_str())
            || !take.file.ends_with(".mcap")
        {
            let problem =
                format!("file {:?} must be the name of an .mcap file in the session's folder", take.file);
            return Err(RecordingError::content(path, place, problem));
        }
        if take.step >= recording.steps.len() {
            let problem = format!("step {} of a plan with {} steps", take.step, recording.steps.len());
            return Err(RecordingError::content(path, place, problem));
        }
    }
    Ok(())
}
