//! The bytes that the hand, the arm and the tactile boards speak, without the ports they travel through.
//!
//! Every protocol comes in both directions, so that the drivers (host side) and the emulated devices (device side) share
//! one description: what one encodes the other decodes. The crate takes bytes and gives values, or takes values and gives
//! bytes; it never opens a port, reads a clock or retries. Time-outs, pacing and reconnection belong to the drivers.
//!
//! - [`dynamixel`]: Protocol 2.0 and the control table of the hand's servos.
//! - [`xarm`]: the arm's private TCP protocol and its report streams.
//! - [`lines`]: the ASCII lines of the tactile boards.
//! - [`framed`]: our own binary frames for new tactile firmware.
//!
//! All decoders are incremental: bytes may arrive in chunks of any size, and the chunking never changes what is
//! delivered. They share [`DecodeCounters`]: every byte ends in a delivered frame, among the dropped bytes, or is still
//! pending.

mod counters;
mod crc16;
pub mod dynamixel;
mod fields;
pub mod framed;
pub mod lines;
pub mod xarm;

pub use counters::DecodeCounters;
pub use fields::LayoutError;
