//! A second look at names of whole streams: what delays a stream and what smooths it are told apart by little, and least while
//! other effects are still missing.

use palpate_robot_model::Place;
use palpate_sim::effects::Effect;
use rayon::prelude::*;

use super::choose::with_base_of;
use super::evidence::joint_evidence;
use super::fit::{BETWEEN_DOSES, Fit, scaled};
use super::linear::Linear;
use super::naming::{FEW, Round, Tried};
use super::{Domain, Model};
use crate::DiagnosisError;

/// What removed less than this share of what the named effect did is not looked at again.
const LEAST_REMOVED: f64 = 0.5;
/// A rival must lower the deviance by this share of the loss that is left.
const LEAST_BETTER: f64 = 0.005;

/// Puts a rival that was tried in the same round in the place of every effect of a whole stream beyond the first `known`, if the
/// whole model has a lower deviance with it, and a lower one than with the name fitted anew, and its evidence reaches
/// the `bar`. The round then has the rival for its name.
pub(super) fn reconsider<D: Domain>(
    domain: &D,
    model: &mut Model,
    known: usize,
    rounds: &mut [Round],
    takes: &[usize],
    bar: f64,
) -> Result<(), DiagnosisError> {
    let linear = Linear::without_nuisances(domain, model, takes)?;
    let (mut deviance, least_better) = (linear.deviance(), LEAST_BETTER * linear.loss);
    drop(linear);
    for idx in known..model.effects.len() {
        let Some((round, named)) = round_of(&model.effects[idx], rounds) else { continue };
        let refitted = |of_trial: usize, scale: f64| -> Result<Option<Rival>, DiagnosisError> {
            let tried = &round.tried[of_trial];
            let mut with = with_base_of(domain, model, tried);
            with.effects[idx] = scaled(&tried.effect, &domain.parameters(&tried.effect)[..1], scale);
            let with = Fit::again().of(domain, &with, takes)?;
            let after = Linear::without_nuisances(domain, &with, takes)?.deviance();
            let is_founded = after < deviance && joint_evidence(domain, &with, takes)?[idx] > bar;
            Ok(is_founded.then_some(Rival { deviance: after, model: with, of_trial }))
        };
        let rivals = rivals(model, round, named).into_par_iter().map(|rival| refitted(rival, 1.0));
        let best = least(rivals.collect::<Result<_, DiagnosisError>>()?);
        let Some(rival) = best.filter(|rival| rival.deviance < deviance - least_better) else { continue };
        // The named effect may have gone astray while others were missing: it gets as fresh a start, from several sizes.
        let anew = [1.0].par_iter().chain(&BETWEEN_DOSES).map(|scale| refitted(named, *scale));
        let better = match least(anew.collect::<Result<_, DiagnosisError>>()?) {
            Some(named) if rival.deviance >= named.deviance.min(deviance) - least_better => named,
            _ => rival,
        };
        if better.deviance < deviance {
            (deviance, *model) = (better.deviance, better.model);
            if better.of_trial != named {
                round.named = Some(better.of_trial);
                round.class.retain(|member| ![named, better.of_trial].contains(member));
                round.class.push(better.of_trial);
            }
        }
    }
    Ok(())
}

/// A model with what was tried in a round in the place of its name.
struct Rival {
    deviance: f64,
    model: Model,
    /// Index of what was tried.
    of_trial: usize,
}

fn least(rivals: Vec<Option<Rival>>) -> Option<Rival> {
    rivals.into_iter().flatten().min_by(|one, other| one.deviance.total_cmp(&other.deviance))
}

fn is_same(one: &Effect, other: &Effect) -> bool {
    one.id == other.id && one.place == other.place
}

/// The last of `rounds` that named `effect`, and the index of its name.
fn round_of<'r>(effect: &Effect, rounds: &'r mut [Round]) -> Option<(&'r mut Round, usize)> {
    let named = |round: &Round| round.named.filter(|&named| is_same(&round.tried[named].effect, effect));
    rounds.iter_mut().rev().find_map(|round| named(round).map(|named| (round, named)))
}

/// Indices of what was tried in `round` beside its name, acts on the same stream, and is not in `model`.
fn rivals(model: &Model, round: &Round, named: usize) -> Vec<usize> {
    let is_simple =
        |effect: &Effect| matches!(effect.place, Place::Stream(_)) && effect.parameters.len() <= FEW;
    let Tried { effect, held_out_gain, .. } = &round.tried[named];
    let is_rival = |&idx: &usize| {
        let tried = &round.tried[idx];
        is_simple(effect)
            && is_simple(&tried.effect)
            && tried.effect.place == effect.place
            && tried.held_out_gain >= LEAST_REMOVED * held_out_gain
            && !model.effects.iter().any(|other| is_same(other, &tried.effect))
    };
    (0..round.tried.len()).filter(is_rival).collect()
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use palpate_sim::effects::Parameter;

    use super::super::tests::{LEVELS, size, sized};
    use super::super::{BaseParameter, Series};
    use super::*;

    const ROWS: usize = 200;

    /// One signal, to which effects of the whole stream add waves of different lengths.
    struct Waves {
        observed: Vec<f64>,
        block: Range<usize>,
    }

    fn effect(id: &str, size: f64) -> Effect {
        sized(id, Place::Stream("all".to_owned()), size)
    }

    fn wave(effects: &[Effect], row: usize) -> f64 {
        let of = |effect: &Effect| {
            let length = if effect.id == "long" { 0.05 } else { 0.06 };
            effect.parameter("size") * (row as f64 * length).sin()
        };
        effects.iter().map(of).sum()
    }

    impl Domain for Waves {
        fn num_takes(&self) -> usize {
            1
        }

        fn blocks(&self, _take: usize) -> &[Range<usize>] {
            std::slice::from_ref(&self.block)
        }

        fn observed(&self, _take: usize, _signal: usize) -> &[f64] {
            &self.observed
        }

        fn base(&self) -> &[BaseParameter] {
            &LEVELS[..1]
        }

        fn candidates(&self) -> Vec<Effect> {
            vec![effect("long", 0.0), effect("short", 0.0)]
        }

        fn parameters(&self, _effect: &Effect) -> Vec<Parameter> {
            size()
        }

        fn num_units(&self) -> usize {
            1
        }

        fn support(&self, _effect: &Effect, _parameter: &str) -> Vec<bool> {
            vec![true]
        }

        fn predict(&self, _take: usize, model: &Model) -> Result<Vec<Series>, DiagnosisError> {
            Ok(vec![(0..ROWS).map(|row| model.base[0] + wave(&model.effects, row)).collect()])
        }

        fn weights(&self, _take: usize, _signal: usize, prediction: &[f64]) -> Vec<f64> {
            vec![10.0; prediction.len()]
        }
    }

    /// The name that is left of `named` where a long wave is hidden and both were tried, the other with this gain over that
    /// of the named one.
    fn reconsidered(named: &str, share: f64, bar: f64) -> String {
        let hidden = [effect("long", 1.0)];
        let observed = (0..ROWS).map(|row| 0.3 + wave(&hidden, row)).collect();
        let waves = Waves { observed, block: 0..ROWS };
        let other = if named == "long" { "short" } else { "long" };
        let tried = |id: &str, held_out_gain: f64| Tried {
            effect: effect(id, 0.5),
            base: vec![0.0],
            evidence: 50.0,
            held_out_gain,
            share: 0.1,
            takes_improved: 1,
        };
        let before = Model { base: vec![0.0], effects: Vec::new() };
        let mut rounds = [Round {
            before: before.clone(),
            tried: vec![tried(named, 100.0), tried(other, 100.0 * share)],
            named: Some(0),
            class: vec![0],
        }];
        let with = Model { effects: vec![effect(named, 0.5)], ..before };
        let mut model = Fit::again().of(&waves, &with, &[0]).unwrap();
        reconsider(&waves, &mut model, 0, &mut rounds, &[0], bar).unwrap();
        let [round] = rounds;
        let of_round = &round.tried[round.named.unwrap()].effect.id;
        assert_eq!((of_round, round.class), (&model.effects[0].id, vec![round.named.unwrap()]));
        model.effects[0].id.clone()
    }

    #[test]
    fn a_rival_that_leaves_less_takes_the_place_of_a_name() {
        assert_eq!(reconsidered("short", 0.9, 12.0), "long");
        assert_eq!(reconsidered("long", 0.9, 12.0), "long", "the right name stays");
        assert_eq!(reconsidered("short", 0.1, 12.0), "short", "what removed little is no rival");
        assert_eq!(reconsidered("short", 0.9, f64::MAX), "short", "a rival must be founded");
    }
}
