//! The cross-entropy method.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use palpate_sim::job::{Cancel, Progress};
use rand::{Rng, RngExt};
use rayon::prelude::*;
use serde::Serialize;

use super::TuningConfig;
use crate::env::stream;
use crate::scene::digits;
use crate::trial::{self, Outcome, Score, TrialReport};
use crate::{GraspError, GraspScene, Script};

/// Time after a script's last key in which a lifted object can still be held long enough, s, beyond the hold itself.
const SLACK_S: f64 = 0.5;
/// Trials that choose between generations are none of those that the search saw.
const FIRST_CHECK_TRIAL: u64 = 1 << 40;
/// Share of the old distribution that a generation keeps, and the least that is left of a spread.
const KEEP_MEAN: f64 = 0.2;
const KEEP_SPREAD: f64 = 0.3;
const LEAST_SPREAD: f64 = 0.1;

/// How long to search, and with which random numbers. Every number is at least 1, `elite` at most `candidates`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TuneParams {
    /// Seed of candidates and trials.
    pub seed: u64,
    /// Rounds of candidates.
    pub generations: usize,
    /// Scripts drawn in each.
    pub candidates: usize,
    /// The best of them, which the distribution moves to.
    pub elite: usize,
    /// Trials of each candidate, in worlds that all of a generation share.
    pub trials: usize,
    /// Trials of each generation's mean, in worlds that all generations share and no candidate sees.
    pub check_trials: usize,
}

/// What a generation found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Generation {
    /// Its number; 0 is the script that the search began with.
    pub generation: usize,
    /// Mean score of its candidates, and of the best of them; none for generation 0.
    pub mean_score: Option<f64>,
    /// See `mean_score`.
    pub elite_score: Option<f64>,
    /// Mean spread of the parameters, as a share of what the search began with.
    pub spread: f64,
    /// Score of its mean in the check trials.
    pub check_score: f64,
    /// Verdicts of those.
    pub check: Score,
    /// Whether that is the best mean so far.
    pub best: bool,
}

/// The best script that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct TuneReport {
    /// It.
    pub script: Script,
    /// The value of each parameter.
    pub values: Vec<f64>,
    /// Every generation that was completed.
    pub generations: Vec<Generation>,
}

/// Tunes `script` in the worlds of `scene`. `on_generation` is told of each generation and the best script so far.
///
/// The same seed gives the same bits for any number of threads. Stops early when `cancel` is set: the generation under way
/// is forgotten, what was found before is kept. `None` when not even the first script was scored by then.
pub fn tune(
    scene: &Arc<GraspScene>,
    script: &Script,
    config: &TuningConfig,
    params: &TuneParams,
    progress: &dyn Progress,
    cancel: &Cancel,
    mut on_generation: impl FnMut(&Generation, &Script) -> Result<(), GraspError>,
) -> Result<Option<TuneReport>, GraspError> {
    let search = Search::new(scene, script, config, params, progress, cancel);
    let mut rng = stream(params.seed, u64::MAX);
    let initial: Vec<f64> = config.parameters.iter().map(|parameter| parameter.spread).collect();
    let (mut mean, mut spread) = (vec![0.0; initial.len()], initial.clone());
    let Some((check_score, check)) = search.check(script)? else { return Ok(None) };
    let first = Generation {
        generation: 0,
        mean_score: None,
        elite_score: None,
        spread: 1.0,
        check_score,
        check,
        best: true,
    };
    on_generation(&first, script)?;
    let mut best_score = first.check_score;
    let mut report = TuneReport { script: script.clone(), values: mean.clone(), generations: vec![first] };
    for generation in 1..=params.generations {
        let candidates: Vec<Vec<f64>> = (0..params.candidates)
            .map(|_| {
                mean.iter().zip(&spread).map(|(mean, spread)| mean + spread * normal(&mut rng)).collect()
            })
            .collect();
        let Some(scores) = search.scores(&candidates, generation)? else { break };
        let mut order: Vec<usize> = (0..candidates.len()).collect();
        // A stable sort: of equal candidates the first drawn counts.
        order.sort_by(|&one, &other| scores[other].total_cmp(&scores[one]));
        let elite: Vec<&[f64]> =
            order.iter().take(params.elite).map(|&idx| candidates[idx].as_slice()).collect();
        move_to(&elite, &mut mean, &mut spread, &initial);
        let average = |of: &mut dyn Iterator<Item = f64>, count: usize| of.sum::<f64>() / count as f64;
        let Some(tuned) = search.script_of(&mean) else { continue };
        let Some((check_score, check)) = search.check(&tuned)? else { break };
        let best = check_score > best_score;
        if best {
            best_score = check_score;
            report.script = tuned;
            report.values.clone_from(&mean);
        }
        let told = Generation {
            generation,
            mean_score: Some(average(&mut scores.iter().copied(), scores.len())),
            elite_score: Some(average(
                &mut order.iter().take(elite.len()).map(|&idx| scores[idx]),
                elite.len(),
            )),
            spread: average(&mut spread.iter().zip(&initial).map(|(now, first)| now / first), spread.len()),
            check_score,
            check,
            best,
        };
        on_generation(&told, &report.script)?;
        report.generations.push(told);
    }
    Ok(Some(report))
}

/// Moves the distribution to `elite`.
fn move_to(elite: &[&[f64]], mean: &mut [f64], spread: &mut [f64], initial: &[f64]) {
    let count = elite.len() as f64;
    for (idx, initial) in initial.iter().enumerate() {
        let elite_mean = elite.iter().map(|values| values[idx]).sum::<f64>() / count;
        let variance = elite.iter().map(|values| (values[idx] - elite_mean).powi(2)).sum::<f64>() / count;
        mean[idx] += (1.0 - KEEP_MEAN) * (elite_mean - mean[idx]);
        let moved = KEEP_SPREAD * spread[idx] + (1.0 - KEEP_SPREAD) * variance.sqrt();
        spread[idx] = moved.max(LEAST_SPREAD * initial);
    }
}

/// A standard normal number (Box and Muller).
fn normal(rng: &mut impl Rng) -> f64 {
    let (one, other) = (1.0 - rng.random::<f64>(), rng.random::<f64>());
    (-2.0 * one.ln()).sqrt() * (std::f64::consts::TAU * other).cos()
}

/// What stays the same during a search.
struct Search<'a> {
    scene: &'a Arc<GraspScene>,
    script: &'a Script,
    config: &'a TuningConfig,
    params: &'a TuneParams,
    progress: &'a dyn Progress,
    cancel: &'a Cancel,
    num_digits: usize,
    trials_done: AtomicUsize,
    trials_wanted: usize,
}

impl<'a> Search<'a> {
    fn new(
        scene: &'a Arc<GraspScene>,
        script: &'a Script,
        config: &'a TuningConfig,
        params: &'a TuneParams,
        progress: &'a dyn Progress,
        cancel: &'a Cancel,
    ) -> Self {
        let num_digits =
            digits(&scene.station().robot, scene.config()).iter().flatten().max().map_or(0, |last| last + 1);
        let per_generation = params.candidates * params.trials + params.check_trials;
        Self {
            scene,
            script,
            config,
            params,
            progress,
            cancel,
            num_digits,
            trials_done: AtomicUsize::new(0),
            trials_wanted: params.check_trials + params.generations * per_generation,
        }
    }

    fn script_of(&self, values: &[f64]) -> Option<Script> {
        self.config.apply(values, self.script, &self.scene.station().robot, self.scene.config())
    }

    /// Mean score of each candidate; `None` when cancelled. Those that cannot be reached score as if stopped.
    fn scores(&self, candidates: &[Vec<f64>], generation: usize) -> Result<Option<Vec<f64>>, GraspError> {
        let scripts: Vec<Option<Script>> = candidates.iter().map(|values| self.script_of(values)).collect();
        let num_trials = self.params.trials;
        let first = (generation - 1) * num_trials;
        let scores: Option<Vec<f64>> = (0..scripts.len() * num_trials)
            .into_par_iter()
            .map(|idx| match &scripts[idx / num_trials] {
                Some(script) => {
                    let trial = self.trial(script, (first + idx % num_trials) as u64)?;
                    Ok(trial.map(|report| self.score(&report)))
                }
                None => Ok(Some(-self.config.score.stop)),
            })
            .collect::<Result<_, GraspError>>()?;
        Ok(scores.map(|scores| {
            scores.chunks(num_trials).map(|of_one| of_one.iter().sum::<f64>() / num_trials as f64).collect()
        }))
    }

    /// Mean score and verdicts of `script` in the check trials; `None` when cancelled.
    fn check(&self, script: &Script) -> Result<Option<(f64, Score)>, GraspError> {
        let reports: Option<Vec<TrialReport>> = (0..self.params.check_trials)
            .into_par_iter()
            .map(|idx| self.trial(script, FIRST_CHECK_TRIAL + idx as u64))
            .collect::<Result<_, GraspError>>()?;
        Ok(reports.map(|reports| {
            let score = reports.iter().map(|report| self.score(report)).sum::<f64>() / reports.len() as f64;
            let outcomes: Vec<Outcome> = reports.iter().map(|report| report.outcome).collect();
            (score, Score::of(&outcomes))
        }))
    }

    fn trial(&self, script: &Script, trial: u64) -> Result<Option<TrialReport>, GraspError> {
        if self.cancel.is_cancelled() {
            return Ok(None);
        }
        let task = &self.scene.config().task;
        let longest_s = (script.end_s() + task.hold_s + SLACK_S).min(task.episode_s);
        let report = trial::watch(self.scene, script, self.params.seed, trial, longest_s)?;
        let done = 1 + self.trials_done.fetch_add(1, Ordering::Relaxed);
        self.progress.report(done as f64 / self.trials_wanted as f64, "trials");
        Ok(Some(report))
    }

    fn score(&self, report: &TrialReport) -> f64 {
        let weights = &self.config.score;
        let won = if report.outcome == Outcome::Success { 1.0 } else { 0.0 };
        let lifted = (report.lift_m / self.scene.config().task.lift_m).clamp(0.0, 1.0);
        let touching = f64::from(report.num_digits) / self.num_digits.max(1) as f64;
        let stopped = if report.outcome == Outcome::EmergencyStop { weights.stop } else { 0.0 };
        won + weights.lift * lifted + weights.digits * touching
            - weights.table_per_s * report.table_s
            - stopped
    }
}
