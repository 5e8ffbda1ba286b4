//! The hardware of a station: which device moves which joint and feels which channel, and within what limits.
//!
//! All of it is optional in a station file: a station that only replays takes needs none. Positions of joints and of
//! servos, and joint orders of other software, meet in [`conventions`] and nowhere else.

pub mod conventions;
mod read;
mod safety;

use std::{net::IpAddr, ops::Range};

pub(crate) use read::{DeviceText, devices};
pub use safety::{JointSafety, SafetyConfig, WorkspaceBox};
pub(crate) use safety::{SafetyText, safety};

/// Most current that a servo of a hand may draw, A: above, the small servos shut down and their gears suffer.
pub const MAX_CURRENT_LIMIT_A: f64 = 0.55;

/// Longest silence after which servos stop by themselves, s: if the program dies they move on to their last goal until
/// then. The register could hold 2.54 s.
pub const MAX_WATCHDOG_S: f64 = 1.0;

/// One device of a station.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceConfig {
    /// Stable id, e.g. `u2d2`.
    pub id: String,
    /// What it is and how to reach it.
    pub kind: DeviceKind,
}

/// What a device is.
#[derive(Clone, Debug, PartialEq)]
pub enum DeviceKind {
    /// Servos on a Dynamixel Protocol 2.0 bus; `kind = "dynamixel"`.
    Dynamixel(ServoBusConfig),
    /// An xArm's control box; `kind = "xarm"`.
    Xarm(ArmConfig),
    /// A tactile board that writes a line of text per sample; `kind = "lines"`.
    Lines(BoardConfig),
}

/// A bus of servos.
#[derive(Clone, Debug, PartialEq)]
pub struct ServoBusConfig {
    /// Serial port, e.g. `/dev/ttyUSB0`.
    pub port: String,
    /// Bits per second, one of the rates that the servos know. Default 4 000 000.
    pub baud: u32,
    /// How often positions are read and goals written, Hz, 10 to 1000. Default 100.
    pub rate_hz: f64,
    /// Largest current of a servo, A, at most [`MAX_CURRENT_LIMIT_A`]. Default 0.3.
    pub current_limit_a: f64,
    /// Silence after which servos stop by themselves, s, 0.02 to [`MAX_WATCHDOG_S`], and at least two cycles of `rate_hz`.
    /// Default 0.2.
    pub watchdog_s: f64,
    /// The servos, in the file's order.
    pub servos: Vec<ServoConfig>,
}

/// One servo and its joint.
#[derive(Clone, Debug, PartialEq)]
pub struct ServoConfig {
    /// Name of the joint it moves.
    pub joint: String,
    /// Degree of freedom of that joint, in the station's order.
    pub dof: usize,
    /// Id on the bus, 0 to 252.
    pub id: u8,
    /// Position of the servo where the joint is at zero, rad.
    pub zero_rad: f64,
    /// 1 where joint and servo turn the same way, -1 where they do not. Default 1.
    pub direction: i8,
    /// Position gain register. Default 600.
    pub p: u16,
    /// Integral gain register. Default 0.
    pub i: u16,
    /// Derivative gain register. Default 200.
    pub d: u16,
}

/// An arm.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmConfig {
    /// Address of the control box.
    pub address: IpAddr,
    /// Port of commands. Default 502.
    pub command_port: u16,
    /// Port of the report stream that gives joints at 100 Hz. Default 30003.
    pub report_port: u16,
    /// Names of its joints, from the base.
    pub joints: Vec<String>,
    /// Degrees of freedom of these joints, in the station's order.
    pub dofs: Vec<usize>,
}

/// A tactile board.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardConfig {
    /// Serial port, e.g. `/dev/ttyACM0`.
    pub port: String,
    /// Bits per second. Default 115 200.
    pub baud: u32,
    /// Id of the stream of the layout that its readings belong to.
    pub stream: String,
    /// Index of that stream in the layout.
    pub stream_idx: usize,
    /// Its first channel, counted within the stream.
    pub first_channel: usize,
    /// How many channels it reads.
    pub num_channels: usize,
    /// Lines of text per sample; a matrix sends one line per row. Default 1.
    pub lines_per_sample: usize,
    /// Its channels, counted through the whole layout.
    pub channels: Range<usize>,
}

impl DeviceConfig {
    /// Degrees of freedom that this device moves, in its own order; empty for boards.
    pub fn dofs(&self) -> Vec<usize> {
        match &self.kind {
            DeviceKind::Dynamixel(bus) => bus.servos.iter().map(|servo| servo.dof).collect(),
            DeviceKind::Xarm(arm) => arm.dofs.clone(),
            DeviceKind::Lines(_) => Vec::new(),
        }
    }

    /// What the station file calls this kind of device.
    pub fn kind_name(&self) -> &'static str {
        match self.kind {
            DeviceKind::Dynamixel(_) => "dynamixel",
            DeviceKind::Xarm(_) => "xarm",
            DeviceKind::Lines(_) => "lines",
        }
    }
}
