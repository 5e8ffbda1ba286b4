//! Names of takes: each of a session has its own.

use std::path::PathBuf;

use super::{GrowingSession, RecordedTake, TakeState, move_file};
use crate::RecordingError;

impl GrowingSession {
    /// A name for a new take of a step, that no take of this session has and no file lies under.
    pub(super) fn free_name(&self, step_idx: usize) -> String {
        self.unused(numbered(format!("take-{:02}", step_idx + 1)))
    }

    /// A name for what was recovered of the take called `id`.
    pub(super) fn recovered_name(&self, id: &str) -> String {
        self.unused(numbered(format!("{id}-recovered")))
    }

    /// A recovered take called `id` that lies in its place though no list knows it: what a crash leaves that comes
    /// between moving the file and writing that down.
    pub(super) fn unlisted_recovered(&self, id: &str) -> Option<String> {
        // Recovering takes the first free number, so that there is no gap before it but by deleted files.
        let mut names = numbered(format!("{id}-recovered")).take(self.recording.takes.len() + 2);
        names.find(|name| !self.is_listed(name) && self.session.dir.join(name).is_file())
    }

    /// Gives every take of a list that has a name twice a name of its own, and moves its file. An earlier version of
    /// this program wrote such lists when a step was recovered twice.
    pub(super) fn separate_names(&mut self, report: &mut Vec<String>) -> Result<(), RecordingError> {
        for take_idx in 1..self.recording.takes.len() {
            let take = &self.recording.takes[take_idx];
            let before = &self.recording.takes[..take_idx];
            let Some(first) = before.iter().find(|other| other.file == take.file) else { continue };
            let (old, id) = (self.path_of(take), take.id().to_owned());
            // Both say that they lie in the same place: there is one file, and the first take has it.
            let has_file = self.path_of(first) != old && old.is_file();
            let stem = id.trim_end_matches(|c: char| c.is_ascii_digit()).trim_end_matches('-');
            let stem = if stem.ends_with("-recovered") { stem } else { &id };
            let name = if has_file {
                self.unused(numbered(stem.to_owned()))
            } else {
                // Moved already, if a crash came before that was written down.
                let moved = numbered(stem.to_owned()).take(before.len() + 2).find(|name| {
                    !self.is_listed(name)
                        && self.path_of(&RecordedTake { file: name.clone(), ..take.clone() }).is_file()
                });
                moved.unwrap_or_else(|| self.unused(numbered(stem.to_owned())))
            };
            let take = &mut self.recording.takes[take_idx];
            take.file.clone_from(&name);
            // It was checked by a name that meant another take.
            take.verdict = None;
            take.readable = take.readable.filter(|_| take.state == TakeState::Discarded);
            let new = self.path_of(&self.recording.takes[take_idx]);
            if has_file {
                move_file(&old, &new)?;
            }
            report.push(format!(
                "{id} was listed twice; the later one of step {} is called {} now and is checked again",
                self.recording.takes[take_idx].step + 1,
                self.recording.takes[take_idx].id()
            ));
        }
        Ok(())
    }

    fn unused(&self, mut names: impl Iterator<Item = String>) -> String {
        let is_free = |name: &String| {
            let paths: [PathBuf; 3] =
                [self.session.dir.join(name), self.partial_path(name), self.discarded_path(name)];
            !self.is_listed(name) && paths.iter().all(|path| path.symlink_metadata().is_err())
        };
        names.find(is_free).unwrap_or_default()
    }

    fn is_listed(&self, name: &str) -> bool {
        self.recording.takes.iter().any(|take| take.file == *name)
    }
}

/// `stem.mcap`, `stem-2.mcap`, `stem-3.mcap` and so on.
fn numbered(stem: String) -> impl Iterator<Item = String> {
    let first = format!("{stem}.mcap");
    std::iter::once(first).chain((2_u64..).map(move |number| format!("{stem}-{number}.mcap")))
}
