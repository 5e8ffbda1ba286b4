//! Looks at every device of a station for a while and says what is there, what is missing, and how to mend it.

use std::fmt;
use std::sync::{Arc, mpsc};
use std::time::Duration;

use palpate_robot_model::{DeviceConfig, DeviceKind, Station};

use crate::clock::Stop;
use crate::devices::{Devices, Ports};
use crate::error::DriverError;
use crate::event::Link;
use crate::health::DeviceHealth;

/// Devices have this long to be found and set up.
const FIND: Duration = Duration::from_secs(6);
/// And are watched for this long.
const WATCH: Duration = Duration::from_secs(3);
const STEP: Duration = Duration::from_millis(100);
/// Fewer samples than this share of those expected are too few.
const SLOW_SHARE: f64 = 0.9;

/// What was found of one device.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceCheck {
    /// Whether it can be reached and has no fault.
    pub ok: bool,
    /// What to know of one that works: it is slower than it should be, or something slows it down.
    pub warnings: Vec<String>,
    /// How it was at the end: link, problem with advice, rates, motors with identity, temperature and voltage.
    pub health: DeviceHealth,
}

/// Opens every device as for driving, without a goal for any motor, and says how it is after some seconds. Servos are
/// set up on the way, so a hand that was held goes limp.
pub fn probe(station: &Arc<Station>, ports: &Ports) -> Result<Vec<DeviceCheck>, DriverError> {
    // Nobody listens: what counts is the devices' health.
    let (events, received) = mpsc::sync_channel(1);
    drop(received);
    let devices = Devices::open(station, ports, events)?;
    let pause = Stop::default();
    let mut waited = Duration::ZERO;
    while waited < FIND && devices.health().iter().any(|device| !device.link.is_connected()) {
        pause.wait(STEP);
        waited += STEP;
    }
    pause.wait(WATCH);
    let health = devices.health().into_iter().zip(&station.devices);
    Ok(health.map(|(health, config)| check(health, nominal_rate_hz(station, config))).collect())
}

fn check(mut health: DeviceHealth, nominal_rate_hz: Option<f64>) -> DeviceCheck {
    let ok = health.link == Link::Ready;
    let mut warnings = Vec::new();
    if ok {
        warnings.extend(std::mem::take(&mut health.problem).lines().map(str::to_owned));
        warnings.extend(nominal_rate_hz.and_then(|nominal_hz| slow(health.rate_hz, nominal_hz)));
    }
    DeviceCheck { ok, warnings, health }
}

/// That so many samples a second are too few, if they are.
fn slow(rate_hz: f64, nominal_hz: f64) -> Option<String> {
    (rate_hz < SLOW_SHARE * nominal_hz).then(|| {
        format!("{rate_hz:.0} samples/s, expected {nominal_hz:.0}: the line is slow, or the computer is busy")
    })
}

/// Samples a second that the station's files promise; `None` where they promise none.
fn nominal_rate_hz(station: &Station, device: &DeviceConfig) -> Option<f64> {
    match &device.kind {
        DeviceKind::Dynamixel(bus) => Some(bus.rate_hz),
        DeviceKind::Lines(board) => Some(station.layout.streams.get(board.stream_idx)?.rate_hz),
        DeviceKind::Xarm(_) => None,
    }
}

impl fmt::Display for DeviceCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let health = &self.health;
        let link = match health.link {
            Link::Ready => "ready",
            Link::Fault => "FAULT",
            Link::Connecting => "not found yet",
            Link::Lost => "NOT FOUND",
        };
        writeln!(f, "{} ({}): {link}", health.id, health.kind)?;
        for line in health.problem.lines() {
            writeln!(f, "    {line}")?;
        }
        for warning in &self.warnings {
            writeln!(f, "    warning: {warning}")?;
        }
        if health.link.is_connected() {
            writeln!(
                f,
                "    {:.0} samples/s (worst second {:.0}), missed: {}, bad frames: {}",
                health.rate_hz, health.rate_worst_hz, health.gaps, health.bad_frames
            )?;
        }
        for motor in health.motors.iter().filter(|motor| !motor.identity.is_empty()) {
            write!(f, "    {}: {}", motor.joint, motor.identity)?;
            if let Some(temperature_c) = motor.temperature_c {
                write!(f, ", {temperature_c:.0} C")?;
            }
            if let Some(supply_v) = motor.supply_v {
                write!(f, ", {supply_v:.1} V")?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_works_slowly_is_warned_of_and_one_that_is_lost_is_not_ok() {
        let device = |link, rate_hz, problem: &str| DeviceHealth {
            link,
            rate_hz,
            problem: problem.to_owned(),
            ..DeviceHealth::default()
        };
        let found = check(device(Link::Ready, 63.0, "answers take 8.0 ms"), Some(100.0));
        assert!(found.ok && found.health.problem.is_empty(), "{found:?}");
        let text = found.to_string();
        assert!(text.contains("warning: answers take 8.0 ms"), "{text}");
        assert!(text.contains("warning: 63 samples/s, expected 100: "), "{text}");
        let found = check(device(Link::Ready, 95.0, ""), Some(100.0));
        assert!(found.ok && found.warnings.is_empty(), "{found:?}");
        for link in [Link::Lost, Link::Fault, Link::Connecting] {
            let found = check(device(link, 0.0, "no such port"), Some(100.0));
            assert!(!found.ok && found.warnings.is_empty() && found.health.problem == "no such port");
        }
    }
}
