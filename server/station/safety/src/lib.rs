//! The one way to any motor: lease, deadman, limits, ease-in and the latched stop.
//!
//! [`Supervisor`] is told what operators ask for and what joints measure, and makes one [`Setpoint`] per turn of the
//! control loop; nothing else makes any, so whatever moves a station (pages, guided motions, policies) comes past it.
//! It reads no clock and opens no port: every call says what time it is, in ns since the station was opened, and the same
//! calls give the same bits. A stop given here is a stop by software; it is no emergency stop.

mod audit;
mod lease;
mod measured;
mod profile;
mod refusal;
mod supervisor;
mod workspace;

pub use audit::{AuditEntry, Outcome};
pub use lease::Lease;
pub use measured::{DeviceFault, JointReading, Measured};
pub use refusal::Refusal;
pub use supervisor::{
    OUTSIDE_TOLERANCE_M, OUTSIDE_TOLERANCE_RAD, Phase, Setpoint, Status, Supervisor, disarm_begins_s,
};
