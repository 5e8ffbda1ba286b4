//! Host side of the station's devices: ports, bus threads, clocks, health, reconnection.

#![expect(dead_code, reason = "the first driver that uses the framework is being written")]

mod clock;
mod clock_map;
mod context;
mod error;
mod event;
mod health;
mod rate;

pub use clock::HostClock;
pub use error::DriverError;
pub use event::{DeviceEvent, Link};
pub use health::{DeviceHealth, MotorHealth};
