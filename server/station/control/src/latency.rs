//! From a device's byte to the message that shows it.

use std::collections::VecDeque;

/// Width of a bin, ms, and how many there are; what takes longer counts in the last.
const BIN_MS: f64 = 0.25;
const NUM_BINS: usize = 2000;
/// The percentile is of so many slices of a second.
const NUM_SLICES: usize = 10;
const SLICE_NS: u64 = 1_000_000_000;
/// Samples that may wait for a message: more than any station sends in a second.
const MOST_WAITING: usize = 10_000;

/// Ages of samples when they are published.
///
/// Every sample counts once: from the moment its bytes were here to the message that is the first to show it or
/// something newer. A sample that waits for the next message waits honestly.
#[derive(Clone, Debug, Default)]
pub(crate) struct Latency {
    /// When the samples since the last message were received, ns.
    waiting: Vec<u64>,
    newest_ms: f64,
    /// Counts of ages, a slice a second, the newest last, with the beginning of each.
    slices: VecDeque<(u64, Vec<u32>)>,
}

impl Latency {
    /// A sample's bytes were here at `received_ns`.
    pub(crate) fn received(&mut self, received_ns: u64) {
        if self.waiting.len() < MOST_WAITING {
            self.waiting.push(received_ns);
        }
    }

    /// A message with everything so far leaves at `now_ns`.
    pub(crate) fn published(&mut self, now_ns: u64) {
        while self
            .slices
            .front()
            .is_some_and(|(began_ns, _)| began_ns + NUM_SLICES as u64 * SLICE_NS <= now_ns)
        {
            self.slices.pop_front();
        }
        if self.slices.back().is_none_or(|(began_ns, _)| began_ns + SLICE_NS <= now_ns) {
            self.slices.push_back((now_ns, vec![0; NUM_BINS]));
        }
        if let Some(&newest_ns) = self.waiting.iter().max() {
            self.newest_ms = now_ns.saturating_sub(newest_ns) as f64 * 1e-6;
        }
        if let Some((_, counts)) = self.slices.back_mut() {
            for received_ns in self.waiting.drain(..) {
                let age_ms = now_ns.saturating_sub(received_ns) as f64 * 1e-6;
                counts[((age_ms / BIN_MS) as usize).min(NUM_BINS - 1)] += 1;
            }
        }
    }

    /// Age of the newest sample in the last message that had one, ms.
    pub(crate) fn newest_ms(&self) -> f64 {
        self.newest_ms
    }

    /// 95th percentile over the last ten seconds, ms, rounded up to a bin; 0 without samples.
    pub(crate) fn p95_ms(&self) -> f64 {
        let total: u64 =
            self.slices.iter().flat_map(|(_, counts)| counts).map(|&count| u64::from(count)).sum();
        if total == 0 {
            return 0.0;
        }
        let mut so_far = 0;
        for bin in 0..NUM_BINS {
            so_far += self.slices.iter().map(|(_, counts)| u64::from(counts[bin])).sum::<u64>();
            if so_far * 100 >= total * 95 {
                return (bin + 1) as f64 * BIN_MS;
            }
        }
        NUM_BINS as f64 * BIN_MS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn the_percentile_is_of_every_sample_and_the_newest_of_the_last_message() {
        let mut latency = Latency::default();
        // A sample every millisecond, a message every twenty: ages of 0 to 19 ms, each as often.
        for message in 1..=200_u64 {
            for sample in 0..20 {
                latency.received((message * 20 - sample) * MS);
            }
            latency.published(message * 20 * MS);
        }
        assert_eq!(latency.newest_ms(), 0.0);
        assert!((latency.p95_ms() - 18.25).abs() < 1e-9, "{}", latency.p95_ms());
    }

    #[test]
    fn what_is_older_than_ten_seconds_is_forgotten() {
        let mut latency = Latency::default();
        latency.received(0);
        latency.published(400 * MS);
        assert_eq!((latency.newest_ms(), latency.p95_ms()), (400.0, 400.25));
        for second in 1..=11_u64 {
            latency.received(second * 1000 * MS);
            latency.published(second * 1000 * MS + 2 * MS);
        }
        assert_eq!((latency.newest_ms(), latency.p95_ms()), (2.0, 2.25));
    }

    #[test]
    fn without_samples_there_is_no_latency() {
        let mut latency = Latency::default();
        latency.published(5 * MS);
        assert_eq!((latency.newest_ms(), latency.p95_ms()), (0.0, 0.0));
    }
}
