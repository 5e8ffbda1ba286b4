//! Responses to parameters: weighted differences between the predictions of a model and of its neighbours.

use palpate_sim::effects::Parameter;
use rayon::prelude::*;

use super::super::rows::{Column, Prior};
use super::super::{Domain, Model, Series};
use super::{Linear, predict};
use crate::DiagnosisError;

/// Responses to a whole dose below this many standard deviations are left out.
const SMALLEST_RESPONSE: f64 = 5e-4;

impl<D: Domain> Linear<'_, D> {
    /// Responses to the parameters `which` of the model's own.
    pub(crate) fn base_columns(&self, which: &[usize]) -> Result<Vec<Column>, DiagnosisError> {
        which
            .par_iter()
            .map(|&idx| {
                let (model, step) = self.base_stepped(idx);
                Ok(Column { prior: self.prior(idx), ..self.response(&model, step)? })
            })
            .collect()
    }

    /// The model with its own parameter `idx` moved by its dose, and by how much.
    fn base_stepped(&self, idx: usize) -> (Model, f64) {
        let (parameter, value) = (&self.domain.base()[idx], self.model.base[idx]);
        let step = if value + parameter.dose <= parameter.upper { parameter.dose } else { -parameter.dose };
        let mut model = self.model.clone();
        model.base[idx] += step;
        (model, step)
    }

    /// Responses to the parameters of the model's effect `idx`, around their values.
    pub(crate) fn effect_columns(&self, idx: usize) -> Result<Vec<Column>, DiagnosisError> {
        let effect = &self.model.effects[idx];
        let of_parameter = |parameter: Parameter| {
            let value = effect.parameter(&parameter.name);
            let step = inside(value, 0.25 * parameter.dose, parameter.lower, parameter.upper);
            let mut model = self.model.clone();
            model.effects[idx].parameters.insert(parameter.name, value + step);
            self.response(&model, step)
        };
        self.domain.parameters(effect).into_par_iter().map(of_parameter).collect()
    }

    /// Responses to the model's own parameters and to those of its effects.
    pub(crate) fn nuisance_columns(&self) -> Result<Vec<Column>, DiagnosisError> {
        self.columns_near(&[])
    }

    /// [`Self::nuisance_columns`] where `before` are those of a model nearby: parameters that are known to move
    /// little respond as they did there.
    pub(crate) fn columns_near(&self, before: &[Column]) -> Result<Vec<Column>, DiagnosisError> {
        let of_base = self.model.base.len();
        let stays = |idx: usize| idx < before.len() && self.domain.prior_standard_deviation(idx).is_some();
        let mut variants: Vec<Option<(Model, f64)>> =
            (0..of_base).map(|idx| (!stays(idx)).then(|| self.base_stepped(idx))).collect();
        for (effect_idx, effect) in self.model.effects.iter().enumerate() {
            for parameter in self.domain.parameters(effect) {
                let value = effect.parameter(&parameter.name);
                let step = inside(value, 0.25 * parameter.dose, parameter.lower, parameter.upper);
                let mut model = self.model.clone();
                model.effects[effect_idx].parameters.insert(parameter.name.clone(), value + step);
                variants.push(Some((model, step)));
            }
        }
        let column = |(idx, variant): (usize, &Option<(Model, f64)>)| {
            let column = match variant {
                Some((model, step)) => self.response(model, *step)?,
                None => before[idx].clone(),
            };
            let prior = if idx < of_base { self.prior(idx) } else { Prior::default() };
            Ok(Column { prior, ..column })
        };
        variants.par_iter().enumerate().map(column).collect()
    }

    /// What is known of the model's own parameter `idx`.
    fn prior(&self, idx: usize) -> Prior {
        let deviation = self.domain.prior_standard_deviation(idx);
        let precision = deviation.map_or(0.0, |deviation| deviation.powi(-2));
        Prior { precision, score: -precision * self.model.base[idx] }
    }

    /// Weighted difference between the predictions of `model` and of this one, over `step`.
    fn response(&self, model: &Model, step: f64) -> Result<Column, DiagnosisError> {
        let predicted = predict(self.domain, model, &self.takes)?;
        let owner = vec![0; self.domain.num_units()];
        let mut columns = self.columns(&self.predicted, &predicted, &owner, &[step]);
        Ok(columns.pop().unwrap_or_default())
    }

    /// Weighted differences between `after` and `before` (predictions by take), split by unit: `owner` says which of
    /// the columns a unit belongs to (`usize::MAX`: none), `steps` by what each is divided.
    pub(crate) fn columns(
        &self,
        before: &[Vec<Series>],
        after: &[Vec<Series>],
        owner: &[usize],
        steps: &[f64],
    ) -> Vec<Column> {
        let mut columns = vec![Column::default(); steps.len()];
        for (idx, before, after) in self.changed(before, after) {
            let owner = owner[self.rows.unit(idx)];
            if owner == usize::MAX {
                continue;
            }
            let (column, step) = (&mut columns[owner], steps[owner]);
            let first = column.rows.len();
            column.rows.reserve(before.len());
            column.values.reserve(before.len());
            let changes = before.iter().zip(after.iter()).zip(&self.segments[idx].weights);
            for (sample, ((before, after), weight)) in changes.enumerate() {
                let change = (after - before) * weight;
                if change.abs() > SMALLEST_RESPONSE {
                    column.rows.push((self.rows.starts[idx] + sample) as u32);
                    column.values.push((change / step) as f32);
                }
            }
            if column.rows.len() > first {
                column.parts.push((idx, first..column.rows.len()));
            }
        }
        // They grew by doubling, and some are kept for long.
        for column in &mut columns {
            column.rows.shrink_to_fit();
            column.values.shrink_to_fit();
        }
        columns
    }
}

/// `step`, or its opposite where that would leave the bounds.
pub(crate) fn inside(value: f64, step: f64, lower: f64, upper: f64) -> f64 {
    if (lower..=upper).contains(&(value + step)) { step } else { -step }
}
