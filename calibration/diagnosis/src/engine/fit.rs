//! Fits: one candidate beside a linearised model, and a whole model.

use palpate_sim::effects::{Effect, Parameter};
use rayon::prelude::*;

use super::descend::{Free, Lower, descend};
use super::linear::{Assessment, Linear, Residual, predict};
use super::robust::Blocks;
use super::rows::Column;
use super::screen::{responses, stepped};
use super::{Domain, Model, Series, within};
use crate::DiagnosisError;

/// Steps of a full fit after an addition.
pub(super) const REFIT_STEPS: usize = 3;

/// A candidate, fitted.
pub(crate) struct Fitted {
    pub(crate) effect: Effect,
    pub(crate) parameters: Vec<Parameter>,
    /// At the fitted parameters.
    pub(crate) assessment: Assessment,
    /// Loss that it removes on each take when fitted to the others.
    pub(crate) held_out_gains: Vec<f64>,
    /// Kinds of rows that it changes.
    pub(crate) changes: Vec<bool>,
    /// Squares of residuals that it removes in each unit.
    pub(crate) removed_by_unit: Vec<f64>,
}

/// A candidate with the model's own parameters fitted anew beside it.
pub(crate) struct Profiled {
    pub(crate) model: Model,
    /// Loss that it removes on each take when fitted to the others, with the weights of the model without it.
    pub(crate) held_out_gains: Vec<f64>,
}

/// Sizes at which a candidate is tried with the model's own parameters fitted anew, as multiples of its dose.
const PROFILED_DOSES: [f64; 4] = [1.0, -1.0, 2.5, -2.5];
/// Sizes between the doses at which a fit is tried when it has ended, as multiples.
pub(super) const BETWEEN_DOSES: [f64; 4] = [0.5, 0.7, 0.85, 1.25];
/// Steps of such a fit.
const PROFILE_STEPS: usize = 3;
/// Sizes that the fit begins with, and of which it goes on after its first step: the best.
const PROFILES_BEGUN: usize = 3;
const PROFILES_KEPT: usize = 2;

/// A trial of an effect with the model's own parameters fitted anew, after its first step.
///
/// It is tried at large doses of its first parameter, and as it is, each time with those of the model's own
/// parameters fitted anew that reach all that it reaches and of which nothing is known beforehand. Thresholds
/// fitted to delayed touches account for most of the delay: beside them it is worth little, and only beside
/// thresholds of its own does it show what it explains.
pub(crate) struct Profile<'l, 'a, D: Domain> {
    linear: &'l Linear<'a, D>,
    /// Which of the model's own parameters are fitted.
    free: Vec<usize>,
    /// Trials at several sizes, the best first.
    begun: Vec<Begun>,
}

/// A fit that was begun. It has the model alone: many profiles wait for one another, and what a model predicts for a
/// long session takes much memory.
struct Begun {
    /// Loss that it removes.
    gained: f64,
    model: Model,
    /// Whether more steps would gain nothing worth while.
    is_done: bool,
}

impl<'l, 'a, D: Domain> Profile<'l, 'a, D> {
    /// Begins with `effect`; `None` where it has no parameter.
    pub(crate) fn begin(
        linear: &'l Linear<'a, D>,
        effect: &Effect,
        parameters: &[Parameter],
    ) -> Result<Option<Self>, DiagnosisError> {
        let Some(first) = parameters.first() else { return Ok(None) };
        let domain = linear.domain;
        let reach = domain.support(effect, &first.name);
        let covers = |&idx: &usize| {
            domain.prior_standard_deviation(idx).is_none() && within(&reach, &domain.base_support(idx))
        };
        let free = (0..domain.base().len()).filter(covers).collect();
        let mut profile = Self { linear, free, begun: Vec::new() };
        let mut starts = vec![effect.clone()];
        for dose in PROFILED_DOSES {
            let value = first.neutral + dose * first.dose;
            if (first.lower..=first.upper).contains(&value) {
                let mut start = effect.clone();
                start.parameters.insert(first.name.clone(), value);
                starts.push(start);
            }
        }
        let start = |start: Effect| {
            let tried = linear.moved_to(linear.with(start))?;
            Ok(Begun { gained: profile.gained(&tried), model: tried.model, is_done: false })
        };
        let started = starts.into_par_iter().map(start).collect::<Result<_, DiagnosisError>>()?;
        let begun = best_of(started, PROFILES_BEGUN).into_par_iter().map(|begun| profile.stepped(begun, 1));
        profile.begun = best_of(begun.collect::<Result<_, DiagnosisError>>()?, PROFILES_KEPT);
        Ok(Some(profile))
    }

    /// Loss that it removes so far.
    pub(crate) fn gained_so_far(&self) -> f64 {
        self.begun.first().map_or(0.0, |best| best.gained)
    }

    /// The best of it, after all steps.
    pub(crate) fn finish(mut self) -> Result<Option<Profiled>, DiagnosisError> {
        let begun = std::mem::take(&mut self.begun);
        let ended = begun.into_par_iter().map(|begun| self.stepped(begun, PROFILE_STEPS - 1));
        let Some(best) = best_of(ended.collect::<Result<_, DiagnosisError>>()?, 1).pop() else {
            return Ok(None);
        };
        let tried = self.linear.moved_to(self.resized(best)?.model)?;
        Ok(Some(Profiled { held_out_gains: self.held_out_gains(&tried)?, model: tried.model }))
    }

    /// [`Self::gains`], less what each take loses when the parameters are fitted to the others: a step from where all
    /// of them have it.
    fn held_out_gains(&self, tried: &Linear<'a, D>) -> Result<Vec<f64>, DiagnosisError> {
        let mut columns = tried.base_columns(&self.free)?;
        columns.extend(tried.effect_columns(tried.model.effects.len() - 1)?);
        let of_steps = tried.assess(&columns, &tried.residual).held_out_gains;
        // At an optimum no step gains anything; one that does was not taken.
        Ok(self
            .gains(tried)
            .into_iter()
            .zip(of_steps)
            .map(|(gain, of_step)| gain + of_step.min(0.0))
            .collect())
    }

    /// `ended`, or what it becomes at a size between the doses.
    fn resized(&self, ended: Begun) -> Result<Begun, DiagnosisError> {
        let model = &ended.model;
        let Some((effect, others)) = model.effects.split_last() else { return Ok(ended) };
        let parameters = self.linear.domain.parameters(effect);
        let resize = |scale: &f64| {
            let mut effects = others.to_vec();
            effects.push(scaled(effect, &parameters[..1], *scale));
            let tried = self.linear.moved_to(Model { base: model.base.clone(), effects })?;
            Ok(Begun { gained: self.gained(&tried), model: tried.model, is_done: false })
        };
        let resized = BETWEEN_DOSES.par_iter().map(resize).collect::<Result<_, DiagnosisError>>()?;
        match best_of(resized, 1).pop() {
            Some(better) if better.gained > ended.gained => self.stepped(better, 1),
            _ => Ok(ended),
        }
    }

    /// Loss that `tried` removes on each take.
    fn gains(&self, tried: &Linear<'a, D>) -> Vec<f64> {
        let after = self.linear.losses_of(&tried.predicted);
        let by_take = self.linear.loss_by_take().into_iter().zip(after);
        by_take.map(|(before, after)| before - after.iter().sum::<f64>()).collect()
    }

    fn gained(&self, tried: &Linear<'a, D>) -> f64 {
        self.gains(tried).iter().sum()
    }

    /// `begun` after up to so many further `steps`.
    fn stepped(&self, begun: Begun, steps: usize) -> Result<Begun, DiagnosisError> {
        if begun.is_done {
            return Ok(begun);
        }
        let mut tried = self.linear.moved_to(begun.model)?;
        let mut is_done = false;
        let base = self.linear.domain.base();
        for _ in 0..steps {
            if is_done {
                break;
            }
            let free: Vec<Free> =
                self.free.iter().map(|&idx| Free::of_base(self.linear.domain, &tried.model, idx)).collect();
            let assessment = tried.assess(&tried.base_columns(&self.free)?, &tried.residual);
            let lower = descend(&tried, &assessment, &free, |step| {
                let mut model = tried.model.clone();
                for (&idx, step) in self.free.iter().zip(step.iter()) {
                    model.base[idx] = (model.base[idx] + step).clamp(base[idx].lower, base[idx].upper);
                }
                model
            })?;
            is_done = lower.as_ref().is_none_or(|lower| lower.is_done);
            tried = lower.map_or(tried, |lower| lower.linear);
        }
        Ok(Begun { gained: self.gained(&tried), model: tried.model, is_done })
    }
}

/// The `most` that gained most, the best first.
fn best_of(mut fits: Vec<Begun>, most: usize) -> Vec<Begun> {
    fits.sort_by(|one, other| other.gained.total_cmp(&one.gained));
    fits.truncate(most);
    fits
}

/// Steps of Gauss and Newton for a candidate.
const STEPS: usize = 3;

/// Where else a fit starts, as multiples of the screened estimate.
const STARTS: [f64; 2] = [2.0, 4.0];

/// `effect` at a multiple of its distance from its neutral parameters, as far as their bounds allow.
pub(super) fn scaled(effect: &Effect, parameters: &[Parameter], scale: f64) -> Effect {
    let steps: Vec<f64> = parameters
        .iter()
        .map(|parameter| (scale - 1.0) * (effect.parameter(&parameter.name) - parameter.neutral))
        .collect();
    stepped(effect, parameters, &steps)
}

/// A candidate at some size.
struct Attempt {
    effect: Effect,
    predicted: Vec<Vec<Series>>,
    /// What it leaves.
    left: Residual,
}

/// Fits `start` with the parameters of `linear`'s model projected out.
pub(crate) fn fit<D: Domain>(
    linear: &Linear<'_, D>,
    start: &Effect,
    parameters: &[Parameter],
) -> Result<Fitted, DiagnosisError> {
    let tried = |effect: Effect| -> Result<Attempt, DiagnosisError> {
        let predicted = predict(linear.domain, &linear.with(effect.clone()), &linear.takes)?;
        Ok(Attempt { left: linear.residual_of(&predicted), predicted, effect })
    };
    let assessed = |tried: &Attempt| -> Result<Assessment, DiagnosisError> {
        let columns = responses(linear, &tried.effect, parameters, &tried.predicted)?;
        let columns: Vec<&Column> = columns.iter().collect();
        Ok(linear.assess_with_errors(&columns, &tried.left, columns.len(), Blocks::Many))
    };
    // A dose response flattens out: where an effect is large, its estimate from a small dose falls short.
    let mut best = tried(start.clone())?;
    for scale in STARTS {
        let farther = tried(scaled(start, parameters, scale))?;
        if farther.left.square() < best.left.square() {
            best = farther;
        }
    }
    let mut assessment = assessed(&best)?;
    for _ in 0..STEPS {
        let mut better = None;
        for scale in [1.0, 0.4, 0.1] {
            let steps: Vec<f64> = assessment.step.iter().map(|step| step * scale).collect();
            let shorter = tried(stepped(&best.effect, parameters, &steps))?;
            if shorter.left.square() < best.left.square() {
                better = Some(shorter);
                break;
            }
        }
        let Some(better) = better else { break };
        let gained = best.left.square() - better.left.square();
        best = better;
        assessment = assessed(&best)?;
        if gained < 0.5 {
            break;
        }
    }
    let Attempt { effect, predicted, left } = best;
    let held_out_gains = (linear.residual.squares.iter().zip(&left.squares))
        .zip(&assessment.held_out_gains)
        .map(|((before, after), of_step)| before - after + of_step)
        .collect();
    Ok(Fitted {
        effect,
        parameters: parameters.to_vec(),
        assessment,
        held_out_gains,
        changes: linear.kinds_changed(&predicted),
        removed_by_unit: linear.removed(&predicted).into_iter().fold(
            vec![0.0; linear.domain.num_units()],
            |mut sums, of_take| {
                sums.iter_mut().zip(of_take).for_each(|(sum, removed)| *sum += removed);
                sums
            },
        ),
    })
}

/// Fits every parameter of `model`, its own and those of its effects, to `takes`.
///
/// Never returns a model with a higher loss. Parameters stay within their bounds.
pub(crate) fn refit<D: Domain>(
    domain: &D,
    model: &Model,
    takes: &[usize],
    steps: usize,
) -> Result<Model, DiagnosisError> {
    Fit::within(steps).of(domain, model, takes)
}

/// How a whole model is fitted, as [`refit`] does it.
#[derive(Clone, Copy)]
pub(crate) struct Fit<'f> {
    /// Most steps.
    steps: usize,
    /// How many of them go by the same responses.
    steps_each: usize,
    /// See [`Self::beside`].
    nearby: &'f [Column],
}

impl<'f> Fit<'f> {
    /// In so many steps at most.
    pub(super) fn within(steps: usize) -> Self {
        Self { steps, steps_each: 1, nearby: &[] }
    }

    /// After an addition.
    pub(super) fn again() -> Self {
        Self::within(REFIT_STEPS)
    }

    /// By the responses of the model that it starts from, for half of the time: to see what becomes of a model that was
    /// fitted with an effect more, or less.
    pub(crate) fn roughly() -> Self {
        Self { steps: ROUGH_STEPS, steps_each: ROUGH_STEPS, ..Self::again() }
    }

    /// With these responses of a model nearby to its own parameters, for those that are known to move little.
    pub(super) fn beside(self, nearby: &'f [Column]) -> Self {
        Self { nearby, ..self }
    }

    /// [`Self::beside`] the responses of another model.
    pub(crate) fn near(self, Nearby(nearby): &'f Nearby) -> Self {
        self.beside(nearby)
    }

    /// Fits `model` to `takes`. Its loss never rises.
    pub(crate) fn of<D: Domain>(
        self,
        domain: &D,
        model: &Model,
        takes: &[usize],
    ) -> Result<Model, DiagnosisError> {
        let mut linear = Linear::without_nuisances(domain, model, takes)?;
        let mut columns = Vec::new();
        for first in (0..self.steps).step_by(self.steps_each) {
            let before = if first == 0 { self.nearby } else { &columns };
            columns = linear.columns_near(before)?;
            let is_done;
            let responses: Vec<&Column> = columns.iter().collect();
            (linear, is_done) = follow(linear, self.steps_each.min(self.steps - first), &responses)?;
            if is_done {
                break;
            }
        }
        Ok(linear.model)
    }
}

/// Responses of a model to those of its own parameters that are known to move little; none where it is not asked.
#[derive(Default)]
pub(crate) struct Nearby(Vec<Column>);

impl Nearby {
    pub(crate) fn to<D: Domain>(domain: &D, model: &Model, takes: &[usize]) -> Result<Self, DiagnosisError> {
        let linear = Linear::without_nuisances(domain, model, takes)?;
        let known = (0..model.base.len()).filter(|&idx| domain.prior_standard_deviation(idx).is_some());
        let known: Vec<usize> = known.collect();
        let mut columns = vec![Column::default(); model.base.len()];
        for (idx, column) in known.iter().zip(linear.base_columns(&known)?) {
            columns[*idx] = column;
        }
        Ok(Self(columns))
    }
}

const ROUGH_STEPS: usize = 2;

/// As [`Fit::roughly`] by the `responses` of the model of `from` to the parameters of `model`, which is nearby:
/// for hardly more than its predictions take.
pub(super) fn refit_nearby<D: Domain>(
    from: &Linear<'_, D>,
    model: Model,
    responses: &[&Column],
) -> Result<Model, DiagnosisError> {
    let (linear, _) = follow(from.moved_to(model)?, ROUGH_STEPS, responses)?;
    Ok(linear.model)
}

/// Takes up to so many `steps` from `linear` by `responses`. Says whether more would gain nothing worth while.
fn follow<'a, D: Domain>(
    mut linear: Linear<'a, D>,
    steps: usize,
    responses: &[&Column],
) -> Result<(Linear<'a, D>, bool), DiagnosisError> {
    for _ in 0..steps {
        let Some(lower) = lower(&linear, responses)? else { return Ok((linear, true)) };
        linear = lower.linear;
        if lower.is_done {
            return Ok((linear, true));
        }
    }
    Ok((linear, false))
}

/// What a step of all parameters of the model of `linear`, which responds to them with `columns`, lowers the loss to.
fn lower<'a, D: Domain>(
    linear: &Linear<'a, D>,
    columns: &[&Column],
) -> Result<Option<Lower<'a, D>>, DiagnosisError> {
    let assessment = linear.assess(columns, &linear.residual);
    let free = Free::all(linear.domain, &linear.model);
    descend(linear, &assessment, &free, |step| moved(linear.domain, &linear.model, step.as_slice()))
}

fn moved<D: Domain>(domain: &D, model: &Model, step: &[f64]) -> Model {
    let mut moved = model.clone();
    let (of_base, mut of_effects) = step.split_at(model.base.len());
    for ((value, step), parameter) in moved.base.iter_mut().zip(of_base).zip(domain.base()) {
        *value = (*value + step).clamp(parameter.lower, parameter.upper);
    }
    for effect in &mut moved.effects {
        let parameters = domain.parameters(effect);
        let (own, rest) = of_effects.split_at(parameters.len());
        *effect = stepped(effect, &parameters, own);
        of_effects = rest;
    }
    moved
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::ops::Range;

    use palpate_robot_model::Place;

    use super::super::{BaseParameter, Series};
    use super::*;

    /// Events, of which the model is sure and every tenth is otherwise. Its effect makes the model less sure.
    struct Events {
        observed: Vec<f64>,
        block: Range<usize>,
    }

    const EVENTS: usize = 100;
    const SURE: f64 = 0.98;

    impl Domain for Events {
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
            const LEVEL: &[BaseParameter] =
                &[BaseParameter { name: String::new(), lower: -1e-3, upper: 1e-3, dose: 1e-3 }];
            LEVEL
        }

        fn candidates(&self) -> Vec<Effect> {
            Vec::new()
        }

        fn parameters(&self, _effect: &Effect) -> Vec<Parameter> {
            let name = "doubt".to_owned();
            vec![Parameter { name, lower: 0.0, upper: 1.0, neutral: 0.0, smallest: 0.01, dose: 0.3 }]
        }

        fn num_units(&self) -> usize {
            1
        }

        fn support(&self, _effect: &Effect, _parameter: &str) -> Vec<bool> {
            vec![true]
        }

        fn predict(&self, _take: usize, model: &Model) -> Result<Vec<Series>, DiagnosisError> {
            let doubt: f64 = model.effects.iter().map(|effect| effect.parameter("doubt")).sum();
            let sure = 0.5 + (SURE - 0.5) * (1.0 - doubt) + model.base[0];
            Ok(vec![vec![sure; EVENTS].into()])
        }

        fn weights(&self, _take: usize, _signal: usize, prediction: &[f64]) -> Vec<f64> {
            prediction.iter().map(|p| (p * (1.0 - p) + 0.02).sqrt().recip()).collect()
        }
    }

    #[test]
    fn a_model_that_doubts_more_than_it_must_is_the_worse_one() {
        // As many are otherwise as the model says.
        let observed = (0..EVENTS).map(|event| f64::from(u8::from(event % 50 != 0))).collect();
        let events = Events { observed, block: 0..EVENTS };
        let parameters = BTreeMap::from([("doubt".to_owned(), 0.3)]);
        let place = Place::Stream("all".to_owned());
        let doubt = Effect {
            id: "doubt".to_owned(),
            place,
            parameters,
            interval: BTreeMap::new(),
            takes: Vec::new(),
        };
        let model = Model { base: vec![0.0], effects: Vec::new() };
        let sure = Linear::without_nuisances(&events, &model, &[0]).unwrap();
        let unsure = sure.moved_to(sure.with(doubt)).unwrap();
        assert!(unsure.loss < 0.6 * sure.loss, "the loss would prefer it: {} of {}", unsure.loss, sure.loss);
        let (deviance, of_unsure) = (sure.deviance(), unsure.deviance());
        assert!(of_unsure > deviance + 50.0, "{of_unsure} instead of {deviance}");
    }

    #[test]
    fn what_only_makes_the_model_less_sure_removes_nothing() {
        let observed = (0..EVENTS).map(|event| f64::from(u8::from(event % 10 != 0))).collect();
        let events = Events { observed, block: 0..EVENTS };
        let doubt = |size: f64| Effect {
            id: "doubt".to_owned(),
            place: Place::Stream("all".to_owned()),
            parameters: BTreeMap::from([("doubt".to_owned(), size)]),
            interval: BTreeMap::new(),
            takes: Vec::new(),
        };
        let model = Model { base: vec![0.0], effects: Vec::new() };
        let linear = Linear::new(&events, &model, &[0]).unwrap();
        let unsure = linear.moved_to(linear.with(doubt(0.3))).unwrap();
        assert!(
            unsure.loss < 0.5 * linear.loss,
            "with weights of its own: {} of {}",
            unsure.loss,
            linear.loss
        );

        let parameters = events.parameters(&doubt(0.0));
        let profile = Profile::begin(&linear, &doubt(0.0), &parameters).unwrap().unwrap();
        let profiled = profile.finish().unwrap().unwrap();
        let found = profiled.model.effects[0].parameter("doubt");
        let gained: f64 = profiled.held_out_gains.iter().sum();
        assert!(found < 0.1 && gained < 0.1 * linear.loss, "doubt {found} gains {gained} of {}", linear.loss);
    }
}
