//! Whether what is left repeats: the ground for `unexplained`, which rests on this and not on a lack of power.

use palpate_robot_model::{SensorKind, Station};

use super::judge::repeated;
use super::wander::Wander;
use super::{Observed, Signal, TactileDomain};
use crate::DiagnosisError;
use crate::engine::{Domain, Model, Series, huber};
use crate::fired::{self, Fired, InForce};

/// What is left of a model's residuals and should not be there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Adequacy {
    /// Mean square of what residuals of repeated motions have in common, in variances, over rows near contact; 0 if
    /// repetitions have nothing in common.
    pub repeating: f64,
    /// The same of the readings of the patch of pressure sensors in which most repeats, with rows enough to tell: over
    /// all patches together what is wrong with one of them is lost.
    pub at_patch: f64,
    /// Variance of the mean over a stream's quiet channels, over what noise and the wander of its board make it;
    /// about 1 if that is all.
    pub common_mode: f64,
    /// Huber's loss of a row, in variances, over all events and readings that were measured.
    pub loss: f64,
    /// The same over what firmware makes of readings.
    pub switching: f64,
    /// Index of the patch of [`Self::at_patch`].
    pub patch: usize,
    /// Index of the stream of [`Self::common_mode`].
    pub stream: usize,
}

impl Adequacy {
    /// Limits, tuned on sessions of an emulated station in which nothing is hidden.
    pub(crate) const SHIPPED: Self = Self {
        repeating: 0.5,
        at_patch: 0.85,
        common_mode: 1.5,
        loss: 0.61,
        switching: 0.03,
        patch: 0,
        stream: 0,
    };

    /// How many times as much is left of touches as `limits` allow, by the measure in variances that is farthest
    /// beyond its own: how far residuals are from what standard errors take them for.
    pub(crate) fn overdispersion(&self, limits: &Self) -> f64 {
        let repeating = (self.repeating / limits.repeating).max(self.at_patch / limits.at_patch);
        repeating.max(self.loss / limits.loss)
    }

    /// Fires if the residual that repetitions share has grown from what it was `before`. This catches a stuck channel
    /// that is taken for a flickering one: its errors shrink, but become the same in every repetition.
    pub(crate) fn repeats_more(&self, before: &Self, rules: InForce<'_>) -> Option<Fired> {
        rules.above(fired::REPEATS_MORE, self.repeating / before.repeating.max(TINY), MOST_RAISED)
    }
}

/// Less than anything that is measured, in variances: keeps quotients finite, as reports need them.
const TINY: f64 = 1e-9;

/// What repeats with right names, over what did before: no more, but for chance.
pub(crate) const MOST_RAISED: f64 = 1.2;

/// Residuals count up to this many standard deviations.
pub(super) const CLIP: f64 = 4.0;

/// What is left in one signal.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Left {
    /// Products of what residuals of repeated motions have in common, and their number.
    products: [f64; 2],
    /// Huber's loss, and the number of rows.
    losses: [f64; 2],
    gains: Gains,
}

/// What gains of one channel's response would remove from its residuals, in variances, over the takes that press it enough to
/// tell.
#[derive(Clone, Copy, Debug, Default)]
struct Gains {
    /// By a gain of its own for each take.
    by_take: f64,
    num_takes: f64,
    /// Product of response and residual over all these takes, and the square of the response.
    along: f64,
    square: f64,
}

impl Gains {
    /// Adds a take of which the product and the square are these.
    fn add(&mut self, along: f64, square: f64) {
        if square > PRESSES {
            self.by_take += along * along / square;
            self.num_takes += 1.0;
            self.along += along;
            self.square += square;
        }
    }

    /// What gains by take remove beyond one gain for all takes, and how many more they are.
    fn beyond_one(&self) -> [f64; 2] {
        if self.num_takes < 2.0 {
            return [0.0; 2];
        }
        [(self.by_take - self.along * self.along / self.square).max(0.0), self.num_takes - 1.0]
    }
}

impl Left {
    /// Of several signals together.
    fn sum<'l>(signals: impl Iterator<Item = &'l Self>) -> Self {
        signals.fold(Self::default(), |sum, one| Self {
            products: [0, 1].map(|idx| sum.products[idx] + one.products[idx]),
            losses: [0, 1].map(|idx| sum.losses[idx] + one.losses[idx]),
            ..sum
        })
    }

    /// As [`Adequacy::repeating`].
    fn repeating(&self) -> f64 {
        let [product, count] = self.products;
        if count > 0.0 { (product / count).max(0.0) } else { 0.0 }
    }

    /// As [`Adequacy::loss`].
    fn loss(&self) -> f64 {
        let [loss, rows] = self.losses;
        if rows > 0.0 { loss / rows } else { 0.0 }
    }
}

/// Loss of a row, in variances, of a model that misses nothing.
const COMPLETE_LOSS: f64 = 0.56;
/// A channel is quiet where the model expects less than this, in units of the threshold.
pub(super) const QUIET: f64 = 0.02;

/// Measures `model` on `takes`: over all signals, and what is left in each.
pub(crate) fn adequacy(
    station: &Station,
    domain: &TactileDomain<'_>,
    model: &Model,
    takes: &[usize],
) -> Result<(Adequacy, Vec<Left>), DiagnosisError> {
    let mut left = vec![Left::default(); domain.num_signals()];
    let mut quiet = vec![Quiet::default(); station.layout.streams.len()];
    for &take in takes {
        let observed = domain.take(take);
        let prediction = domain.predict(take, model)?;
        let repeated = repeated(observed);
        for ((signal, predicted), Left { products, losses, gains }) in
            prediction.iter().enumerate().zip(&mut left)
        {
            let weights = domain.weights(take, signal, predicted);
            let rows = observed.signals[signal].iter().zip(predicted.iter()).zip(&weights);
            let deviation: Vec<f64> =
                rows.map(|((row, predicted), weight)| (row - predicted) * weight).collect();
            for deviation in deviation.iter().filter(|deviation| deviation.is_finite()) {
                losses[0] += huber(*deviation);
                losses[1] += 1.0;
            }
            let residual = |frame: usize| deviation[frame].clamp(-CLIP, CLIP);
            let of_gain = predicted.iter().zip(&weights).map(|(predicted, weight)| predicted * weight);
            let pressing = of_gain.enumerate().filter(|(frame, _)| deviation[*frame].is_finite());
            let [along, square] = pressing.fold([0.0, 0.0], |[along, square], (frame, of_gain)| {
                [along + of_gain * residual(frame), square + of_gain * of_gain]
            });
            gains.add(along, square);
            for (a, b) in repeated.iter().flat_map(|(first, second)| first.clone().zip(second.clone())) {
                let (x, y) = (residual(a), residual(b));
                let near = predicted[a] > QUIET || predicted[b] > QUIET;
                if near && x.is_finite() && y.is_finite() {
                    products[0] += x * y;
                    products[1] += 1.0;
                }
            }
        }
        for ((stream, wander), sum) in station.layout.streams.iter().zip(domain.wander()).zip(&mut quiet) {
            sum.add(observed, &prediction, *wander, stream.channels.clone());
        }
    }
    let of = |switched: bool| {
        let signals = left.iter().enumerate();
        let of_kind = signals.filter(|(idx, _)| (Signal::at(*idx) == Signal::Switched) == switched);
        Left::sum(of_kind.map(|(_, left)| left))
    };
    let (touch, switching) = (of(false), of(true).loss());
    let (stream, common_mode) = largest(quiet.iter().map(Quiet::ratio));
    let (patch, at_patch) = largest(repeating_by_patch(station, &left));
    let (repeating, loss) = (touch.repeating(), touch.loss());
    Ok((Adequacy { repeating, at_patch, common_mode, loss, switching, patch, stream }, left))
}

/// The largest of `values`, none of which is negative, and its index; 0 of none.
fn largest(values: impl IntoIterator<Item = f64>) -> (usize, f64) {
    let values = values.into_iter().enumerate();
    values.fold((0, 0.0), |most, one| if one.1 > most.1 { one } else { most })
}

/// Squared signal of a channel in a take, in variances, from which its gain is known to a fifth.
const PRESSES: f64 = 25.0;

/// Per stream, how much the response of a channel differs from take to take beyond the model: what a gain of its own for each
/// take removes from the readings beyond one gain for all takes, in variances for each such gain; none of a stream that no two
/// takes press.
///
/// This is the dispersion of a quasi-likelihood whose clusters are the channels of a take: 1 where noise is all that is left.
pub(crate) fn touch_to_touch(station: &Station, left: &[Left]) -> Vec<Option<f64>> {
    let of_stream = |channels: std::ops::Range<usize>| {
        let gains = channels.map(|channel| left[Signal::Reading.of(channel)].gains.beyond_one());
        let [removed, count] = gains.fold([0.0; 2], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
        (count > 0.0).then(|| removed / count)
    };
    station.layout.streams.iter().map(|stream| of_stream(stream.channels.clone())).collect()
}

/// Sums over all events and readings, in variances.
pub(crate) struct LeftOver {
    /// What residuals of repeated motions have in common.
    pub(crate) repeating: f64,
    /// Huber's loss, beyond that of a model that misses nothing.
    pub(crate) loss: f64,
}

/// What is left in events and readings together.
pub(crate) fn left_over(left: &[Left]) -> LeftOver {
    let touch = left.iter().enumerate().filter(|(idx, _)| Signal::at(*idx) != Signal::Switched);
    let sum = Left::sum(touch.map(|(_, left)| left));
    LeftOver { repeating: sum.products[0], loss: sum.losses[0] - COMPLETE_LOSS * sum.losses[1] }
}

/// What repeats in the readings of each patch of pressure sensors, as in [`Adequacy::at_patch`]; 0 for other patches and
/// those with too few rows near contact to tell.
fn repeating_by_patch(station: &Station, left: &[Left]) -> Vec<f64> {
    let layout = &station.layout;
    let of_patch = layout.patches.iter().map(|patch| {
        let readings = patch.channels.clone().map(|channel| &left[Signal::Reading.of(channel)]);
        let left = Left::sum(readings);
        let is_pressure = layout.streams[patch.stream].kind == SensorKind::Pressure;
        if is_pressure && left.products[1] >= ENOUGH_ROWS { left.repeating() } else { 0.0 }
    });
    of_patch.collect()
}

/// Rows near contact from which what repeats by chance is a small part of a variance.
const ENOUGH_ROWS: f64 = 300.0;

/// What quiet channels of a stream have in common.
#[derive(Clone, Copy, Default)]
struct Quiet {
    frames: f64,
    squares: f64,
}

impl Quiet {
    fn add(
        &mut self,
        observed: &Observed<'_>,
        prediction: &[Series],
        wander: Wander,
        channels: std::ops::Range<usize>,
    ) {
        for frame in 0..observed.take.num_frames() {
            let (mut sum, mut count, mut alone, mut together) = (0.0, 0.0, 0.0, 0.0);
            let readings =
                observed.signals.iter().zip(prediction).skip(Signal::Reading as usize).step_by(Signal::COUNT);
            let of_stream = readings.zip(&observed.noise).take(channels.end).skip(channels.start);
            for ((reading, predicted), noise) in of_stream {
                let value = reading[frame] - predicted[frame];
                if value.is_finite() && predicted[frame].abs() < QUIET && *noise > 0.0 {
                    let variance = noise * noise + wander.variance();
                    sum += (value / variance.sqrt()).clamp(-2.0 * CLIP, 2.0 * CLIP);
                    alone += 1.0 - wander.together / variance;
                    together += (wander.together / variance).sqrt();
                    count += 1.0;
                }
            }
            if count > 1.0 {
                // The square of a sum of independent deviates is as large as their number; what a board does is the
                // same in all of them.
                self.squares += sum * sum / (alone + together * together);
                self.frames += 1.0;
            }
        }
    }

    fn ratio(&self) -> f64 {
        if self.frames > 0.0 { self.squares / self.frames } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn a_gain_that_is_wrong_and_always_the_same_is_no_difference_from_touch_to_touch() {
        let of = |gains: &[f64]| {
            let mut sums = Gains::default();
            gains.iter().for_each(|gain| sums.add(100.0 * gain, 100.0));
            sums.beyond_one()
        };
        assert_eq!(of(&[0.3, 0.3, 0.3]), [0.0, 2.0]);
        let [removed, more] = of(&[0.2, 0.4]);
        assert!((removed - 2.0).abs() < 1e-9 && more == 1.0, "{removed} {more}");
        assert_eq!(of(&[0.3]), [0.0; 2], "one take has nothing to differ from");
        let mut weak = Gains::default();
        weak.add(9.0, 0.5 * PRESSES);
        assert_eq!(weak.num_takes, 0.0);
    }

    #[test]
    fn a_stuck_channel_that_is_said_to_flicker_repeats_more() {
        let shipped = BTreeMap::new();
        let rules = InForce::scaled(&shipped);
        let of = |repeating: f64| Adequacy { repeating, ..Adequacy::default() };
        assert!(of(0.76).repeats_more(&of(0.54), rules).is_some());
        assert!(of(0.55).repeats_more(&of(0.54), rules).is_none(), "by chance");
    }
}
