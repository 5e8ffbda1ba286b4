//! The report on an actuator.

use std::collections::BTreeMap;

use palpate_reports::{
    Bar, Candidate, Cell, DiagnosisReport, Gap, NamedEffect, Rival, Unexplained, Verdict, WaterfallStep,
};
use palpate_sim::actuator;
use palpate_sim::effects::Effect;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::domain::{DEFAULT_GAIN, DEFAULT_SUPPLY_V, SIGNAL_NAMES};
use super::experiment::{Rivals, Telling};
use super::friction::{self, FrictionRival};
use super::{ACTUATOR_BAR, ActuatorConfig, ActuatorDomain, FIT_STEPS, adequacy, at_bound, deployed};
use crate::DiagnosisError;
use crate::engine::{Model, Naming, Round, refit};
use crate::steps::{in_doubt, interval};

/// Speed below which a joint holds, rad/s.
const HOLDING_RAD_PER_S: f64 = 0.05;
/// Share of the excess that the reported cells hold.
const CELLS_SHARE: f64 = 0.8;
/// The step that adds Coulomb friction, viscous friction and an offset of the encoder, which every servo has a little
/// of.
const TRIMS_STEP: &str = "constants_of_every_servo";
/// The three states of motion.
const PHASES: [&str; 3] = ["moving", "holding", "reversing"];

/// Everything that a report is made of.
pub(super) struct Evidence<'a> {
    pub(super) config: &'a ActuatorConfig,
    pub(super) domain: &'a ActuatorDomain<'a>,
    pub(super) naming: &'a Naming,
    pub(super) nominal: &'a Model,
    /// Calibrated, then with one more effect each, fitted to windows.
    pub(super) steps: &'a [Model],
    /// The same, fitted to whole logs.
    pub(super) deployed: &'a [Model],
    /// The last of these with what every servo has a little of; without names none, or with friction of no name.
    pub(super) trimmed: Option<&'a Model>,
    pub(super) fitted: &'a [usize],
    pub(super) confirm: &'a [usize],
    /// Loss of a row by signal on the fitted logs, in variances.
    pub(super) losses: &'a [f64],
    /// Ids of effects that fitted only at the end of their bounds.
    pub(super) refused: &'a [String],
    pub(super) seconds: f64,
}

pub(super) fn report(evidence: &Evidence<'_>) -> Result<DiagnosisReport, DiagnosisError> {
    let Evidence {
        config, domain, naming, nominal, steps, deployed, trimmed, fitted, confirm, losses, ..
    } = *evidence;
    let judged_on = if confirm.is_empty() { fitted } else { confirm };
    let mut models = vec![nominal];
    models.extend(deployed);
    models.extend(trimmed);
    let errors: Vec<Vec<f64>> =
        models.iter().map(|model| log_errors(domain, model, judged_on)).collect::<Result<_, _>>()?;
    let fitted_errors: Vec<f64> = [nominal, &deployed[0], models[models.len() - 1]]
        .into_iter()
        .map(|model| mean_error(domain, model, fitted))
        .collect::<Result<_, DiagnosisError>>()?;
    let last = errors.len() - 1;
    let gap =
        |gaps: [f64; 3]| Gap { nominal: gaps[0], calibrated: gaps[1], diagnosed: gaps[2], noise_floor: None };
    let held_out = gap([mean(&errors[0]), mean(&errors[1]), mean(&errors[last])]);
    let last_step = &steps[steps.len() - 1];
    let frictions = friction::rivals(domain, last_step, fitted, &config.without)?;
    let effects: Vec<NamedEffect> = last_step
        .effects
        .iter()
        .enumerate()
        .map(|(idx, effect)| {
            named(evidence, &frictions, effect, idx, judged_on, [&errors[idx + 1], &errors[idx + 2]])
        })
        .collect::<Result<_, DiagnosisError>>()?;
    let left_in: Vec<&str> = adequacy::left(losses).map(|signal| SIGNAL_NAMES[signal]).collect();
    let left = !left_in.is_empty();
    let verdict = match (effects.is_empty(), left) {
        (true, true) => Verdict::Unexplained,
        (true, false) => Verdict::NoDiscrepancy,
        (false, true) => Verdict::PartlyExplained,
        (false, false) => Verdict::Explained,
    };
    let waterfall = errors
        .iter()
        .enumerate()
        .map(|(idx, errors)| WaterfallStep {
            step: match idx {
                0 => "nominal".to_owned(),
                1 => "calibrated".to_owned(),
                _ => effects.get(idx - 2).map_or(TRIMS_STEP, |effect| effect.id.as_str()).to_owned(),
            },
            gap: mean(errors),
            interval_95: bootstrap(errors, config),
        })
        .collect();
    let cells_after = cells(domain, &steps[steps.len() - 1], judged_on, config)?;
    let mut notes = Vec::new();
    if left {
        notes
            .push(format!("more is left than a complete model leaves: of the {}", left_in.join(", of the ")));
    }
    if confirm.is_empty() {
        notes.push("no log is held out: the figures are from the logs that were fitted".to_owned());
    }
    for id in evidence.refused {
        notes.push(format!(
            "{id} fits only at the end of its bounds, which no real servo has: it stands in for something else and is not named"
        ));
    }
    for effect in &models[models.len() - 1].effects {
        if at_bound(domain, effect) {
            notes.push(format!(
                "{} ends where it may go no further in the fit of whole logs: treat its size with care",
                effect.id
            ));
        }
    }
    for effect in &naming.dropped {
        notes.push(format!(
            "{} was named at first and dropped when later effects accounted for it",
            effect.id
        ));
    }
    for effect in &effects {
        if effect.gap_after >= effect.gap_before && effect.id != "integer_wrap" {
            notes.push(format!(
                "{} is needed to explain short windows of the fitted logs, but does not lower the open-loop error on \
                 the held-out logs: treat its size with care",
                effect.id
            ));
        }
    }
    for effect in &effects {
        let mut kinds: Vec<&str> = vec![&effect.id];
        kinds.extend(
            frictions.iter().filter(|rival| rival.of == effect.id).map(|rival| rival.effect.id.as_str()),
        );
        if kinds.len() > 1 {
            notes.push(format!(
                "friction is missing, of a kind that these logs do not tell: it may be {}",
                kinds.join(" or ")
            ));
        }
    }
    notes.extend(assumed(domain));
    let is_of_no_name = effects.is_empty() && trimmed.is_some();
    let rivals = if is_of_no_name {
        friction::likeliest(domain, last_step, fitted, &config.without)?
    } else {
        rivals(evidence, &frictions)?
    };
    let telling = rivals.map(|rivals| Telling::new(domain, &rivals)).transpose()?.flatten();
    notes.extend(telling.as_ref().and_then(Telling::note));
    let first = &naming.rounds[0];
    let ids = |takes: &[usize]| takes.iter().map(|&take| domain.log(take).id.clone()).collect::<Vec<_>>();
    Ok(DiagnosisReport {
        verdict,
        sentence: sentence(verdict, &effects, is_of_no_name, &held_out, judged_logs(confirm)),
        candidates: first
            .tried
            .iter()
            .enumerate()
            .filter(|&(idx, _)| first.named != Some(idx))
            .map(|(_, tried)| Candidate {
                id: tried.effect.id.clone(),
                place: tried.effect.place.clone(),
                parameters: tried.effect.parameters.clone(),
                evidence: tried.evidence,
                share_removed: tried.share,
                explanation: explain(&tried.effect),
            })
            .collect(),
        next_experiment: telling.and_then(Telling::next_experiment),
        effects,
        in_doubt: in_doubt(naming),
        cells: cells(domain, &steps[0], judged_on, config)?,
        fitted: gap([fitted_errors[0], fitted_errors[1], fitted_errors[2]]),
        gap: held_out.clone(),
        unexplained: Unexplained {
            fraction: if held_out.calibrated > 0.0 {
                (held_out.diagnosed / held_out.calibrated).clamp(0.0, 1.0)
            } else {
                0.0
            },
            significant: left,
            cells: cells_after,
            ..Unexplained::default()
        },
        held_out,
        waterfall,
        metrics: BTreeMap::new(),
        residual_map: Vec::new(),
        takes: BTreeMap::from([("fit".to_owned(), ids(fitted)), ("confirm".to_owned(), ids(judged_on))]),
        bar: Bar { evidence: config.bar.unwrap_or(ACTUATOR_BAR), ..Bar::default() },
        reference_sessions: None,
        notes,
        seconds: evidence.seconds,
    })
}

/// Mean absolute position error of an open-loop rollout of each log, rad.
fn log_errors(
    domain: &ActuatorDomain<'_>,
    model: &Model,
    takes: &[usize],
) -> Result<Vec<f64>, DiagnosisError> {
    takes
        .iter()
        .map(|&take| {
            let measured = &domain.log(take).positions_rad;
            let predicted = domain.open_loop(take, model)?;
            let sum: f64 = measured.iter().zip(&predicted).map(|(m, p)| (m - p).abs()).sum();
            Ok(sum / measured.len() as f64)
        })
        .collect()
}

/// Mean absolute position error of open-loop rollouts, mean over `takes`, rad.
pub(super) fn mean_error(
    domain: &ActuatorDomain<'_>,
    model: &Model,
    takes: &[usize],
) -> Result<f64, DiagnosisError> {
    Ok(mean(&log_errors(domain, model, takes)?))
}

/// What the logs do not state, and what was taken instead.
fn assumed(domain: &ActuatorDomain<'_>) -> Vec<String> {
    let log = domain.log(0);
    let mut notes = Vec::new();
    if log.position_gain_register.is_none() {
        notes.push(format!(
            "the logs state no position gain: {DEFAULT_GAIN:.0} was assumed, and gain_error is what the drive's \
             differs by"
        ));
    }
    if log.supply_v.is_none() {
        notes.push(format!("the logs state no supply voltage: {DEFAULT_SUPPLY_V:.0} V were assumed"));
    }
    notes
}

/// Two models that explain the fitted logs alike: those of the first name that has a rival.
fn rivals(evidence: &Evidence<'_>, frictions: &[FrictionRival]) -> Result<Option<Rivals>, DiagnosisError> {
    let Evidence { domain, naming, steps, fitted, .. } = *evidence;
    let is_kept = |round: &Round| {
        let named = round.named.map(|named| &round.tried[named].effect.id);
        naming.model.effects.iter().any(|effect| Some(&effect.id) == named)
    };
    if let Some(round) = naming.rounds.iter().find(|round| round.class.len() > 1 && is_kept(round)) {
        let with = |member: usize| {
            let mut model = round.before.clone();
            model.effects.push(round.tried[member].effect.clone());
            refit(domain, &model, fitted, FIT_STEPS)
        };
        let ids = [0, 1].map(|member| round.tried[round.class[member]].effect.id.clone());
        return Ok(Some(Rivals { ids, models: [with(round.class[0])?, with(round.class[1])?] }));
    }
    Ok(frictions.first().map(|rival| Rivals {
        ids: [rival.of.clone(), rival.effect.id.clone()],
        models: [steps[steps.len() - 1].clone(), rival.model.clone()],
    }))
}

fn named(
    evidence: &Evidence<'_>,
    frictions: &[FrictionRival],
    effect: &Effect,
    idx: usize,
    judged_on: &[usize],
    [before, after]: [&[f64]; 2],
) -> Result<NamedEffect, DiagnosisError> {
    let Evidence { config, domain, naming, steps, fitted, .. } = *evidence;
    let round = naming.round_of(effect);
    let (mut class, mut rivals) = (vec![effect.id.clone()], Vec::new());
    let (gap_before, gap_after) = (mean(before), mean(after));
    let of_round: Vec<&Effect> = round.map_or_else(Vec::new, |(round, named)| {
        let others = round.class.iter().filter(|&&member| member != named);
        others.map(|&member| &round.tried[member].effect).collect()
    });
    let of_friction = frictions.iter().filter(|rival| rival.of == effect.id).map(|rival| &rival.effect);
    for rival in of_round.into_iter().chain(of_friction) {
        if class.contains(&rival.id) {
            continue;
        }
        let mut with = steps[idx + 1].clone();
        with.effects[idx] = rival.clone();
        let with = deployed(domain, &refit(domain, &with, fitted, FIT_STEPS)?, None, fitted, config)?;
        class.push(rival.id.clone());
        rivals.push(Rival {
            id: rival.id.clone(),
            place: rival.place.clone(),
            gap_after: mean_error(domain, &with, judged_on)?,
        });
    }
    let strength = naming.evidence.get(idx).copied().unwrap_or(0.0);
    let improved = before.iter().zip(after).filter(|(before, after)| after < before).count();
    Ok(NamedEffect {
        id: effect.id.clone(),
        place: effect.place.clone(),
        parameters: effect.parameters.clone(),
        interval: naming
            .standard_errors
            .get(idx)
            .map_or_else(BTreeMap::new, |errors| interval(domain, effect, errors)),
        gap_before,
        gap_after,
        // No log is simulated with nothing missing, from which it would come.
        p_value: None,
        evidence: strength,
        takes_improved: format!("{improved}/{}", before.len()),
        class,
        rivals,
        explanation: explain(effect),
    })
}

fn explain(effect: &Effect) -> String {
    actuator::actuator(&effect.id).map_or_else(String::new, |kind| kind.explain(effect))
}

/// What the logs are that figures are from, where these are to confirm.
fn judged_logs(confirm: &[usize]) -> &'static str {
    if confirm.is_empty() { "the fitted logs" } else { "logs not fitted to" }
}

fn sentence(
    verdict: Verdict,
    effects: &[NamedEffect],
    is_friction_of_no_name: bool,
    gap: &Gap,
    judged_logs: &str,
) -> String {
    if is_friction_of_no_name {
        return format!(
            "Friction is missing from the model, of a kind that these logs do not tell. With dry and viscous \
             friction of no name the position error on {judged_logs} is {:.1} mrad instead of {:.1} mrad.",
            gap.diagnosed * 1e3,
            gap.calibrated * 1e3
        );
    }
    let removed = if gap.calibrated > 0.0 { 100.0 * (1.0 - gap.diagnosed / gap.calibrated) } else { 0.0 };
    let names: Vec<&str> = effects.iter().map(|effect| effect.id.as_str()).collect();
    let found = format!(
        "Missing from the model: {}. Position error on {judged_logs}: {:.1} mrad instead of {:.1} mrad \
         ({removed:.0} % less)",
        names.join(", "),
        gap.diagnosed * 1e3,
        gap.calibrated * 1e3
    );
    match verdict {
        Verdict::Explained => format!("{found}."),
        Verdict::PartlyExplained => format!("{found}; something is left that no effect accounts for."),
        Verdict::Unexplained => {
            "Model and servo differ in a way that no effect of the library accounts for.".to_owned()
        }
        Verdict::NoDiscrepancy | Verdict::CannotBeJudged => {
            "Model and servo agree within what the encoder can tell.".to_owned()
        }
    }
}

/// Excess by state of motion: absolute error that windows of `takes` gather, and its sign along the motion.
fn cells(
    domain: &ActuatorDomain<'_>,
    model: &Model,
    takes: &[usize],
    config: &ActuatorConfig,
) -> Result<Vec<Cell>, DiagnosisError> {
    let mut excess = [0.0; PHASES.len()];
    let mut signed: [Vec<f64>; PHASES.len()] = Default::default();
    let mut seen: [Vec<String>; PHASES.len()] = Default::default();
    for &take in takes {
        let log = domain.log(take);
        let shot = domain.shot(take, model)?;
        let starts: Vec<_> = domain.windows(take).collect();
        for (idx, (samples, start)) in starts.iter().enumerate() {
            let next = starts.get(idx + 1).map_or(start.speed_rad_per_s, |(_, next)| next.speed_rad_per_s);
            let speed = start.speed_rad_per_s;
            let phase = if speed.abs().max(next.abs()) < HOLDING_RAD_PER_S {
                1
            } else if speed * next < 0.0 {
                2
            } else {
                0
            };
            let residuals = samples.clone().map(|idx| log.positions_rad[idx] - shot[idx]);
            let sum: f64 = residuals.clone().sum();
            excess[phase] += residuals.map(f64::abs).sum::<f64>();
            signed[phase].push(sum / samples.len() as f64 * if speed + next < 0.0 { -1.0 } else { 1.0 });
            if !seen[phase].contains(&log.id) {
                seen[phase].push(log.id.clone());
            }
        }
    }
    let total: f64 = excess.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let mut order: Vec<usize> = (0..PHASES.len()).collect();
    order.sort_by(|&a, &b| excess[b].total_cmp(&excess[a]));
    let (mut cells, mut held) = (Vec::new(), 0.0);
    for phase in order {
        if held >= CELLS_SHARE || signed[phase].len() < 2 {
            continue;
        }
        held += excess[phase] / total;
        let values = &signed[phase];
        let deviation =
            (values.iter().map(|v| (v - mean(values)).powi(2)).sum::<f64>() / values.len() as f64).sqrt();
        cells.push(Cell {
            stream: None,
            channels: vec!["position".to_owned()],
            joints: vec![domain.log(0).joint.clone()],
            phase: PHASES[phase].to_owned(),
            takes: seen[phase].clone(),
            excess: excess[phase] / total,
            effect_size: if deviation > 0.0 { mean(values) / deviation } else { 0.0 },
            p_value: sign_flips(values, config),
        });
    }
    Ok(cells)
}

/// Probability of a mean this far from zero if signs were chance.
fn sign_flips(values: &[f64], config: &ActuatorConfig) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let found = mean(values).abs();
    let num_flips = config.resamples.max(1);
    let as_far = (0..num_flips)
        .filter(|_| {
            let flipped: f64 = values.iter().map(|v| if rng.random_bool(0.5) { -v } else { *v }).sum();
            (flipped / values.len() as f64).abs() >= found
        })
        .count();
    (1 + as_far) as f64 / (1 + num_flips) as f64
}

/// 95 % interval of the mean over logs; `None` for fewer than four.
fn bootstrap(errors: &[f64], config: &ActuatorConfig) -> Option<[f64; 2]> {
    if errors.len() < 4 || config.resamples < 100 {
        return None;
    }
    Some(mean_interval_95(errors, config.resamples, config.seed))
}

/// 95 % interval of the mean from resampling `values`, of which there must be some.
pub fn mean_interval_95(values: &[f64], resamples: usize, seed: u64) -> [f64; 2] {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut resampled = || {
        let sum: f64 = values.iter().map(|_| values[rng.random_range(0..values.len())]).sum();
        sum / values.len() as f64
    };
    let mut means: Vec<f64> = (0..resamples.max(1)).map(|_| resampled()).collect();
    means.sort_unstable_by(f64::total_cmp);
    [0.025, 0.975].map(|share| means[((means.len() - 1) as f64 * share).round() as usize])
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
