//! Reads the records of a rollout again.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use palpate_wire::api::TrialVerdict;
use serde::Deserialize;

use crate::task::Source;

/// How a trial began, as far as somebody knows.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct KnownStart {
    /// Seed of the starts.
    pub seed: Option<u64>,
    /// Number of the start.
    pub trial: Option<u64>,
    /// Half the edge length of the square that objects start in, cm; `None` is that of the world file.
    pub start_cm: Option<f64>,
    /// x y z (m), then w x y z, in the base's frame, when the object lay there.
    pub object_pose: Option<[f64; 7]>,
    /// In a campaign: where its plan has the object, from the middle of the region, m.
    pub offset_m: Option<[f64; 2]>,
    /// In a campaign: how far its plan has the object turned, rad.
    pub yaw_rad: Option<f64>,
    /// In a campaign: on which of its sides its plan has the object, from 0 to 1.
    pub side: Option<f64>,
}

/// The first line of a record.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Head {
    /// Number of the trial.
    pub trial: u64,
    /// Id of the object.
    pub object: String,
    /// File of what moved the hand.
    pub policy: String,
    /// It was told that it feels nothing.
    #[serde(default)]
    pub is_silenced: bool,
    /// `None` where a person placed the object.
    pub start: Option<KnownStart>,
    /// Id of the station.
    pub station: String,
    /// Files that were read.
    pub files: Vec<Source>,
    /// Steps per second.
    pub control_rate_hz: f64,
    /// Names of the joints, in the station's order.
    pub joints: Vec<String>,
    /// Ids of the channels, in the layout's order.
    pub channels: Vec<String>,
    /// Where joints were told to be when it began, rad or m.
    pub begins_at: Vec<f64>,
}

/// A step of the policy.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct StepLine {
    /// Since the trial began, in steps of the control rate, s.
    pub time_s: f64,
    /// Joint positions that it acted on, rad or m.
    pub positions: Vec<f64>,
    /// Channels that were on in what it acted on.
    pub active: Vec<usize>,
}

/// What the stream said.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct FrameLine {
    /// When it came in, since the trial began, s.
    pub at_s: f64,
    /// What the safety layer commanded, rad or m; empty without torque.
    pub let_through: Vec<f64>,
}

/// What a trial came to.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct OutcomeLine {
    /// What the robot took it for.
    pub suggested: TrialVerdict,
    /// What the operator of an emulated station saw.
    pub truth: Option<SeenByOperator>,
}

/// What the operator of an emulated station saw.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct SeenByOperator {
    /// How the grasp world would count it; `None` where the operator did not answer.
    pub verdict: Option<TrialVerdict>,
}

/// The record of a trial.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// Its file.
    pub path: PathBuf,
    /// What it was.
    pub head: Head,
    /// Steps, in order.
    pub steps: Vec<StepLine>,
    /// Frames, in order.
    pub frames: Vec<FrameLine>,
    /// `None` where the process was killed before the trial ended.
    pub outcome: Option<OutcomeLine>,
}

#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Line {
    Trial { trial: Box<Head> },
    Step(StepLine),
    Frame(FrameLine),
    Answer {},
    Outcome { outcome: OutcomeLine },
}

/// The records in a rollout's folder, by number of the trial.
///
/// # Errors
/// A folder without records, and a record that is none, with its line.
pub fn folder(dir: &Path) -> anyhow::Result<Vec<Recorded>> {
    let entries = std::fs::read_dir(dir).with_context(|| format!("failed to read the folder {dir:?}"))?;
    let is_record = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        name.starts_with("trial-") && name.ends_with(".jsonl")
    };
    let mut paths: Vec<PathBuf> =
        entries.filter_map(|entry| Some(entry.ok()?.path())).filter(is_record).collect();
    paths.sort();
    if paths.is_empty() {
        bail!("{dir:?} holds no record of a trial (trial-0000.jsonl); expected the --out of a rollout");
    }
    let mut records = paths.iter().map(|path| record(path)).collect::<anyhow::Result<Vec<_>>>()?;
    records.sort_by_key(|record| record.head.trial);
    Ok(records)
}

/// The record of one trial.
///
/// # Errors
/// A file that cannot be read or is no record, with the line.
pub fn record(path: &Path) -> anyhow::Result<Recorded> {
    let text = std::fs::read_to_string(path).with_context(|| format!("failed to read {path:?}"))?;
    parse(path, &text).with_context(|| format!("{} is no record of a trial", path.display()))
}

fn parse(path: &Path, text: &str) -> anyhow::Result<Recorded> {
    let mut lines = text.split_inclusive('\n').enumerate();
    let (_, first) = lines.next().context("it is empty")?;
    let Line::Trial { trial: head } = serde_json::from_str(first).context("line 1")? else {
        bail!("line 1 is none of the kind \"trial\"");
    };
    check_head(&head).context("line 1")?;
    let (mut steps, mut frames, mut outcome) = (Vec::new(), Vec::new(), None);
    for (idx, line) in lines {
        let parsed = serde_json::from_str(line);
        if parsed.is_err() && !line.ends_with('\n') {
            // Whoever wrote it was killed in the middle of the last line.
            break;
        }
        let number = idx + 1;
        match parsed.with_context(|| format!("line {number}"))? {
            Line::Trial { .. } => bail!("line {number} begins another trial"),
            Line::Step(step) => {
                check_step(&head, &step, steps.last()).with_context(|| format!("line {number}"))?;
                steps.push(step);
            }
            Line::Frame(frame) => {
                let (found, expected) = (frame.let_through.len(), head.joints.len());
                if found != 0 && found != expected {
                    bail!(
                        "line {number}: let_through has {found} numbers, expected one per joint, {expected}"
                    );
                }
                if !frame.at_s.is_finite() {
                    bail!("line {number}: at_s is {}", frame.at_s);
                }
                frames.push(frame);
            }
            Line::Answer {} => (),
            Line::Outcome { outcome: ended } => outcome = Some(ended),
        }
    }
    Ok(Recorded { path: path.to_owned(), head: *head, steps, frames, outcome })
}

fn check_head(head: &Head) -> anyhow::Result<()> {
    if !(head.control_rate_hz.is_finite() && head.control_rate_hz > 0.0) {
        bail!("control_rate_hz is {}, expected a positive number", head.control_rate_hz);
    }
    if head.begins_at.len() != head.joints.len() {
        bail!(
            "begins_at has {} numbers, expected one per joint, {}",
            head.begins_at.len(),
            head.joints.len()
        );
    }
    Ok(())
}

fn check_step(head: &Head, step: &StepLine, before: Option<&StepLine>) -> anyhow::Result<()> {
    if step.positions.len() != head.joints.len() {
        bail!(
            "positions has {} numbers, expected one per joint, {}",
            step.positions.len(),
            head.joints.len()
        );
    }
    if let Some(channel) = step.active.iter().find(|channel| **channel >= head.channels.len()) {
        bail!("active names channel {channel}, expected less than {}", head.channels.len());
    }
    let before_s = before.map_or(f64::NEG_INFINITY, |before| before.time_s);
    if !(step.time_s >= 0.0 && step.time_s > before_s) {
        bail!("time_s is {}, expected more than in the step before", step.time_s);
    }
    Ok(())
}

impl Recorded {
    /// Touch at each control step, `[step * num_channels + channel]`; steps that were left out keep what was felt before.
    pub fn active_by_step(&self) -> Vec<bool> {
        let num_channels = self.head.channels.len();
        let mut active = Vec::new();
        let mut before = vec![false; num_channels];
        for step in &self.steps {
            let idx = (step.time_s * self.head.control_rate_hz).round() as usize;
            while active.len() < idx * num_channels {
                active.extend_from_slice(&before);
            }
            before.fill(false);
            for &channel in &step.active {
                before[channel] = true;
            }
            active.extend_from_slice(&before);
        }
        active
    }

    /// What the safety layer commanded in each control step: the newest that was heard of by its end. It ends with the steps, or
    /// where torque went off before.
    pub fn commands_by_step(&self) -> Vec<Vec<f64>> {
        let mut frames = self.frames.iter().peekable();
        let mut now = self.head.begins_at.clone();
        let num_steps = self
            .steps
            .last()
            .map_or(0, |step| (step.time_s * self.head.control_rate_hz).round() as usize + 1);
        let mut commands = Vec::with_capacity(num_steps);
        for idx in 0..num_steps {
            let end_s = (idx + 1) as f64 / self.head.control_rate_hz;
            while let Some(frame) = frames.next_if(|frame| frame.at_s <= end_s) {
                if frame.let_through.is_empty() {
                    return commands;
                }
                now.clone_from(&frame.let_through);
            }
            commands.push(now.clone());
        }
        commands
    }
}

#[cfg(test)]
mod tests;
