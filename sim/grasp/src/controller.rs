//! What moves the robot in a trial, from what a robot can know.

use std::sync::Arc;

use palpate_robot_model::Station;

use crate::{GraspConfig, Script, ScriptRun, Sensed};

/// What a robot knows at the beginning of a control step.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// Time since the episode began, s.
    pub time_s: f64,
    /// Position of every degree of freedom as it is read, rad or m.
    pub positions: &'a [f64],
    /// Where every degree of freedom was sent last, rad or m.
    pub commands: &'a [f64],
    /// Whether each channel feels something.
    pub active: &'a [bool],
    /// How strongly each channel is touched, from 0 to 1; nothing where that cannot be told.
    pub strengths: Option<&'a [f32]>,
    /// Where the object is, m along x and y of the base from the middle of the region: what no robot knows and an oracle is told.
    pub told_place_m: Option<[f64; 2]>,
}

/// What a robot does in a control step.
#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    /// Where every degree of freedom goes, rad or m.
    pub targets: Vec<f64>,
    /// Whether it says that it holds the object; it matters in a task of one claim alone.
    pub claims_held: bool,
}

/// Moves the robot through one trial.
pub trait Controller {
    /// What it does in the control step that begins now. Moments come in order.
    fn control(&mut self, now: &Observation<'_>) -> Command;
}

/// A script as a controller: it says nothing, and holds what it has to the end.
#[derive(Clone, Debug)]
pub struct Scripted {
    script: Arc<Script>,
    run: ScriptRun,
    station: Arc<Station>,
    config: Arc<GraspConfig>,
}

impl Scripted {
    /// At the beginning of `script`.
    pub fn new(script: Arc<Script>, station: Arc<Station>, config: Arc<GraspConfig>) -> Self {
        Self { run: ScriptRun::new(&script), script, station, config }
    }
}

impl Controller for Scripted {
    fn control(&mut self, now: &Observation<'_>) -> Command {
        let sensed = Sensed { time_s: now.time_s, positions: now.positions, active: now.active };
        let targets = self.run.targets(&self.script, &self.station, &self.config, sensed);
        Command { targets, claims_held: false }
    }
}
