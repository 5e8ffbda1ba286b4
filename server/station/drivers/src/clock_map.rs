//! When a device took a sample, in the host's time.
//!
//! A sample is received some time after it was taken: never before, often soon, sometimes late because a thread or a
//! bus was busy. Offset and skew of the device's clock therefore follow from the samples that came soonest. Of each
//! half second the soonest is kept. The line below all that are kept which is nearest to them in sum is found first: it
//! is the edge of their lower convex hull above their mean time (Moon, Skelly, Towsley 1999, "Estimation and removal of
//! clock skew from network delay measurements"). Least squares through those samples that lie near it make it exact.

use std::collections::VecDeque;

/// Device time of which the soonest sample is kept, ns.
const BUCKET_NS: i64 = 500_000_000;
/// Buckets kept: a minute, over which a warming oscillator still runs evenly.
const MAX_BUCKETS: usize = 120;
/// Buckets from which on a skew is believed; before that the clocks count as equally fast.
const MIN_BUCKETS: usize = 4;
/// A clock that is off by more than this was set, restarted or stood still, ns.
const STEP_NS: f64 = 20e6;
/// Buckets that have to agree that all later samples are late before that counts as a step of the clock.
const STEP_BUCKETS: usize = 4;
/// By this much the soonest samples of two half seconds differ even on a quiet bus, ns.
const USUAL_DELAY_NS: f64 = 50e3;
/// No oscillator is worse; a larger skew is the mark of something else.
const MAX_SKEW: f64 = 0.05;

/// Maps the time of one device to the host's.
#[derive(Clone, Debug, Default)]
pub(crate) struct ClockMap {
    /// Device and host time of the first sample, from which both are counted here.
    origin: Option<(u64, u64)>,
    /// Soonest sample of each bucket, oldest first; the last bucket may be unfinished.
    soonest: VecDeque<Sample>,
    line: Line,
    last_device_ns: u64,
    last_host_ns: u64,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    bucket: i64,
    /// Device time since the origin, ns.
    device_ns: i64,
    /// Host time less device time, both since the origin, ns.
    lead_ns: i64,
}

/// Host time less device time as it would be without delay: `at_ns + skew * device time`.
#[derive(Clone, Copy, Debug, Default)]
struct Line {
    at_ns: f64,
    skew: f64,
}

impl Line {
    fn lead_ns(&self, device_ns: i64) -> f64 {
        self.at_ns + self.skew * device_ns as f64
    }
}

impl ClockMap {
    /// Takes a sample that the device took at `device_ns` of its clock and that was received at `received_ns`, and says
    /// when that was in host time: never after it was received, never before the sample that came before it.
    pub(crate) fn observe(&mut self, device_ns: u64, received_ns: u64) -> u64 {
        if device_ns < self.last_device_ns {
            *self = Self { last_host_ns: self.last_host_ns, ..Self::default() };
        }
        self.last_device_ns = device_ns;
        let mut sample = self.sample(device_ns, received_ns);
        if (sample.lead_ns as f64) < self.line.lead_ns(sample.device_ns) - STEP_NS && !self.soonest.is_empty()
        {
            // Sooner than possible: the device's clock has jumped ahead.
            *self = Self { last_device_ns: device_ns, last_host_ns: self.last_host_ns, ..Self::default() };
            sample = self.sample(device_ns, received_ns);
        }
        self.keep(sample);
        let lead_ns = (sample.lead_ns as f64).min(self.line.lead_ns(sample.device_ns));
        let (_, host_origin_ns) = self.origin.unwrap_or_default();
        let since_origin_ns = (sample.device_ns as f64 + lead_ns).max(-(host_origin_ns as f64)) as i64;
        let host_ns = host_origin_ns.saturating_add_signed(since_origin_ns);
        self.last_host_ns = host_ns.max(self.last_host_ns).min(received_ns);
        self.last_host_ns
    }

    /// How much faster the host's clock runs, parts per million.
    pub(crate) fn skew_ppm(&self) -> f64 {
        self.line.skew * 1e6
    }

    fn sample(&mut self, device_ns: u64, received_ns: u64) -> Sample {
        let (device_origin_ns, host_origin_ns) = *self.origin.get_or_insert((device_ns, received_ns));
        let device_ns = device_ns.wrapping_sub(device_origin_ns) as i64;
        let host_ns = received_ns.wrapping_sub(host_origin_ns) as i64;
        let lead_ns = host_ns.saturating_sub(device_ns);
        Sample { bucket: device_ns.div_euclid(BUCKET_NS), device_ns, lead_ns }
    }

    fn keep(&mut self, sample: Sample) {
        match self.soonest.back_mut() {
            Some(last) if last.bucket == sample.bucket => {
                // Lines of a known skew are compared where both samples were taken.
                let sooner = |s: &Sample| s.lead_ns as f64 - self.line.skew * s.device_ns as f64;
                if sooner(&sample) < sooner(last) {
                    *last = sample;
                    if self.soonest.len() < MIN_BUCKETS {
                        self.fit();
                    }
                }
            }
            _ => {
                self.fit();
                self.soonest.push_back(sample);
                if self.soonest.len() > MAX_BUCKETS {
                    self.soonest.pop_front();
                }
                if self.soonest.len() < MIN_BUCKETS {
                    self.fit();
                }
            }
        }
    }

    /// Finds the line below all samples that are kept.
    fn fit(&mut self) {
        let late = |sample: &Sample| sample.lead_ns as f64 > self.line.lead_ns(sample.device_ns) + STEP_NS;
        if self.soonest.len() > STEP_BUCKETS && self.soonest.iter().rev().take(STEP_BUCKETS).all(late) {
            // The device's clock stood still for a while: what was before says nothing any more.
            self.soonest.drain(..self.soonest.len() - STEP_BUCKETS);
        }
        let points: Vec<(f64, f64)> =
            self.soonest.iter().map(|sample| (sample.device_ns as f64, sample.lead_ns as f64)).collect();
        let lowest = points.iter().map(|&(_, lead_ns)| lead_ns).fold(f64::INFINITY, f64::min);
        if points.is_empty() {
            return;
        }
        self.line = Line { at_ns: lowest, skew: 0.0 };
        if points.len() < MIN_BUCKETS {
            return;
        }
        let mean = points.iter().map(|&(device_ns, _)| device_ns).sum::<f64>() / points.len() as f64;
        let hull = lower_hull(&points);
        let edge = hull.windows(2).find(|edge| edge[0].0 <= mean && mean <= edge[1].0);
        if let Some(&[(x0, y0), (x1, y1)]) = edge
            && x1 > x0
            && ((y1 - y0) / (x1 - x0)).abs() <= MAX_SKEW
        {
            self.line = straighten(&points, (y1 - y0) / (x1 - x0));
        }
    }
}

/// The line of the least squares through those points that are about as low as most are above a line of the slope
/// `skew`, moved down until none is below it: an edge of the hull may be short, and its slope rough.
fn straighten(points: &[(f64, f64)], skew: f64) -> Line {
    let above: Vec<f64> = points.iter().map(|&(x, y)| y - skew * x).collect();
    let lowest = above.iter().copied().fold(f64::INFINITY, f64::min);
    let mut sorted = above.clone();
    sorted.sort_by(f64::total_cmp);
    let most = lowest + 3.0 * (sorted[sorted.len() / 2] - lowest) + USUAL_DELAY_NS;
    let low: Vec<(f64, f64)> =
        points.iter().zip(&above).filter(|(_, above)| **above <= most).map(|(&point, _)| point).collect();
    let num = low.len() as f64;
    let mean_x = low.iter().map(|&(x, _)| x).sum::<f64>() / num;
    let mean_y = low.iter().map(|&(_, y)| y).sum::<f64>() / num;
    let xx: f64 = low.iter().map(|&(x, _)| (x - mean_x).powi(2)).sum();
    let xy: f64 = low.iter().map(|&(x, y)| (x - mean_x) * (y - mean_y)).sum();
    let skew = if xx > 0.0 { xy / xx } else { skew };
    let at_ns = points.iter().map(|&(x, y)| y - skew * x).fold(f64::INFINITY, f64::min);
    Line { at_ns, skew }
}

/// The points below which there are none, from left to right; `points` are in order of their first coordinate.
fn lower_hull(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut hull: Vec<(f64, f64)> = Vec::with_capacity(points.len());
    for &point in points {
        while let [.., a, b] = hull[..] {
            let turns_left = (b.0 - a.0) * (point.1 - a.1) - (b.1 - a.1) * (point.0 - a.0) > 0.0;
            if turns_left {
                break;
            }
            hull.pop();
        }
        hull.push(point);
    }
    hull
}

/// Makes one growing count of one that starts over at `modulus`, as long as it is read more often than that.
#[derive(Clone, Debug)]
pub(crate) struct GrowingCount {
    modulus: u64,
    last: Option<u64>,
    total: u64,
}

impl GrowingCount {
    pub(crate) fn new(modulus: u64) -> Self {
        Self { modulus, last: None, total: 0 }
    }

    /// The count since the first reading.
    pub(crate) fn read(&mut self, raw: u64) -> u64 {
        let raw = raw % self.modulus;
        if let Some(last) = self.last.replace(raw) {
            self.total += (raw + self.modulus - last) % self.modulus;
        }
        self.total
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;
    /// True host time at which the device's clock read zero.
    const HOST_AT_ZERO: u64 = 77_000_000_000;
    const PERIOD_NS: u64 = 10 * MS;

    /// Feeds samples, each late by its delay, and gives true and mapped host times.
    fn run(
        map: &mut ClockMap,
        skew_ppm: f64,
        device_from_ns: u64,
        delays_ns: &[u64],
        resolution_ns: u64,
    ) -> Vec<(f64, f64)> {
        let mut last_received_ns = 0;
        delays_ns
            .iter()
            .zip(0..)
            .map(|(delay_ns, idx)| {
                let device_ns = device_from_ns + idx * PERIOD_NS;
                let truth = HOST_AT_ZERO as f64 + device_ns as f64 * (1.0 + skew_ppm * 1e-6);
                let seen_ns = device_ns / resolution_ns * resolution_ns;
                // Samples do not overtake each other.
                let received_ns = (truth as u64 + delay_ns).max(last_received_ns);
                last_received_ns = received_ns;
                let host_ns = map.observe(seen_ns, received_ns);
                assert!(host_ns <= received_ns, "mapped behind its receipt");
                (truth, host_ns as f64)
            })
            .collect()
    }

    fn delays() -> impl Strategy<Value = Vec<u64>> {
        // Mostly under 2 ms, now and then up to 100 ms late; nothing is ever early.
        let delay = prop_oneof![9 => 100_000..2 * MS, 1 => 2 * MS..100 * MS];
        proptest::collection::vec(delay, 6000)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]

        #[test]
        fn offset_and_skew_are_found_whatever_is_late(
            delays in delays(),
            skew_ppm in -10_000.0..10_000.0_f64,
            start_ns in 0..10_000_000_000_u64,
        ) {
            let mut map = ClockMap::default();
            let times = run(&mut map, skew_ppm, start_ns, &delays, MS);
            prop_assert!((map.skew_ppm() - skew_ppm).abs() < 60.0, "{} is not {skew_ppm}", map.skew_ppm());
            for (truth, mapped) in &times[3000..] {
                // The soonest come 0.1 ms late and the clock has steps of 1 ms, both in the same direction.
                prop_assert!((-1.2e6..2.5e6).contains(&(mapped - truth)), "{} ns off", mapped - truth);
            }
            prop_assert!(times.is_sorted_by(|a, b| a.1 <= b.1), "time runs back");
        }

        #[test]
        fn a_count_that_starts_over_grows_on(start in 0..32768_u64, steps in proptest::collection::vec(0..32768_u64, 1..200)) {
            let mut count = GrowingCount::new(32768);
            let mut total = 0;
            prop_assert_eq!(count.read(start), 0);
            for step in steps {
                total += step;
                prop_assert_eq!(count.read((start + total) % 32768), total);
            }
        }
    }

    #[test]
    fn a_clock_that_restarts_jumps_or_stands_still_is_followed() {
        let delays: Vec<u64> = (0..2000).map(|idx| 200_000 + 37_000 * (idx % 41)).collect();
        let mut map = ClockMap::default();
        run(&mut map, 40.0, 500 * MS, &delays, MS);
        // Restarted: device time is back at zero while host time went on.
        let received_ns = HOST_AT_ZERO + 60_000 * MS;
        assert!(received_ns - map.observe(3 * MS, received_ns) <= 2 * MS);
        // Jumped ahead.
        let received_ns = received_ns + 10 * MS;
        assert!(received_ns - map.observe(9_000 * MS, received_ns) <= 2 * MS);
        // Stood still for 400 ms: after some seconds the samples are no longer thought to be that late.
        let mut last_ns = 0;
        for idx in 1..1000 {
            let received_ns = received_ns + 400 * MS + idx * PERIOD_NS;
            last_ns = received_ns - map.observe(9_000 * MS + idx * PERIOD_NS, received_ns);
        }
        assert!(last_ns < MS, "{last_ns}");
    }

    #[test]
    fn a_single_sample_was_taken_when_it_was_received_as_far_as_anybody_can_tell() {
        let mut map = ClockMap::default();
        assert_eq!(map.observe(5, 1000), 1000);
        assert_eq!(map.skew_ppm(), 0.0);
    }
}
