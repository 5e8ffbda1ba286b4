//! What to name of what was tried.

use rayon::prelude::*;

use super::fit::refit;
use super::linear::Linear;
use super::name::{REFIT_STEPS, Round, SIMILAR_COUNT, Tried, founded};
use super::{Domain, Model, NamingConfig};
use crate::DiagnosisError;

/// Rivals explain at least this share of what the best does.
const RIVAL_SHARE: f64 = 0.8;
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
    /// Loss of that model.
    pub(super) loss: f64,
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

/// Chooses from what was `tried` beside `model`, which has this `loss`: the best that passes; a rival that explains nearly
/// as much with fewer parameters is the better name.
pub(super) fn choose<D: Domain>(
    domain: &D,
    model: &Model,
    loss: f64,
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
            let model = refit(domain, &with, takes, REFIT_STEPS)?;
            let loss = Linear::without_nuisances(domain, &model, takes)?.loss;
            let holds = passes(&tried[named]) || founded(domain, &model, takes, config.bar)?;
            Ok(holds.then_some(Chosen { named, model, loss }))
        })
        .collect::<Result<_, DiagnosisError>>()?;
    simplest_of_best(domain, refitted.into_iter().flatten().collect(), loss, tried)
}

/// `model` with what was `tried`, and with its own parameters as they were fitted to that where it reaches.
fn beside<D: Domain>(domain: &D, model: &Model, tried: &Tried) -> Model {
    let reach = domain.reach(&tried.effect);
    let mut with = model.clone();
    for (idx, (value, fitted)) in with.base.iter_mut().zip(&tried.base).enumerate() {
        if overlap(&domain.base_support(idx), &reach) {
            *value = *fitted;
        }
    }
    with.effects.push(tried.effect.clone());
    with
}

fn overlap(one: &[bool], other: &[bool]) -> bool {
    one.iter().zip(other).any(|(one, other)| *one && *other)
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
        let is_within = reach.iter().zip(&joined).all(|(reached, joined)| !reached || *joined);
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
            units.iter_mut().zip(support).for_each(|(unit, joined)| *unit |= joined);
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

/// Of what each adds one of `tried`: the one with the least loss, or one that is as
/// good as that with fewer parameters, or with less [strain](Domain::strain). `before` is the loss without any.
fn simplest_of_best<D: Domain>(
    domain: &D,
    refitted: Vec<Chosen>,
    before: f64,
    tried: &[Tried],
) -> Result<Option<Chosen>, DiagnosisError> {
    let least = refitted.iter().map(|chosen| chosen.loss).fold(f64::INFINITY, f64::min);
    let as_good = least + AS_GOOD * (before - least).max(0.0);
    let as_good: Vec<(f64, Chosen)> = refitted
        .into_iter()
        .filter(|chosen| chosen.loss <= as_good)
        .map(|chosen| Ok((domain.strain(&chosen.model)?, chosen)))
        .collect::<Result<_, DiagnosisError>>()?;
    let count = |chosen: &Chosen| tried[chosen.named].effect.parameters.len();
    let simplest = as_good.into_iter().min_by(|(strain, chosen), (other_strain, other)| {
        count(chosen)
            .cmp(&count(other))
            .then(strain.total_cmp(other_strain))
            .then(chosen.loss.total_cmp(&other.loss))
    });
    Ok(simplest.map(|(_, chosen)| chosen))
}
