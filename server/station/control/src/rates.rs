//! How often something happens: now, on average, and in the worst second.

use std::collections::VecDeque;

const SECOND_NS: u64 = 1_000_000_000;

/// Counts events.
#[derive(Clone, Debug, Default)]
pub(crate) struct RateMeter {
    /// Events of the last second, ns.
    recent: VecDeque<u64>,
    first_ns: Option<u64>,
    num_events: u64,
    /// The whole second under way: when it began, and its events so far.
    second: (u64, u64),
    worst: Option<u64>,
}

impl RateMeter {
    /// Something happened at `now_ns`.
    pub(crate) fn tick(&mut self, now_ns: u64) {
        if self.first_ns.is_none() {
            self.first_ns = Some(now_ns);
            self.second = (now_ns, 0);
        }
        self.roll(now_ns);
        self.num_events += 1;
        self.second.1 += 1;
        self.recent.push_back(now_ns);
    }

    /// Events in the second before `now_ns`.
    pub(crate) fn now_hz(&mut self, now_ns: u64) -> f64 {
        self.roll(now_ns);
        let age_ns = now_ns.saturating_sub(self.first_ns.unwrap_or(now_ns));
        match age_ns {
            0 => 0.0,
            // In the first second there is less than a second to look back on.
            1..SECOND_NS => self.recent.len().saturating_sub(1) as f64 / (age_ns as f64 * 1e-9),
            _ => self.recent.len() as f64,
        }
    }

    /// Events per second since the first.
    pub(crate) fn mean_hz(&self, now_ns: u64) -> f64 {
        let age_ns = now_ns.saturating_sub(self.first_ns.unwrap_or(now_ns));
        if age_ns == 0 { 0.0 } else { self.num_events.saturating_sub(1) as f64 / (age_ns as f64 * 1e-9) }
    }

    /// Events of the worst whole second so far; the mean rate before there is one.
    pub(crate) fn worst_hz(&self, now_ns: u64) -> f64 {
        self.worst.map_or_else(|| self.mean_hz(now_ns), |count| count as f64)
    }

    fn roll(&mut self, now_ns: u64) {
        while self.recent.front().is_some_and(|&at_ns| at_ns + SECOND_NS <= now_ns) {
            self.recent.pop_front();
        }
        if self.first_ns.is_none() {
            return;
        }
        // After a long silence, one empty second says as much as all of them.
        let silent = now_ns.saturating_sub(self.second.0) / SECOND_NS;
        if silent >= 1 {
            let count = if silent >= 2 { 0 } else { self.second.1 };
            self.worst = Some(self.worst.map_or(count, |worst| worst.min(count)).min(self.second.1));
            self.second = (self.second.0 + silent * SECOND_NS, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_of_the_last_second_of_all_and_of_the_worst_second() {
        let mut meter = RateMeter::default();
        let at = |milliseconds: u64| milliseconds * 1_000_000;
        // 100 Hz for two seconds, 50 Hz for two, 200 Hz for one.
        let mut now = 0;
        for (step, until) in [(10, 2000), (20, 4000), (5, 5000)] {
            while now < until {
                meter.tick(at(now));
                now += step;
            }
        }
        assert!((meter.now_hz(at(5000)) - 200.0).abs() < 1.5, "{}", meter.now_hz(at(5000)));
        assert!((meter.mean_hz(at(5000)) - 100.0).abs() < 1.0);
        assert!((meter.worst_hz(at(5000)) - 50.0).abs() < 1.5);
    }

    #[test]
    fn silence_is_the_worst_second() {
        let mut meter = RateMeter::default();
        for step in 0..100_u64 {
            meter.tick(step * 10_000_000);
        }
        let later_ns = 5 * SECOND_NS;
        assert_eq!(meter.now_hz(later_ns), 0.0);
        assert_eq!(meter.worst_hz(later_ns), 0.0);
    }

    #[test]
    fn nothing_yet_is_no_rate() {
        let mut meter = RateMeter::default();
        assert_eq!((meter.now_hz(7), meter.mean_hz(7), meter.worst_hz(7)), (0.0, 0.0, 0.0));
        meter.tick(9);
        assert_eq!((meter.now_hz(9), meter.mean_hz(9)), (0.0, 0.0));
    }
}
