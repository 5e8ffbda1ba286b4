//! The surroundings of a model to first order.

mod responses;

use std::borrow::Borrow;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use palpate_sim::effects::Effect;
use rayon::prelude::*;

use super::normal::inverse;
use super::robust::{Blocks, standard_errors};
use super::rows::{Column, Rows, add_priors};
use super::segment::{Segment, square};
use super::{Domain, Model, Series, huber};
use crate::DiagnosisError;
pub(crate) use responses::inside;

/// A model over some takes: residuals, and the responses to parameters that are no news (the nuisances).
///
/// Residuals and responses are weighted: one is a standard deviation.
pub(crate) struct Linear<'a, D: Domain> {
    pub(crate) domain: &'a D,
    pub(crate) model: Model,
    /// Takes, in order.
    pub(crate) takes: Vec<usize>,
    /// Predictions by take.
    pub(crate) predicted: Vec<Vec<Series>>,
    rows: Arc<Rows>,
    segments: Vec<Arc<Segment>>,
    /// Huber's loss of the residuals, and [`Self::prior_loss`].
    pub(crate) loss: f64,
    /// How far the model is from what is known of its own parameters beforehand: squares of standard deviations,
    /// summed.
    prior_loss: f64,
    /// Huber's loss of the residuals by take and by kind of row, `[take * num_kinds + kind]`.
    losses: Vec<f64>,
    nuisances: Nuisances,
    /// Of this model, with the nuisances projected out.
    pub(crate) residual: Residual,
}

/// Weighted residuals `r` with the nuisances `N` projected out: `r - N c`.
pub(crate) struct Residual {
    /// `r`, by segment.
    values: Vec<Arc<[f64]>>,
    /// `c`.
    coefficients: DVector<f64>,
    /// `N'(r - N c)` by block. Over all blocks this is nothing, within a block it is not.
    along_nuisances: Vec<DVector<f64>>,
    /// Squares of `r - N c`, by take.
    pub(crate) squares: Vec<f64>,
}

impl Residual {
    pub(crate) fn square(&self) -> f64 {
        self.squares.iter().sum()
    }
}

struct Nuisances {
    count: usize,
    /// Per row, where its values start; `u32::MAX` if all are zero.
    index: Vec<u32>,
    values: Vec<f32>,
    /// Inverse of the normal matrix.
    inverse: DMatrix<f64>,
    /// Normal matrix of each block.
    by_block: Vec<DMatrix<f64>>,
    /// Normal matrix of each take.
    by_take: Vec<DMatrix<f64>>,
    /// `N'r` of this model's residuals, by block.
    along: Vec<DVector<f64>>,
    /// Squares of this model's residuals, by take.
    squares: Vec<f64>,
}

impl Nuisances {
    fn none(num_blocks: usize, squares: Vec<f64>) -> Self {
        Self {
            count: 0,
            index: Vec::new(),
            values: Vec::new(),
            inverse: DMatrix::zeros(0, 0),
            by_block: vec![DMatrix::zeros(0, 0); num_blocks],
            by_take: vec![DMatrix::zeros(0, 0); squares.len()],
            along: vec![DVector::zeros(0); num_blocks],
            squares,
        }
    }

    /// Values of `row`; `None` if all are zero.
    fn of_row(&self, row: usize) -> Option<&[f32]> {
        let start = *self.index.get(row)?;
        (start != u32::MAX).then(|| &self.values[start as usize..start as usize + self.count])
    }
}

/// What a candidate's responses say.
#[derive(Clone, Debug)]
pub(crate) struct Assessment {
    /// Best step of its parameters, in their own units: where [`Self::normal`] times it is [`Self::score`].
    pub(crate) step: DVector<f64>,
    /// R~'R~.
    pub(crate) normal: DMatrix<f64>,
    /// R~'r.
    pub(crate) score: DVector<f64>,
    /// Standard errors of the last parameters, as many as were asked for, robust against dependence within blocks.
    pub(crate) standard_errors: Vec<f64>,
    /// Loss that steps fitted to the other takes remove, by take; to other blocks, where few takes see them. The
    /// nuisances are projected out with their coefficients of all takes.
    pub(crate) held_out_gains: Vec<f64>,
}

/// With fewer takes that see a parameter, fits are judged on blocks instead.
const FEW_TAKES: usize = 3;
/// A take that sees less than this share of what all see of a parameter does not see it.
const LEAST_TAKE_SHARE: f64 = 0.02;
/// Folds of blocks.
const FEW_FOLDS: usize = 5;

impl<'a, D: Domain> Linear<'a, D> {
    /// Linearises `model` over `takes`; its own parameters and those of its effects become nuisances.
    pub(crate) fn new(domain: &'a D, model: &Model, takes: &[usize]) -> Result<Self, DiagnosisError> {
        let mut linear = Self::without_nuisances(domain, model, takes)?;
        let mut columns = linear.nuisance_columns()?;
        // A parameter that is driven to the end of its range takes up no more of what drives it.
        for ((column, value), bounds) in columns.iter_mut().zip(&model.base).zip(domain.base()) {
            if *value <= bounds.lower || *value >= bounds.upper {
                *column = Column::default();
            }
        }
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
        let rows = Arc::new(Rows::new(domain, takes));
        Ok(Self::of_predicted(domain, model.clone(), takes, rows, predicted, &[]))
    }

    /// The same of another model over the same takes, for less where it predicts the same.
    pub(crate) fn moved_to(&self, model: Model) -> Result<Self, DiagnosisError> {
        let predicted = predict(self.domain, &model, &self.takes)?;
        let rows = Arc::clone(&self.rows);
        Ok(Self::of_predicted(self.domain, model, &self.takes, rows, predicted, &self.segments))
    }

    /// `known` may hold segments of another model.
    fn of_predicted(
        domain: &'a D,
        model: Model,
        takes: &[usize],
        rows: Arc<Rows>,
        predicted: Vec<Vec<Series>>,
        known: &[Arc<Segment>],
    ) -> Self {
        let segments: Vec<Arc<Segment>> = (0..rows.starts.len() - 1)
            .into_par_iter()
            .map(|idx| {
                let (take, signal) = (rows.take(idx), rows.signal(idx));
                let series = &predicted[take][signal];
                match known.get(idx).filter(|known| Arc::ptr_eq(&known.predicted, series)) {
                    Some(known) => Arc::clone(known),
                    None => Arc::new(Segment::new(domain, takes[take], signal, series)),
                }
            })
            .collect();
        let mut losses = vec![0.0; takes.len() * rows.num_kinds];
        let mut squares = vec![0.0; takes.len()];
        for (idx, segment) in segments.iter().enumerate() {
            losses[rows.take(idx) * rows.num_kinds + rows.kind(idx)] += segment.loss;
            squares[rows.take(idx)] += segment.square;
        }
        let residual = Residual {
            values: segments.iter().map(|segment| Arc::clone(&segment.residual)).collect(),
            coefficients: DVector::zeros(0),
            along_nuisances: vec![DVector::zeros(0); rows.takes.len()],
            squares: squares.clone(),
        };
        let prior_loss = prior_losses(domain, &model).map(|(_, loss)| loss).sum::<f64>();
        Self {
            domain,
            model,
            takes: takes.to_vec(),
            predicted,
            loss: losses.iter().sum::<f64>() + prior_loss,
            prior_loss,
            losses,
            nuisances: Nuisances::none(rows.takes.len(), squares),
            residual,
            rows,
            segments,
        }
    }

    /// Segments of which `predicted` (by take) is another series than this model's, with it.
    fn changed<'p>(
        &self,
        before: &'p [Vec<Series>],
        after: &'p [Vec<Series>],
    ) -> impl Iterator<Item = (usize, &'p Series, &'p Series)> + use<'p, 'a, D> {
        let pairs = before.iter().flatten().zip(after.iter().flatten()).enumerate();
        pairs.filter(|(_, (before, after))| !Arc::ptr_eq(before, after)).map(|(idx, (a, b))| (idx, a, b))
    }

    /// Minus twice the logarithm of the posterior, up to a constant: [`Self::loss`] plus the logarithms of the
    /// variances that the model allows its rows. Models compare by this and not by [`Self::loss`], in which a model
    /// that allows more wins.
    pub(crate) fn deviance(&self) -> f64 {
        let of_segment = |(idx, segment): (usize, &Arc<Segment>)| {
            segment.deviance(self.domain, self.takes[self.rows.take(idx)], self.rows.signal(idx))
        };
        // Summed in one order, whatever the number of threads.
        let of_segments: Vec<f64> = self.segments.par_iter().enumerate().map(of_segment).collect();
        of_segments.iter().sum::<f64>() + self.prior_loss
    }

    /// Loss by take.
    pub(crate) fn loss_by_take(&self) -> Vec<f64> {
        self.losses.chunks_exact(self.rows.num_kinds).map(|of_take| of_take.iter().sum()).collect()
    }

    /// Loss by unit; what is known of a parameter counts at the first unit that it reaches.
    pub(crate) fn loss_by_unit(&self) -> Vec<f64> {
        let mut losses = vec![0.0; self.domain.num_units()];
        for (idx, segment) in self.segments.iter().enumerate() {
            losses[self.rows.unit(idx)] += segment.loss;
        }
        for (idx, loss) in prior_losses(self.domain, &self.model) {
            if let Some(unit) = self.domain.base_support(idx).iter().position(|reached| *reached) {
                losses[unit] += loss;
            }
        }
        losses
    }

    /// Loss in the rows of `kinds`.
    pub(crate) fn loss_in(&self, kinds: &[bool]) -> f64 {
        let of_take = |losses: &[f64]| {
            losses.iter().zip(kinds).map(|(loss, of)| if *of { *loss } else { 0.0 }).sum::<f64>()
        };
        self.losses.chunks_exact(kinds.len()).map(of_take).sum()
    }

    /// Loss of `predicted` by take and kind of row, as [`Self::loss_by_take`] has it for this model, with the
    /// weights of this model's predictions: what a model is unsure of weighs less, so that losses with weights of
    /// their own do not compare.
    pub(crate) fn losses_of(&self, predicted: &[Vec<Series>]) -> Vec<Vec<f64>> {
        let mut losses = vec![vec![0.0; self.rows.num_kinds]; self.takes.len()];
        for (idx, segment) in self.segments.iter().enumerate() {
            let (take, signal) = (self.rows.take(idx), self.rows.signal(idx));
            let after = &predicted[take][signal];
            losses[take][self.rows.kind(idx)] += if Arc::ptr_eq(&segment.predicted, after) {
                segment.loss
            } else {
                self.losses_of_rows(idx, after).map(|(_, loss)| loss).sum()
            };
        }
        losses
    }

    /// Huber's losses of a `predicted` series of the segment `idx`, with the weights of this model's predictions: of
    /// each frame that was measured.
    fn losses_of_rows<'s>(
        &'s self,
        idx: usize,
        predicted: &'s [f64],
    ) -> impl Iterator<Item = (usize, f64)> + 's {
        let (take, signal) = (self.takes[self.rows.take(idx)], self.rows.signal(idx));
        let segment = &self.segments[idx];
        let allowed = || self.domain.weights(take, signal, &segment.predicted);
        let weights = segment.allowed.get_or_init(allowed);
        let rows = self.domain.observed(take, signal).iter().zip(predicted).zip(weights).enumerate();
        let measured = rows.filter(|(_, ((observed, _), _))| !observed.is_nan());
        measured
            .map(|(frame, ((observed, predicted), weight))| (frame, huber((observed - predicted) * weight)))
    }

    /// Loss that `predicted` (by take) has beyond this model, by block, with the weights of [`Self::losses_of`].
    pub(crate) fn losses_beyond(&self, predicted: &[Vec<Series>]) -> Vec<f64> {
        let blocks = |take: usize| self.domain.blocks(self.takes[take]);
        let mut beyond: Vec<Vec<f64>> =
            (0..self.takes.len()).map(|take| vec![0.0; blocks(take).len()]).collect();
        for (idx, before, after) in self.changed(&self.predicted, predicted) {
            let take = self.rows.take(idx);
            let block_of = |frame: usize| blocks(take).partition_point(|block| block.end <= frame);
            let pairs = self.losses_of_rows(idx, after).zip(self.losses_of_rows(idx, before));
            for ((frame, after), (_, before)) in pairs {
                beyond[take][block_of(frame)] += after - before;
            }
        }
        beyond.into_iter().flatten().collect()
    }

    /// Loss of `model`, with the weights of this model's predictions.
    pub(crate) fn loss_of(&self, model: &Model) -> Result<f64, DiagnosisError> {
        let losses = self.losses_of(&predict(self.domain, model, &self.takes)?);
        let of_priors: f64 = prior_losses(self.domain, model).map(|(_, loss)| loss).sum();
        Ok(losses.iter().flatten().sum::<f64>() + of_priors)
    }

    /// Which kinds of rows `predicted` (by take) has otherwise than this model.
    pub(crate) fn kinds_changed(&self, predicted: &[Vec<Series>]) -> Vec<bool> {
        let mut changed = vec![false; self.rows.num_kinds];
        for (idx, before, after) in self.changed(&self.predicted, predicted) {
            let weights = &self.segments[idx].weights;
            changed[self.rows.kind(idx)] |= before
                .iter()
                .zip(after.iter())
                .zip(weights)
                .any(|((before, after), weight)| ((after - before) * weight).abs() > NOTICEABLE);
        }
        changed
    }

    /// Which kinds of rows `columns` reach.
    pub(crate) fn kinds_in(&self, columns: &[Column]) -> Vec<bool> {
        let mut reached = vec![false; self.rows.num_kinds];
        for (segment, _) in columns.iter().flat_map(|column| &column.parts) {
            reached[self.rows.kind(*segment)] = true;
        }
        reached
    }

    /// Makes `columns` the nuisances and projects them out of the residual.
    pub(crate) fn project(&mut self, columns: &[Column]) {
        let count = columns.len();
        let (index, values) = self.by_row(columns);
        let mut nuisances = Nuisances {
            count,
            index,
            values,
            by_take: vec![DMatrix::zeros(count, count); self.takes.len()],
            ..Nuisances::none(0, std::mem::take(&mut self.nuisances.squares))
        };
        let of_takes: Vec<Vec<(DMatrix<f64>, DVector<f64>)>> =
            (0..self.takes.len()).into_par_iter().map(|take| self.normals_of(&nuisances, take)).collect();
        (nuisances.by_block, nuisances.along) = of_takes.into_iter().flatten().unzip();
        add_priors(columns.iter(), &mut nuisances.by_block, &mut nuisances.along);
        if let Some(square) = nuisances.squares.last_mut() {
            *square += self.prior_loss;
        }
        let mut normal = DMatrix::zeros(count, count);
        for (of_block, &take) in nuisances.by_block.iter().zip(&self.rows.takes) {
            normal += of_block;
            nuisances.by_take[take] += of_block;
        }
        nuisances.inverse = inverse(&normal);
        self.nuisances = nuisances;
        let values = std::mem::take(&mut self.residual.values);
        self.residual = self.projected(values, self.nuisances.along.clone(), self.nuisances.squares.clone());
    }

    /// The values of `columns` row by row: where those of each row start (`u32::MAX` if all are zero), and the values.
    fn by_row(&self, columns: &[Column]) -> (Vec<u32>, Vec<f32>) {
        let mut index = vec![u32::MAX; self.rows.blocks.len()];
        columns.iter().flat_map(|column| &column.rows).for_each(|&row| index[row as usize] = 0);
        let mut end = 0;
        for start in index.iter_mut().filter(|start| **start == 0) {
            *start = end;
            end += columns.len() as u32;
        }
        let mut values = vec![0.0_f32; end as usize];
        for (idx, column) in columns.iter().enumerate() {
            for (&row, &value) in column.rows.iter().zip(&column.values) {
                values[index[row as usize] as usize + idx] = value;
            }
        }
        (index, values)
    }

    /// Of each block of the take with this index, the normal matrix of `nuisances` and `N'r`.
    fn normals_of(&self, nuisances: &Nuisances, take: usize) -> Vec<(DMatrix<f64>, DVector<f64>)> {
        let count = nuisances.count;
        let first = self.rows.takes.partition_point(|other| *other < take);
        let num_blocks = self.rows.takes.iter().filter(|other| **other == take).count();
        let mut of_blocks = vec![(DMatrix::zeros(count, count), DVector::zeros(count)); num_blocks];
        let segments = take * self.rows.num_signals..(take + 1) * self.rows.num_signals;
        for (segment, &start) in self.segments[segments.clone()].iter().zip(&self.rows.starts[segments]) {
            for (row, residual) in (start..).zip(segment.residual.iter()) {
                let Some(values) = nuisances.of_row(row) else { continue };
                let (normal, along) = &mut of_blocks[self.rows.blocks[row] as usize - first];
                for (i, &a) in values.iter().enumerate().filter(|(_, a)| **a != 0.0) {
                    let a = f64::from(a);
                    along[i] += a * residual;
                    let mut below = normal.view_mut((i, i), (count - i, 1));
                    below.iter_mut().zip(&values[i..]).for_each(|(sum, &b)| *sum += a * f64::from(b));
                }
            }
        }
        of_blocks.iter_mut().for_each(|(normal, _)| normal.fill_upper_triangle_with_lower_triangle());
        of_blocks
    }

    /// By take and unit, how much smaller the squares of the residuals are with `predicted` (by take) in place of this
    /// model's predictions, with these weights.
    pub(crate) fn removed(&self, predicted: &[Vec<Series>]) -> Vec<Vec<f64>> {
        let mut removed = vec![vec![0.0; self.domain.num_units()]; self.takes.len()];
        for (idx, before, after) in self.changed(&self.predicted, predicted) {
            let (take, signal) = (self.rows.take(idx), self.rows.signal(idx));
            let observed = self.domain.observed(self.takes[take], signal);
            let sum = &mut removed[take][self.rows.unit(idx)];
            let rows = observed.iter().zip(before.iter().zip(after.iter())).zip(&self.segments[idx].weights);
            for ((observed, (before, after)), &weight) in rows {
                if weight > 0.0 && before != after {
                    let squares = (observed - before).powi(2) - (observed - after).powi(2);
                    *sum += weight * weight * squares;
                }
            }
        }
        removed
    }

    /// Squares of the residuals, by unit.
    pub(crate) fn squares_by_unit(&self) -> Vec<f64> {
        let mut squares = vec![0.0; self.domain.num_units()];
        for (idx, segment) in self.segments.iter().enumerate() {
            squares[self.rows.unit(idx)] += segment.square;
        }
        squares
    }

    /// Residuals of `predicted` (by take) with these weights and nuisances: what a candidate leaves.
    pub(crate) fn residual_of(&self, predicted: &[Vec<Series>]) -> Residual {
        let mut values: Vec<Arc<[f64]>> =
            self.segments.iter().map(|segment| Arc::clone(&segment.residual)).collect();
        let mut along = self.nuisances.along.clone();
        let mut squares = self.nuisances.squares.clone();
        for (idx, _, after) in self.changed(&self.predicted, predicted) {
            let (take, segment) = (self.rows.take(idx), &self.segments[idx]);
            let observed = self.domain.observed(self.takes[take], self.rows.signal(idx));
            let rows = observed.iter().zip(after.iter()).zip(&segment.weights);
            let residual: Arc<[f64]> = rows
                .map(
                    |((observed, predicted), &weight)| {
                        if weight > 0.0 { (observed - predicted) * weight } else { 0.0 }
                    },
                )
                .collect();
            squares[take] += square(&residual) - segment.square;
            if self.nuisances.count > 0 {
                let pairs = residual.iter().zip(segment.residual.iter());
                for (row, (after, before)) in (self.rows.starts[idx]..).zip(pairs) {
                    let change = after - before;
                    if change == 0.0 {
                        continue;
                    }
                    if let Some(values) = self.nuisances.of_row(row) {
                        let sums = along[self.rows.blocks[row] as usize].iter_mut();
                        sums.zip(values).for_each(|(sum, &value)| *sum += f64::from(value) * change);
                    }
                }
            }
            values[idx] = residual;
        }
        self.projected(values, along, squares)
    }

    /// The residual `values` (by segment) with the nuisances projected out, given `along = N'r` by block and the
    /// squares of `r` by take.
    fn projected(
        &self,
        values: Vec<Arc<[f64]>>,
        mut along: Vec<DVector<f64>>,
        mut squares: Vec<f64>,
    ) -> Residual {
        let Nuisances { count, inverse, by_block, by_take, .. } = &self.nuisances;
        let total = along.iter().fold(DVector::zeros(*count), |sum, part| sum + part);
        let coefficients = inverse * total;
        for (along, &take) in along.iter().zip(&self.rows.takes) {
            squares[take] -= 2.0 * coefficients.dot(along);
        }
        for (square, normal) in squares.iter_mut().zip(by_take) {
            *square += coefficients.dot(&(normal * &coefficients));
        }
        for (along, normal) in along.iter_mut().zip(by_block) {
            along.gemv(-1.0, normal, &coefficients, 1.0);
        }
        Residual { values, coefficients, along_nuisances: along, squares }
    }

    /// What `columns` can do about `residual` (as [`Self::residual`] or [`Self::residual_of`]).
    ///
    /// With R the responses and N the nuisances, R~ = R - N (N'N)^-1 N'R; the step is (R~'R~)^-1 R~'r.
    pub(crate) fn assess<C: Borrow<Column>>(&self, columns: &[C], residual: &Residual) -> Assessment {
        let columns: Vec<&Column> = columns.iter().map(Borrow::borrow).collect();
        self.assess_with_errors(&columns, residual, 0, Blocks::Many)
    }

    /// The same, with standard errors (of the sandwich over blocks) of the last `num_errors` parameters.
    pub(crate) fn assess_with_errors(
        &self,
        columns: &[&Column],
        residual: &Residual,
        num_errors: usize,
        taken_for: Blocks,
    ) -> Assessment {
        let coefficients = &residual.coefficients;
        let k = columns.len();
        let Nuisances { count: m, inverse: p, by_block, .. } = &self.nuisances;
        let num_blocks = self.rows.takes.len();
        let blocks = &self.rows.blocks;
        // Per block: R'r, N'R, R'R.
        let mut scores = vec![DVector::<f64>::zeros(k); num_blocks];
        let mut nuisances_with = vec![DMatrix::<f64>::zeros(*m, k); num_blocks];
        let mut normals = vec![DMatrix::<f64>::zeros(k, k); num_blocks];
        for (i, column) in columns.iter().enumerate() {
            for (segment, part) in &column.parts {
                let (start, residual) = (self.rows.starts[*segment], &residual.values[*segment]);
                for (&row, &value) in column.rows[part.clone()].iter().zip(&column.values[part.clone()]) {
                    let (row, value) = (row as usize, f64::from(value));
                    let block = blocks[row] as usize;
                    let mut left = residual[row - start];
                    normals[block][(i, i)] += value * value;
                    if let Some(values) = self.nuisances.of_row(row) {
                        let mut with = nuisances_with[block].column_mut(i);
                        for ((&nuisance, coefficient), with) in
                            values.iter().zip(coefficients.iter()).zip(with.iter_mut())
                        {
                            let nuisance = f64::from(nuisance);
                            left -= nuisance * coefficient;
                            *with += value * nuisance;
                        }
                    }
                    scores[block][i] += value * left;
                }
            }
            for (j, other) in columns[..i].iter().enumerate() {
                column.each_common(other, |row, product| normals[blocks[row] as usize][(i, j)] += product);
            }
        }
        add_priors(columns.iter().copied(), &mut normals, &mut scores);
        for normal in &mut normals {
            normal.fill_upper_triangle_with_lower_triangle();
        }
        let with_nuisances: Vec<DMatrix<f64>> = nuisances_with.iter().map(DMatrix::transpose).collect();
        let a: DMatrix<f64> = with_nuisances.iter().fold(DMatrix::zeros(k, *m), |sum, part| sum + part);
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
        let standard_errors = standard_errors(
            &h_inverse,
            (num_errors, taken_for),
            &step,
            &projected_scores,
            &projected_normals,
        );

        let (folds, num_folds) = self.folds(&projected_normals);
        let mut of_fold = vec![(DVector::<f64>::zeros(k), DMatrix::<f64>::zeros(k, k)); num_folds];
        for (&fold, (score, normal)) in folds.iter().zip(projected_scores.iter().zip(&projected_normals)) {
            of_fold[fold].0 += score;
            of_fold[fold].1 += normal;
        }
        let steps: Vec<DVector<f64>> =
            of_fold.iter().map(|(score, normal)| inverse(&(&h - normal)) * (&s - score)).collect();
        let mut held_out_gains = vec![0.0; self.takes.len()];
        for (block, take) in self.rows.takes.iter().enumerate() {
            // What is known beforehand is held out of no fit.
            let is_known = block + 1 == num_blocks;
            let step = if is_known { &step } else { &steps[folds[block]] };
            held_out_gains[*take] +=
                2.0 * projected_scores[block].dot(step) - step.dot(&(&projected_normals[block] * step));
        }
        Assessment { standard_errors, step, normal: h, score: s, held_out_gains }
    }

    /// Calls `visit` with the take, the value of `column` and the residual of every row, both with the nuisances
    /// projected out, where the former is not nothing.
    pub(crate) fn each_left(&self, column: &Column, mut visit: impl FnMut(usize, f64, f64)) {
        let mut values = vec![0.0; self.rows.blocks.len()];
        let mut along = DVector::zeros(self.nuisances.count);
        for (&row, &value) in column.rows.iter().zip(&column.values) {
            values[row as usize] = f64::from(value);
            for (sum, &nuisance) in
                along.iter_mut().zip(self.nuisances.of_row(row as usize).unwrap_or_default())
            {
                *sum += f64::from(nuisance) * f64::from(value);
            }
        }
        let of_column = &self.nuisances.inverse * along;
        for (segment, residual) in self.residual.values.iter().enumerate() {
            let take = self.rows.take(segment);
            for (row, residual) in (self.rows.starts[segment]..).zip(residual.iter()) {
                let (mut value, mut left) = (values[row], *residual);
                let nuisances = self.nuisances.of_row(row).unwrap_or_default();
                for (idx, &nuisance) in nuisances.iter().enumerate() {
                    let nuisance = f64::from(nuisance);
                    value -= nuisance * of_column[idx];
                    left -= nuisance * self.residual.coefficients[idx];
                }
                if value != 0.0 {
                    visit(take, value, left);
                }
            }
        }
    }

    /// Which blocks are judged together by a fit to all others, and the number of such folds: those of a take; or,
    /// where so few takes see what is fitted that a fit without one of them would know nothing, every
    /// [`FEW_FOLDS`]-th block.
    fn folds(&self, normals: &[DMatrix<f64>]) -> (Vec<usize>, usize) {
        let mut seen = vec![0.0; self.takes.len()];
        for (take, normal) in self.rows.takes.iter().zip(normals) {
            seen[*take] += normal.trace();
        }
        let least = LEAST_TAKE_SHARE * seen.iter().sum::<f64>();
        if seen.iter().filter(|seen| **seen > least).count() >= FEW_TAKES {
            return (self.rows.takes.clone(), self.takes.len());
        }
        ((0..self.rows.takes.len()).map(|block| block % FEW_FOLDS).collect(), FEW_FOLDS)
    }

    /// `model` with another effect.
    pub(crate) fn with(&self, effect: Effect) -> Model {
        let mut model = self.model.clone();
        model.effects.push(effect);
        model
    }
}

/// The model's own parameters of which something is known beforehand, with the squares of the standard deviations that
/// `model` has them away from it.
fn prior_losses<D: Domain>(domain: &D, model: &Model) -> impl Iterator<Item = (usize, f64)> {
    let of =
        |(idx, value): (usize, &f64)| Some((idx, (value / domain.prior_standard_deviation(idx)?).powi(2)));
    model.base.iter().enumerate().filter_map(of)
}

/// Changes of fewer standard deviations are not noticed.
const NOTICEABLE: f64 = 0.05;

/// Predictions for `takes`, side by side.
pub(crate) fn predict<D: Domain>(
    domain: &D,
    model: &Model,
    takes: &[usize],
) -> Result<Vec<Vec<Series>>, DiagnosisError> {
    domain.predict_takes(takes, model)
}
