//! The blind bench: hides effects in emulated sessions, diagnoses them blind, and scores the names.
//!
//! The truth world knows what it hides and the library does not; this crate is the only place where both meet, and it
//! looks at what was hidden only after a diagnosis. [`tactile`] and [`actuator`] are the jobs.

mod score;

use std::path::Path;

use palpate_diagnosis::actuator::{ActuatorConfig, diagnose_actuator};
use palpate_diagnosis::{DiagnosisConfig, DiagnosisError, diagnose};
use palpate_emulator::actuator::{ServoCaseKind, record_servo, servo_cases};
use palpate_emulator::{EmulationError, Expected, Stage, Strength, cases};
use palpate_recording::Take;
use palpate_sim::job::{Cancel, NoProgress, Progress};
use palpate_sim::{SensorModel, SensorModelError};
use palpate_wire::api::{DiagnosisReport, Verdict};

pub use score::{BlindReport, LeftOut, Pairs, Scores, StrengthScores};

/// What to run.
#[derive(Clone, Debug)]
pub struct BlindConfig {
    /// Rounds of the catalogue, each with places and noise of its own.
    pub seeds: u64,
    /// The first seed.
    pub first_seed: u64,
    /// Sessions with nothing hidden in each round.
    pub nulls: usize,
    /// Whether each session is diagnosed again without its raw readings (touch only).
    pub binary_only: bool,
    /// Whether effects are diagnosed again with themselves left out of the library.
    pub leave_out: bool,
    /// Run only cases whose label contains this; empty: all.
    pub only: String,
}

/// A bench that cannot be run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BlindError {
    /// The truth.
    #[error(transparent)]
    Emulation(#[from] EmulationError),
    /// A diagnosis failed: a bug, or a truth whose sessions cannot be diagnosed.
    #[error("case {label:?}: {source}")]
    Diagnosis {
        /// Which.
        label: String,
        /// Why.
        source: DiagnosisError,
    },
    /// The station's nominal model.
    #[error(transparent)]
    Model(#[from] SensorModelError),
    /// Nothing to run.
    #[error("no case's label contains {0:?}")]
    NoCase(String),
    /// Somebody cancelled.
    #[error("cancelled")]
    Cancelled,
}

/// What was hidden in a session: for scoring alone.
#[derive(Clone, Debug)]
pub(crate) struct Secret {
    pub(crate) label: String,
    /// Ids, in no order.
    pub(crate) hidden: Vec<String>,
    /// `weak`, `medium` or `strong`; `None` for pairs and without effects.
    pub(crate) strength: Option<String>,
    pub(crate) expected: Expected,
}

impl Secret {
    /// Whether to ask again with the effect left out of the library.
    fn to_leave_out(&self) -> Option<String> {
        let strong = self.strength.as_deref() == Some("strong") && self.expected == Expected::Named;
        strong.then(|| self.hidden[0].clone())
    }
}

/// What one diagnosis said about one session.
#[derive(Clone, Debug)]
pub(crate) struct Answer {
    pub(crate) secret: Secret,
    /// Whether the effect was left out of the library.
    pub(crate) left_out: bool,
    /// Whether the raw readings were taken away.
    pub(crate) binary: bool,
    /// Names, in order.
    pub(crate) named: Vec<String>,
    /// Every member of every name's class.
    pub(crate) class: Vec<String>,
    pub(crate) verdict: Verdict,
    /// Gap of the calibrated and of the diagnosed model on confirm takes.
    pub(crate) gap: [f64; 2],
}

impl Answer {
    fn new(secret: &Secret, left_out: bool, binary: bool, report: &DiagnosisReport) -> Self {
        let named: Vec<String> = report.effects.iter().map(|effect| effect.id.clone()).collect();
        tracing::debug!(label = secret.label, left_out, binary, ?named, verdict = ?report.verdict, "answered");
        Self {
            secret: secret.clone(),
            left_out,
            binary,
            named,
            class: report.effects.iter().flat_map(|effect| effect.class.iter().cloned()).collect(),
            verdict: report.verdict,
            gap: [report.gap.calibrated, report.gap.diagnosed],
        }
    }
}

/// Runs the bench of touch in the world of the truth file at `truth`.
pub fn tactile(
    truth: &Path,
    config: &BlindConfig,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<BlindReport, BlindError> {
    progress.report(0.0, "planning motions");
    let stage = Stage::read(truth)?;
    let nominal =
        SensorModel::from_toml("nominal model of the station", &stage.station().nominal_model_toml)?;
    let rounds = config.first_seed..config.first_seed + config.seeds;
    let mut all = Vec::new();
    for seed in rounds {
        all.extend(cases(&stage, config.nulls, seed)?);
    }
    all.retain(|case| case.label.contains(&config.only));
    let mut answers = Vec::new();
    for (idx, case) in all.iter().enumerate() {
        watch(idx, all.len(), &case.label, progress, cancel)?;
        let secret = Secret {
            label: case.label.clone(),
            hidden: case.hidden.iter().map(|hidden| hidden.id.clone()).collect(),
            strength: case.strength.map(strength_name),
            expected: case.expected,
        };
        let takes = stage.record(&case.hidden, case.seed)?;
        let ask = |takes: &[Take], without: Option<String>| {
            let config = DiagnosisConfig {
                without: without.into_iter().collect(),
                bootstrap_resamples: 0,
                ..DiagnosisConfig::default()
            };
            let outcome = diagnose(&config, takes, &nominal, None, &NoProgress, cancel, &|| 0.0);
            outcome.map(|outcome| outcome.report).map_err(|source| failed(&case.label, source))
        };
        answers.push(Answer::new(&secret, false, false, &ask(&takes, None)?));
        if config.binary_only {
            let takes: Vec<Take> = takes.iter().map(without_raw).collect();
            answers.push(Answer::new(&secret, false, true, &ask(&takes, None)?));
        }
        if let (true, Some(without)) = (config.leave_out, secret.to_leave_out()) {
            answers.push(Answer::new(&secret, true, false, &ask(&takes, Some(without))?));
        }
    }
    finish(&answers, config, progress)
}

/// Runs the bench of joint servos.
pub fn actuator(
    config: &BlindConfig,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<BlindReport, BlindError> {
    let catalogue = servo_cases();
    let mut all = Vec::new();
    for round in 0..config.seeds {
        for (idx, case) in catalogue.iter().enumerate() {
            let times = if case.kind == ServoCaseKind::Null { config.nulls } else { 1 };
            let seed = (config.first_seed + round) << 20 | (idx as u64) << 10;
            all.extend((0..times as u64).map(|time| (case, seed + time)));
        }
    }
    all.retain(|(case, _)| case.label.contains(&config.only));
    let mut answers = Vec::new();
    for (idx, (case, seed)) in all.iter().enumerate() {
        watch(idx, all.len(), &case.label, progress, cancel)?;
        let strengths = [Strength::Weak, Strength::Medium, Strength::Strong];
        let (strength, expected) = match case.kind {
            ServoCaseKind::Single(strength) => (Some(strength_name(strengths[strength])), Expected::Named),
            ServoCaseKind::Pair => (None, Expected::Named),
            ServoCaseKind::Null => (None, Expected::Nothing),
            ServoCaseKind::Outside => (None, Expected::Unexplained),
        };
        let hidden = case.hidden.iter().map(|id| (*id).to_owned()).collect();
        let secret = Secret { label: case.label.clone(), hidden, strength, expected };
        let logs = record_servo(&case.truth, *seed);
        let ask = |without: Option<String>| {
            let config =
                ActuatorConfig { without: without.into_iter().collect(), ..ActuatorConfig::default() };
            let outcome = diagnose_actuator(&config, &logs, &NoProgress, cancel, &|| 0.0);
            outcome.map(|outcome| outcome.report).map_err(|source| failed(&case.label, source))
        };
        answers.push(Answer::new(&secret, false, false, &ask(None)?));
        if let (true, Some(without)) = (config.leave_out, secret.to_leave_out()) {
            answers.push(Answer::new(&secret, true, false, &ask(Some(without))?));
        }
    }
    finish(&answers, config, progress)
}

fn finish(
    answers: &[Answer],
    config: &BlindConfig,
    progress: &dyn Progress,
) -> Result<BlindReport, BlindError> {
    if answers.is_empty() {
        return Err(BlindError::NoCase(config.only.clone()));
    }
    progress.report(1.0, "done");
    Ok(BlindReport::new(answers))
}

fn watch(
    idx: usize,
    count: usize,
    label: &str,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<(), BlindError> {
    progress.report(idx as f64 / count as f64, &format!("session {} of {count}: {label}", idx + 1));
    if cancel.is_cancelled() { Err(BlindError::Cancelled) } else { Ok(()) }
}

fn failed(label: &str, source: DiagnosisError) -> BlindError {
    match source {
        DiagnosisError::Cancelled => BlindError::Cancelled,
        source => BlindError::Diagnosis { label: label.to_owned(), source },
    }
}

fn strength_name(strength: Strength) -> String {
    format!("{strength:?}").to_lowercase()
}

/// `take` as a device would have recorded it that reports events only.
fn without_raw(take: &Take) -> Take {
    let mut take = take.clone();
    for stream in &mut take.streams {
        stream.raw.clear();
        stream.reference.clear();
    }
    take
}
