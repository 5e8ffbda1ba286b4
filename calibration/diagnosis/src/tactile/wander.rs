//! How far readings wander without touch: boards warm up, supplies sag, mains leak in, skins settle.
//!
//! What is steady from one reading to the next is no noise, and what is the same in all channels is not independent,
//! but neither is news as long as it is small. How large it is in a session is told by second differences, as in the
//! Allan variance of D. W. Allan, "Statistics of atomic frequency standards" (1966): a steady drift, which is news,
//! has none.

use palpate_robot_model::{Patch, TactileLayout};
use statrs::statistics::{Data, OrderStatistics, Statistics};

use super::{Observed, Signal};

/// How far the readings of a stream wander within a take, squares of the switching threshold.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Wander {
    /// Variance of what each channel does by itself, beyond its noise.
    own: f64,
    /// Variance of what all channels do together.
    pub(crate) together: f64,
}

impl Wander {
    /// Of `stream`, over `takes`; none without raw readings.
    pub(crate) fn of(takes: &[&Observed<'_>], layout: &TactileLayout, stream: usize) -> Self {
        let (mut next, mut apart, mut together) = (Vec::new(), Vec::new(), Vec::new());
        let mut white = Vec::new();
        for take in takes.iter().filter(|take| take.has_raw) {
            let patches = layout.patches.iter().filter(|patch| patch.stream == stream);
            let quiet: Vec<Vec<f64>> = patches.flat_map(|patch| quiet(take, patch)).collect();
            let middle_of = |frame: usize| match quiet.len() {
                // Of few channels nobody can tell what they have in common.
                ..FEWEST_CHANNELS => 0.0,
                _ => median(quiet.iter().map(|channel| channel[frame]).collect()),
            };
            let num_frames = take.take.num_frames();
            let middle: Vec<f64> = (0..num_frames).map(middle_of).collect();
            let lag = ((SPAN * num_frames as f64) as usize).max(1);
            together.extend(second_differences(&middle, lag));
            for channel in &quiet {
                let alone = channel.iter().zip(&middle).map(|(reading, middle)| reading - middle);
                let alone: Vec<f64> = alone.collect();
                next.extend(second_differences(&alone, 1));
                apart.extend(second_differences(&alone, lag));
            }
            let noise = &take.noise[layout.streams[stream].channels.clone()];
            white.push(noise.iter().map(|noise| noise * noise).mean() / noise.len() as f64);
        }
        let of_middle = OF_SECOND_DIFFERENCE * OF_MEDIAN * white.mean();
        Self {
            // A touch that switches no channel is felt as well: what most of them do is no touch.
            own: within_bounds((median(apart) - median(next)) / MEDIAN_OF_SQUARE),
            together: within_bounds(together.mean() - of_middle),
        }
    }

    /// Variance of a reading.
    pub(crate) fn variance(self) -> f64 {
        self.own + self.together
    }

    /// Levels of all channels of `layout` that streams with this `wander` may have, by standard normal deviates.
    pub(crate) fn levels(
        wander: &[Self],
        layout: &TactileLayout,
        mut deviate: impl FnMut() -> f64,
    ) -> Vec<f64> {
        let boards: Vec<f64> = wander.iter().map(|of| of.together.sqrt() * deviate()).collect();
        let channels = layout.channels.iter();
        channels
            .map(|channel| boards[channel.stream] + wander[channel.stream].own.sqrt() * deviate())
            .collect()
    }
}

/// Channels from which a common level can be told from theirs.
const FEWEST_CHANNELS: usize = 4;
/// Share of a take's length over which readings are compared. A random walk is as far from where a take began, on
/// average, as its second differences over a quarter of the take are large; what forgets sooner is nearer.
const SPAN: f64 = 0.25;
/// Standard deviation of wander, in units of the switching threshold, beyond which it is news: a twentieth of what a
/// touch must reach is more than a board's warming up and less than what moves an event.
const MOST: f64 = 0.05;
/// Median of the square of a standard normal deviate.
const MEDIAN_OF_SQUARE: f64 = 0.454_936;
/// Variance of a second difference of independent deviates, over theirs.
const OF_SECOND_DIFFERENCE: f64 = 6.0;
/// Variance of the median of many normal deviates, over that of their mean.
const OF_MEDIAN: f64 = std::f64::consts::FRAC_PI_2;
/// A patch is pressed a little before the first of its channels switches, and after the last has, s.
const AROUND_S: f64 = 0.5;

/// Readings of `patch` where nothing touches it, by channel; NaN elsewhere.
fn quiet(take: &Observed<'_>, patch: &Patch) -> Vec<Vec<f64>> {
    let is_on = |channel: usize, frame: usize| take.signals[Signal::Event.of(channel)][frame] > 0.0;
    let times_s = &take.take.joints.times_s;
    let touched_s: Vec<f64> = (0..times_s.len())
        .filter(|&frame| patch.channels.clone().any(|channel| is_on(channel, frame)))
        .map(|frame| times_s[frame])
        .collect();
    let is_quiet = |time_s: f64| {
        let next = touched_s.partition_point(|touched_s| *touched_s < time_s - AROUND_S);
        touched_s.get(next).is_none_or(|touched_s| *touched_s > time_s + AROUND_S)
    };
    let is_quiet: Vec<bool> = times_s.iter().map(|&time_s| is_quiet(time_s)).collect();
    let of_channel = |channel: usize| {
        let readings = take.signals[Signal::Reading.of(channel)].iter().zip(&is_quiet);
        readings.map(|(reading, is_quiet)| if *is_quiet { *reading } else { f64::NAN }).collect()
    };
    patch.channels.clone().map(of_channel).collect()
}

/// Squares of the second differences of `series` over `lag` that are numbers.
fn second_differences(series: &[f64], lag: usize) -> impl Iterator<Item = f64> {
    let differences = series.windows(2 * lag + 1);
    let squares = differences.map(move |window| (window[0] - 2.0 * window[lag] + window[2 * lag]).powi(2));
    squares.filter(|square| square.is_finite())
}

/// A variance that nobody could tell is none; one that is news counts up to where it becomes that.
fn within_bounds(variance: f64) -> f64 {
    if variance.is_finite() { variance.clamp(0.0, MOST * MOST) } else { 0.0 }
}

/// The median of those of `values` that are numbers; NaN of none.
pub(super) fn median(values: Vec<f64>) -> f64 {
    Data::new(values.into_iter().filter(|value| value.is_finite()).collect::<Vec<_>>()).median()
}

#[cfg(test)]
mod tests {
    use palpate_recording::Take;
    use palpate_robot_model::Station;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::testing::{Session, session};

    /// What is told of the first stream of an emulated station to whose readings `shift` adds so many thresholds, by
    /// time in s.
    fn wander(mut shift: impl FnMut(f64) -> f64) -> Wander {
        let Session { stage, mut takes, .. } = session("small");
        let station = stage.station();
        let mut take = takes.remove(0);
        let (log, width) = (&mut take.streams[0], station.layout.streams[0].channels.len());
        for (sample, time_s) in log.raw.chunks_exact_mut(width).zip(&log.times_s) {
            let shift = shift(*time_s) * station.streams[0].on_threshold;
            sample.iter_mut().for_each(|raw| *raw += shift as f32);
        }
        of(station, &take)
    }

    fn of(station: &Station, take: &Take) -> Wander {
        let observed = Observed::new(station, take).unwrap();
        Wander::of(&[&observed], &station.layout, 0)
    }

    #[test]
    fn a_steady_drift_is_no_wander() {
        let (steady, drifting) = (wander(|_| 0.0), wander(|time_s| 0.02 * time_s));
        // Readings are whole numbers: the second differences of so steep a drift are nearly none.
        assert!((drifting.together - steady.together).abs() < 5e-5, "{drifting:?} {steady:?}");
        assert!((drifting.own - steady.own).abs() < 1e-5, "{drifting:?} {steady:?}");
    }

    #[test]
    fn what_a_board_does_is_told_as_what_channels_do_together() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut at = 0.0;
        let walking = wander(|_| {
            at += 5e-4 * (rng.random::<f64>() - 0.5);
            at
        });
        let steady = wander(|_| 0.0);
        assert!((walking.own - steady.own).abs() < 1e-5, "{walking:?} {steady:?}");
        let added = walking.together - steady.together;
        assert!((1e-4..MOST * MOST).contains(&added), "{walking:?} {steady:?}");
    }

    #[test]
    fn more_than_a_board_may_do_counts_no_more() {
        let humming = wander(|time_s| 0.5 * (7.0 * time_s).sin());
        assert_eq!(humming.together, MOST * MOST);
    }
}
