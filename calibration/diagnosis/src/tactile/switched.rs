//! What a firmware makes of the readings that it has: whether it switches where its station says. It is seen sample by
//! sample, without any simulation of touch.

use palpate_recording::StreamLog;

/// Samples of one channel in a take.
#[derive(Clone, Copy)]
pub(super) struct Samples<'a> {
    log: &'a StreamLog,
    /// Column of the channel, and number of columns.
    column: usize,
    width: usize,
    on_threshold: f64,
    frame_times_s: &'a [f64],
}

impl<'a> Samples<'a> {
    /// Those of the channel `column` of `width` in `log`, which has raw readings.
    pub(super) fn new(
        log: &'a StreamLog,
        column: usize,
        width: usize,
        on_threshold: f64,
        frame_times_s: &'a [f64],
    ) -> Self {
        Self { log, column, width, on_threshold, frame_times_s }
    }

    /// Per joint frame, the share of the samples since the frame before that were reported as on; NaN without samples.
    pub(super) fn share_on(&self) -> Vec<f64> {
        self.by_frame((0..self.log.times_s.len()).map(|sample| f64::from(u8::from(self.is_on(sample)))))
    }

    /// The share that should have been, by their readings, of a firmware that switches off at `off_fraction` of the
    /// threshold and reports what has lasted `min_on_s`; 0 without samples.
    pub(super) fn expected_share_on(&self, off_fraction: f64, min_on_s: f64) -> Vec<f64> {
        let period_s = self.period_s();
        // What is on when a take begins has been on for long.
        let mut on_since_s = (!self.log.times_s.is_empty() && self.is_on(0)).then_some(f64::NEG_INFINITY);
        let expected = self.log.times_s.iter().enumerate().map(|(sample, &time_s)| {
            let threshold = if on_since_s.is_some() { off_fraction } else { 1.0 };
            let is_above = self.reading(sample) > threshold;
            on_since_s = is_above.then(|| on_since_s.unwrap_or(time_s));
            // A firmware counts samples; between two counts, as many are reported as a longer time leaves out.
            on_since_s.map_or(0.0, |since_s| ((time_s - since_s - min_on_s) / period_s + 1.0).clamp(0.0, 1.0))
        });
        let mut shares = self.by_frame(expected);
        shares.iter_mut().filter(|share| share.is_nan()).for_each(|share| *share = 0.0);
        shares
    }

    /// Whether the firmware may count from the same reading without touch as the take: it then does not switch on below the
    /// threshold, nor both later and off earlier (below `off_fraction` of it) than it should. What is always on tells
    /// nothing.
    pub(super) fn may_count_from_reference(&self, off_fraction: f64) -> bool {
        let mut highest_off = f64::NEG_INFINITY;
        let mut lowest_switched_on = f64::INFINITY;
        let mut highest_switched_off = f64::NEG_INFINITY;
        for sample in 0..self.log.times_s.len() {
            let reading = self.reading(sample);
            let was_on = sample > 0 && self.is_on(sample - 1);
            match (was_on, self.is_on(sample)) {
                (false, true) if sample > 0 => lowest_switched_on = lowest_switched_on.min(reading),
                (_, true) => {}
                (was_on, false) => {
                    highest_off = highest_off.max(reading);
                    if was_on {
                        highest_switched_off = highest_switched_off.max(reading);
                    }
                }
            }
        }
        let is_late = highest_off > 1.0 + NEAR && highest_switched_off > off_fraction + NEAR;
        highest_off.is_finite() && lowest_switched_on >= 1.0 - NEAR && !is_late
    }

    fn is_on(&self, sample: usize) -> bool {
        self.log.active[sample * self.width + self.column]
    }

    /// Above its reference, in units of the threshold.
    fn reading(&self, sample: usize) -> f64 {
        let reference = self.log.reference_at(self.log.times_s[sample])[self.column];
        let above = self.log.raw[sample * self.width + self.column] - reference;
        f64::from(above) / self.on_threshold
    }

    /// Mean time between two samples, s.
    fn period_s(&self) -> f64 {
        match (self.log.times_s.first(), self.log.times_s.last()) {
            (Some(first_s), Some(last_s)) if last_s > first_s => {
                (last_s - first_s) / (self.log.times_s.len() - 1) as f64
            }
            _ => 1.0,
        }
    }

    /// Mean of the values of samples since the frame before, by frame.
    fn by_frame(&self, of_samples: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut samples = self.log.times_s.iter().zip(of_samples).peekable();
        let of_frame = |&frame_s: &f64| {
            let (mut sum, mut count) = (0.0, 0.0);
            while let Some((_, value)) = samples.next_if(|(time_s, _)| **time_s <= frame_s) {
                sum += value;
                count += 1.0;
            }
            sum / count
        };
        self.frame_times_s.iter().map(of_frame).collect()
    }
}

/// Thresholds and readings without touch are known to this, in units of the threshold.
const NEAR: f64 = 0.03;

#[cfg(test)]
mod tests {
    use palpate_recording::Reference;

    use super::*;

    /// One channel at 100 Hz, with frames at 10 Hz.
    fn log(raw: Vec<f32>, active: Vec<bool>) -> (StreamLog, Vec<f64>) {
        let times_s: Vec<f64> = (1..=raw.len()).map(|sample| sample as f64 * 0.01 - 0.001).collect();
        let frames_s = (1..=raw.len() / 10).map(|frame| frame as f64 * 0.1).collect();
        (StreamLog { times_s, raw, active, reference: vec![1000.0], ..StreamLog::default() }, frames_s)
    }

    /// A comparator that counts.
    fn firmware(raw: &[f32], on: f32, off: f32, debounce: usize) -> Vec<bool> {
        let mut count = 0;
        let one = |raw: &f32| {
            let threshold = if count > 0 { off } else { on };
            count = if raw - 1000.0 > threshold { count + 1 } else { 0 };
            count > debounce
        };
        raw.iter().map(one).collect()
    }

    fn differ(expected: &[f64], seen: &[f64]) -> f64 {
        expected.iter().zip(seen).map(|(a, b)| (a - b).abs()).sum()
    }

    #[test]
    fn a_firmware_is_known_by_what_it_makes_of_readings() {
        let raw: Vec<f32> = (0..400).map(|sample| 1000.0 + 150.0 * (sample as f32 * 0.05).sin()).collect();
        for (off, debounce) in [(60.0, 0), (20.0, 0), (60.0, 3)] {
            let (log, frames_s) = log(raw.clone(), firmware(&raw, 100.0, off, debounce));
            let samples = Samples::new(&log, 0, 1, 100.0, &frames_s);
            let seen = samples.share_on();
            let of = |off: f64, min_on_s: f64| differ(&samples.expected_share_on(off, min_on_s), &seen);
            assert!(of(f64::from(off) / 100.0, debounce as f64 * 0.01) < 1e-9);
            assert!(of(f64::from(off) / 100.0 + 0.2, debounce as f64 * 0.01) > 0.5);
            assert!(of(f64::from(off) / 100.0, debounce as f64 * 0.01 + 0.02) > 0.5);
        }
    }

    #[test]
    fn a_firmware_that_counts_from_elsewhere_is_noticed() {
        let raw: Vec<f32> = (0..400).map(|sample| 1000.0 + 150.0 * (sample as f32 * 0.05).sin()).collect();
        let counts_from_here = |on: f32, debounce: usize| {
            let (log, frames_s) = log(raw.clone(), firmware(&raw, on, on - 40.0, debounce));
            Samples::new(&log, 0, 1, 100.0, &frames_s).may_count_from_reference(0.6)
        };
        assert!(counts_from_here(100.0, 0) && counts_from_here(100.0, 3));
        assert!(!counts_from_here(120.0, 0) && !counts_from_here(80.0, 0));
        let (log, frames_s) = log(raw.clone(), vec![true; 400]);
        assert!(!Samples::new(&log, 0, 1, 100.0, &frames_s).may_count_from_reference(0.6), "always on");
    }

    #[test]
    fn a_firmware_that_tares_again_counts_from_there() {
        let drift = |sample: i32| if sample < 200 { 0.0 } else { 70.0 };
        let sines = (0..400).map(|sample| 150.0 * (sample as f32 * 0.05).sin());
        let raw: Vec<f32> = sines.clone().map(|sine| 1000.0 + sine).collect();
        let active = firmware(&raw, 100.0, 60.0, 0);
        let drifted: Vec<f32> = raw.iter().zip(0..).map(|(raw, sample)| raw + drift(sample)).collect();
        let (mut log, frames_s) = log(drifted, active);
        let may_count =
            |log: &StreamLog| Samples::new(log, 0, 1, 100.0, &frames_s).may_count_from_reference(0.6);
        assert!(!may_count(&log), "the drift shows");
        log.later_references.push(Reference { from_s: 2.005, readings: vec![1070.0] });
        assert!(may_count(&log));
    }

    #[test]
    fn nothing_is_expected_where_no_sample_is() {
        let (log, _) = log(vec![1200.0; 10], vec![true; 10]);
        let samples = Samples::new(&log, 0, 1, 100.0, &[-0.5, 0.1, 0.3]);
        assert_eq!(samples.expected_share_on(0.6, 0.0), [0.0, 1.0, 0.0]);
        assert!(samples.share_on()[0].is_nan());
    }
}
