//! Why the devices of a station cannot be driven at all. A device that is not there is no such reason.

use std::io;

/// Why a call failed. What goes wrong with a device later on is told by [`crate::DeviceEvent::Link`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DriverError {
    /// A device that the station does not have.
    #[error("no device {device:?}; the station has {known}")]
    UnknownDevice {
        /// The id asked for.
        device: String,
        /// The ids there are.
        known: String,
    },
    /// A port was given that does not suit the device.
    #[error("device {device:?} is a {kind} device: expected {expected} in place of its port")]
    Port {
        /// The device.
        device: String,
        /// What it is.
        kind: &'static str,
        /// What would suit it.
        expected: &'static str,
    },
    /// Something in the device's part of the station file cannot be done.
    #[error("device {device:?}: {problem}")]
    Config {
        /// The device.
        device: String,
        /// What is wrong, what was expected, and what to do.
        problem: String,
    },
    /// The operating system gave no thread.
    #[error("start the thread of device {device:?}")]
    Thread {
        /// The device.
        device: String,
        /// Why not.
        #[source]
        source: io::Error,
    },
}
