//! What a rollout of a campaign has begun, ended and told, in a file that outlives its process.
//!
//! A line is on disk before what it announces is done, so that a process that goes on later neither makes a trial twice nor
//! loses what one came to.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use palpate_wire::api::RolloutOutcome;
use serde::{Deserialize, Serialize};

/// Its name in the folder of the records.
const FILE: &str = "campaign.jsonl";

/// A line of the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Line {
    /// The first: whose trials are made here.
    Campaign { campaign: String, created: String },
    /// The studio is going to be told that the trial begins.
    Begins { trial: u32, attempt: u32 },
    /// The policy is going to move the hand.
    Moves { trial: u32, attempt: u32 },
    /// What it came to; the studio is going to be told.
    Ended { trial: u32, attempt: u32, outcome: RolloutOutcome },
    /// The studio was told.
    Told { trial: u32, attempt: u32 },
}

/// How far an attempt of a trial has come.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Stage {
    /// The studio may know that it has begun; nothing has moved.
    Begins,
    /// The policy has moved the hand.
    Moves,
    /// It is over; the studio may know.
    Ended(RolloutOutcome),
    /// The studio knows all of it.
    Told,
}

/// The file, open for adding, and what it says.
pub(crate) struct Journal {
    path: PathBuf,
    file: File,
    stages: BTreeMap<(u32, u32), Stage>,
}

impl Journal {
    /// The journal in `folder` of the campaign with this id, made at this time.
    ///
    /// # Errors
    /// A folder that holds anything else, another campaign's journal, or one that another process writes.
    pub(crate) fn open(folder: &Path, campaign: &str, created: &str) -> anyhow::Result<Self> {
        let path = folder.join(FILE);
        let is_empty = std::fs::read_dir(folder).map_or(true, |mut entries| entries.next().is_none());
        if !is_empty && !path.is_file() {
            bail!(
                "--out is {folder:?}, which is not empty and holds no trials of a campaign; records are never written over"
            );
        }
        std::fs::create_dir_all(folder).with_context(|| format!("failed to make the folder {folder:?}"))?;
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
        let mut file = file.with_context(|| format!("failed to open {path:?}"))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => bail!("another rollout makes trials into {folder:?}"),
            Err(TryLockError::Error(err)) => {
                return Err(err).with_context(|| format!("failed to lock {path:?}"));
            }
        }
        let mut text = String::new();
        file.read_to_string(&mut text).with_context(|| format!("failed to read {path:?}"))?;
        // Half a line is what a power cut left of something that was not done yet.
        let len = text.rfind('\n').map_or(0, |end| end + 1);
        file.set_len(len as u64)?;
        file.seek(SeekFrom::End(0))?;
        let lines = text.get(..len).unwrap_or_default().lines().zip(1..).map(|(line, number)| {
            serde_json::from_str(line).with_context(|| format!("{path:?}: line {number} makes no sense"))
        });
        let lines: Vec<Line> = lines.collect::<anyhow::Result<_>>()?;
        let mut journal = Self { path, file, stages: BTreeMap::new() };
        match lines.first() {
            None => {
                let (campaign, created) = (campaign.to_owned(), created.to_owned());
                journal.add(Line::Campaign { campaign, created })?;
            }
            Some(Line::Campaign { campaign: of, created: at }) if of == campaign && at == created => {}
            Some(Line::Campaign { campaign: of, created: at }) => bail!(
                "--out is {folder:?}, which holds trials of the campaign {of:?} made at {at}, not of {campaign:?} made at {created}"
            ),
            Some(_) => bail!("{:?}: line 1 names no campaign", journal.path),
        }
        lines.into_iter().for_each(|line| journal.apply(line));
        Ok(journal)
    }

    fn apply(&mut self, line: Line) {
        let (key, stage) = match line {
            Line::Campaign { .. } => return,
            Line::Begins { trial, attempt } => ((trial, attempt), Stage::Begins),
            Line::Moves { trial, attempt } => ((trial, attempt), Stage::Moves),
            Line::Ended { trial, attempt, outcome } => ((trial, attempt), Stage::Ended(outcome)),
            Line::Told { trial, attempt } => ((trial, attempt), Stage::Told),
        };
        self.stages.insert(key, stage);
    }

    fn add(&mut self, line: Line) -> anyhow::Result<()> {
        let text = serde_json::to_string(&line)? + "\n";
        let done = self.file.write_all(text.as_bytes()).and_then(|()| self.file.sync_data());
        done.with_context(|| format!("failed to write {:?}", self.path))?;
        self.apply(line);
        Ok(())
    }

    /// How far attempt `attempt` of `trial` has come, if it was begun here.
    pub(crate) fn stage(&self, trial: u32, attempt: u32) -> Option<&Stage> {
        self.stages.get(&(trial, attempt))
    }

    /// Attempts that have moved the hand and that the studio may not know the end of: what each came to, if that is known.
    pub(crate) fn untold(&self) -> Vec<((u32, u32), Option<RolloutOutcome>)> {
        let untold = self.stages.iter().filter_map(|(key, stage)| match stage {
            Stage::Moves => Some((*key, None)),
            Stage::Ended(outcome) => Some((*key, Some(outcome.clone()))),
            Stage::Begins | Stage::Told => None,
        });
        untold.collect()
    }

    pub(crate) fn begins(&mut self, trial: u32, attempt: u32) -> anyhow::Result<()> {
        self.add(Line::Begins { trial, attempt })
    }

    pub(crate) fn moves(&mut self, trial: u32, attempt: u32) -> anyhow::Result<()> {
        self.add(Line::Moves { trial, attempt })
    }

    pub(crate) fn ended(&mut self, trial: u32, attempt: u32, outcome: RolloutOutcome) -> anyhow::Result<()> {
        self.add(Line::Ended { trial, attempt, outcome })
    }

    pub(crate) fn told(&mut self, trial: u32, attempt: u32) -> anyhow::Result<()> {
        self.add(Line::Told { trial, attempt })
    }
}

#[cfg(test)]
mod tests {
    use palpate_wire::api::TrialVerdict;

    use super::*;

    const CREATED: &str = "2026-11-25T09:00:00.000Z";

    fn outcome() -> RolloutOutcome {
        RolloutOutcome {
            suggested: Some(TrialVerdict::Slip),
            reasons: vec!["lost at 12 mm".to_owned()],
            time_to_grasp_s: Some(3.25),
            held_s: Some(0.1),
            take: None,
            record: Some("trial-0001-0.jsonl".to_owned()),
        }
    }

    #[test]
    fn what_was_begun_ended_and_told_outlives_the_process() {
        let folder = tempfile::tempdir().expect("a folder");
        let open = || Journal::open(folder.path(), "first", CREATED);
        let mut journal = open().expect("a new one");
        journal.begins(1, 0).expect("a line");
        journal.begins(2, 0).expect("a line");
        journal.moves(2, 0).expect("a line");
        journal.begins(3, 1).expect("a line");
        journal.moves(3, 1).expect("a line");
        journal.ended(3, 1, outcome()).expect("a line");
        journal.ended(4, 0, outcome()).expect("a line");
        journal.told(4, 0).expect("a line");
        let busy = open().err().expect("it is in use");
        assert!(busy.to_string().contains("another rollout"), "{busy}");
        drop(journal);

        // Half a line of a power cut is left out, and overwritten.
        let path = folder.path().join(FILE);
        let mut file = OpenOptions::new().append(true).open(&path).expect("the file");
        file.write_all(b"{\"kind\":\"told\",\"tri").expect("half a line");
        let mut journal = open().expect("it goes on");
        assert_eq!(journal.stage(1, 0), Some(&Stage::Begins));
        assert_eq!(journal.stage(1, 1), None);
        assert_eq!(journal.untold(), [((2, 0), None), ((3, 1), Some(outcome()))]);
        journal.told(3, 1).expect("a line");
        drop(journal);
        assert_eq!(open().expect("it goes on").untold(), [((2, 0), None)]);
    }

    #[test]
    fn folders_of_anything_else_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let refused = |campaign: &str, created: &str| {
            let err = Journal::open(folder.path(), campaign, created).err().expect("a refusal");
            format!("{err:#}")
        };
        drop(Journal::open(folder.path(), "first", CREATED).expect("a new one"));
        assert!(refused("second", CREATED).contains("of the campaign \"first\""));
        assert!(refused("first", "2027").contains("not of \"first\" made at 2027"));
        std::fs::write(folder.path().join(FILE), "{\"kind\":\"dances\"}\n").expect("a file");
        assert!(refused("first", CREATED).contains("line 1 makes no sense"));
        std::fs::remove_file(folder.path().join(FILE)).expect("it goes");
        std::fs::write(folder.path().join("trial-0000.jsonl"), "").expect("a file");
        assert!(refused("first", CREATED).contains("holds no trials of a campaign"));
    }
}
