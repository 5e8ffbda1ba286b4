//! One signal of one take under a model: what is left of it, weighted.

use std::sync::{Arc, OnceLock};

use super::{Domain, HUBER, Series, huber};

/// One signal of one take under a model.
pub(super) struct Segment {
    pub(super) predicted: Series,
    /// Weight of each row: one over its standard deviation, less for outliers; 0 where nothing was measured.
    pub(super) weights: Vec<f64>,
    /// The same without regard to outliers; made when somebody asks.
    pub(super) allowed: OnceLock<Vec<f64>>,
    /// Weighted residuals.
    pub(super) residual: Arc<[f64]>,
    /// Huber's loss of the residuals.
    pub(super) loss: f64,
    /// Their squares.
    pub(super) square: f64,
}

impl Segment {
    pub(super) fn new<D: Domain>(domain: &D, take: usize, signal: usize, predicted: &Series) -> Self {
        let observed = domain.observed(take, signal);
        let mut weights = domain.weights(take, signal, predicted);
        let mut loss = 0.0;
        let residual: Arc<[f64]> = weights
            .iter_mut()
            .zip(predicted.iter().zip(observed))
            .map(|(weight, (predicted, observed))| {
                if observed.is_nan() {
                    *weight = 0.0;
                    return 0.0;
                }
                let deviation = (observed - predicted) * *weight;
                loss += huber(deviation);
                if deviation.abs() <= HUBER {
                    return deviation;
                }
                // Reweighted least squares: an outlier pulls as hard as one at the limit.
                *weight *= (HUBER / deviation.abs()).sqrt();
                (observed - predicted) * *weight
            })
            .collect();
        let square = square(&residual);
        Self { predicted: Arc::clone(predicted), weights, allowed: OnceLock::new(), residual, loss, square }
    }

    /// The loss plus the logarithms of the variances that the model allows the rows that were measured. `take` and `signal`
    /// are those that the segment was made of.
    pub(super) fn deviance<D: Domain>(&self, domain: &D, take: usize, signal: usize) -> f64 {
        let weights = self.allowed.get_or_init(|| domain.weights(take, signal, &self.predicted));
        let mut last = (f64::NAN, 0.0);
        let log_variance = |(observed, &weight): (&f64, &f64)| {
            if observed.is_nan() {
                return 0.0;
            }
            // Long spans without touch have one weight.
            if weight != last.0 {
                last = (weight, -2.0 * weight.ln());
            }
            last.1
        };
        self.loss + domain.observed(take, signal).iter().zip(weights).map(log_variance).sum::<f64>()
    }
}

/// The sum of the squares of `values`.
pub(super) fn square(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum()
}
