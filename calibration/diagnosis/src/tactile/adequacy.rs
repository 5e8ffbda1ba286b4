//! Whether what is left repeats: the ground for `unexplained`, which rests on this and not on a lack of power.

use palpate_robot_model::{Place, SensorKind, Station};

use super::judge::repeated;
use super::{Observed, Signal, TactileDomain};
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
    /// Huber's loss of a row, in variances, over all events and readings that were measured.
    pub loss: f64,
    /// The same over what firmware makes of readings.
    pub switching: f64,
}

impl Adequacy {
    /// Whether more repeats than did `before`, as it does with a channel that is said to flicker, and is stuck: it then is off by
    /// the same in every sample, if by less than before.
    pub(crate) fn repeats_more(&self, before: &Self) -> bool {
        self.repeating > MOST_RAISED * before.repeating
    }

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
const COMPLETE: Adequacy = Adequacy { repeating: 0.36, common_mode: 1.07, loss: 0.56, switching: 0.0 };
/// What repeats with right names, over what did before: no more, but for chance.
const MOST_RAISED: f64 = 1.2;
/// Share of the excess that names may leave and still be the right ones.
const MOST_LEFT: f64 = 0.35;

/// Residuals count up to this many standard deviations.
const CLIP: f64 = 4.0;

/// What is left in one signal.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Left {
    /// Products of what residuals of repeated motions have in common, and their number.
    products: [f64; 2],
    /// Huber's loss, and the number of rows.
    losses: [f64; 2],
}

impl Left {
    /// Of several signals together.
    fn sum<'l>(signals: impl Iterator<Item = &'l Self>) -> Self {
        signals.fold(Self::default(), |sum, one| Self {
            products: [0, 1].map(|idx| sum.products[idx] + one.products[idx]),
            losses: [0, 1].map(|idx| sum.losses[idx] + one.losses[idx]),
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

/// Whether names account for what there was in the signals that they change, where that is clear; `None` where it is not.
///
/// `before` and `after` are what is left without and with them, by signal, `complete` what repeats in each where nothing is
/// missing; `None` where names cannot be held to that, because there are many or the search was cut short. However much repeats elsewhere, right names leave little of it where they act, and what is named in place of
/// something else leaves most of it, or takes most of the loss away and leaves what repeats.
pub(crate) fn account_where_they_act(
    before: &[Left],
    after: &[Left],
    changed: &[bool],
    complete: Option<&[f64]>,
) -> Option<bool> {
    let there = |left: &[Left]| {
        Left::sum(left.iter().zip(changed).filter(|(_, changed)| **changed).map(|(left, _)| left))
    };
    let excess = |left: &[Left], complete: &[f64]| {
        let of_changed = left.iter().zip(complete).zip(changed).filter(|(_, changed)| **changed);
        let [sum, count] = of_changed.fold([0.0, 0.0], |[sum, count], ((left, complete), _)| {
            [sum + left.products[0] - complete * left.products[1], count + left.products[1]]
        });
        if count > 0.0 { (sum / count).max(0.0) } else { 0.0 }
    };
    let share = |after: f64, before: f64| if before > 0.0 { after / before } else { f64::NAN };
    let repeating = share(there(after).repeating(), there(before).repeating());
    let loss = share(there(after).loss(), there(before).loss());
    if repeating <= LITTLE_REPEATING || loss <= LEAST_LOSS {
        return Some(true);
    }
    let excess = complete.map(|complete| [excess(before, complete), excess(after, complete)]);
    let leaves_little = excess.map(|[before, after]| after <= (MOST_EXCESS * before).max(LITTLE_EXCESS));
    if loss <= LITTLE_LOSS {
        return Some(leaves_little.unwrap_or(true));
    }
    if excess.is_some_and(|[before, after]| after <= MOST_EXCESS * before && before > LITTLE_EXCESS) {
        return Some(true);
    }
    (repeating > MOST_REPEATING && loss > MOST_LOSS).then_some(false)
}

/// Shares of what repeats, and of the loss, in the signals that names change: what only right names leave, one or the
/// other, and what only wrong ones leave. On the tuning station, one effect hidden, most right ones that act on places leave
/// 0.04 to 0.29 of what repeats, most that act on a stream 0.01 to 0.5 of the loss; wrong ones 0.3 to 0.73 and 0.67 to 0.87,
/// but for those that stand in for an effect that was left out and explain much of it. Those that leave so little of the loss
/// leave a share of 0.24 to 2 of the [excess](COMPLETE_PRESSURE) of what repeats, right ones 0 to 0.16, where any was.
const LITTLE_REPEATING: f64 = 0.25;
const LEAST_LOSS: f64 = 0.03;
const LITTLE_LOSS: f64 = 0.55;
const MOST_EXCESS: f64 = 0.2;
/// Excess of what repeats, in variances, that is no more than the model's own misfit.
const LITTLE_EXCESS: f64 = 0.2;
const MOST_REPEATING: f64 = 0.6;
const MOST_LOSS: f64 = 0.7;

/// What repeats where nothing is missing, of pressure and of proximity sensors: on the tuning station 0.22 to 0.30 and 1.36 to
/// 1.54; with room for stations of which the model knows less.
const COMPLETE_PRESSURE: f64 = 0.45;
const COMPLETE_PROXIMITY: f64 = 1.5;

/// What repeats in each signal of `station` where nothing is missing.
pub(crate) fn complete_by_signal(station: &Station) -> Vec<f64> {
    let of_channel =
        station.layout.channels.iter().map(|channel| match station.layout.streams[channel.stream].kind {
            SensorKind::Pressure => COMPLETE_PRESSURE,
            SensorKind::Proximity => COMPLETE_PROXIMITY,
        });
    of_channel.flat_map(|complete| [complete; Signal::COUNT]).collect()
}

/// Which signals the effects of `model` beyond the first `known` are about: those in which they do more than a small share of
/// what they do in one, and events and readings of channels that they name.
pub(crate) fn changed_signals(
    domain: &TactileDomain<'_>,
    model: &Model,
    known: usize,
    takes: &[usize],
) -> Result<Vec<bool>, DiagnosisError> {
    let mut without = model.clone();
    without.effects.truncate(known);
    let mut changes = vec![0.0; domain.num_signals()];
    for &take in takes {
        let predicted = domain.predict(take, model)?.into_iter().zip(domain.predict(take, &without)?);
        for (signal, ((with, without), change)) in predicted.zip(&mut changes).enumerate() {
            let rows = with.iter().zip(without.iter()).zip(domain.weights(take, signal, &with));
            let squares =
                rows.map(|((with, without), weight)| ((with - without) * weight).abs().min(CLIP).powi(2));
            *change += squares.sum::<f64>();
        }
    }
    let most = changes.iter().copied().fold(0.0, f64::max);
    let mut changed: Vec<bool> = changes.iter().map(|change| *change > SMALL_CHANGE * most).collect();
    // Whoever says what is wrong with a channel says what becomes of its readings too, and be it nothing.
    let of_channels = model.effects[known..]
        .iter()
        .filter(|effect| matches!(effect.place, Place::Channel(_) | Place::Channels(_)));
    for reach in of_channels.map(|effect| domain.reach(effect)) {
        for channel in (0..reach.len()).filter(|&channel| reach[channel]) {
            changed[Signal::Event.of(channel)] = true;
            changed[Signal::Reading.of(channel)] = true;
        }
    }
    Ok(changed)
}

/// Share of what names do in one signal below which they do nothing in another.
const SMALL_CHANGE: f64 = 0.02;
/// A channel is quiet where the model expects less than this, in units of the threshold.
const QUIET: f64 = 0.02;

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
        for ((signal, predicted), Left { products, losses }) in prediction.iter().enumerate().zip(&mut left) {
            let weights = domain.weights(take, signal, predicted);
            let rows = observed.signals[signal].iter().zip(predicted.iter()).zip(&weights);
            let deviation: Vec<f64> =
                rows.map(|((row, predicted), weight)| (row - predicted) * weight).collect();
            for deviation in deviation.iter().filter(|deviation| deviation.is_finite()) {
                losses[0] += huber(*deviation);
                losses[1] += 1.0;
            }
            let residual = |frame: usize| deviation[frame].clamp(-CLIP, CLIP);
            for (a, b) in repeated.iter().flat_map(|(first, second)| first.clone().zip(second.clone())) {
                let (x, y) = (residual(a), residual(b));
                let near = predicted[a] > QUIET || predicted[b] > QUIET;
                if near && x.is_finite() && y.is_finite() {
                    products[0] += x * y;
                    products[1] += 1.0;
                }
            }
        }
        for (stream, sum) in station.layout.streams.iter().zip(&mut quiet) {
            sum.add(observed, &prediction, stream.channels.clone());
        }
    }
    let of = |switched: bool| {
        let signals = left.iter().enumerate();
        let of_kind = signals.filter(|(idx, _)| (Signal::at(*idx) == Signal::Switched) == switched);
        Left::sum(of_kind.map(|(_, left)| left))
    };
    let (touch, switching) = (of(false), of(true).loss());
    let common_mode = quiet.iter().map(Quiet::ratio).fold(0.0, f64::max);
    Ok((Adequacy { repeating: touch.repeating(), common_mode, loss: touch.loss(), switching }, left))
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
            let readings =
                observed.signals.iter().zip(prediction).skip(Signal::Reading as usize).step_by(Signal::COUNT);
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Two signals, of which names change the first; the other is as bad with them as without.
    fn accounts(repeating: [f64; 2], loss: [f64; 2]) -> Option<bool> {
        let elsewhere = Left { products: [50.0, 10.0], losses: [500.0, 100.0] };
        let of = |idx: usize| {
            let first = Left { products: [10.0 * repeating[idx], 10.0], losses: [100.0 * loss[idx], 100.0] };
            [first, elsewhere]
        };
        account_where_they_act(&of(0), &of(1), &[true, false], Some(&[0.3, 0.3]))
    }

    #[test]
    fn what_left_nothing_that_repeats_is_held_to_leave_little() {
        assert_eq!(accounts([0.3, 0.45], [25.0, 0.8]), Some(true), "as much as the model's own misfit");
        assert_eq!(accounts([0.3, 0.9], [25.0, 0.8]), Some(false));
        assert_eq!(accounts([1.35, 0.45], [0.9, 0.84]), Some(true), "little of the loss, all that repeats");
    }

    #[test]
    fn a_stuck_channel_that_is_said_to_flicker_repeats_more() {
        let of = |repeating: f64| Adequacy { repeating, ..Adequacy::default() };
        assert!(of(0.76).repeats_more(&of(0.54)));
        assert!(!of(0.55).repeats_more(&of(0.54)), "by chance");
    }

    #[test]
    fn names_are_judged_by_what_they_leave_where_they_act() {
        assert_eq!(accounts([2.0, 0.2], [1.2, 1.0]), Some(true), "nothing repeats any more");
        assert_eq!(accounts([0.2, 0.15], [4.0, 0.6]), Some(true), "the loss is gone");
        assert_eq!(
            accounts([2.3, 0.9], [4.0, 0.6]),
            Some(false),
            "the loss is gone, and a third of what repeats is not"
        );
        assert_eq!(accounts([0.2, 0.9], [4.0, 0.6]), Some(false), "what is left repeats more");
        assert_eq!(accounts([0.2, 0.9], [40.0, 0.6]), Some(true), "next to no loss is left");
        assert_eq!(accounts([2.0, 1.5], [1.2, 1.1]), Some(false), "nearly all is left");
        assert_eq!(accounts([2.0, 0.9], [1.2, 0.9]), None);
        assert_eq!(accounts([0.0, 0.0], [1.2, 1.1]), None, "nothing repeated there");
        let left = [Left::default()];
        assert_eq!(account_where_they_act(&left, &left, &[false], Some(&[0.3])), None, "no names");
    }
}
