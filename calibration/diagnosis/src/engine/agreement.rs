//! Whether what names add to a model is of one size wherever it is measured.
//!
//! What a name adds to a prediction is `c`, with all that the rest of the model can do projected out of it and of the residual
//! `r`. In some of the rows it would have to be `1 + (c.r)/(c.c)` times as large to explain them best. A right name is as large
//! everywhere; one that stands in for something else is too large here and too small there.

use std::collections::BTreeMap;

use super::linear::{Linear, predict};
use super::rows::Column;
use super::{Domain, Model};
use crate::DiagnosisError;

/// What the effects of a model add to its predictions, over some takes.
pub(crate) struct Contributions<'a, D: Domain> {
    linear: Linear<'a, D>,
    /// What each effect adds, in standard deviations.
    added: Vec<Column>,
}

impl<'a, D: Domain> Contributions<'a, D> {
    /// Of the effects of `model`.
    pub(crate) fn of(domain: &'a D, model: &Model, takes: &[usize]) -> Result<Self, DiagnosisError> {
        let linear = Linear::without_nuisances(domain, model, takes)?;
        let owner = vec![0; domain.num_units()];
        let added = (0..model.effects.len()).map(|idx| {
            let mut without = model.clone();
            without.effects.remove(idx);
            let before = predict(domain, &without, takes)?;
            Ok(linear.columns(&before, &linear.predicted, &owner, &[1.0]).pop().unwrap_or_default())
        });
        let added = added.collect::<Result<_, DiagnosisError>>()?;
        Ok(Self { linear, added })
    }

    /// How far the takes disagree on the size of each effect: root mean square of how far each is from the size
    /// that it has, over that size. Takes count by how much they see of it.
    pub(crate) fn disagreements(mut self) -> Result<Vec<f64>, DiagnosisError> {
        let domain = self.linear.domain;
        let responses = self.linear.nuisance_columns()?;
        let mut first = self.linear.model.base.len();
        let mut disagreements = Vec::new();
        for (idx, added) in self.added.iter().enumerate() {
            let own = first..first + domain.parameters(&self.linear.model.effects[idx]).len();
            first = own.end;
            self.linear.project(&[&responses[..own.start], &responses[own.end..]].concat());
            disagreements.push(disagreement(&self.linear, added));
        }
        Ok(disagreements)
    }
}

/// How far the takes disagree on the size of what is `added` to the model of `linear`.
fn disagreement<D: Domain>(linear: &Linear<'_, D>, added: &Column) -> f64 {
    let mut by_take: BTreeMap<usize, [f64; 2]> = BTreeMap::new();
    linear.each_left(added, |take, added, left| {
        let sums = by_take.entry(take).or_default();
        sums[0] += added * left;
        sums[1] += added * added;
    });
    let removable = |[product, square]: &[f64; 2]| product * product / square.max(f64::MIN_POSITIVE);
    let square: f64 = by_take.values().map(|[_, square]| square).sum();
    let over_takes: f64 = by_take.values().map(removable).sum();
    (over_takes / square.max(f64::MIN_POSITIVE)).sqrt()
}
