//! Host side of the station's devices: ports, bus threads, clocks, health, reconnection.
//!
//! [`Devices`] starts one thread for each device of a station file. What a device has to say comes as a
//! [`DeviceEvent`], dated by one [`HostClock`]; what motors shall do is the newest [`palpate_safety::Setpoint`], and only
//! that. A device that is not there, or goes, is looked for until it comes back. [`DeviceHealth`] tells how it has been
//! doing, [`probe()`] looks at all of them once.
//!
//! The crate decides nothing about motion: limits, leases and stops are the safety layer's. What it does decide is
//! what happens when nobody stands behind a setpoint any more: joints hold, then go limp.

mod arm;
mod boards;
mod clock;
mod clock_map;
mod context;
mod devices;
#[cfg(test)]
mod emulated;
mod error;
mod event;
mod health;
pub mod priority;
mod probe;
mod rate;
mod servo_bus;

pub use clock::HostClock;
pub use devices::{Devices, PortOverride, Ports};
pub use error::DriverError;
pub use event::{DeviceEvent, Link};
pub use health::{DeviceHealth, MotorHealth};
pub use probe::{DeviceCheck, probe};
