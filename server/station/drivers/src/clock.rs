//! The host's clock, and the way to interrupt a thread that waits for it.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The one monotonic clock of an opened station: nanoseconds since it was opened. Clones tell the same time.
#[derive(Clone, Debug)]
pub struct HostClock {
    opened: Instant,
    /// The time that tests set, in place of the computer's.
    #[cfg(test)]
    by_hand: Option<Arc<std::sync::atomic::AtomicU64>>,
}

impl HostClock {
    /// A clock that starts now.
    pub(crate) fn start() -> Self {
        Self {
            opened: Instant::now(),
            #[cfg(test)]
            by_hand: None,
        }
    }

    /// A clock that shows what `now_ns` holds, for devices in their own time.
    #[cfg(test)]
    pub(crate) fn by_hand(now_ns: Arc<std::sync::atomic::AtomicU64>) -> Self {
        Self { opened: Instant::now(), by_hand: Some(now_ns) }
    }

    /// Time since the station was opened, ns.
    pub fn now_ns(&self) -> u64 {
        #[cfg(test)]
        if let Some(now_ns) = &self.by_hand {
            return now_ns.load(std::sync::atomic::Ordering::Relaxed);
        }
        u64::try_from(self.opened.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }
}

/// Tells a thread to end, also while it waits. Clones are the same signal.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stop {
    shared: Arc<(Mutex<bool>, Condvar)>,
}

impl Stop {
    /// Ends every wait now and from now on.
    pub(crate) fn set(&self) {
        *self.shared.0.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.shared.1.notify_all();
    }

    /// Whether the thread shall end.
    pub(crate) fn is_set(&self) -> bool {
        *self.shared.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits, and says whether the thread shall end, in which case it returns at once.
    pub(crate) fn wait(&self, duration: Duration) -> bool {
        let guard = self.shared.0.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.shared.1.wait_timeout_while(guard, duration, |stopped| !*stopped);
        *waited.unwrap_or_else(PoisonError::into_inner).0
    }
}

/// Pauses between attempts that double from 0.2 s to 5 s.
#[derive(Clone, Debug)]
pub(crate) struct BackOff {
    next: Duration,
}

impl Default for BackOff {
    fn default() -> Self {
        Self { next: Self::SHORTEST }
    }
}

impl BackOff {
    /// The first pause.
    pub(crate) const SHORTEST: Duration = Duration::from_millis(200);
    /// No pause is longer.
    pub(crate) const LONGEST: Duration = Duration::from_secs(5);

    /// How long to wait before the next attempt.
    pub(crate) fn pause(&mut self) -> Duration {
        let pause = self.next;
        self.next = (2 * pause).min(Self::LONGEST);
        pause
    }

    /// The device was there: the next pause is the first again.
    pub(crate) fn reset(&mut self) {
        self.next = Self::SHORTEST;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_up_to_five_seconds_and_start_over() {
        let mut back_off = BackOff::default();
        let pauses: Vec<u128> = (0..7).map(|_| back_off.pause().as_millis()).collect();
        assert_eq!(pauses, [200, 400, 800, 1600, 3200, 5000, 5000]);
        back_off.reset();
        assert_eq!(back_off.pause().as_millis(), 200);
    }

    #[test]
    fn a_stop_ends_a_wait_of_another_thread_and_all_later_ones() {
        let stop = Stop::default();
        let waiting = std::thread::spawn({
            let stop = stop.clone();
            move || stop.wait(Duration::from_secs(600))
        });
        assert!(!stop.wait(Duration::from_millis(1)));
        stop.set();
        assert!(waiting.join().unwrap());
        assert!(stop.wait(Duration::from_secs(600)) && stop.is_set());
    }
}
