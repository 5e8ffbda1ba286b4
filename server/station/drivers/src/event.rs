//! What the devices' threads report.

use std::sync::Arc;

/// Whether a device can be reached and works.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Link {
    /// Being opened and set up, for the first time or again.
    #[default]
    Connecting,
    /// Talks, and all is well.
    Ready,
    /// Talks, but something is wrong with it.
    Fault,
    /// Cannot be reached; the driver keeps trying.
    Lost,
}

impl Link {
    /// Whether bytes go back and forth.
    pub fn is_connected(self) -> bool {
        matches!(self, Self::Ready | Self::Fault)
    }
}

/// What one device has to say. `device` counts the station's devices; all times are ns of [`crate::HostClock`].
#[derive(Clone, Debug, PartialEq)]
pub enum DeviceEvent {
    /// A reading of joints. The vectors go with `dofs`; a joint that could not be read is not in them.
    Joints {
        /// Which device.
        device: usize,
        /// When the last byte of the reading was there.
        received_ns: u64,
        /// When the device took the reading, by its own clock mapped to the host's.
        host_ns: u64,
        /// When the device took the reading, by its own clock since it was connected.
        device_ns: Option<u64>,
        /// Degrees of freedom, in the station's order.
        dofs: Arc<[usize]>,
        /// Positions, rad or m.
        positions: Vec<f64>,
        /// Velocities, rad/s or m/s.
        velocities: Vec<f64>,
        /// Motor currents, A; 0 where the device gives none.
        currents_a: Vec<f64>,
        /// Whether a motor holds the joint, as last reported by the device itself.
        torque_on: Vec<bool>,
    },
    /// A sample of consecutive channels of a tactile stream.
    Tactile {
        /// Which device.
        device: usize,
        /// When the last byte of the sample was there.
        received_ns: u64,
        /// When the device took the sample, by its own clock mapped to the host's, where it has one.
        host_ns: u64,
        /// When the device took the sample, by its own clock.
        device_ns: Option<u64>,
        /// The device's own count of samples, where it counts.
        sequence: Option<u32>,
        /// Which stream of the layout.
        stream: usize,
        /// First channel of the stream that the sample is of.
        first_channel: usize,
        /// Raw readings.
        raw: Vec<f32>,
    },
    /// A device was found, lost, has a fault, or has none any more.
    Link {
        /// Which device.
        device: usize,
        /// Since when.
        at_ns: u64,
        /// What it is now.
        link: Link,
        /// What is wrong and what to do; empty when all is well.
        problem: String,
    },
}
