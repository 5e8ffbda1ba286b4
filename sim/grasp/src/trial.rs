//! Trials of the grasping task and their verdicts.

use std::sync::Arc;

use palpate_statistics::wilson;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::controller::{Controller, Observation};
use crate::env::stream;
use crate::{Contacts, GraspConfig, GraspEnv, GraspError, GraspScene, Script, ScriptRun, Start, World};

/// How a trial ended.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Touched, lifted, and held for the time asked.
    Success,
    /// Never lifted.
    EmptyGrasp,
    /// Lifted, and dropped or not held long enough.
    Slip,
    /// The force between robot and table passed its limit, or the physics diverged.
    EmergencyStop,
}

/// Watches a trial step by step.
#[derive(Clone, Debug)]
pub struct Judge {
    start_height_m: f64,
    longest_s: f64,
    lifted_for_s: f64,
    was_touched: bool,
    was_lifted: bool,
}

impl Judge {
    /// Of an episode that has just begun in `world` and lasts `longest_s` at most.
    pub fn new(world: &World, longest_s: f64) -> Self {
        let start_height_m = world.base_from_object().translation.z;
        Self { start_height_m, longest_s, lifted_for_s: 0.0, was_touched: false, was_lifted: false }
    }

    /// How far the object's origin is above where it began, m.
    pub fn lift_m(&self, world: &World) -> f64 {
        world.base_from_object().translation.z - self.start_height_m
    }

    /// Looks at `world`, which has these `contacts`, after a control step; the verdict as soon as there is one. Success
    /// needs touch by the robot, the object's origin `lift_m` above where it began, and that for `hold_s` without a break
    /// (paper, "Evaluation Protocol"); in a task of one claim also that the episode is over.
    pub fn look(&mut self, config: &GraspConfig, world: &World, contacts: &Contacts) -> Option<Outcome> {
        self.look_and_hear(config, world, contacts, false)
    }

    /// The same when the policy may have claimed just now that it holds the object, which ends a task of one claim.
    pub fn look_and_hear(
        &mut self,
        config: &GraspConfig,
        world: &World,
        contacts: &Contacts,
        claims_held: bool,
    ) -> Option<Outcome> {
        let step_s = 1.0 / config.control_rate_hz;
        if contacts.robot_table_n > config.task.max_table_force_n {
            return Some(Outcome::EmergencyStop);
        }
        self.was_touched |= contacts.robot_object_n > 0.0;
        if self.lift_m(world) >= config.task.lift_m && self.was_touched {
            self.was_lifted = true;
            self.lifted_for_s += step_s;
        } else {
            self.lifted_for_s = 0.0;
        }
        // A step's rounding is no reason to hold, or to last, for a step longer.
        let is_held = self.lifted_for_s >= config.task.hold_s - 0.5 * step_s;
        let is_late = world.time_s() >= self.longest_s - 0.5 * step_s;
        let is_over = is_late || (config.task.one_claim && claims_held);
        if is_held && (is_over || !config.task.one_claim) {
            return Some(Outcome::Success);
        }
        is_over.then_some(if self.was_lifted { Outcome::Slip } else { Outcome::EmptyGrasp })
    }
}

/// Outcomes of trials, counted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Trials run.
    pub trials: usize,
    /// Of them won.
    pub successes: usize,
    /// Never lifted.
    pub empty_grasp: usize,
    /// Lifted and lost.
    pub slip: usize,
    /// Stopped.
    pub emergency_stop: usize,
    /// 95 % interval of the success rate (Wilson's).
    pub interval_95: [f64; 2],
}

impl Score {
    /// Counts `outcomes`.
    pub fn of(outcomes: &[Outcome]) -> Self {
        let count = |wanted: Outcome| outcomes.iter().filter(|outcome| **outcome == wanted).count();
        let successes = count(Outcome::Success);
        Self {
            trials: outcomes.len(),
            successes,
            empty_grasp: count(Outcome::EmptyGrasp),
            slip: count(Outcome::Slip),
            emergency_stop: count(Outcome::EmergencyStop),
            interval_95: wilson_95(successes, outcomes.len()),
        }
    }

    /// These trials and those of `other` together.
    pub fn and(&self, other: &Self) -> Self {
        let (successes, trials) = (self.successes + other.successes, self.trials + other.trials);
        Self {
            trials,
            successes,
            empty_grasp: self.empty_grasp + other.empty_grasp,
            slip: self.slip + other.slip,
            emergency_stop: self.emergency_stop + other.emergency_stop,
            interval_95: wilson_95(successes, trials),
        }
    }
}

/// Wilson's interval of the success rate with 95 % confidence; 0 to 1 without trials.
fn wilson_95(successes: usize, trials: usize) -> [f64; 2] {
    let interval = wilson(successes as u64, trials as u64, 0.95);
    interval.map_or([0.0, 1.0], |interval| [interval.low, interval.high])
}

/// What happened in a trial.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrialReport {
    /// Its verdict.
    pub outcome: Outcome,
    /// How far the object was above its start at the end, m.
    pub lift_m: f64,
    /// Digits that touched the object at the end.
    pub num_digits: u32,
    /// For how long the robot touched the table, s.
    pub table_s: f64,
}

/// One trial of `script`: number `trial` of those with `seed`, cut off after `longest_s`. Where the script does not feel,
/// touch is not computed; the physics is to the bit that of a [`crate::GraspEnv`] with the same numbers.
pub fn watch(
    scene: &Arc<GraspScene>,
    script: &Script,
    seed: u64,
    trial: u64,
    longest_s: f64,
) -> Result<TrialReport, GraspError> {
    let mut rng = stream(seed, trial);
    let start = Start::draw(scene, &mut rng);
    if script.feels() {
        let env = GraspEnv::at(Arc::clone(scene), &start, rng)?;
        let mut run = ScriptRun::new(script);
        let judge = Judge::new(env.world(), longest_s);
        return judged(env, judge, scene.config(), GraspEnv::world, |env, _| {
            let targets = run.targets(script, scene.station(), scene.config(), env.sensed());
            env.step(&targets)
        });
    }
    let world = scene.world(&start)?;
    let judge = Judge::new(&world, longest_s);
    judged(
        world,
        judge,
        scene.config(),
        |world| world,
        |world, time_s| {
            world.set_targets(&script.targets_at(time_s));
            world.step()
        },
    )
}

/// Makes control steps of `simulated`, of which `step` is told the time, until `judge` has a verdict.
fn judged<T>(
    mut simulated: T,
    mut judge: Judge,
    config: &GraspConfig,
    world: impl Fn(&T) -> &World,
    mut step: impl FnMut(&mut T, f64) -> Result<(), GraspError>,
) -> Result<TrialReport, GraspError> {
    let mut report =
        TrialReport { outcome: Outcome::EmergencyStop, lift_m: 0.0, num_digits: 0, table_s: 0.0 };
    for idx in 0_u32.. {
        match step(&mut simulated, f64::from(idx) / config.control_rate_hz) {
            Err(GraspError::Diverged { .. }) => break,
            other => other?,
        }
        let world = world(&simulated);
        let contacts = world.contacts();
        report.lift_m = judge.lift_m(world);
        report.num_digits = contacts.digits.count_ones();
        report.table_s += if contacts.robot_table_n > 0.0 { 1.0 / config.control_rate_hz } else { 0.0 };
        if let Some(outcome) = judge.look(config, world, &contacts) {
            report.outcome = outcome;
            break;
        }
    }
    Ok(report)
}

/// What a controller gets to know in a trial: controls of an experiment take something away, or give what no robot has.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
pub struct Known {
    /// Touch as it is felt; otherwise no channel ever feels anything.
    pub touch: bool,
    /// Joint positions as they are; otherwise every joint seems to be where it was sent, so that tracking errors say nothing.
    pub tracking: bool,
    /// Where the object is ([`Observation::told_place_m`]).
    pub place: bool,
}

impl Known {
    /// What the robot itself knows.
    pub const ROBOT: Self = Self { touch: true, tracking: true, place: false };
}

/// How a trial under a protocol ended.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Serialize)]
pub struct Ending {
    /// Its verdict.
    pub outcome: Outcome,
    /// When the verdict was there, s.
    #[serde(rename = "seconds")]
    pub time_s: f64,
    /// Whether the controller said in a task of one claim that it held the object.
    pub claimed: bool,
}

impl Ending {
    /// Whether it was won.
    pub fn is_won(&self) -> bool {
        self.outcome == Outcome::Success
    }

    /// Whether the controller claimed to hold an object that it did not hold.
    pub fn is_false_claim(&self) -> bool {
        self.claimed && !self.is_won()
    }
}

/// Trial number `trial` of those with `seed` moved by `controller`, which sees what `known` says. It begins where
/// [`watch`] begins with the same numbers.
pub fn conduct(
    scene: &Arc<GraspScene>,
    controller: &mut dyn Controller,
    known: Known,
    seed: u64,
    trial: u64,
) -> Result<Ending, GraspError> {
    conduct_seen(scene, controller, known, seed, trial, &mut |_| ())
}

/// The same trial, to the same bits, with `see` shown its beginning and what came of each control step.
pub fn conduct_seen(
    scene: &Arc<GraspScene>,
    controller: &mut dyn Controller,
    known: Known,
    seed: u64,
    trial: u64,
    see: &mut dyn FnMut(&GraspEnv),
) -> Result<Ending, GraspError> {
    let mut rng = stream(seed, trial);
    let start = Start::draw(scene, &mut rng);
    let mut env = GraspEnv::at(Arc::clone(scene), &start, rng)?;
    see(&env);
    let task = &scene.config().task;
    let mut judge = Judge::new(env.world(), task.episode_s);
    let nothing = vec![false; scene.station().layout.num_channels()];
    loop {
        let at = env.world().base_from_object().translation;
        let strengths = env.strengths().map(|felt| if known.touch { felt } else { vec![0.0; felt.len()] });
        let command = controller.control(&Observation {
            time_s: env.time_s(),
            positions: if known.tracking { env.positions() } else { env.targets() },
            commands: env.targets(),
            active: if known.touch { &env.readings().active } else { &nothing },
            strengths: strengths.as_deref(),
            told_place_m: known.place.then_some([at.x - task.center_m[0], at.y - task.center_m[1]]),
        });
        let claimed = task.one_claim && command.claims_held;
        match env.step(&command.targets) {
            Err(GraspError::Diverged { .. }) => {
                return Ok(Ending { outcome: Outcome::EmergencyStop, time_s: env.time_s(), claimed });
            }
            other => other?,
        }
        see(&env);
        let contacts = env.world().contacts();
        let verdict = judge.look_and_hear(scene.config(), env.world(), &contacts, claimed);
        if let Some(outcome) = verdict {
            return Ok(Ending { outcome, time_s: env.time_s(), claimed });
        }
    }
}

/// The verdict on one trial of `script`: number `trial` of those with `seed`.
pub fn run(scene: &Arc<GraspScene>, script: &Script, seed: u64, trial: u64) -> Result<Outcome, GraspError> {
    Ok(watch(scene, script, seed, trial, scene.config().task.episode_s)?.outcome)
}

/// `trials` trials of `script` on every core, in order.
pub fn run_all(
    scene: &Arc<GraspScene>,
    script: &Script,
    seed: u64,
    trials: u64,
) -> Result<Vec<Outcome>, GraspError> {
    (0..trials).into_par_iter().map(|trial| run(scene, script, seed, trial)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_wilsons() {
        // Known values: 45 of 50.
        let [low, high] = wilson_95(45, 50);
        assert!((low - 0.7864).abs() < 1e-3 && (high - 0.9565).abs() < 1e-3, "{low} {high}");
        assert_eq!(wilson_95(0, 0), [0.0, 1.0]);
        assert_eq!(wilson_95(0, 50)[0], 0.0);
        assert_eq!(wilson_95(50, 50)[1], 1.0);
    }
}
