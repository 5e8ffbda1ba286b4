//! What speaks for an effect beside all others of its model.

use palpate_sim::effects::{Effect, Parameter};
use rayon::prelude::*;

use super::fit::{Fit, refit_nearby};
use super::linear::{Linear, predict};
use super::normal::inverse;
use super::robust::{Blocks, missed_by};
use super::rows::Column;
use super::{Domain, Model};
use crate::DiagnosisError;

/// Numbers of parameters up to this many apart count as equally simple.
pub(super) const SIMILAR_COUNT: usize = 7;
/// Below so many times the bar, what comes back without an effect is not left to a rough fit. Where evidence is beyond
/// the square of it, over the bar, nothing is fitted.
const NEAR_BAR: f64 = 10.0;
/// What an effect must be missed by: as rare as what passes the shipped bar of evidence.
const NEEDED: f64 = 12.0;

/// Whether the last effect of `model`, which is fitted as a whole, reaches the bar.
pub(super) fn founded<D: Domain>(
    domain: &D,
    model: &Model,
    takes: &[usize],
    bar: f64,
) -> Result<bool, DiagnosisError> {
    let evidence = joint_evidence(domain, model, takes)?;
    Ok(evidence.last().is_some_and(|evidence| *evidence > bar))
}

/// Evidence for each effect of `model` beside all others, as a search goes by it.
pub(super) fn joint_evidence<D: Domain>(
    domain: &D,
    model: &Model,
    takes: &[usize],
) -> Result<Vec<f64>, DiagnosisError> {
    let linear = Linear::without_nuisances(domain, model, takes)?;
    let columns = linear.nuisance_columns()?;
    let num_errors = columns.len() - model.base.len();
    let columns: Vec<&Column> = columns.iter().collect();
    let assessed = linear.assess_with_errors(&columns, &linear.residual, num_errors, Blocks::Many);
    Ok(evidence_of_each(domain, model, &by_effect(domain, model, &assessed.standard_errors)))
}

/// A model in the end, and what its effects are judged by.
pub(super) struct Judged<'a, D: Domain> {
    linear: Linear<'a, D>,
    /// Responses to every parameter.
    pub(super) columns: Vec<Column>,
    /// Variances that independent rows of standard weight would give the parameters of each effect.
    variances: Vec<Vec<f64>>,
    /// Standard errors of the parameters of each effect, where few blocks count as few.
    pub(super) standard_errors: Vec<Vec<f64>>,
    /// Evidence for each effect beside all others.
    pub(super) evidence: Vec<f64>,
}

impl<'a, D: Domain> Judged<'a, D> {
    /// Judges `model`, which is fitted to `takes`.
    pub(super) fn new(domain: &'a D, model: &Model, takes: &[usize]) -> Result<Self, DiagnosisError> {
        let linear = Linear::without_nuisances(domain, model, takes)?;
        let columns = linear.nuisance_columns()?;
        let num_errors = columns.len() - model.base.len();
        let assess = |columns: &[&Column], blocks| {
            linear.assess_with_errors(columns, &linear.residual, num_errors, blocks)
        };
        // Beside what is known to be small a parameter is told by what little is left of it: what is known is
        // held while blocks are counted.
        let (known, free): (Vec<&Column>, Vec<&Column>) =
            columns.iter().partition(|column| column.is_known());
        let all: Vec<&Column> = columns.iter().collect();
        let mut assessed = assess(&all, if known.is_empty() { Blocks::Counted } else { Blocks::Many });
        if !known.is_empty() {
            let counted = assess(&free, Blocks::Counted).standard_errors;
            assessed
                .standard_errors
                .iter_mut()
                .zip(counted)
                .for_each(|(error, other)| *error = error.max(other));
        }
        let of_rows = inverse(&assessed.normal).diagonal();
        let standard_errors = by_effect(domain, model, &assessed.standard_errors);
        Ok(Self {
            variances: by_effect(domain, model, &of_rows.as_slice()[model.base.len()..]),
            evidence: evidence_of_each(domain, model, &standard_errors),
            standard_errors,
            linear,
            columns,
        })
    }

    /// How well each effect beyond the first `known` is founded, over what it needs: its evidence over the `bar`, or
    /// its likelihood ratio where that is less and all have enough: else one of them goes first. What has not enough
    /// is founded all the same where it is [missed](Self::missed); that is its evidence then.
    /// Far beyond the `bar` a rough fit of the others is enough, so that the ratio may be too high there.
    ///
    /// The ratio is the loss that comes back without the effect, where the others are fitted anew, over how much
    /// larger the variance of its strongest parameter is than independent rows would have it. Where the loss is a
    /// parabola this is the squared Wald statistic that evidence is. Where it is none, a parameter may be told
    /// sharply at a place that is hardly better than no effect at all.
    pub(super) fn founded(&mut self, known: usize, bar: f64) -> Result<Vec<f64>, DiagnosisError> {
        let missed = self.count_missed(known, bar)?;
        let of_evidence = self.evidence[known..].iter().zip(&missed);
        let mut founded: Vec<f64> =
            of_evidence.map(|(evidence, missed)| (evidence / bar).max(missed / NEEDED)).collect();
        if founded.iter().all(|founded| *founded >= 1.0) {
            let ratios = (known..self.evidence.len()).into_par_iter().zip(&missed).map(|(idx, missed)| {
                if *missed >= NEEDED { Ok(f64::INFINITY) } else { Ok(self.likelihood_ratio(idx, bar)? / bar) }
            });
            let ratios = ratios.collect::<Result<Vec<f64>, DiagnosisError>>()?;
            founded.iter_mut().zip(ratios).for_each(|(founded, ratio)| *founded = founded.min(ratio));
        }
        Ok(founded)
    }

    /// By how much each effect beyond the first `known` is [missed](Self::missed) that has less evidence than `bar`;
    /// where that is enough, it is the effect's evidence from now on.
    pub(super) fn count_missed(&mut self, known: usize, bar: f64) -> Result<Vec<f64>, DiagnosisError> {
        let missed = |idx: usize| if self.evidence[idx] < bar { self.missed(idx) } else { Ok(0.0) };
        let missed: Vec<f64> =
            (known..self.evidence.len()).into_par_iter().map(missed).collect::<Result<_, _>>()?;
        for (evidence, missed) in self.evidence[known..].iter_mut().zip(&missed) {
            if *missed >= NEEDED {
                *evidence = evidence.max(*missed);
            }
        }
        Ok(missed)
    }

    /// [`missed_by`] of the effect `idx`, where the others are fitted anew. Unlike a standard error this asks nothing
    /// of how the loss runs near the fit: of events alone a few frames in which a channel is about to switch seem to
    /// tell all there.
    fn missed(&self, idx: usize) -> Result<f64, DiagnosisError> {
        let Linear { domain, model, takes, .. } = &self.linear;
        let mut without = model.clone();
        without.effects.remove(idx);
        let without = Fit::again().beside(&self.columns).of(*domain, &without, takes)?;
        let predicted = predict(*domain, &without, takes)?;
        Ok(missed_by(&self.linear.losses_beyond(&predicted), self.linear.loss))
    }

    /// Of the effect `idx`. The others are fitted better and better until the ratio is below the `bar`: one fit that
    /// makes up for the effect is enough.
    fn likelihood_ratio(&self, idx: usize, bar: f64) -> Result<f64, DiagnosisError> {
        let Linear { domain, model, takes, .. } = &self.linear;
        let effect = &model.effects[idx];
        let strengths = strengths(effect, &domain.parameters(effect), &self.standard_errors[idx]);
        let strongest =
            (0..strengths.len()).max_by(|&one, &other| strengths[one].total_cmp(&strengths[other]));
        let Some(strongest) = strongest else { return Ok(0.0) };
        let larger = self.standard_errors[idx][strongest].powi(2) / self.variances[idx][strongest];
        let ratio = |without: &Model| Ok((self.linear.loss_of(without)? - self.linear.loss) / larger);

        let mut without = model.clone();
        without.effects.remove(idx);
        let unfitted = ratio(&without)?;
        if unfitted < bar || self.evidence[idx] > NEAR_BAR * NEAR_BAR * bar {
            return Ok(unfitted);
        }
        let first = self.columns.len() - self.variances[idx..].iter().map(Vec::len).sum::<usize>();
        let own = first..first + self.variances[idx].len();
        let others: Vec<&Column> = self.columns[..own.start].iter().chain(&self.columns[own.end..]).collect();
        let nearby = ratio(&refit_nearby(&self.linear, without.clone(), &others)?)?;
        if !(bar..NEAR_BAR * bar).contains(&nearby) {
            return Ok(nearby);
        }
        ratio(&Fit::again().beside(&self.columns).of(*domain, &without, takes)?)
    }
}

/// `values` of the parameters of all effects of `model`, split by effect.
fn by_effect<D: Domain>(domain: &D, model: &Model, values: &[f64]) -> Vec<Vec<f64>> {
    let mut rest = values.iter().copied();
    let of_effect = |effect: &Effect| rest.by_ref().take(domain.parameters(effect).len()).collect();
    model.effects.iter().map(of_effect).collect()
}

fn evidence_of_each<D: Domain>(domain: &D, model: &Model, standard_errors: &[Vec<f64>]) -> Vec<f64> {
    let effects = model.effects.iter().zip(standard_errors);
    effects.map(|(effect, errors)| evidence(effect, &domain.parameters(effect), errors)).collect()
}

/// How far the strongest parameter lies beyond the smallest size that matters, in standard errors, squared. For an
/// effect of many parameters it is the geometric mean over the strongest third of those that the data sees: where
/// fewer are out there it stands in for one that acts in fewer places. None for an effect that is driven to the end
/// of its range: it stands in for one of another kind.
pub(crate) fn evidence(effect: &Effect, parameters: &[Parameter], standard_errors: &[f64]) -> f64 {
    let at_end = |parameter: &Parameter| {
        let value = effect.parameter(&parameter.name);
        value != parameter.neutral && (value == parameter.lower || value == parameter.upper)
    };
    if parameters.iter().any(|parameter| parameter.is_size() && at_end(parameter)) {
        return 0.0;
    }
    let mut strengths = strengths(effect, parameters, standard_errors);
    strengths.sort_unstable_by(|a, b| b.total_cmp(a));
    if strengths.len() <= SIMILAR_COUNT {
        return strengths.first().copied().unwrap_or(0.0);
    }
    let third = (num_seen(standard_errors) / 3).max(1);
    let logarithms = strengths[..third].iter().map(|strength| strength.ln());
    (logarithms.sum::<f64>() / third as f64).exp()
}

/// How far each of `parameters` lies beyond the smallest size that matters, in standard errors, squared.
fn strengths(effect: &Effect, parameters: &[Parameter], standard_errors: &[f64]) -> Vec<f64> {
    let of_parameter = |(parameter, &error): (&Parameter, &f64)| {
        let size = (effect.parameter(&parameter.name) - parameter.neutral).abs();
        let beyond = (size - parameter.smallest).max(0.0);
        if error > 0.0 { (beyond / error).powi(2) } else { 0.0 }
    };
    parameters.iter().zip(standard_errors).map(of_parameter).collect()
}

/// How many parameters the data sees: an error of nothing is that of a direction that it does not see.
pub(super) fn num_seen(standard_errors: &[f64]) -> usize {
    standard_errors.iter().filter(|error| **error > 0.0).count()
}
