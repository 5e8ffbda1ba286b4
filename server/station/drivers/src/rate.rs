//! How many samples a second a device really gives.

use std::collections::VecDeque;

const SECOND_NS: u64 = 1_000_000_000;

/// Rate over the last second, over all time connected, and of the worst whole second while connected.
#[derive(Clone, Debug, Default)]
pub(crate) struct RateMeter {
    /// Times of the samples of the last second.
    recent: VecDeque<u64>,
    /// The present connection: since when, and where its unfinished second began.
    connected: Option<Connection>,
    /// Time and samples of earlier connections.
    earlier_ns: u64,
    num_samples: u64,
    worst: Option<u64>,
}

#[derive(Clone, Copy, Debug)]
struct Connection {
    since_ns: u64,
    second_ns: u64,
    in_second: u64,
}

/// What a [`RateMeter`] says, Hz.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Rates {
    pub(crate) now_hz: f64,
    pub(crate) mean_hz: f64,
    pub(crate) worst_hz: f64,
}

impl RateMeter {
    /// Counts from here on. Time before the first sample of a connection is setting up, not silence.
    pub(crate) fn sample(&mut self, now_ns: u64) {
        let connection =
            self.connected.get_or_insert(Connection { since_ns: now_ns, second_ns: now_ns, in_second: 0 });
        let mut connection = *connection;
        self.finish_seconds(&mut connection, now_ns);
        connection.in_second += 1;
        self.connected = Some(connection);
        self.num_samples += 1;
        self.recent.push_back(now_ns);
        self.forget(now_ns);
    }

    /// The device is gone: the unfinished second does not count.
    pub(crate) fn disconnected(&mut self, now_ns: u64) {
        self.recent.clear();
        if let Some(mut connection) = self.connected.take() {
            self.finish_seconds(&mut connection, now_ns);
            self.earlier_ns += now_ns.saturating_sub(connection.since_ns);
        }
    }

    /// The rates at `now_ns`.
    pub(crate) fn rates(&mut self, now_ns: u64) -> Rates {
        self.forget(now_ns);
        let mut total_ns = self.earlier_ns;
        let mut span_ns = SECOND_NS;
        if let Some(mut connection) = self.connected {
            self.finish_seconds(&mut connection, now_ns);
            self.connected = Some(connection);
            let connected_ns = now_ns.saturating_sub(connection.since_ns);
            total_ns += connected_ns;
            // In the first second there cannot be a second's samples.
            span_ns = connected_ns.clamp(SECOND_NS / 10, SECOND_NS);
        }
        let per_second = |count: f64, ns: u64| if ns > 0 { count * 1e9 / ns as f64 } else { 0.0 };
        let now_hz = per_second(self.recent.len() as f64, span_ns);
        Rates {
            now_hz,
            mean_hz: per_second(self.num_samples as f64, total_ns),
            worst_hz: self.worst.map_or(now_hz, |worst| worst as f64),
        }
    }

    fn finish_seconds(&mut self, connection: &mut Connection, now_ns: u64) {
        while now_ns >= connection.second_ns + SECOND_NS {
            self.worst =
                Some(self.worst.map_or(connection.in_second, |worst| worst.min(connection.in_second)));
            connection.second_ns += SECOND_NS;
            connection.in_second = 0;
            if self.worst == Some(0) {
                // Nothing is worse: a long silence need not be walked through.
                let rest = now_ns.saturating_sub(connection.second_ns) / SECOND_NS;
                connection.second_ns += rest * SECOND_NS;
            }
        }
    }

    fn forget(&mut self, now_ns: u64) {
        while self.recent.front().is_some_and(|&at_ns| at_ns + SECOND_NS <= now_ns) {
            self.recent.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn sample(meter: &mut RateMeter, from_ms: u64, to_ms: u64, every_ms: u64) {
        for ms in (from_ms..to_ms).step_by(every_ms as usize) {
            meter.sample(ms * MS);
        }
    }

    #[test]
    fn now_mean_and_worst_tell_a_slow_second_from_a_slow_device() {
        let mut meter = RateMeter::default();
        sample(&mut meter, 0, 3000, 10);
        sample(&mut meter, 3000, 4000, 50);
        sample(&mut meter, 4000, 10_000, 10);
        let rates = meter.rates(10_000 * MS);
        assert!((rates.now_hz - 100.0).abs() <= 1.0 && rates.worst_hz == 20.0, "{rates:?}");
        assert!((rates.mean_hz - 92.0).abs() < 1.0, "{rates:?}");
    }

    #[test]
    fn silence_while_connected_is_a_worst_second_of_zero_and_time_unplugged_counts_nowhere() {
        let mut meter = RateMeter::default();
        sample(&mut meter, 0, 2000, 10);
        meter.disconnected(2000 * MS);
        let rates = meter.rates(60_000 * MS);
        assert_eq!((rates.now_hz, rates.worst_hz), (0.0, 100.0));
        assert!((rates.mean_hz - 100.0).abs() < 1.0);
        sample(&mut meter, 60_000, 61_000, 10);
        assert_eq!(meter.rates(65_000 * MS).worst_hz, 0.0);
        assert_eq!(RateMeter::default().rates(5), Rates::default());
    }
}
