//! The surroundings of a model to first order.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use palpate_sim::effects::Effect;
use rayon::prelude::*;

use super::{Domain, HUBER, Model, huber};
use crate::DiagnosisError;

/// The response of all rows to one unit of a parameter, where it is not zero.
#[derive(Clone, Debug, Default)]
pub(crate) struct Column {
    pub(crate) rows: Vec<u32>,
    pub(crate) values: Vec<f32>,
}

/// A model over some takes: residuals, and the responses to parameters that are no news (the nuisances).
///
/// Rows are numbered through over the takes. Residuals and responses are weighted: one is a standard deviation.
pub(crate) struct Linear<'a, D: Domain> {
    pub(crate) domain: &'a D,
    pub(crate) model: Model,
    /// Takes, in order.
    pub(crate) takes: Vec<usize>,
    /// First row of each take, and the number of all rows.
    pub(crate) starts: Vec<usize>,
    /// Predictions by take.
    pub(crate) predicted: Vec<Vec<f64>>,
    /// Weight of each row: one over its standard deviation, less for outliers; 0 where nothing was measured.
    pub(crate) weights: Vec<f64>,
    /// Blocks as ranges of rows, with the index of their take within `takes`.
    pub(crate) blocks: Vec<(Range<usize>, usize)>,
    /// Huber's loss of the residuals.
    pub(crate) loss: f64,
    /// The same by take and by kind of row, `[take * num_kinds + kind]`.
    losses: Vec<f64>,
    nuisances: Nuisances,
    /// Of this model, with the nuisances projected out.
    pub(crate) residual: Residual,
}

/// Weighted residuals, and what they have along the nuisances.
pub(crate) struct Residual {
    /// One a row.
    pub(crate) values: Vec<f64>,
    /// By block. Over all blocks this is nothing, within a block it is not.
    along_nuisances: Vec<DVector<f64>>,
}

impl Residual {
    pub(crate) fn square(&self) -> f64 {
        self.values.iter().map(|r| r * r).sum()
    }
}

struct Nuisances {
    count: usize,
    /// Per row, where its values start; `u32::MAX` if all are zero.
    index: Vec<u32>,
    values: Vec<f64>,
    /// Inverse of the normal matrix.
    inverse: DMatrix<f64>,
    /// Normal matrix of each block.
    by_block: Vec<DMatrix<f64>>,
}

/// What a candidate's responses say.
#[derive(Clone, Debug)]
pub(crate) struct Assessment {
    /// Best step of its parameters, in their own units.
    pub(crate) step: DVector<f64>,
    /// Standard error of each, robust against dependence within blocks.
    pub(crate) standard_errors: Vec<f64>,
    /// Loss that steps fitted to the other takes remove, by take; to other blocks, where few takes see them.
    pub(crate) held_out_gains: Vec<f64>,
}

/// With fewer takes that see a parameter, fits are judged on blocks instead.
const FEW_TAKES: usize = 3;
/// A take that sees less than this share of what all see of a parameter does not see it.
const LEAST_TAKE_SHARE: f64 = 0.02;
/// Folds of blocks.
const FEW_FOLDS: usize = 5;
/// Share of the variance that independent rows of standard weight would give a parameter, below which none is believed.
const LEAST_SPREAD: f64 = 0.01;

impl<'a, D: Domain> Linear<'a, D> {
    /// Linearises `model` over `takes`; its own parameters and those of its effects become nuisances.
    pub(crate) fn new(domain: &'a D, model: &Model, takes: &[usize]) -> Result<Self, DiagnosisError> {
        let mut linear = Self::without_nuisances(domain, model, takes)?;
        let columns = linear.nuisance_columns()?;
        linear.project(&columns);
        Ok(linear)
    }

    /// Residuals of `model` over `takes` as they are.
    pub(crate) fn without_nuisances(
        domain: &'a D,
        model: &Model,
        takes: &[usize],
    ) -> Result<Self, DiagnosisError> {
        let predicted = predict(domain, model, takes)?;
        let mut starts = vec![0];
        for prediction in &predicted {
            starts.push(starts[starts.len() - 1] + prediction.len());
        }
        let num_rows = starts[starts.len() - 1];
        let (mut weights, mut residual) = (Vec::with_capacity(num_rows), Vec::with_capacity(num_rows));
        let mut blocks = Vec::new();
        let num_kinds = domain.num_kinds();
        let mut losses = vec![0.0; takes.len() * num_kinds];
        for (idx, (&take, prediction)) in takes.iter().zip(&predicted).enumerate() {
            let observed = domain.observed(take);
            let rows = domain.weights(take, prediction).into_iter().zip(prediction).zip(observed);
            for (row, ((weight, &predicted), &observed)) in rows.enumerate() {
                if observed.is_nan() {
                    weights.push(0.0);
                    residual.push(0.0);
                    continue;
                }
                let deviation = (observed - predicted) * weight;
                losses[idx * num_kinds + domain.kind(row)] += huber(deviation);
                // Reweighted least squares: an outlier pulls as hard as one at the limit.
                let damped = (HUBER / deviation.abs()).min(1.0).sqrt();
                weights.push(weight * damped);
                residual.push(deviation * damped);
            }
            let start = starts[idx];
            blocks.extend(domain.blocks(take).iter().map(|rows| (rows.start + start..rows.end + start, idx)));
        }
        let nuisances = Nuisances {
            count: 0,
            index: vec![u32::MAX; num_rows],
            values: Vec::new(),
            inverse: DMatrix::zeros(0, 0),
            by_block: vec![DMatrix::zeros(0, 0); blocks.len()],
        };
        let along_nuisances = vec![DVector::zeros(0); blocks.len()];
        Ok(Self {
            domain,
            model: model.clone(),
            takes: takes.to_vec(),
            starts,
            predicted,
            weights,
            blocks,
            loss: losses.iter().sum(),
            losses,
            nuisances,
            residual: Residual { values: residual, along_nuisances },
        })
    }

    /// Loss by take.
    pub(crate) fn loss_by_take(&self) -> Vec<f64> {
        self.losses.chunks_exact(self.domain.num_kinds()).map(|of_take| of_take.iter().sum()).collect()
    }

    /// Loss in the rows of `kinds`.
    pub(crate) fn loss_in(&self, kinds: &[bool]) -> f64 {
        let of_take = |losses: &[f64]| {
            losses.iter().zip(kinds).map(|(loss, of)| if *of { *loss } else { 0.0 }).sum::<f64>()
        };
        self.losses.chunks_exact(kinds.len()).map(of_take).sum()
    }

    /// Loss of `predicted` (by take) by kind of row, with the weights of this model's predictions: what a model is unsure
    /// of weighs less, so that losses with weights of their own do not compare.
    pub(crate) fn losses_of(&self, predicted: &[Vec<f64>]) -> Vec<f64> {
        let mut losses = vec![0.0; self.domain.num_kinds()];
        for ((&take, own), predicted) in self.takes.iter().zip(&self.predicted).zip(predicted) {
            let weights = self.domain.weights(take, own);
            let rows = self.domain.observed(take).iter().zip(predicted).zip(weights).enumerate();
            for (row, ((observed, predicted), weight)) in rows {
                if !observed.is_nan() {
                    losses[self.domain.kind(row)] += huber((observed - predicted) * weight);
                }
            }
        }
        losses
    }

    /// Which kinds of rows `predicted` (by take) has otherwise than this model.
    pub(crate) fn kinds_changed(&self, predicted: &[Vec<f64>]) -> Vec<bool> {
        let mut changed = vec![false; self.domain.num_kinds()];
        for ((before, after), start) in self.predicted.iter().zip(predicted).zip(&self.starts) {
            for (row, (before, after)) in before.iter().zip(after).enumerate() {
                let kind = self.domain.kind(row);
                changed[kind] |= ((after - before) * self.weights[start + row]).abs() > NOTICEABLE;
            }
        }
        changed
    }

    /// Which kinds of rows `columns` reach.
    pub(crate) fn kinds_in(&self, columns: &[Column]) -> Vec<bool> {
        let mut reached = vec![false; self.domain.num_kinds()];
        for column in columns {
            let mut take = 0;
            for &row in &column.rows {
                while row as usize >= self.starts[take + 1] {
                    take += 1;
                }
                reached[self.domain.kind(row as usize - self.starts[take])] = true;
            }
        }
        reached
    }

    /// Responses to the parameters `which` of the model's own.
    pub(crate) fn base_columns(&self, which: &[usize]) -> Result<Vec<Column>, DiagnosisError> {
        which
            .iter()
            .map(|&idx| {
                let (model, step) = self.base_stepped(idx);
                self.response(&model, step)
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

    /// Responses to the model's own parameters and to those of its effects.
    pub(crate) fn nuisance_columns(&self) -> Result<Vec<Column>, DiagnosisError> {
        let mut variants: Vec<(Model, f64)> =
            (0..self.model.base.len()).map(|idx| self.base_stepped(idx)).collect();
        for (effect_idx, effect) in self.model.effects.iter().enumerate() {
            for parameter in self.domain.parameters(effect) {
                let value = effect.parameter(&parameter.name);
                let step = inside(value, 0.25 * parameter.dose, parameter.lower, parameter.upper);
                let mut model = self.model.clone();
                model.effects[effect_idx].parameters.insert(parameter.name.clone(), value + step);
                variants.push((model, step));
            }
        }
        variants.iter().map(|(model, step)| self.response(model, *step)).collect()
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
        before: &[Vec<f64>],
        after: &[Vec<f64>],
        owner: &[usize],
        steps: &[f64],
    ) -> Vec<Column> {
        let mut columns = vec![Column::default(); steps.len()];
        for ((before, after), &start) in before.iter().zip(after).zip(&self.starts) {
            for (row, (before, after)) in before.iter().zip(after).enumerate() {
                let change = (after - before) * self.weights[start + row];
                if change.abs() > SMALLEST_RESPONSE {
                    let owner = owner[self.domain.unit(row)];
                    if owner != usize::MAX {
                        columns[owner].rows.push((start + row) as u32);
                        columns[owner].values.push((change / steps[owner]) as f32);
                    }
                }
            }
        }
        columns
    }

    /// Makes `columns` the nuisances and projects them out of the residual.
    pub(crate) fn project(&mut self, columns: &[Column]) {
        let count = columns.len();
        let mut index = vec![u32::MAX; self.residual.values.len()];
        let mut values: Vec<f64> = Vec::new();
        for (idx, column) in columns.iter().enumerate() {
            for (&row, &value) in column.rows.iter().zip(&column.values) {
                let slot = &mut index[row as usize];
                if *slot == u32::MAX {
                    *slot = values.len() as u32;
                    values.resize(values.len() + count, 0.0);
                }
                values[*slot as usize + idx] = f64::from(value);
            }
        }
        let mut by_block = Vec::with_capacity(self.blocks.len());
        let mut normal = DMatrix::zeros(count, count);
        for (rows, _) in &self.blocks {
            let mut of_block = DMatrix::zeros(count, count);
            for row in rows.clone() {
                let Some(values) = row_values(&index, &values, count, row) else { continue };
                for (i, a) in values.iter().enumerate() {
                    if *a != 0.0 {
                        for (j, b) in values.iter().enumerate() {
                            of_block[(i, j)] += a * b;
                        }
                    }
                }
            }
            normal += &of_block;
            by_block.push(of_block);
        }
        self.nuisances = Nuisances { count, index, values, inverse: inverse(&normal), by_block };
        let values = std::mem::take(&mut self.residual.values);
        self.residual = self.projected(values);
    }

    /// By take and unit, how much smaller the squares of the residuals are with `predicted` (by take) in place of this
    /// model's predictions, with these weights.
    pub(crate) fn removed(&self, predicted: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let mut removed = vec![vec![0.0; self.domain.num_units()]; self.takes.len()];
        for (idx, (&take, after)) in self.takes.iter().zip(predicted).enumerate() {
            let rows = self.domain.observed(take).iter().zip(&self.predicted[idx]).zip(after).enumerate();
            for (row, ((observed, before), after)) in rows {
                let weight = self.weights[self.starts[idx] + row];
                if weight > 0.0 && before != after {
                    let squares = (observed - before).powi(2) - (observed - after).powi(2);
                    removed[idx][self.domain.unit(row)] += weight * weight * squares;
                }
            }
        }
        removed
    }

    /// Residuals of `predicted` (by take) with these weights and nuisances: what a candidate leaves.
    pub(crate) fn residual_of(&self, predicted: &[Vec<f64>]) -> Residual {
        let mut residual = vec![0.0; self.weights.len()];
        for ((&take, predicted), &start) in self.takes.iter().zip(predicted).zip(&self.starts) {
            for (row, (observed, predicted)) in self.domain.observed(take).iter().zip(predicted).enumerate() {
                if self.weights[start + row] > 0.0 {
                    residual[start + row] = (observed - predicted) * self.weights[start + row];
                }
            }
        }
        self.projected(residual)
    }

    /// `residual` with the nuisances projected out.
    fn projected(&self, mut residual: Vec<f64>) -> Residual {
        let Nuisances { count, index, values, inverse, .. } = &self.nuisances;
        let along = |residual: &[f64]| -> Vec<DVector<f64>> {
            self.blocks
                .iter()
                .map(|(rows, _)| {
                    let mut sums = DVector::zeros(*count);
                    for row in rows.clone() {
                        if let Some(values) = row_values(index, values, *count, row) {
                            for (sum, value) in sums.iter_mut().zip(values) {
                                *sum += value * residual[row];
                            }
                        }
                    }
                    sums
                })
                .collect()
        };
        let total = along(&residual).iter().fold(DVector::zeros(*count), |sum, part| sum + part);
        let coefficients = inverse * total;
        for (row, residual) in residual.iter_mut().enumerate() {
            if let Some(values) = row_values(index, values, *count, row) {
                *residual -= values.iter().zip(coefficients.iter()).map(|(a, c)| a * c).sum::<f64>();
            }
        }
        let along_nuisances = along(&residual);
        Residual { values: residual, along_nuisances }
    }

    /// What `columns` can do about `residual` (as [`Self::residual`] or [`Self::residual_of`]).
    ///
    /// With R the responses and N the nuisances, R~ = R - N (N'N)^-1 N'R; the step is (R~'R~)^-1 R~'r, its covariance
    /// the sandwich over blocks.
    pub(crate) fn assess(&self, columns: &[Column], residual: &Residual) -> Assessment {
        let k = columns.len();
        let Nuisances { count, index, values, inverse: p, by_block } = &self.nuisances;
        let m = *count;
        let num_blocks = self.blocks.len();
        // Per block: R'r, R'N, R'R.
        let mut scores = vec![DVector::<f64>::zeros(k); num_blocks];
        let mut with_nuisances = vec![DMatrix::<f64>::zeros(k, m); num_blocks];
        let mut normals = vec![DMatrix::<f64>::zeros(k, k); num_blocks];
        let mut cursor = vec![0; k];
        for (block, (rows, _)) in self.blocks.iter().enumerate() {
            let mut parts: Vec<Range<usize>> = Vec::with_capacity(k);
            for (column, cursor) in columns.iter().zip(&mut cursor) {
                let first = *cursor;
                while column.rows.get(*cursor).is_some_and(|&row| (row as usize) < rows.end) {
                    *cursor += 1;
                }
                parts.push(first..*cursor);
            }
            for (i, (column, part)) in columns.iter().zip(&parts).enumerate() {
                for (&row, &value) in column.rows[part.clone()].iter().zip(&column.values[part.clone()]) {
                    let (row, value) = (row as usize, f64::from(value));
                    scores[block][i] += value * residual.values[row];
                    normals[block][(i, i)] += value * value;
                    if let Some(values) = row_values(index, values, m, row) {
                        for (j, nuisance) in values.iter().enumerate() {
                            with_nuisances[block][(i, j)] += value * nuisance;
                        }
                    }
                }
                for (j, (other, other_part)) in columns.iter().zip(&parts).enumerate().take(i) {
                    let cross = dot(column, part, other, other_part);
                    normals[block][(i, j)] = cross;
                    normals[block][(j, i)] = cross;
                }
            }
        }
        let a: DMatrix<f64> = with_nuisances.iter().fold(DMatrix::zeros(k, m), |sum, part| sum + part);
        let c = &a * p;
        let mut projected_scores = Vec::with_capacity(num_blocks);
        let mut projected_normals = Vec::with_capacity(num_blocks);
        for block in 0..num_blocks {
            projected_scores.push(&scores[block] - &c * &residual.along_nuisances[block]);
            let cross = &with_nuisances[block] * c.transpose();
            projected_normals
                .push(&normals[block] - &cross - cross.transpose() + &c * &by_block[block] * c.transpose());
        }
        let h = projected_normals.iter().fold(DMatrix::zeros(k, k), |sum, part| sum + part);
        let s = projected_scores.iter().fold(DVector::zeros(k), |sum, part| sum + part);
        let h_inverse = inverse(&h);
        let step = &h_inverse * &s;
        let mut v = DMatrix::zeros(k, k);
        for (score, normal) in projected_scores.iter().zip(&projected_normals) {
            let left = score - normal * &step;
            v += &left * left.transpose();
        }
        let covariance = &h_inverse * v * &h_inverse;

        let (folds, num_folds) = self.folds(&projected_normals);
        let mut of_fold = vec![(DVector::<f64>::zeros(k), DMatrix::<f64>::zeros(k, k)); num_folds];
        for (&fold, (score, normal)) in folds.iter().zip(projected_scores.iter().zip(&projected_normals)) {
            of_fold[fold].0 += score;
            of_fold[fold].1 += normal;
        }
        let steps: Vec<DVector<f64>> =
            of_fold.iter().map(|(score, normal)| inverse(&(&h - normal)) * (&s - score)).collect();
        let mut held_out_gains = vec![0.0; self.takes.len()];
        for (block, (_, take)) in self.blocks.iter().enumerate() {
            let step = &steps[folds[block]];
            held_out_gains[*take] +=
                2.0 * projected_scores[block].dot(step) - step.dot(&(&projected_normals[block] * step));
        }
        Assessment {
            // What explains its rows perfectly leaves no spread to judge by, but no row is measured without error.
            standard_errors: covariance
                .diagonal()
                .iter()
                .zip(h_inverse.diagonal().iter())
                .map(|(robust, of_rows)| robust.max(LEAST_SPREAD * of_rows).max(0.0).sqrt())
                .collect(),
            step,
            held_out_gains,
        }
    }

    /// Which blocks are judged together by a fit to all others, and the number of such folds: those of a take; or, where
    /// so few takes see what is fitted that a fit without one of them would know nothing, every [`FEW_FOLDS`]-th block.
    fn folds(&self, normals: &[DMatrix<f64>]) -> (Vec<usize>, usize) {
        let mut seen = vec![0.0; self.takes.len()];
        for ((_, take), normal) in self.blocks.iter().zip(normals) {
            seen[*take] += normal.trace();
        }
        let least = LEAST_TAKE_SHARE * seen.iter().sum::<f64>();
        if seen.iter().filter(|seen| **seen > least).count() >= FEW_TAKES {
            return (self.blocks.iter().map(|(_, take)| *take).collect(), self.takes.len());
        }
        ((0..self.blocks.len()).map(|block| block % FEW_FOLDS).collect(), FEW_FOLDS)
    }

    /// `model` with another effect.
    pub(crate) fn with(&self, effect: Effect) -> Model {
        let mut model = self.model.clone();
        model.effects.push(effect);
        model
    }
}

/// Responses to a whole dose below this many standard deviations are left out.
const SMALLEST_RESPONSE: f64 = 5e-4;

/// Changes of fewer standard deviations are not noticed.
const NOTICEABLE: f64 = 0.05;

/// Predictions for `takes`, side by side.
pub(crate) fn predict<D: Domain>(
    domain: &D,
    model: &Model,
    takes: &[usize],
) -> Result<Vec<Vec<f64>>, DiagnosisError> {
    takes.par_iter().map(|&take| domain.predict(take, model)).collect()
}

/// `step`, or its opposite where that would leave the bounds.
pub(crate) fn inside(value: f64, step: f64, lower: f64, upper: f64) -> f64 {
    if (lower..=upper).contains(&(value + step)) { step } else { -step }
}

fn row_values<'v>(index: &[u32], values: &'v [f64], count: usize, row: usize) -> Option<&'v [f64]> {
    let start = index[row];
    (start != u32::MAX).then(|| &values[start as usize..start as usize + count])
}

/// Product of two columns over parts that cover the same rows.
fn dot(a: &Column, a_part: &Range<usize>, b: &Column, b_part: &Range<usize>) -> f64 {
    let (mut i, mut j, mut sum) = (a_part.start, b_part.start, 0.0);
    while i < a_part.end && j < b_part.end {
        match a.rows[i].cmp(&b.rows[j]) {
            std::cmp::Ordering::Less => i += 1,
            std::cmp::Ordering::Greater => j += 1,
            std::cmp::Ordering::Equal => {
                sum += f64::from(a.values[i]) * f64::from(b.values[j]);
                i += 1;
                j += 1;
            }
        }
    }
    sum
}

/// Directions of parameters that the data sees less than this, of what it sees of one alone, are left at rest: steps
/// along them would be large and say nothing.
const LEAST_SEEN: f64 = 1e-3;

/// Inverse of a normal matrix, with directions that the data says nothing about left at rest.
pub(crate) fn inverse(normal: &DMatrix<f64>) -> DMatrix<f64> {
    let n = normal.nrows();
    // Scaled to a unit diagonal first: parameters have units.
    let scale: Vec<f64> =
        (0..n).map(|i| if normal[(i, i)] > 0.0 { normal[(i, i)].sqrt().recip() } else { 0.0 }).collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| normal[(i, j)] * scale[i] * scale[j]);
    let eigen = scaled.symmetric_eigen();
    let mut inverse = DMatrix::zeros(n, n);
    for (idx, &value) in eigen.eigenvalues.iter().enumerate() {
        if value > LEAST_SEEN {
            let vector = eigen.eigenvectors.column(idx);
            inverse += vector * vector.transpose() / value;
        }
    }
    DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scale[i] * scale[j])
}
