//! The models of a diagnosis as they are deployed.

use std::collections::BTreeMap;

use palpate_recording::Take;
use palpate_reports::{Doubt, EffectInDoubt};
use palpate_robot_model::Station;
use palpate_sim::SensorModel;
use palpate_sim::effects::Effect;
use rayon::prelude::*;

use crate::DiagnosisError;
use crate::engine::{Domain, Fit, Model, Naming, Nearby, Tried};
use crate::fired::{self, Fired, InForce, Withheld};
use crate::tactile::judge::{Judged, flickering, judge, set_thresholds};
use crate::tactile::{Observed, TactileDomain};

/// What the names of diagnosed models end with.
const DIAGNOSED: &str = ", diagnosed";
/// Frames that may be mistaken with the names, over those with a model that had effects already.
pub(crate) const MOST_MISTAKEN: f64 = 1.0;

/// Models as deployed: calibrated, then with one more effect each.
pub(crate) struct Steps {
    /// Indices of the confirm takes; all takes where none is held out.
    pub(crate) confirm: Vec<usize>,
    /// The calibrated model first.
    pub(crate) models: Vec<SensorModel>,
    /// Responses of the model with every name.
    nearby: Nearby,
}

impl Steps {
    pub(crate) fn new(
        station: &Station,
        domain: &TactileDomain<'_>,
        naming: &Naming,
        fitted: &[usize],
        calibrated: &SensorModel,
        takes: &[Take],
    ) -> Result<Self, DiagnosisError> {
        let mut confirm: Vec<usize> = (0..takes.len()).filter(|idx| !fitted.contains(idx)).collect();
        if confirm.is_empty() {
            confirm = (0..takes.len()).collect();
        }
        let ids: Vec<String> = fitted.iter().map(|&take| takes[take].id.clone()).collect();
        let first = naming.rounds.first().map_or(0, |round| round.before.effects.len());
        let all = naming.model.effects.len();
        let has_steps = all > first;
        let nearby = if has_steps { Nearby::to(domain, &naming.model, fitted)? } else { Nearby::default() };
        let step = |count: usize| -> Result<SensorModel, DiagnosisError> {
            // The effects in the order of the final model, each step with the parameters of a fit of its own.
            let partial =
                Model { base: naming.model.base.clone(), effects: naming.model.effects[..count].to_vec() };
            let partial = if count == all {
                partial
            } else {
                Fit::roughly().near(&nearby).of(domain, &partial, fitted)?
            };
            let effects = described(domain, naming, &partial.effects, &ids, first);
            let mut model = deployed(station, domain, &partial, effects, calibrated, fitted)?;
            model.provenance.push(format!(
                "effects named by palpate {} on takes {}",
                env!("CARGO_PKG_VERSION"),
                ids.join(", ")
            ));
            Ok(model)
        };
        let mut models = vec![calibrated.clone()];
        models.extend((first + 1..=all).into_par_iter().map(step).collect::<Result<Vec<_>, _>>()?);
        Ok(Self { confirm, models, nearby })
    }

    /// The model of the step that adds the effect at `idx`, with `rival` in the place of that effect and everything
    /// fitted anew.
    pub(crate) fn with_rival(
        &self,
        station: &Station,
        domain: &TactileDomain<'_>,
        naming: &Naming,
        fitted: &[usize],
        idx: usize,
        rival: &Tried,
    ) -> Result<SensorModel, DiagnosisError> {
        let mut effects = naming.model.effects[..=idx].to_vec();
        effects[idx] = rival.effect.clone();
        let model = Model { base: naming.model.base.clone(), effects };
        let model = Fit::roughly().near(&self.nearby).of(domain, &model, fitted)?;
        deployed(station, domain, &model, model.effects.clone(), &self.models[0], fitted)
    }

    /// Fires if the last model mistakes more events on the takes `fitted` than the first, which has effects already, on
    /// channels that it does not say flicker by chance: diagnoses in a row must not make a good model worse bit by bit.
    pub(crate) fn widen_the_gap(
        &self,
        station: &Station,
        domain: &TactileDomain<'_>,
        fitted: &[usize],
        rules: InForce<'_>,
    ) -> Result<Option<Fired>, DiagnosisError> {
        let [first, .., last] = &self.models[..] else { return Ok(None) };
        if first.effects.is_empty() {
            return Ok(None);
        }
        let observed: Vec<&Observed<'_>> = fitted.iter().map(|&take| domain.take(take)).collect();
        let flickers = flickering(station, &observed, last);
        let mistaken = |model: &SensorModel| -> Result<f64, DiagnosisError> {
            let judged = judge(station, &observed, model)?;
            let by_channel = judged.iter().flat_map(|judged| judged.sums.iter().zip(&flickers));
            let frames = by_channel
                .filter(|(_, flickers)| !**flickers)
                .map(|(sum, _)| sum.false_positives + sum.false_negatives);
            Ok(frames.sum::<u64>() as f64)
        };
        let (before, after) = (mistaken(first)?, mistaken(last)?);
        Ok(rules.above(fired::GAP_GROWS, after / before.max(1.0), MOST_MISTAKEN))
    }
}

/// `model` as a file that starts from `calibrated`: with `effects`, and with thresholds set on the takes `fitted`.
fn deployed(
    station: &Station,
    domain: &TactileDomain<'_>,
    model: &Model,
    effects: Vec<Effect>,
    calibrated: &SensorModel,
    fitted: &[usize],
) -> Result<SensorModel, DiagnosisError> {
    let observed: Vec<&Observed<'_>> = fitted.iter().map(|&take| domain.take(take)).collect();
    let (theta, streams, response) = domain.theta_and_response(model);
    let name = calibrated.name.trim_end_matches(DIAGNOSED);
    let mut model = SensorModel {
        name: format!("{name}{DIAGNOSED}"),
        theta,
        streams,
        response,
        effects,
        ..calibrated.clone()
    };
    set_thresholds(station, &observed, &mut model)?;
    Ok(model)
}

/// `effects` with intervals and takes, as they go into a model file.
fn described(
    domain: &TactileDomain<'_>,
    naming: &Naming,
    effects: &[Effect],
    takes: &[String],
    first: usize,
) -> Vec<Effect> {
    let mut effects = effects.to_vec();
    for (idx, effect) in effects.iter_mut().enumerate().skip(first) {
        effect.takes = takes.to_vec();
        effect.interval = interval(domain, effect, &naming.standard_errors[idx]);
    }
    effects
}

/// 95 % intervals of the parameters of `effect`.
pub(crate) fn interval<D: Domain>(domain: &D, effect: &Effect, errors: &[f64]) -> BTreeMap<String, [f64; 2]> {
    let parameters = domain.parameters(effect);
    parameters
        .iter()
        .zip(errors)
        .map(|(parameter, error)| {
            let value = effect.parameter(&parameter.name);
            let end = |sign: f64| (value + sign * 1.96 * error).clamp(parameter.lower, parameter.upper);
            (parameter.name.clone(), [end(-1.0), end(1.0)])
        })
        .collect()
}

/// Judges each of `models` on the confirm takes.
pub(crate) fn judge_all(
    station: &Station,
    observed: &[&Observed<'_>],
    models: &[SensorModel],
) -> Result<Vec<Vec<Judged>>, DiagnosisError> {
    models.iter().map(|model| judge(station, observed, model)).collect()
}

/// What was withheld, as a report has it.
pub(crate) fn in_doubt(naming: &Naming) -> Vec<EffectInDoubt> {
    let of = |withheld: &Withheld| EffectInDoubt {
        id: withheld.effect.id.clone(),
        place: withheld.effect.place.clone(),
        parameters: withheld.effect.parameters.clone(),
        doubt: vec![Doubt {
            check: withheld.why.rule.to_owned(),
            measured: withheld.why.measured,
            limit: withheld.why.limit,
        }],
    };
    naming.withheld.iter().map(of).collect()
}
