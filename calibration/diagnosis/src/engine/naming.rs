//! Candidates and names.

use palpate_robot_model::Place;
use palpate_sim::effects::Effect;

use super::evidence::{Judged, SIMILAR_COUNT, num_seen};
use super::fit::{Fit, Fitted, REFIT_STEPS, refit};
use super::rows::Column;
use super::{Domain, Model, share};
use crate::DiagnosisError;
use crate::fired::{Fired, Withheld};

/// Steps of the last fit, which ends where one gains little.
const SETTLE_STEPS: usize = 8;
/// Parameters of an effect of a whole stream that is tried beside thresholds of its own.
pub(super) const FEW: usize = 2;
/// An effect of many parameters must remove this share of all that it removes in at least a third as many units as
/// it has parameters that the data sees.
const NEARLY_ALL: f64 = 0.8;

/// How to name.
#[derive(Clone, Debug)]
pub struct NamingConfig {
    /// Most effects to name.
    pub max_effects: usize,
    /// Evidence that an effect must reach: how far its estimate lies beyond the smallest size that matters, in standard
    /// errors, squared.
    pub bar: f64,
    /// Evidence that it must have beside all others in the end: what is barely founded while others are still
    /// missing is often a part of them.
    pub kept_bar: f64,
    /// Share of the loss, in the kinds of rows that an effect changes, that it must remove on takes it was not
    /// fitted to.
    pub least_share: f64,
    /// Candidates that are fitted in each round.
    pub num_fits: usize,
    /// Effects to leave out, by id.
    pub without: Vec<String>,
}

/// A candidate that was fitted.
#[derive(Clone, Debug)]
pub struct Tried {
    /// The effect, fitted beside the model of its round.
    pub effect: Effect,
    /// The model's own parameters beside it.
    pub base: Vec<f64>,
    /// On the scale of [`NamingConfig::bar`].
    pub evidence: f64,
    /// Loss that it removes on takes that its own parameters were not fitted to; the model's other parameters are
    /// projected out, or fitted beside it, on all of them.
    pub held_out_gain: f64,
    /// The same over the loss before, in the kinds of rows that the effect changes.
    pub share: f64,
    /// Takes on which it lowers the loss when fitted to the others.
    pub takes_improved: usize,
}

impl Tried {
    /// `effect` beside the base of `model`, which removes `gains` of the `loss` by take.
    pub(super) fn new(effect: Effect, model: &Model, evidence: f64, gains: &[f64], loss: f64) -> Self {
        let held_out_gain = gains.iter().sum::<f64>();
        Self {
            effect,
            base: model.base.clone(),
            evidence,
            held_out_gain,
            share: share(held_out_gain, loss),
            takes_improved: gains.iter().filter(|gain| **gain > 0.0).count(),
        }
    }
}

/// One round.
#[derive(Clone, Debug)]
pub struct Round {
    /// The model that it began with.
    pub before: Model,
    /// What was fitted, best first.
    pub tried: Vec<Tried>,
    /// Index in `tried` of what was named.
    pub named: Option<usize>,
    /// Indices in `tried` of what explains the same nearly as well, the named one among them.
    pub class: Vec<usize>,
}

/// What was named, and how.
#[derive(Clone, Debug)]
pub struct Naming {
    /// The model with every named effect.
    pub model: Model,
    /// Standard errors of the effects' parameters, in the order of [`Domain::parameters`].
    pub standard_errors: Vec<Vec<f64>>,
    /// Evidence for each effect beside all others.
    pub evidence: Vec<f64>,
    /// The rounds, the last of which names nothing unless the limit was reached.
    pub rounds: Vec<Round>,
    /// Effects that were named and dropped again, because others account for them.
    pub dropped: Vec<Effect>,
    /// Effects that were named and taken back, because together they do not account for what is there.
    pub withheld: Vec<Withheld>,
    /// What [`Self::weigh_again`] asked of names, and whoever assesses them later asks too.
    pub(super) needs: Option<Needs>,
}

/// What a name needs in the end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Needs {
    /// Effects at the beginning of the model of which nothing is asked.
    known: usize,
    bar: f64,
}

impl Naming {
    /// The last round that named `effect`, and the index of its name there. A second look may have given that
    /// round, and no earlier one, another name and class.
    pub(crate) fn round_of(&self, effect: &Effect) -> Option<(&Round, usize)> {
        self.rounds.iter().rev().find_map(|round| {
            let named = round.named?;
            (key(&round.tried[named].effect) == key(effect)).then_some((round, named))
        })
    }

    /// Takes all names back, to what was there at the `start`.
    pub fn withhold(&mut self, start: &Model, why: Fired) {
        let known = start.effects.len();
        let effects = self.model.effects.split_off(known).into_iter();
        self.withheld.splice(..0, effects.map(|effect| Withheld { effect, why }));
        self.model = start.clone();
        self.evidence.truncate(known);
        self.standard_errors.truncate(known);
    }

    /// Goes back to `start` where all names were withheld: what was fitted beside them says nothing without them.
    pub(crate) fn begin_again_without_names(&mut self, start: &Model) {
        if self.model.effects.len() == start.effects.len() && !self.withheld.is_empty() {
            self.model = start.clone();
        }
    }

    /// Fits the model to the end, and assesses every effect anew: rounds take a few steps each, after the last of
    /// which a large effect may be far from its size still.
    pub(crate) fn settle<D: Domain>(&mut self, domain: &D, takes: &[usize]) -> Result<(), DiagnosisError> {
        self.model = refit(domain, &self.model, takes, SETTLE_STEPS)?;
        self.assess(Judged::new(domain, &self.model, takes)?);
        Ok(())
    }

    /// Gives the responses to all parameters.
    fn assess<D: Domain>(&mut self, judged: Judged<'_, D>) -> Vec<Column> {
        (self.evidence, self.standard_errors) = (judged.evidence, judged.standard_errors);
        judged.columns
    }

    /// [`Self::settle`] without the effects beyond the first `known` that have no more evidence than `bar` then, or
    /// without which another fit is nearly as good ([`Judged::founded`]).
    pub(crate) fn weigh_again<D: Domain>(
        &mut self,
        domain: &D,
        known: usize,
        takes: &[usize],
        bar: f64,
    ) -> Result<(), DiagnosisError> {
        self.needs = Some(Needs { known, bar });
        let mut nearby = Vec::new();
        loop {
            self.model = Fit::within(SETTLE_STEPS).beside(&nearby).of(domain, &self.model, takes)?;
            let mut judged = Judged::new(domain, &self.model, takes)?;
            let founded = judged.founded(known, bar)?;
            nearby = self.assess(judged);
            let weakest = (known..).zip(founded).min_by(|(_, one), (_, other)| one.total_cmp(other));
            let Some((idx, _)) = weakest.filter(|(_, founded)| *founded < 1.0) else { return Ok(()) };
            self.dropped.push(self.model.effects.remove(idx));
        }
    }

    /// What a search found that began with what this one had found.
    pub(crate) fn go_on(&mut self, again: Self) {
        let Self { model, standard_errors, evidence, rounds, dropped, .. } = again;
        (self.model, self.standard_errors, self.evidence) = (model, standard_errors, evidence);
        self.rounds.extend(rounds);
        self.dropped.extend(dropped);
    }

    /// Takes the name of the effect `idx` back; the others stay as they were fitted and assessed beside it.
    pub(crate) fn set_aside(&mut self, idx: usize, why: Fired) {
        self.withheld.push(Withheld { effect: self.model.effects.remove(idx), why });
        self.evidence.remove(idx);
        self.standard_errors.remove(idx);
    }

    /// Takes the name of the effect `idx` back, and fits and assesses the others without it.
    pub(crate) fn withhold_one<D: Domain>(
        &mut self,
        domain: &D,
        idx: usize,
        takes: &[usize],
        why: Fired,
    ) -> Result<(), DiagnosisError> {
        self.withheld.push(Withheld { effect: self.model.effects.remove(idx), why });
        self.model = refit(domain, &self.model, takes, REFIT_STEPS)?;
        let mut judged = Judged::new(domain, &self.model, takes)?;
        if let Some(Needs { known, bar }) = self.needs {
            judged.count_missed(known, bar)?;
        }
        self.assess(judged);
        Ok(())
    }
}

/// What tells candidates apart.
pub(super) fn key(effect: &Effect) -> (String, Place) {
    (effect.id.clone(), effect.place.clone())
}

/// Whether an effect of many parameters does what it does in few places only: it then stands in for one that acts
/// there.
pub(super) fn stands_in(fitted: &Fitted) -> bool {
    if fitted.parameters.len() <= SIMILAR_COUNT {
        return false;
    }
    let mut removed: Vec<f64> =
        fitted.removed_by_unit.iter().copied().filter(|removed| *removed > 0.0).collect();
    removed.sort_unstable_by(|a, b| b.total_cmp(a));
    let nearly_all = NEARLY_ALL * removed.iter().sum::<f64>();
    let mut sum = 0.0;
    let carriers = removed.iter().take_while(|removed| {
        let before = sum;
        sum += **removed;
        before < nearly_all
    });
    carriers.count() < num_seen(&fitted.assessment.standard_errors) / 3
}
