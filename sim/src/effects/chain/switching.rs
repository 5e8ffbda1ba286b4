//! Loads become events.

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

    /// Activation of `channel` at frames `times_s`, given what `arrived` of its load.
    pub fn activation(&self, channel: usize, arrived: &Arrived, times_s: &[f64]) -> Vec<f64> {
        let mut activation = self.latched(channel, &arrived.present, times_s);
        let past: Vec<Vec<f64>> =
            arrived.past.iter().map(|loads| self.latched(channel, loads, times_s)).collect();
        if !past.is_empty() {
            arrived.blend(&mut activation, &past);
            activation.iter_mut().for_each(|activation| *activation = activation.clamp(0.0, 1.0));
        }
        activation
    }

    /// Activation of `channel` under `loads`.
    ///
    /// A soft latch: an event that is on stays on as far as the load is above the lower threshold. Where it switches
    /// hard this is the latch of a comparator with hysteresis.
    fn latched(&self, channel: usize, loads: &[f64], times_s: &[f64]) -> Vec<f64> {
        let [on, off_fraction, min_on_s, idle, passed, width] = self.of_channel(channel);
        let (off, off_width) = (on * off_fraction, width * off_fraction);
        let above = |load: f64, threshold: f64, width: f64| {
            if width > 0.0 && threshold.is_finite() {
                1.0 / (1.0 + (-(load - threshold) / width).exp())
            } else {
                f64::from(u8::from(load > threshold))
            }
        };
        let mut latched = 0.0_f64;
        let mut last = (f64::NAN, 0.0, None);
        let mut values: Vec<f64> = loads
            .iter()
            .enumerate()
            .map(|(frame, &load)| {
                // Quiet channels stay where they are, and are most of the work.
                if load != last.0 {
                    last = (load, above(load, on, width), None);
                }
                let (_, over_on, over_off) = &mut last;
                latched = if latched > *over_on && off != on {
                    // The lower threshold concerns only what is on.
                    let over_off = *over_off.get_or_insert_with(|| above(load, off, off_width));
                    over_on.max(latched.min(over_off))
                } else {
                    *over_on
                };
                let idle = if width > 0.0 || idle >= 1.0 { idle } else { drawn(frame, channel, idle) };
                passed * latched.max(idle)
            })
            .collect();
        if min_on_s > 0.0 {
            debounce(&mut values, times_s, min_on_s);
        }
        values
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
