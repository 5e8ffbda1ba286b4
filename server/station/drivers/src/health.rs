//! How a device has been doing, for operators and for takes.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::event::Link;
use crate::rate::RateMeter;

/// How one device is and has been since the station was opened.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeviceHealth {
    /// Id of the station file.
    pub id: String,
    /// `dynamixel`, `xarm` or `lines`.
    pub kind: String,
    /// Whether it can be reached and works.
    pub link: Link,
    /// What is wrong and what to do; empty when all is well.
    pub problem: String,
    /// Samples in the last second, Hz.
    pub rate_hz: f64,
    /// Mean over the time that it was connected, Hz.
    pub rate_mean_hz: f64,
    /// Of the worst whole second in which it was connected, Hz.
    pub rate_worst_hz: f64,
    /// Samples that did not come in time.
    pub gaps: u64,
    /// Frames dropped for a wrong checksum or form.
    pub bad_frames: u64,
    /// Readings dropped because nobody took them in time.
    pub dropped_events: u64,
    /// Times that it was connected again.
    pub reconnects: u64,
    /// How much faster the host's clock runs than the device's, parts per million; 0 where the device has none.
    pub clock_skew_ppm: f64,
    /// Its motors, in the order of the station file.
    pub motors: Vec<MotorHealth>,
}

/// How one motor is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MotorHealth {
    /// The joint that it moves.
    pub joint: String,
    /// Model and firmware, once known.
    pub identity: String,
    /// Degrees Celsius, once known.
    pub temperature_c: Option<f64>,
    /// Supply at the motor, V, once known.
    pub supply_v: Option<f64>,
    /// A, once known.
    pub current_a: Option<f64>,
    /// What is wrong and what to do; empty when all is well.
    pub problem: String,
}

/// The health of one device, shared between its thread and everybody who asks.
#[derive(Clone, Debug, Default)]
pub(crate) struct SharedHealth {
    inner: Arc<Mutex<Inner>>,
}

#[derive(Debug, Default)]
struct Inner {
    health: DeviceHealth,
    meter: RateMeter,
    was_connected: bool,
}

impl SharedHealth {
    pub(crate) fn new(id: &str, kind: &str) -> Self {
        let health = DeviceHealth { id: id.to_owned(), kind: kind.to_owned(), ..DeviceHealth::default() };
        Self { inner: Arc::new(Mutex::new(Inner { health, ..Inner::default() })) }
    }

    /// The motors there are; what was known of motors before is forgotten.
    pub(crate) fn set_motors(&self, joints: impl IntoIterator<Item = String>) {
        let motor = |joint| MotorHealth { joint, ..MotorHealth::default() };
        self.lock().health.motors = joints.into_iter().map(motor).collect();
    }

    /// Changes what is known of all motors.
    pub(crate) fn motors(&self, change: impl FnOnce(&mut [MotorHealth])) {
        change(&mut self.lock().health.motors);
    }

    /// A sample has come.
    pub(crate) fn sample(&self, now_ns: u64) {
        self.lock().meter.sample(now_ns);
    }

    /// Samples that were due have not come.
    pub(crate) fn add_gaps(&self, count: u64) {
        self.lock().health.gaps += count;
    }

    /// Frames had a wrong checksum or form.
    pub(crate) fn add_bad_frames(&self, count: u64) {
        self.lock().health.bad_frames += count;
    }

    /// A reading was dropped because nobody took it; how many that makes.
    pub(crate) fn add_dropped_event(&self) -> u64 {
        let mut inner = self.lock();
        inner.health.dropped_events += 1;
        inner.health.dropped_events
    }

    pub(crate) fn set_skew_ppm(&self, skew_ppm: f64) {
        self.lock().health.clock_skew_ppm = skew_ppm;
    }

    /// Notes the link and says whether anything is new about it.
    pub(crate) fn set_link(&self, now_ns: u64, link: Link, problem: &str) -> bool {
        let mut inner = self.lock();
        let Inner { health, meter, was_connected } = &mut *inner;
        let changed = health.link != link || health.problem != problem;
        if link.is_connected() && !health.link.is_connected() {
            if *was_connected {
                health.reconnects += 1;
            }
            *was_connected = true;
        }
        if !link.is_connected() {
            meter.disconnected(now_ns);
        }
        health.link = link;
        if health.problem != problem {
            problem.clone_into(&mut health.problem);
        }
        changed
    }

    /// Everything, as it is now.
    pub(crate) fn snapshot(&self, now_ns: u64) -> DeviceHealth {
        let mut inner = self.lock();
        let rates = inner.meter.rates(now_ns);
        let mut health = inner.health.clone();
        (health.rate_hz, health.rate_mean_hz, health.rate_worst_hz) =
            (rates.now_hz, rates.mean_hz, rates.worst_hz);
        health
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_comes_back_counts_as_reconnected_but_a_fault_that_passes_does_not() {
        let health = SharedHealth::new("u2d2", "dynamixel");
        assert!(health.set_link(1, Link::Lost, "no such port"));
        assert!(!health.set_link(2, Link::Lost, "no such port"));
        for (link, problem) in [
            (Link::Ready, ""),
            (Link::Fault, "overload"),
            (Link::Ready, ""),
            (Link::Lost, "silent"),
            (Link::Connecting, ""),
            (Link::Ready, ""),
        ] {
            assert!(health.set_link(3, link, problem));
        }
        assert_eq!(health.snapshot(4).reconnects, 1);
    }
}
