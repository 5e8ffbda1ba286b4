//! The file of a trial: JSON lines, what was seen, wanted, let through, answered, and what happened.
//!
//! The first line is the `trial`, the last its `outcome`. Between them, in the order of events: a `step` for each step of the
//! policy, an `answer` for each answer of the safety layer to one, and a `frame` for everything that the studio's stream
//! said. `at_s` is the rollout's clock since the trial began; `station_s` is the station's.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;
use std::time::Instant;

use anyhow::Context as _;
use palpate_messages::bits;
use palpate_wire::proto::control_state::Phase;
use serde::Serialize;
use serde_json::{Value, json};

use crate::link::{Answered, Frame};
use crate::policy::{Seen, Step};

/// Writes one.
pub struct Record {
    file: BufWriter<File>,
    begun: Instant,
    num_channels: usize,
}

impl Record {
    /// A new file at `path` that begins with `trial`.
    ///
    /// # Errors
    /// A file that cannot be made.
    pub fn create(path: &Path, num_channels: usize, trial: &Value) -> anyhow::Result<Self> {
        let file = File::create(path).with_context(|| format!("failed to make {path:?}"))?;
        let mut record = Self { file: BufWriter::new(file), begun: Instant::now(), num_channels };
        record.line(&json!({ "kind": "trial", "trial": trial }))?;
        Ok(record)
    }

    fn line(&mut self, line: &impl Serialize) -> anyhow::Result<()> {
        serde_json::to_writer(&mut self.file, line).context("failed to write the record")?;
        self.file.write_all(b"\n").context("failed to write the record")
    }

    fn at_s(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.begun).as_secs_f64()
    }

    /// A step: what was seen when, and what it came to. `number` is that of the request which said so.
    ///
    /// # Errors
    /// A disk that takes no more.
    pub fn step(
        &mut self,
        number: u64,
        late_s: f64,
        frame: &Frame,
        seen: &Seen,
        step: &Step,
    ) -> anyhow::Result<()> {
        let active: Vec<usize> = on(&seen.active);
        self.line(&json!({
            "kind": "step", "number": number, "at_s": self.at_s(Instant::now()), "time_s": seen.time_s, "late_s": late_s,
            "station_s": frame.live.time_s, "seen_at_s": self.at_s(frame.received),
            "positions": seen.positions, "active": active, "action": step.action,
            // What is no number is null in JSON.
            "wanted": step.targets,
        }))?;
        self.flush()
    }

    /// What the safety layer answered.
    ///
    /// # Errors
    /// A disk that takes no more.
    pub fn answer(&mut self, answered: &Answered) -> anyhow::Result<()> {
        self.line(&json!({
            "kind": "answer", "number": answered.sequence, "at_s": self.at_s(answered.received),
            "accepted": answered.reply.accepted, "problem": answered.reply.problem,
        }))
    }

    /// What the stream said.
    ///
    /// # Errors
    /// A disk that takes no more.
    pub fn frame(&mut self, frame: &Frame) -> anyhow::Result<()> {
        let live = &frame.live;
        let control = live.control.clone().unwrap_or_default();
        let active: Vec<usize> =
            (0..self.num_channels).filter(|&channel| bits::get(&live.active, channel)).collect();
        let motors = control.devices.iter().flat_map(|device| &device.motors);
        let currents_a: Vec<f32> = motors.map(|motor| motor.current_a).collect();
        self.line(&json!({
            "kind": "frame", "at_s": self.at_s(frame.received), "station_s": live.time_s,
            "positions": live.joint_positions, "active": active, "raw": live.raw, "rates_hz": live.rates_hz,
            "let_through": control.commanded, "phase": phase_word(control.phase()), "reason": control.reason,
            "currents_a": currents_a,
        }))
    }

    /// Brings what was written so far to the file, for whoever looks after this process was killed.
    ///
    /// # Errors
    /// A disk that takes no more.
    pub fn flush(&mut self) -> anyhow::Result<()> {
        self.file.flush().context("failed to write the record")
    }

    /// How it ended; the file is whole then.
    ///
    /// # Errors
    /// A disk that takes no more.
    pub fn outcome(mut self, outcome: &impl Serialize) -> anyhow::Result<()> {
        self.line(&json!({ "kind": "outcome", "outcome": outcome }))?;
        self.flush()
    }
}

/// Indices of channels that are on.
fn on(active: &[bool]) -> Vec<usize> {
    active.iter().enumerate().filter(|(_, active)| **active).map(|(channel, _)| channel).collect()
}

/// What the station is up to, in a word.
pub(crate) fn phase_word(phase: Phase) -> &'static str {
    match phase {
        Phase::Unspecified | Phase::Disarmed => "disarmed",
        Phase::Arming => "arming",
        Phase::Armed => "armed",
        Phase::Holding => "holding",
        Phase::Disarming => "disarming",
        Phase::Stopped => "stopped",
    }
}
