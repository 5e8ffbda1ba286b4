//! Looks at every device of a station for a while and says what is there, what is missing, and how to mend it.

use std::fmt;
use std::sync::{Arc, mpsc};
use std::time::Duration;

use palpate_robot_model::Station;

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

/// What was found of one device.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceCheck {
    /// Whether it can be reached and nothing is wrong with it.
    pub ok: bool,
    /// How it was at the end: link, problem with advice, rates, motors with identity, temperature and voltage.
    pub health: DeviceHealth,
}

/// Opens every device as for driving, without a goal for any motor, and says how it is after some seconds. Servos are
/// set up on the way, so a hand that was held goes limp.
pub fn probe(station: &Arc<Station>, ports: &Ports) -> Result<Vec<DeviceCheck>, DriverError> {
    let (events, received) = mpsc::channel();
    let devices = Devices::open(station, ports, events)?;
    let pause = Stop::default();
    let mut waited = Duration::ZERO;
    while waited < FIND && devices.health().iter().any(|device| !device.link.is_connected()) {
        pause.wait(STEP);
        waited += STEP;
    }
    pause.wait(WATCH);
    drop(received);
    let check = |health: DeviceHealth| DeviceCheck {
        ok: health.link == Link::Ready && health.problem.is_empty(),
        health,
    };
    Ok(devices.health().into_iter().map(check).collect())
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
        if health.link.is_connected() {
            writeln!(
                f,
                "    {:.0} samples/s (worst second {:.0}), {} gaps, {} bad frames",
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
