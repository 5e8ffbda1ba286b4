//! What trials came to, and the file that keeps it.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use palpate_wire::api::TrialVerdict;
use serde::Serialize;
use serde_json::Value;

use crate::take::Recorded;

/// What a trial came to: a line of `outcomes.jsonl`. `docs/rollouts.md` explains the fields; they stay.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// Its campaign; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub campaign: Option<String>,
    /// Its number; in a campaign, that of its plan.
    pub trial: u64,
    /// Which try of the campaign's trial it is, from 0; absent without a campaign.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attempt: Option<u32>,
    /// Id of the object.
    pub object: String,
    /// What moved the hand.
    pub policy: String,
    /// The policy was told that it feels nothing.
    pub is_silenced: bool,
    /// How the trial began: what the object's place was made of, and where it was; `null` where a person placed the
    /// object outside a campaign.
    pub start: Value,
    /// What the robot itself takes it for.
    pub suggested: TrialVerdict,
    /// Why.
    pub reasons: Vec<String>,
    /// When enough digits were first stopped on something, s.
    pub time_to_grasp_s: Option<f64>,
    /// For how long something was held in the air, s.
    pub held_s: f64,
    /// The record of the trial.
    pub take: String,
    /// The take of the studio that it became; absent without `--record`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recorded: Option<Recorded>,
    /// What the emulated station's operator saw; `null` where nobody looks.
    pub truth: Value,
    /// Steps of the policy, those whose targets came after the next was due, and those left out because of that.
    pub steps: u64,
    /// See `steps`.
    pub deadline_misses: u64,
    /// See `steps`.
    pub skipped_steps: u64,
    /// Targets that the safety layer refused.
    pub refused: u64,
    /// Time of a plan, ms: median and 99th percentile.
    pub plan_ms: [f64; 2],
    /// Age of what a step acted on when it began, ms: median and 99th percentile.
    pub age_ms: [f64; 2],
}

/// `outcomes.jsonl`, to which lines are only added.
pub(crate) struct Outcomes {
    file: std::fs::File,
    path: PathBuf,
    prints: bool,
}

impl Outcomes {
    /// The file in `folder`; each line is printed too with `prints`.
    pub(crate) fn open(folder: &Path, prints: bool) -> anyhow::Result<Self> {
        let path = folder.join("outcomes.jsonl");
        let file = std::fs::OpenOptions::new().create(true).append(true).open(&path);
        let file = file.with_context(|| format!("failed to open {path:?}"))?;
        Ok(Self { file, path, prints })
    }

    pub(crate) fn add(&mut self, outcome: &Outcome) -> anyhow::Result<()> {
        let line = serde_json::to_string(outcome)?;
        std::io::Write::write_all(&mut self.file, format!("{line}\n").as_bytes())
            .with_context(|| format!("failed to write {:?}", self.path))?;
        if self.prints {
            println!("{line}");
        }
        Ok(())
    }
}
