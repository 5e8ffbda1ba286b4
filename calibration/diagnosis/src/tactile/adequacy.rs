//! Whether what is left repeats: the ground for `unexplained`, which rests on this and not on a lack of power.

use palpate_robot_model::Station;

use super::judge::repeated;
use super::{Observed, TactileDomain};
use crate::DiagnosisError;
use crate::engine::{Domain, Model};

/// What is left of a model's residuals and should not be there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Adequacy {
    /// Mean square of what residuals of repeated motions have in common, in variances, over rows near contact; 0 if
    /// repetitions have nothing in common.
    pub repeating: f64,
    /// Variance of the mean over a stream's quiet channels, over what independent channels would show; about 1 if they
    /// are independent.
    pub common_mode: f64,
}

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
    let stride = 2 * station.layout.num_channels();
    let (mut product, mut count) = (0.0, 0.0);
    let mut quiet = vec![Quiet::default(); station.layout.streams.len()];
    for &take in takes {
        let observed = domain.take(take);
        let prediction = domain.predict(take, model)?;
        let weights = domain.weights(take, &prediction);
        let residual: Vec<f64> = observed
            .rows
            .iter()
            .zip(&prediction)
            .zip(&weights)
            .map(|((row, predicted), weight)| ((row - predicted) * weight).clamp(-CLIP, CLIP))
            .collect();
        for (first, second) in repeated(observed) {
            for offset in 0..first.len().min(second.len()) {
                let (a, b) = ((first.start + offset) * stride, (second.start + offset) * stride);
                for row in 0..stride {
                    let (x, y) = (residual[a + row], residual[b + row]);
                    let near = prediction[a + row] > QUIET || prediction[b + row] > QUIET;
                    if near && x.is_finite() && y.is_finite() {
                        product += x * y;
                        count += 1.0;
                    }
                }
            }
        }
        for (stream, sum) in station.layout.streams.iter().zip(&mut quiet) {
            sum.add(observed, &prediction, stream.channels.clone(), stride);
        }
    }
    Ok(Adequacy {
        repeating: if count > 0.0 { (product / count).max(0.0) } else { 0.0 },
        common_mode: quiet.iter().map(Quiet::ratio).fold(0.0, f64::max),
    })
}

#[derive(Clone, Copy, Default)]
struct Quiet {
    frames: f64,
    squares: f64,
}

impl Quiet {
    fn add(
        &mut self,
        observed: &Observed<'_>,
        prediction: &[f64],
        channels: std::ops::Range<usize>,
        stride: usize,
    ) {
        for frame in 0..observed.rows.len() / stride {
            let (mut sum, mut count) = (0.0, 0.0);
            for channel in channels.clone() {
                let row = frame * stride + 2 * channel + 1;
                let value = observed.rows[row] - prediction[row];
                if value.is_finite() && prediction[row].abs() < QUIET && observed.noise[channel] > 0.0 {
                    sum += (value / observed.noise[channel]).clamp(-2.0 * CLIP, 2.0 * CLIP);
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
