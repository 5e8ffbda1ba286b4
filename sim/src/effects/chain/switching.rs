//! Loads become events.

use std::sync::Arc;

use super::Arrived;

/// How load becomes an event.
#[derive(Clone, Debug)]
pub struct Switching {
    /// Per channel, the load at which it switches on; `INFINITY` for one that never does, `NEG_INFINITY` always.
    pub on_loads: Vec<f64>,
    /// Per channel, the load below which it switches off, over `on_loads`; 1 without hysteresis.
    pub off_fractions: Vec<f64>,
    /// Per channel, how long a load must be above `on_loads` before the event is reported, s.
    pub min_on_s: Vec<f64>,
    /// Per channel, activation that is there without any load, 0..=1, such as of a value that wraps around zero. A
    /// channel that switches hard is on in that share of frames.
    pub idle_activation: Vec<f64>,
    /// Per channel, the share of its activation that is passed on, 0..=1: 0 for a dead channel.
    pub passed_shares: Vec<f64>,
    /// Per channel, width of the switching curve in units of load; 0 switches hard. At the lower threshold the curve is
    /// narrower as far as the threshold is lower, so that no touch leaves a rest of activation without any load.
    pub widths: Vec<f64>,
}

impl Switching {
    /// Everything of `channel` that its activation depends on besides what arrives of its load.
    pub fn of_channel(&self, channel: usize) -> [f64; 6] {
        [
            self.on_loads[channel],
            self.off_fractions[channel],
            self.min_on_s[channel],
            self.idle_activation[channel],
            self.passed_shares[channel],
            self.widths[channel],
        ]
    }

    /// Whether `channel`, which switches hard, is on under `load` after it was or was not in the frame before.
    pub(super) fn latches(&self, channel: usize, load: f64, was_on: bool) -> bool {
        let on_load = self.on_loads[channel];
        load > on_load || (was_on && load > on_load * self.off_fractions[channel])
    }

    /// Activation of `channel`, which switches hard, in frame number `frame`, before it must have lasted.
    pub(super) fn reported(&self, frame: usize, channel: usize, is_on: bool) -> f64 {
        let idle = self.idle_activation[channel];
        let idle = if self.flickers(channel) { drawn(frame, channel, idle) } else { idle };
        self.passed_shares[channel] * f64::from(u8::from(is_on)).max(idle)
    }

    /// Activation of `channel` at the `frames` of those at `times_s` (`None`: at all of them), given what `arrived` of its load.
    pub fn activation(
        &self,
        channel: usize,
        arrived: &Arrived,
        times_s: &[f64],
        frames: Option<&[usize]>,
    ) -> Vec<f64> {
        let num_frames = arrived.present.len();
        let num_wanted = frames.map_or(num_frames, <[usize]>::len);
        // A channel that feels nothing stays as it is in the first frame.
        let is_still = arrived.is_silent && !self.flickers(channel) && num_frames > 0;
        let (looked_at, frames) =
            if is_still { (1, frames.map(|frames| &frames[..1])) } else { (num_frames, frames) };
        let latched = |loads: &Arc<[f64]>| self.latched(channel, &loads[..looked_at], times_s, frames);
        let mut activation = latched(&arrived.present);
        let past: Vec<Vec<f64>> = arrived.past.iter().map(latched).collect();
        if !past.is_empty() {
            let past: Vec<&[f64]> = past.iter().map(|past| &past[..]).collect();
            arrived.blend(&mut activation, &past);
            activation.iter_mut().for_each(|activation| *activation = activation.clamp(0.0, 1.0));
        }
        activation.resize(num_wanted, activation.last().copied().unwrap_or(0.0));
        activation
    }

    /// [`Self::activation`] at each of the `frames` of `times_s`, on average since the frame before: linear between
    /// moments. The first frame has that of its moment.
    pub fn mean_activation(
        &self,
        channel: usize,
        arrived: &Arrived,
        times_s: &[f64],
        frames: &[usize],
    ) -> Vec<f64> {
        let activation = self.activation(channel, arrived, times_s, None);
        let mut last = None;
        let since_last = |&frame: &usize| {
            let first = last.replace(frame).unwrap_or(frame);
            if activation[first..=frame].iter().all(|one| *one == activation[frame]) {
                return activation[frame];
            }
            let area = |next: usize| {
                0.5 * (activation[next - 1] + activation[next]) * (times_s[next] - times_s[next - 1])
            };
            (first + 1..=frame).map(area).sum::<f64>() / (times_s[frame] - times_s[first])
        };
        frames.iter().map(since_last).collect()
    }

    /// Whether `channel` is on in frames that are drawn.
    fn flickers(&self, channel: usize) -> bool {
        let idle = self.idle_activation[channel];
        self.widths[channel] <= 0.0 && idle > 0.0 && idle < 1.0
    }

    /// Activation of `channel` under `loads`, at `frames` of them (`None`: at all).
    ///
    /// A soft latch: an event that is on stays on as far as the load is above the lower threshold. Where it switches
    /// hard this is the latch of a comparator with hysteresis. It latches how far the load is beyond a threshold, in widths, of
    /// which the activation is a function that only rises, so that most frames never need its value.
    fn latched(&self, channel: usize, loads: &[f64], times_s: &[f64], frames: Option<&[usize]>) -> Vec<f64> {
        let [on, off_fraction, min_on_s, idle, passed, width] = self.of_channel(channel);
        let (off, off_width) = (on * off_fraction, width * off_fraction);
        // Infinitely far where it switches hard.
        let beyond = |load: f64, threshold: f64, width: f64| {
            if width > 0.0 && threshold.is_finite() {
                (load - threshold) / width
            } else if load > threshold {
                f64::INFINITY
            } else {
                f64::NEG_INFINITY
            }
        };
        let flickers = self.flickers(channel);
        let mut latched = f64::NEG_INFINITY;
        let mut last = (f64::NAN, f64::NEG_INFINITY, None);
        let mut latch = |load: f64| {
            // Quiet channels stay where they are, and are most of the work.
            if load != last.0 {
                last = (load, beyond(load, on, width), None);
            }
            let (_, over_on, over_off) = &mut last;
            latched = if latched > *over_on && off != on {
                // The lower threshold concerns only what is on.
                let over_off = *over_off.get_or_insert_with(|| beyond(load, off, off_width));
                over_on.max(latched.min(over_off))
            } else {
                *over_on
            };
            latched
        };
        let mut last = (f64::NAN, 0.0);
        let mut activation = |frame: usize, latched: f64| {
            if latched != last.0 {
                last = (latched, 1.0 / (1.0 + (-latched).exp()));
            }
            let idle = if flickers { drawn(frame, channel, idle) } else { idle };
            passed * last.1.max(idle)
        };
        match frames {
            Some(frames) if min_on_s <= 0.0 => {
                let mut next = 0;
                let at = |&frame: &usize| {
                    let mut latched = f64::NEG_INFINITY;
                    loads[next..=frame].iter().for_each(|load| latched = latch(*load));
                    next = frame + 1;
                    activation(frame, latched)
                };
                frames.iter().map(at).collect()
            }
            _ => {
                let each = loads.iter().enumerate();
                let mut values: Vec<f64> =
                    each.map(|(frame, load)| activation(frame, latch(*load))).collect();
                if min_on_s > 0.0 {
                    debounce(&mut values, times_s, min_on_s);
                }
                match frames {
                    Some(frames) => frames.iter().map(|&frame| values[frame]).collect(),
                    None => values,
                }
            }
        }
    }
}

/// One draw for a frame of a channel that is on with `probability`: always the same, and without any pattern over
/// frames (the finaliser of SplitMix64, Steele et al., "Fast Splittable Pseudorandom Number Generators", 2014).
fn drawn(frame: usize, channel: usize, probability: f64) -> f64 {
    if probability <= 0.0 {
        return 0.0;
    }
    let mut bits =
        ((channel as u64) << 32 | frame as u64).wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    let uniform = ((bits ^ (bits >> 31)) >> 11) as f64 / (1_u64 << 53) as f64;
    f64::from(u8::from(uniform < probability))
}

/// Reports an activation only once it has lasted `min_on_s`: the smallest over that time back, frames being held until
/// the next one.
fn debounce(values: &mut [f64], times_s: &[f64], min_on_s: f64) {
    let raw = values.to_vec();
    for frame in 0..raw.len() {
        let since_s = times_s[frame] - min_on_s;
        let mut first = frame;
        while first > 0 && times_s[first] > since_s {
            first -= 1;
        }
        let mut smallest = raw[first + 1..=frame].iter().copied().fold(raw[frame], f64::min);
        if first < frame {
            // Linear between frames, so that a delay of part of a frame counts in part.
            let share = (since_s - times_s[first]) / (times_s[first + 1] - times_s[first]);
            let at_start = raw[first] + share.clamp(0.0, 1.0) * (raw[first + 1] - raw[first]);
            smallest = smallest.min(at_start);
        }
        values[frame] = smallest;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn arrived(present: &[f64], past: &[Vec<f64>], is_silent: bool) -> Arrived {
        let past = past.iter().map(|past| past.clone().into()).collect();
        Arrived { present: present.into(), past, is_silent, past_share: 0.3 }
    }

    fn switching() -> impl Strategy<Value = Switching> {
        let threshold = prop_oneof![0.5..2.0_f64, Just(f64::INFINITY), Just(f64::NEG_INFINITY)];
        let width = prop_oneof![0.02..0.5_f64, Just(0.0)];
        let min_on_s = prop_oneof![Just(0.0), 0.05..0.4_f64];
        let idle = prop_oneof![Just(0.0), 0.0..=1.0_f64];
        (threshold, 0.0..=1.0_f64, min_on_s, idle, 0.0..=1.0_f64, width).prop_map(
            |(on_load, off_fraction, min_on_s, idle, passed, width)| Switching {
                on_loads: vec![on_load],
                off_fractions: vec![off_fraction],
                min_on_s: vec![min_on_s],
                idle_activation: vec![idle],
                passed_shares: vec![passed],
                widths: vec![width],
            },
        )
    }

    proptest! {
        #[test]
        fn some_frames_are_as_all_are(
            switching in switching(),
            loads in prop::collection::vec(prop_oneof![Just(0.0), 0.0..4.0_f64], 1..40),
            has_past in any::<bool>(),
            wanted in prop::collection::vec(any::<bool>(), 40),
        ) {
            let times_s: Vec<f64> = (0..loads.len()).map(|frame| 0.03 * frame as f64).collect();
            let frames: Vec<usize> = (0..loads.len()).filter(|&frame| wanted[frame]).collect();
            let past = if has_past { vec![loads.iter().map(|load| 0.5 * load).collect()] } else { Vec::new() };
            let arrived = arrived(&loads, &past, false);
            let all = switching.activation(0, &arrived, &times_s, None);
            let some = switching.activation(0, &arrived, &times_s, Some(&frames));
            prop_assert_eq!(frames.iter().map(|&frame| all[frame]).collect::<Vec<_>>(), some);
        }

        #[test]
        fn means_over_frames_add_up(
            switching in switching(),
            loads in prop::collection::vec(prop_oneof![Just(0.0), 0.0..4.0_f64], 1..40),
            gaps_s in prop::collection::vec(0.005..0.1_f64, 40),
            wanted in prop::collection::vec(any::<bool>(), 40),
        ) {
            let mut time_s = 0.0;
            let times_s: Vec<f64> = gaps_s[..loads.len()].iter().map(|gap_s| { time_s += gap_s; time_s }).collect();
            let arrived = arrived(&loads, &[], false);
            let activation = switching.activation(0, &arrived, &times_s, None);
            let of = |frames: &[usize]| switching.mean_activation(0, &arrived, &times_s, frames);
            let each = of(&(0..loads.len()).collect::<Vec<_>>());
            for (mean, ends) in each.iter().skip(1).zip(activation.windows(2)) {
                prop_assert!((mean - 0.5 * (ends[0] + ends[1])).abs() < 1e-12);
            }
            let frames: Vec<usize> = (0..loads.len()).filter(|&frame| wanted[frame]).collect();
            let means = of(&frames);
            prop_assert_eq!(means.first(), frames.first().map(|&first| &activation[first]));
            for (pair, mean) in frames.windows(2).zip(means.iter().skip(1)) {
                let parts = (pair[0] + 1..=pair[1]).map(|next| each[next] * (times_s[next] - times_s[next - 1]));
                let sum: f64 = parts.sum();
                prop_assert!((mean * (times_s[pair[1]] - times_s[pair[0]]) - sum).abs() < 1e-12, "{mean}, {sum}");
            }
        }

        #[test]
        fn what_feels_nothing_is_as_what_feels_zeros(
            switching in switching(), num_frames in 1_usize..40, has_past in any::<bool>(), every in 1_usize..5,
        ) {
            let zeros = vec![0.0; num_frames];
            let times_s: Vec<f64> = (0..num_frames).map(|frame| 0.03 * frame as f64).collect();
            let frames: Vec<usize> = (0..num_frames).step_by(every).collect();
            let past = if has_past { vec![zeros.clone()] } else { Vec::new() };
            for frames in [None, Some(&frames[..])] {
                let of = |is_silent| switching.activation(0, &arrived(&zeros, &past, is_silent), &times_s, frames);
                prop_assert_eq!(of(true), of(false));
            }
        }

        /// The same latch written with activations.
        #[test]
        fn latched_activations_are_those_of_latched_distances(
            switching in switching(), loads in prop::collection::vec(0.0..4.0_f64, 1..40),
        ) {
            let switching = Switching { min_on_s: vec![0.0], idle_activation: vec![0.0], ..switching };
            let [on, off_fraction, _, _, passed, width] = switching.of_channel(0);
            let above = |load: f64, threshold: f64, width: f64| {
                if width > 0.0 && threshold.is_finite() {
                    1.0 / (1.0 + (-(load - threshold) / width).exp())
                } else {
                    f64::from(u8::from(load > threshold))
                }
            };
            let mut latched = 0.0_f64;
            let expected: Vec<f64> = loads
                .iter()
                .map(|&load| {
                    let over_on = above(load, on, width);
                    let over_off = if off_fraction == 1.0 {
                        over_on
                    } else {
                        above(load, on * off_fraction, width * off_fraction)
                    };
                    latched = over_on.max(latched.min(over_off));
                    passed * latched
                })
                .collect();
            let found = switching.activation(0, &arrived(&loads, &[], false), &[], None);
            for (found, expected) in found.iter().zip(&expected) {
                prop_assert!((found - expected).abs() < 1e-12, "{found} {expected}");
            }
        }
    }
}
