//! When the loop runs next.

/// Deadlines at a fixed rate: they do not drift with the time that a turn takes, and those that were missed are left
/// out rather than made up for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    period_ns: u64,
    next_ns: u64,
}

impl Pace {
    /// The first deadline is now.
    pub(crate) fn new(now_ns: u64, period_ns: u64) -> Self {
        Self { period_ns, next_ns: now_ns }
    }

    /// When the next turn is due.
    pub(crate) fn next_ns(&self) -> u64 {
        self.next_ns
    }

    /// Whether a turn is due; if so, the deadline after it lies in the future.
    pub(crate) fn due(&mut self, now_ns: u64) -> bool {
        if now_ns < self.next_ns {
            return false;
        }
        let missed = (now_ns - self.next_ns) / self.period_ns;
        self.next_ns += (missed + 1) * self.period_ns;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deadlines_do_not_drift() {
        let mut pace = Pace::new(1000, 50);
        // Every turn is noticed 7 ns late.
        for turn in 0..100 {
            assert_eq!(pace.next_ns(), 1000 + turn * 50);
            assert!(!pace.due(pace.next_ns() - 1));
            assert!(pace.due(pace.next_ns() + 7));
        }
    }

    #[test]
    fn after_a_pause_there_is_one_turn_and_the_old_rhythm() {
        let mut pace = Pace::new(0, 50);
        assert!(pace.due(0));
        assert!(pace.due(1234));
        assert!(!pace.due(1249));
        assert_eq!(pace.next_ns(), 1250);
    }
}
