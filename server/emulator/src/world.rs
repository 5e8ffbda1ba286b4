//! The truth world.

/// The world behind the emulated sensors.
pub struct TruthWorld {}
