//! Whether what is left repeats: the ground for `unexplained`, which rests on this and not on a lack of power.

use palpate_robot_model::Station;

use super::judge::repeated;
use super::{Observed, TactileDomain};
use crate::DiagnosisError;
use crate::engine::{Domain, Model, Series, huber};

/// What is left of a model's residuals and should not be there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Adequacy {
    /// Mean square of what residuals of repeated motions have in common, in variances, over rows near contact; 0 if
    /// repetitions have nothing in common.
    pub repeating: f64,
    /// Variance of the mean over a stream's quiet channels, over what independent channels would show; about 1 if they
    /// are independent.
    pub common_mode: f64,
    /// Huber's loss of a row, in variances, over all rows that were measured.
    pub loss: f64,
}

impl Adequacy {
    /// Whether names that leave this account for what there was `before` them: whoever is named in place of an effect that
    /// is in no library explains a part of it and leaves the rest.
    pub(crate) fn accounts_for(&self, before: &Self, limits: &Self) -> bool {
        let left = |now: f64, then: f64, complete: f64| {
            (now - complete).max(0.0) <= MOST_LEFT * (then - complete).max(0.0)
        };
        if before.loss > limits.loss {
            self.loss <= limits.loss || left(self.loss, before.loss, COMPLETE.loss)
        } else {
            self.repeating <= limits.repeating || left(self.repeating, before.repeating, COMPLETE.repeating)
        }
    }
}

/// What a model that misses nothing shows, tuned like the limits.
const COMPLETE: Adequacy = Adequacy { repeating: 0.36, common_mode: 1.07, loss: 0.56 };
/// Share of the excess that names may leave and still be the right ones.
const MOST_LEFT: f64 = 0.35;

/// Residuals count up to this many standard deviations.
const CLIP: f64 = 4.0;
/// A channel is quiet where the model expects less than this, in units of the threshold.
const QUIET: f64 = 0.02;

/// Measures `model` on `takes`.
pub(crate) fn adequacy(
    station: &Station,
    domain: &TactileDomain<'_>,
    model: &Model,
    takes: &[usize],
) -> Result<Adequacy, DiagnosisError> {
    let (mut product, mut count) = (0.0, 0.0);
    let (mut loss, mut rows_measured) = (0.0, 0.0);
    let mut quiet = vec![Quiet::default(); station.layout.streams.len()];
    for &take in takes {
        let observed = domain.take(take);
        let prediction = domain.predict(take, model)?;
        let repeated = repeated(observed);
        for (signal, predicted) in prediction.iter().enumerate() {
            let weights = domain.weights(take, signal, predicted);
            let rows = observed.signals[signal].iter().zip(predicted.iter()).zip(&weights);
            let deviation: Vec<f64> =
                rows.map(|((row, predicted), weight)| (row - predicted) * weight).collect();
            for deviation in deviation.iter().filter(|deviation| deviation.is_finite()) {
                loss += huber(*deviation);
                rows_measured += 1.0;
            }
            let residual = |frame: usize| deviation[frame].clamp(-CLIP, CLIP);
            for (a, b) in repeated.iter().flat_map(|(first, second)| first.clone().zip(second.clone())) {
                let (x, y) = (residual(a), residual(b));
                let near = predicted[a] > QUIET || predicted[b] > QUIET;
                if near && x.is_finite() && y.is_finite() {
                    product += x * y;
                    count += 1.0;
                }
            }
        }
        for (stream, sum) in station.layout.streams.iter().zip(&mut quiet) {
            sum.add(observed, &prediction, stream.channels.clone());
        }
    }
    Ok(Adequacy {
        repeating: if count > 0.0 { (product / count).max(0.0) } else { 0.0 },
        common_mode: quiet.iter().map(Quiet::ratio).fold(0.0, f64::max),
        loss: if rows_measured > 0.0 { loss / rows_measured } else { 0.0 },
    })
}

#[derive(Clone, Copy, Default)]
struct Quiet {
    frames: f64,
    squares: f64,
}

impl Quiet {
    fn add(&mut self, observed: &Observed<'_>, prediction: &[Series], channels: std::ops::Range<usize>) {
        for frame in 0..observed.take.num_frames() {
            let (mut sum, mut count) = (0.0, 0.0);
            let readings = observed.signals.iter().zip(prediction).skip(1).step_by(2);
            let of_stream = readings.zip(&observed.noise).take(channels.end).skip(channels.start);
            for ((reading, predicted), noise) in of_stream {
                let value = reading[frame] - predicted[frame];
                if value.is_finite() && predicted[frame].abs() < QUIET && *noise > 0.0 {
                    sum += (value / noise).clamp(-2.0 * CLIP, 2.0 * CLIP);
                    count += 1.0;
                }
            }
            if count > 1.0 {
                // The square of a sum of independent deviates is as large as their number.
                self.squares += sum * sum / count;
                self.frames += 1.0;
            }
        }
    }

    fn ratio(&self) -> f64 {
        if self.frames > 0.0 { self.squares / self.frames } else { 0.0 }
    }
}
