//! A token bucket: so many requests a second, and more of them in a burst.

use std::time::{Duration, Instant};

/// Limits one connection.
#[derive(Debug)]
pub(crate) struct Bucket {
    per_s: f64,
    burst: f64,
    tokens: f64,
    filled: Instant,
}

impl Bucket {
    /// Lets through `per_s` a second, and `burst` at once after a pause.
    pub(crate) fn new(per_s: f64, burst: f64, now: Instant) -> Self {
        Self { per_s, burst, tokens: burst, filled: now }
    }

    /// Whether one more may pass now.
    pub(crate) fn take(&mut self, now: Instant) -> bool {
        let elapsed: Duration = now.saturating_duration_since(self.filled);
        self.filled = now;
        self.tokens = (self.tokens + elapsed.as_secs_f64() * self.per_s).min(self.burst);
        let passes = self.tokens >= 1.0;
        if passes {
            self.tokens -= 1.0;
        }
        passes
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn no_more_than_the_burst_and_the_rate_pass(pauses_ms in prop::collection::vec(0_u64..50, 1..400)) {
            let begun = Instant::now();
            let mut bucket = Bucket::new(100.0, 20.0, begun);
            let (mut now, mut passed) = (begun, 0);
            for pause_ms in pauses_ms {
                now += Duration::from_millis(pause_ms);
                passed += u32::from(bucket.take(now));
                let elapsed_s = now.duration_since(begun).as_secs_f64();
                prop_assert!(f64::from(passed) <= 20.0 + 100.0 * elapsed_s + 1e-6);
            }
        }

        #[test]
        fn whoever_keeps_to_the_rate_always_passes(count in 1_u32..500) {
            let begun = Instant::now();
            let mut bucket = Bucket::new(100.0, 20.0, begun);
            for number in 0..count {
                prop_assert!(bucket.take(begun + number * Duration::from_micros(10_001)));
            }
        }
    }
}
