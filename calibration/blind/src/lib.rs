//! The blind bench: hides effects in emulated sessions, diagnoses them blind, and scores the names.
//!
//! The truth world knows what it hides and the library does not; this crate is the only place where both meet, and it
//! looks at what was hidden only after a diagnosis. [`tactile`] and [`actuator`] are the jobs.

mod answers;
mod score;
mod second;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use palpate_diagnosis::actuator::{ActuatorConfig, diagnose_actuator};
use palpate_diagnosis::rules::{RULES, Rule};
use palpate_diagnosis::{DiagnosisConfig, DiagnosisError, Reference, diagnose, reference};
use palpate_recording::{AxesLog, RecordingError, Take};
use palpate_sim::job::{Cancel, NoProgress, Progress};
use palpate_sim::{SensorModel, SensorModelError};
use palpate_truth::actuator::{ServoCaseKind, ServoTruth, record_servo, servo_cases};
use palpate_truth::{Case, EmulationError, Expected, Hidden, Stage, Strength, cases};
use rayon::prelude::*;

use answers::{Answer, Answers, Asked, Secret};
pub use score::{AblationRow, BlindReport, LeftOut, Pairs, Scores, StrengthScores};
use second::{Kept, Part, Second};

/// Whose physics the sessions of touch have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum World {
    /// The emulated station's, on which the constants of the diagnosis were chosen.
    #[default]
    A,
    /// Another skin, other boards, geometry that is a little off, and a person's pace: for reports alone. It hides what
    /// it can of the catalogue, and its sessions are imported from CSV files.
    B,
    /// Of what is off in world b its skin alone.
    C,
    /// Of what is off in world b its boards alone.
    D,
    /// Of what is off in world b its geometry and the person's pace alone.
    E,
}

impl World {
    /// What answers and tables call it, after the station's name.
    fn suffix(self) -> &'static str {
        match self {
            Self::A => "",
            Self::B => ", second world",
            Self::C => ", skin of the second world",
            Self::D => ", boards of the second world",
            Self::E => ", geometry and operator of the second world",
        }
    }
}

/// What to run.
#[derive(Clone, Debug)]
pub struct BlindConfig {
    /// Whose physics the sessions of touch have.
    pub world: World,
    /// Rounds of the catalogue, each with places and noise of its own.
    pub seeds: u64,
    /// The first seed.
    pub first_seed: u64,
    /// Sessions with nothing hidden in each round.
    pub nulls: usize,
    /// Reference sessions by which the others are judged, recorded beside them with nothing hidden (touch only); 0: the
    /// shipped limits.
    pub references: usize,
    /// Whether each session is diagnosed again without its raw readings (touch only).
    pub binary_only: bool,
    /// Whether effects are diagnosed again with themselves left out of the library.
    pub leave_out: bool,
    /// Factors of the limits of rules of the diagnosis, by id (touch only); a rule with an infinite one withholds
    /// nothing.
    pub rule_scales: BTreeMap<String, f64>,
    /// Whether to say as well what would be named with each rule by itself switched off, and with its limit multiplied
    /// (touch only): what each is good for.
    pub ablation: bool,
    /// Run only cases whose label contains one of these; empty: all.
    pub only: Vec<String>,
    /// Where answers are kept, one a line: those that are there are not asked for again.
    pub answers: Option<PathBuf>,
}

impl BlindConfig {
    fn wants(&self, label: &str) -> bool {
        self.only.is_empty() || self.only.iter().any(|part| label.contains(part))
    }
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
    /// The takes of the second world.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// An object without an inside.
    #[error("cannot be touched: {0}")]
    Shape(String),
    /// The files of the second world.
    #[error("failed to write CSV files for the importer")]
    Disk(#[source] std::io::Error),
    /// The file of answers.
    #[error("answers {path}: {source}")]
    Answers {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Nothing to run.
    #[error("no case's label contains any of {0:?}")]
    NoCase(Vec<String>),
    /// Somebody cancelled.
    #[error("cancelled")]
    Cancelled,
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
    let station_name = stage.truth().name.clone();
    let world = match config.world {
        World::A => Physics::Emulated(stage),
        World::B => Physics::Second(Second::new(stage)),
        World::C => Physics::Second(Second::with_only(stage, Part::Skin)),
        World::D => Physics::Second(Second::with_only(stage, Part::Boards)),
        World::E => Physics::Second(Second::with_only(stage, Part::GeometryAndOperator)),
    };
    let rounds = config.first_seed..config.first_seed + config.seeds;
    let mut all = Vec::new();
    for seed in rounds {
        all.extend(world.cases(config.nulls, seed)?);
    }
    let name = station_name + config.world.suffix();
    let scaled = config.rule_scales.iter().map(|(id, scale)| match scale.is_finite() {
        true => format!(", {scale} times {id}"),
        false => format!(", without {id}"),
    });
    let name = name + &scaled.collect::<String>();
    let name = if config.ablation { name + ", every rule changed" } else { name };
    let name = match config.references {
        0 => name,
        count => format!("{name}, {count} reference sessions"),
    };
    let sessions = all.into_iter().map(|case| {
        let secret = Secret {
            world: name.clone(),
            label: case.label,
            seed: case.seed,
            hidden: case.hidden.iter().map(|hidden| hidden.id.clone()).collect(),
            details: case.hidden,
            strength: case.strength.map(strength_name),
            expected: case.expected,
        };
        (secret, ())
    });
    let references = References::new(&world, &nominal, config, cancel)?;
    let ablation = if config.ablation { ablation() } else { Vec::new() };
    let diagnosed = |secret: &Secret, (): &(), asked: Asked| {
        let takes = world.record(&secret.details, secret.seed, asked == Asked::EventsOnly)?;
        let config = DiagnosisConfig {
            without: without(secret, asked),
            rule_scales: config.rule_scales.clone(),
            ablation: ablation.iter().map(|(rule, scale)| [(rule.clone(), *scale)].into()).collect(),
            reference: references.of(asked).cloned(),
            bootstrap_resamples: 0,
            ..DiagnosisConfig::default()
        };
        let outcome = diagnose(&config, &takes, &nominal, None, &NoProgress, cancel, &|| 0.0);
        let outcome = outcome.map_err(|source| failed(&secret.label, source))?;
        Ok(Answer::new(secret, asked, outcome.report).with_ablation(&ablation, &outcome.ablation))
    };
    run(sessions.collect(), config, config.binary_only, progress, cancel, &diagnosed)
}

/// Every rule by itself, with each factor of its limit; a limit of 0 has no multiples.
fn ablation() -> Vec<(String, f64)> {
    let of_rule = |rule: &'static Rule| {
        let scales = ABLATION_SCALES.iter().filter(|scale| rule.limit != 0.0 || scale.is_infinite());
        scales.map(|scale| (rule.id.to_owned(), *scale))
    };
    RULES.iter().flat_map(of_rule).collect()
}

/// Factors of limits that show whether a rule hangs on where its limit lies, and whether it is needed at all.
const ABLATION_SCALES: [f64; 3] = [0.7, 1.4, f64::INFINITY];

/// Where sessions of touch come from.
enum Physics {
    Emulated(Stage),
    Second(Second),
}

impl Physics {
    fn cases(&self, nulls: usize, seed: u64) -> Result<Vec<Case>, BlindError> {
        match self {
            Self::Emulated(stage) => Ok(cases(stage, nulls, seed)?),
            Self::Second(second) => second.cases(nulls, seed),
        }
    }

    fn record(&self, hidden: &[Hidden], seed: u64, events_only: bool) -> Result<Vec<Take>, BlindError> {
        match self {
            Self::Emulated(stage) => {
                let mut takes = stage.record(hidden, seed)?;
                if events_only {
                    takes.iter_mut().for_each(take_raw_away);
                }
                Ok(takes)
            }
            Self::Second(second) => {
                second.record(hidden, seed, if events_only { Kept::Events } else { Kept::Readings })
            }
        }
    }
}

/// What sessions with nothing hidden leave, with and without raw readings.
struct References {
    as_recorded: Option<Reference>,
    events_only: Option<Reference>,
}

impl References {
    fn new(
        world: &Physics,
        nominal: &SensorModel,
        config: &BlindConfig,
        cancel: &Cancel,
    ) -> Result<Self, BlindError> {
        let measured = |events_only: bool| {
            let seeds = 0..config.references as u64;
            let record =
                |idx| world.record(&[], (config.first_seed << 20) + FIRST_REFERENCE + idx, events_only);
            let takes = seeds.map(record).collect::<Result<Vec<_>, _>>()?;
            let made = reference(&DiagnosisConfig::default(), &takes, nominal, &NoProgress, cancel);
            made.map_err(|source| failed("reference sessions", source))
        };
        let wanted = |is_wanted: bool, events_only: bool| {
            (is_wanted && config.references > 0).then(|| measured(events_only)).transpose()
        };
        Ok(Self { as_recorded: wanted(true, false)?, events_only: wanted(config.binary_only, true)? })
    }

    fn of(&self, asked: Asked) -> Option<&Reference> {
        if asked == Asked::EventsOnly { self.events_only.as_ref() } else { self.as_recorded.as_ref() }
    }
}

/// Seed of the first reference session, after that of the first round: beyond those of its cases.
const FIRST_REFERENCE: u64 = 0xF_0000;

/// Runs the bench of joint servos.
pub fn actuator(
    config: &BlindConfig,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<BlindReport, BlindError> {
    let mut sessions = Vec::new();
    for round in 0..config.seeds {
        for (idx, case) in servo_cases().into_iter().enumerate() {
            let times = if case.kind == ServoCaseKind::Null { config.nulls } else { 1 };
            let strengths = [Strength::Weak, Strength::Medium, Strength::Strong];
            let (strength, expected) = match case.kind {
                ServoCaseKind::Single(strength) => {
                    (Some(strength_name(strengths[strength])), Expected::Named)
                }
                ServoCaseKind::Pair => (None, Expected::Named),
                ServoCaseKind::Null => (None, Expected::Nothing),
                ServoCaseKind::Outside => (None, Expected::Unexplained),
            };
            let seed = (config.first_seed + round) << 20 | (idx as u64) << 10;
            for time in 0..times as u64 {
                let secret = Secret {
                    world: SERVOS.to_owned(),
                    label: case.label.clone(),
                    seed: seed + time,
                    hidden: case.hidden.iter().map(|id| (*id).to_owned()).collect(),
                    details: Vec::new(),
                    strength: strength.clone(),
                    expected,
                };
                sessions.push((secret, case.truth.clone()));
            }
        }
    }
    let diagnosed = |secret: &Secret, truth: &ServoTruth, asked: Asked| {
        let logs = record_servo(truth, secret.seed);
        let config = ActuatorConfig { without: without(secret, asked), ..ActuatorConfig::default() };
        let outcome = diagnose_actuator(&config, &logs, &NoProgress, cancel, &|| 0.0);
        let outcome = outcome.map_err(|source| failed(&secret.label, source))?;
        Ok(Answer::new(secret, asked, outcome.report))
    };
    run(sessions, config, false, progress, cancel, &diagnosed)
}

/// The world of the servos, in answers.
const SERVOS: &str = "servos";

/// Diagnoses each of `sessions`, side by side, in every way that `config` asks for, and scores the answers.
fn run<T: Sync>(
    mut sessions: Vec<(Secret, T)>,
    config: &BlindConfig,
    events_only: bool,
    progress: &dyn Progress,
    cancel: &Cancel,
    diagnosed: &(dyn Fn(&Secret, &T, Asked) -> Result<Answer, BlindError> + Sync),
) -> Result<BlindReport, BlindError> {
    sessions.retain(|(secret, _)| config.wants(&secret.label));
    if sessions.is_empty() {
        return Err(BlindError::NoCase(config.only.clone()));
    }
    let answers = Answers::open(config.answers.as_deref())?;
    let asked = sessions.iter().flat_map(|(secret, truth)| {
        let left_out = config.leave_out && secret.to_leave_out().is_some();
        let ways = [(Asked::AsRecorded, true), (Asked::EventsOnly, events_only), (Asked::LeftOut, left_out)];
        ways.into_iter().filter(|(_, is_asked)| *is_asked).map(move |(asked, _)| (secret, truth, asked))
    });
    let asked: Vec<_> = asked.collect();
    let asked_count = asked.len();
    let num_begun = AtomicUsize::new(0);
    let answer = |&(secret, truth, asked): &(&Secret, &T, Asked)| {
        let begun = num_begun.fetch_add(1, Ordering::Relaxed);
        let (fraction, count) = (begun as f64 / asked_count as f64, asked_count);
        progress.report(fraction, &format!("diagnosis {} of {count}: {}", begun + 1, secret.label));
        if cancel.is_cancelled() {
            return Err(BlindError::Cancelled);
        }
        if let Some(known) = answers.find(secret, asked) {
            return Ok(known);
        }
        let answer = diagnosed(secret, truth, asked)?;
        answers.add(&answer)?;
        Ok(answer)
    };
    let answers: Vec<Answer> = asked.par_iter().with_max_len(1).map(answer).collect::<Result<_, _>>()?;
    progress.report(1.0, "done");
    Ok(BlindReport::new(&answers))
}

/// Effects to leave out of the library.
fn without(secret: &Secret, asked: Asked) -> Vec<String> {
    secret.to_leave_out().filter(|_| asked == Asked::LeftOut).cloned().into_iter().collect()
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

/// Leaves of `take` what a device would have recorded that reports events only.
fn take_raw_away(take: &mut Take) {
    for stream in &mut take.streams {
        stream.raw.clear();
        stream.reference.clear();
        stream.later_references.clear();
        stream.axes = AxesLog::default();
    }
}
