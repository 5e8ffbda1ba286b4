//! What to name of what was tried.

use rayon::prelude::*;

use super::evidence::{SIMILAR_COUNT, founded};
use super::fit::Fit;
use super::linear::Linear;
use super::naming::{Round, Tried};
use super::{Domain, Model, NamingConfig, overlap, unite, within};
use crate::DiagnosisError;

/// Rivals explain at least this share of what the best does.
pub(crate) const RIVAL_SHARE: f64 = 0.8;
/// Rivals that are fitted along with everything else before one is named.
const MOST_CONTENDERS: usize = 3;
/// A fit that removes all but this share of what the best removes is as good.
const AS_GOOD: f64 = 0.02;

/// What is to be named.
pub(super) struct Chosen {
    /// Index in what was tried.
    pub(super) named: usize,
    /// The model with it, fitted as a whole.
    pub(super) model: Model,
    /// [`Linear::deviance`] of that model.
    pub(super) deviance: f64,
}

impl Chosen {
    /// The round in which it was chosen from what was `tried` beside the model `before`.
    pub(super) fn round(&self, before: Model, tried: Vec<Tried>) -> Round {
        let least = tried.first().map_or(0.0, |best| RIVAL_SHARE * best.held_out_gain);
        let class =
            (0..tried.len()).filter(|&idx| idx == self.named || tried[idx].held_out_gain > least).collect();
        Round { before, tried, named: Some(self.named), class }
    }
}

/// Chooses from what was `tried` beside `model`, which has this `deviance`: the best that passes and lowers it; a rival
/// that explains nearly as much with fewer parameters is the better name.
pub(super) fn choose<D: Domain>(
    domain: &D,
    model: &Model,
    deviance: f64,
    tried: &[Tried],
    takes: &[usize],
    config: &NamingConfig,
) -> Result<Option<Chosen>, DiagnosisError> {
    let passes = |tried: &Tried| tried.evidence > config.bar && tried.share > config.least_share;
    let best = tried.iter().position(passes);
    let refitted: Vec<Option<Chosen>> = contenders(tried, best, config.least_share)
        .into_par_iter()
        .map(|named| {
            let with = beside(domain, model, &tried[named]);
            let model = Fit::again().of(domain, &with, takes)?;
            let deviance = Linear::without_nuisances(domain, &model, takes)?.deviance();
            let holds = passes(&tried[named]) || founded(domain, &model, takes, config.bar)?;
            Ok(holds.then_some(Chosen { named, model, deviance }))
        })
        .collect::<Result<_, DiagnosisError>>()?;
    let better = refitted.into_iter().flatten().filter(|chosen| chosen.deviance < deviance).collect();
    simplest_of_best(domain, better, deviance, tried)
}

/// `model` with what was `tried`, and with its own parameters as they were fitted to that where it reaches.
fn beside<D: Domain>(domain: &D, model: &Model, tried: &Tried) -> Model {
    let mut with = with_base_of(domain, model, tried);
    with.effects.push(tried.effect.clone());
    with
}

/// `model` with its own parameters as they were fitted to what was `tried`, where that reaches.
pub(super) fn with_base_of<D: Domain>(domain: &D, model: &Model, tried: &Tried) -> Model {
    let reach = domain.reach(&tried.effect);
    let mut with = model.clone();
    for (idx, (value, fitted)) in with.base.iter_mut().zip(&tried.base).enumerate() {
        if overlap(&domain.base_support(idx), &reach) {
            *value = *fitted;
        }
    }
    with
}

/// What of `tried` explains something that has nothing to do with what was `named`, best first: no parameter of `model`
/// (which has the name) reaches units of both. It can be named from the same trials. Nothing where the best of the rest, or one
/// of its rivals, reaches both: that may be what is missing in both.
pub(super) fn apart<D: Domain>(domain: &D, model: &Model, tried: &[Tried], named: usize) -> Vec<Tried> {
    let joined = joined(domain, model, domain.reach(&tried[named].effect));
    let mut apart: Vec<Tried> = Vec::new();
    for one in tried {
        let reach = domain.reach(&one.effect);
        if !overlap(&reach, &joined) {
            apart.push(one.clone());
            continue;
        }
        let is_within = within(&reach, &joined);
        let is_weaker =
            apart.first().is_some_and(|best| one.held_out_gain < RIVAL_SHARE * best.held_out_gain);
        if !is_within && !is_weaker {
            return Vec::new();
        }
    }
    apart
}

/// `units`, and all those that parameters of `model` join to them.
fn joined<D: Domain>(domain: &D, model: &Model, mut units: Vec<bool>) -> Vec<bool> {
    let of_base = (0..domain.base().len()).map(|idx| domain.base_support(idx));
    let of_effects = model.effects.iter().map(|effect| domain.reach(effect));
    let supports: Vec<Vec<bool>> = of_base.chain(of_effects).collect();
    loop {
        let before = units.clone();
        for support in supports.iter().filter(|support| overlap(support, &before)) {
            unite(&mut units, support);
        }
        if units == before {
            return units;
        }
    }
}

/// What may be named: what passes and explains the most, or nearly as much and is as simple as the simplest of those;
/// and what would explain more if its size were beyond doubt. First order does not tell them apart; full fits may.
fn contenders(tried: &[Tried], best: Option<usize>, least_share: f64) -> Vec<usize> {
    let Some(top) = tried.iter().position(|tried| tried.share > least_share) else { return Vec::new() };
    let complexity = |idx: usize| tried[idx].effect.parameters.len().div_ceil(SIMILAR_COUNT);
    let simplest_like = |first: usize| -> Vec<usize> {
        let least = RIVAL_SHARE * tried[first].held_out_gain;
        let as_good: Vec<usize> =
            (first..tried.len()).filter(|&idx| tried[idx].held_out_gain >= least).collect();
        let simplest = as_good.iter().map(|&idx| complexity(idx)).min();
        as_good.into_iter().filter(|&idx| Some(complexity(idx)) == simplest).take(MOST_CONTENDERS).collect()
    };
    let mut contenders = simplest_like(top);
    for idx in best.map_or_else(Vec::new, simplest_like) {
        if !contenders.contains(&idx) {
            contenders.push(idx);
        }
    }
    contenders
}

/// Of models that each add one of `tried`: the one with the least deviance, or one that is as good as that with fewer
/// parameters, or with less [strain](Domain::strain). `before` is the deviance without any.
fn simplest_of_best<D: Domain>(
    domain: &D,
    refitted: Vec<Chosen>,
    before: f64,
    tried: &[Tried],
) -> Result<Option<Chosen>, DiagnosisError> {
    let least = refitted.iter().map(|chosen| chosen.deviance).fold(f64::INFINITY, f64::min);
    let as_good = least + AS_GOOD * (before - least).max(0.0);
    let as_good: Vec<(f64, Chosen)> = refitted
        .into_iter()
        .filter(|chosen| chosen.deviance <= as_good)
        .map(|chosen| Ok((domain.strain(&chosen.model)?, chosen)))
        .collect::<Result<_, DiagnosisError>>()?;
    let count = |chosen: &Chosen| tried[chosen.named].effect.parameters.len();
    let simplest = as_good.into_iter().min_by(|(strain, chosen), (other_strain, other)| {
        count(chosen)
            .cmp(&count(other))
            .then(strain.total_cmp(other_strain))
            .then(chosen.deviance.total_cmp(&other.deviance))
    });
    Ok(simplest.map(|(_, chosen)| chosen))
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use palpate_robot_model::Place;
    use palpate_sim::effects::{Effect, Parameter};

    use super::super::tests::{LEVELS, size, sized};
    use super::super::{BaseParameter, Series};
    use super::*;

    /// Three units, the last two of which share a number of the base. Effects reach the units that their place lists.
    struct Units;

    const REACHES: [&[usize]; 2] = [&[0], &[1, 2]];

    fn effect(units: &[usize]) -> Effect {
        sized("some", Place::Channels(units.iter().map(usize::to_string).collect()), 1.0)
    }

    fn tried(units: &[usize], held_out_gain: f64) -> Tried {
        let effect = effect(units);
        Tried { effect, base: vec![0.0; 2], evidence: 50.0, held_out_gain, share: 0.1, takes_improved: 4 }
    }

    impl Domain for Units {
        fn num_takes(&self) -> usize {
            0
        }

        fn blocks(&self, _take: usize) -> &[Range<usize>] {
            &[]
        }

        fn observed(&self, _take: usize, _signal: usize) -> &[f64] {
            &[]
        }

        fn base(&self) -> &[BaseParameter] {
            &LEVELS
        }

        fn base_support(&self, idx: usize) -> Vec<bool> {
            (0..self.num_units()).map(|unit| REACHES[idx].contains(&unit)).collect()
        }

        fn candidates(&self) -> Vec<Effect> {
            Vec::new()
        }

        fn parameters(&self, _effect: &Effect) -> Vec<Parameter> {
            size()
        }

        fn num_units(&self) -> usize {
            3
        }

        fn support(&self, effect: &Effect, _parameter: &str) -> Vec<bool> {
            let Place::Channels(ids) = &effect.place else { return vec![false; 3] };
            (0..3_usize).map(|unit| ids.contains(&unit.to_string())).collect()
        }

        fn predict(&self, _take: usize, _model: &Model) -> Result<Vec<Series>, DiagnosisError> {
            Ok(Vec::new())
        }

        fn weights(&self, _take: usize, _signal: usize, prediction: &[f64]) -> Vec<f64> {
            prediction.to_vec()
        }
    }

    /// Gains of what is apart from the first of `all`, in a model that has `named` besides.
    fn gains_apart(named: &[usize], all: &[Tried]) -> Vec<f64> {
        let effects = [effect(named), all[0].effect.clone()].to_vec();
        let model = Model { base: vec![0.0; 2], effects };
        apart(&Units, &model, all, 0).iter().map(|tried| tried.held_out_gain).collect()
    }

    #[test]
    fn only_what_no_parameter_joins_is_apart() {
        let all = [tried(&[1], 100.0), tried(&[2], 90.0), tried(&[0], 50.0), tried(&[0], 20.0)];
        assert_eq!(gains_apart(&[], &all), [50.0, 20.0], "the last two units share a number");
        assert!(gains_apart(&[0, 2], &all).is_empty(), "an effect of the model joins all");
    }

    #[test]
    fn what_may_be_missing_in_both_is_waited_for() {
        let all = |across: f64| [tried(&[1, 2], 100.0), tried(&[0], 50.0), tried(&[0, 1], across)];
        assert!(gains_apart(&[], &all(45.0)).is_empty(), "a rival reaches both");
        assert_eq!(gains_apart(&[], &all(30.0)), [50.0]);
        let first = [tried(&[1, 2], 100.0), tried(&[0, 1], 60.0), tried(&[0], 50.0)];
        assert!(gains_apart(&[], &first).is_empty(), "the best of the rest reaches both");
    }

    #[test]
    fn numbers_that_were_fitted_elsewhere_stay() {
        let model = Model { base: vec![0.5, 0.6], effects: Vec::new() };
        let with = beside(&Units, &model, &tried(&[2], 1.0));
        assert_eq!(with.base, [0.5, 0.0]);
    }
}
