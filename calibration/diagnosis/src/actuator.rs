//! The diagnosis of an actuator: goal position in, joint position out.
//!
//! The engine and its rules are those of touch; [`ActuatorDomain`] says what is measured and what a model predicts, and
//! the gap is the mean absolute position error when the model is driven through a whole log without looking at it.

mod adequacy;
mod domain;
mod experiment;
mod friction;
mod open_loop;
mod report;

use palpate_recording::ServoLog;
use palpate_reports::DiagnosisReport;
use palpate_sim::actuator::ACTUATOR;
use palpate_sim::effects::{Effect, Parameter};
use palpate_sim::job::{Cancel, Progress};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

pub use domain::ActuatorDomain;
pub use report::mean_interval_95;

use crate::DiagnosisError;
use crate::engine::{self, Domain, Model, NamingConfig, huber};
use open_loop::{OpenLoop, Trims};

/// Which logs are kept for the final judgement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LogHoldOut {
    /// Those of the middle position gain where there are three or more gains, else every fourth log.
    Auto,
    /// None.
    None,
    /// Those whose field has a value, e.g. `kp` `400`.
    Field {
        /// Name of the field.
        field: String,
        /// Its value, as text.
        value: String,
    },
}

impl std::str::FromStr for LogHoldOut {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.split_once('=')) {
            ("auto", _) => Ok(Self::Auto),
            ("none", _) => Ok(Self::None),
            (_, Some((field, value))) if !field.is_empty() && !value.is_empty() => {
                Ok(Self::Field { field: field.to_owned(), value: value.to_owned() })
            }
            _ => Err(format!("{text:?} is no FIELD=VALUE, as in kp=400; or say auto or none")),
        }
    }
}

/// What to do.
#[derive(Clone, Debug)]
pub struct ActuatorConfig {
    /// Confirm logs: opened once, for the report.
    pub hold_out: LogHoldOut,
    /// Most effects to name.
    pub max_effects: usize,
    /// Effects to leave out of the library, by id.
    pub without: Vec<String>,
    /// Evidence that a name needs; `None` is the shipped bar.
    pub bar: Option<f64>,
    /// Starts of each fit of a whole model.
    pub starts: usize,
    /// Resamples behind intervals and p-values.
    pub resamples: usize,
    /// Seed of starts and resamples.
    pub seed: u64,
}

impl Default for ActuatorConfig {
    fn default() -> Self {
        Self {
            hold_out: LogHoldOut::Auto,
            max_effects: 6,
            without: Vec::new(),
            bar: None,
            starts: 6,
            resamples: 1000,
            seed: 0,
        }
    }
}

/// What a diagnosis of an actuator found.
#[derive(Clone, Debug)]
pub struct ActuatorOutcome {
    /// The report.
    pub report: DiagnosisReport,
    /// The diagnosed model: torque constant, resistance, supply factor, Coulomb friction, viscous friction, encoder
    /// offset, then the named effects, fitted to whole logs.
    pub model: Model,
    /// Highest evidence of any effect in the first round.
    pub first_evidence: f64,
    /// Loss of a row by signal (position, PWM, supply voltage, sign of the PWM) on the fitted logs, in variances.
    pub losses: Vec<f64>,
}

/// The shipped bar: four standard errors beyond the smallest size that matters.
pub const ACTUATOR_BAR: f64 = 16.0;
/// Share of the loss that a named effect removes at least.
const LEAST_SHARE: f64 = 0.005;
/// Steps of the first fit and of each restart.
const FIT_STEPS: usize = 12;
/// Share of the position error that a model with friction of no name must not exceed, for friction to be what is
/// missing.
const MOST_WITHOUT_FRICTION: f64 = 0.5;
/// Starts of a fit of whole logs: that of windows is near.
const DEPLOYED_STARTS: usize = 3;

/// Diagnoses the actuator that `logs` are of.
///
/// All but the report's `seconds`, which `clock_s` gives, depends on the arguments alone, to the bit, for any number of
/// threads.
pub fn diagnose_actuator(
    config: &ActuatorConfig,
    logs: &[ServoLog],
    progress: &dyn Progress,
    cancel: &Cancel,
    clock_s: &(dyn Fn() -> f64 + Sync),
) -> Result<ActuatorOutcome, DiagnosisError> {
    let start_s = clock_s();
    let watch = |fraction: f64, stage: &str| {
        progress.report(fraction, stage);
        if cancel.is_cancelled() { Err(DiagnosisError::Cancelled) } else { Ok(()) }
    };
    watch(0.0, "cutting logs into windows")?;
    check(config, logs)?;
    let confirm = held_out(&config.hold_out, logs)?;
    let fitted: Vec<usize> = (0..logs.len()).filter(|idx| !confirm.contains(idx)).collect();
    let domain = ActuatorDomain::new(logs)?;
    let nominal = domain.nominal();
    watch(0.02, "fitting the motor")?;
    let calibrated = fit_well(&domain, &nominal, &fitted, config)?;
    let bar = config.bar.unwrap_or(ACTUATOR_BAR);
    let naming_config = NamingConfig {
        max_effects: config.max_effects,
        bar,
        kept_bar: bar,
        least_share: LEAST_SHARE,
        // All of them, they are few.
        num_fits: ACTUATOR.len(),
        without: config.without.clone(),
    };
    let (mut naming_config, mut refused) = (naming_config, Vec::new());
    let mut naming = loop {
        let naming = engine::name(&domain, &calibrated, &fitted, &naming_config, &|fraction, stage| {
            watch(0.1 + 0.6 * fraction, stage)
        })?;
        // An effect that fits only at the end of what makes sense stands in for something else.
        let Some(at_bound) = naming.model.effects.iter().find(|effect| at_bound(&domain, effect)) else {
            break naming;
        };
        refused.push(at_bound.id.clone());
        naming_config.without.push(at_bound.id.clone());
    };
    // The models as deployed: the motor alone, then with one more effect each, every one fitted from several starts.
    let mut steps = vec![calibrated];
    loop {
        let num_effects = naming.model.effects.len();
        for count in steps.len()..=num_effects {
            watch(0.7 + 0.2 * count as f64 / num_effects as f64, "fitting from several starts")?;
            let partial =
                Model { base: naming.model.base.clone(), effects: naming.model.effects[..count].to_vec() };
            steps.push(fit_well(&domain, &partial, &fitted, config)?);
        }
        let Some((inadequate, why)) = adequacy::inadequate(&domain, &steps, &fitted)? else { break };
        naming.withhold_one(&domain, inadequate, &fitted, why)?;
        steps.truncate(inadequate + 1);
    }
    watch(0.9, "fitting whole logs")?;
    let losses = adequacy::losses(&domain, &steps[steps.len() - 1], &fitted)?;
    let whole = |model: &Model, trims| deployed(&domain, model, trims, &fitted, config);
    let deployed: Vec<Model> =
        steps.iter().map(|step| whole(step, None)).collect::<Result<_, DiagnosisError>>()?;
    let errors = |model: &Model| report::mean_error(&domain, model, &fitted);
    let trimmed = match &steps[..] {
        [_, .., last] => Some(whole(last, Some(Trims::default()))?),
        // Beside no name they would stand in for one, unless it is friction that was named and taken back.
        _ if naming.withheld.iter().any(|withheld| friction::is_friction(&withheld.effect)) => {
            let [dry_nm, viscous_nm_s_per_rad] = friction::of_no_name(&domain, &steps[0], &fitted)?;
            let with_friction = whole(&steps[0], Some([dry_nm, viscous_nm_s_per_rad, 0.0]))?;
            let removes_most = errors(&with_friction)? < MOST_WITHOUT_FRICTION * errors(&deployed[0])?;
            removes_most.then_some(with_friction)
        }
        _ => None,
    };
    watch(0.96, "judging on logs that nothing was fitted to")?;
    let last = trimmed.as_ref().unwrap_or(&deployed[deployed.len() - 1]).clone();
    let first_evidence = naming.rounds[0].tried.iter().map(|tried| tried.evidence).fold(0.0, f64::max);
    let report = report::report(&report::Evidence {
        config,
        domain: &domain,
        naming: &naming,
        nominal: &nominal,
        steps: &steps,
        deployed: &deployed,
        trimmed: trimmed.as_ref(),
        fitted: &fitted,
        confirm: &confirm,
        losses: &losses,
        refused: &refused,
        seconds: clock_s() - start_s,
    })?;
    progress.report(1.0, "done");
    Ok(ActuatorOutcome { report, model: last, first_evidence, losses })
}

/// Fits `model` to `takes` from itself and from points around it, and keeps the best: a fit that has not converged turns
/// the ranking of models round.
fn fit_well<D: Domain>(
    domain: &D,
    model: &Model,
    takes: &[usize],
    config: &ActuatorConfig,
) -> Result<Model, DiagnosisError> {
    let fits: Vec<(f64, Model)> = (0..config.starts.max(1))
        .into_par_iter()
        .map(|start| {
            let mut rng = ChaCha8Rng::seed_from_u64(config.seed ^ (start as u64) << 32);
            let mut from = model.clone();
            if start > 0 {
                for (value, parameter) in from.base.iter_mut().zip(domain.base()) {
                    *value = (*value * rng.random_range(0.7..1.4)).clamp(parameter.lower, parameter.upper);
                }
                for effect in &mut from.effects {
                    for parameter in domain.parameters(effect) {
                        let value = effect.parameter(&parameter.name) * rng.random_range(0.3..1.8);
                        effect
                            .parameters
                            .insert(parameter.name, value.clamp(parameter.lower, parameter.upper));
                    }
                }
            }
            let fit = engine::refit(domain, &from, takes, FIT_STEPS)?;
            Ok((loss(domain, &fit, takes)?, fit))
        })
        .collect::<Result<_, DiagnosisError>>()?;
    let best = fits.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
    Ok(best.map_or_else(|| model.clone(), |(_, fit)| fit))
}

/// `model` as a simulator drives it: fitted to whole logs, with what every servo has a little of, from there on, or
/// without.
fn deployed(
    domain: &ActuatorDomain<'_>,
    model: &Model,
    trims: Option<Trims>,
    takes: &[usize],
    config: &ActuatorConfig,
) -> Result<Model, DiagnosisError> {
    let config = ActuatorConfig { starts: config.starts.min(DEPLOYED_STARTS), ..config.clone() };
    let start = OpenLoop::start(model, trims.unwrap_or_default());
    fit_well(&OpenLoop::new(domain, model, trims.is_some()), &start, takes, &config)
}

/// Whether a parameter of `effect` ended where it may go no further. Effects that are there or not are, at their end.
fn at_bound(domain: &ActuatorDomain<'_>, effect: &Effect) -> bool {
    let parameters = domain.parameters(effect);
    let is_there = |parameter: &Parameter| effect.parameter(&parameter.name) != parameter.neutral;
    let some_is_there = parameters.iter().any(is_there);
    parameters.iter().filter(|parameter| is_there(parameter) || !some_is_there).any(|parameter| {
        let value = effect.parameter(&parameter.name);
        let there_or_not = parameter.dose == parameter.upper - parameter.neutral;
        let margin = 1e-6 * (parameter.upper - parameter.lower);
        !there_or_not && (value >= parameter.upper - margin || value <= parameter.lower + margin)
    })
}

/// Huber's loss of the residuals of `model`.
fn loss<D: Domain>(domain: &D, model: &Model, takes: &[usize]) -> Result<f64, DiagnosisError> {
    let mut sum = 0.0;
    for &take in takes {
        let predicted = domain.predict(take, model)?;
        for (signal, predicted) in predicted.iter().enumerate() {
            let weights = domain.weights(take, signal, predicted);
            let rows = domain.observed(take, signal).iter().zip(predicted.iter()).zip(&weights);
            for ((observed, predicted), weight) in rows {
                if !observed.is_nan() {
                    sum += huber((observed - predicted) * weight);
                }
            }
        }
    }
    Ok(sum)
}

fn check(config: &ActuatorConfig, logs: &[ServoLog]) -> Result<(), DiagnosisError> {
    if let (Some(first), Some(other)) = (logs.first(), logs.iter().find(|log| log.joint != logs[0].joint)) {
        return Err(DiagnosisError::Input(format!(
            "log {:?} is of {:?}, but log {:?} is of {:?}; diagnose the logs of one actuator at a time",
            other.id, other.joint, first.id, first.joint
        )));
    }
    for id in &config.without {
        if palpate_sim::actuator::actuator(id).is_none() {
            let known: Vec<&str> = ACTUATOR.iter().map(|kind| kind.id()).collect();
            return Err(DiagnosisError::Input(format!(
                "there is no effect {id:?} to leave out; the library has {}",
                known.join(", ")
            )));
        }
    }
    Ok(())
}

fn held_out(hold_out: &LogHoldOut, logs: &[ServoLog]) -> Result<Vec<usize>, DiagnosisError> {
    let with = |field: &str, value: &str| -> Vec<usize> {
        // As numbers where both are: 400 is 400.0.
        let same = |text: &String| match (text.parse::<f64>(), value.parse::<f64>()) {
            (Ok(a), Ok(b)) => a == b,
            _ => text == value,
        };
        (0..logs.len()).filter(|&idx| logs[idx].fields.get(field).is_some_and(same)).collect()
    };
    match hold_out {
        LogHoldOut::None => Ok(Vec::new()),
        LogHoldOut::Auto => {
            let mut gains: Vec<f64> = logs.iter().filter_map(|log| log.position_gain_register).collect();
            gains.sort_by(f64::total_cmp);
            gains.dedup();
            if gains.len() >= 3 {
                let middle = gains[gains.len() / 2];
                return Ok((0..logs.len())
                    .filter(|&idx| logs[idx].position_gain_register == Some(middle))
                    .collect());
            }
            Ok((0..logs.len()).filter(|idx| idx % 4 == 3).collect())
        }
        LogHoldOut::Field { field, value } => {
            let found = with(field, value);
            if found.is_empty() || found.len() == logs.len() {
                let mut known: Vec<String> = logs
                    .iter()
                    .filter_map(|log| log.fields.get(field).map(|value| format!("{field}={value}")))
                    .collect();
                known.sort();
                known.dedup();
                let choices =
                    if known.is_empty() { "no log has that field".to_owned() } else { known.join(", ") };
                return Err(DiagnosisError::Input(format!(
                    "holding out {field}={value} leaves {} of {} logs to judge on, but some must be held out and some \
                     fitted; choose among: {choices}",
                    found.len(),
                    logs.len()
                )));
            }
            Ok(found)
        }
    }
}

#[cfg(test)]
mod tests;
