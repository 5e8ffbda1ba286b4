//! Dynamixel Protocol 2.0, as the hand's servos speak it on a half-duplex serial line.
//!
//! [`Decoder`] turns a byte stream into [`Packet`]s; [`Request`] and [`Status`] are their typed contents. A host encodes
//! requests and decodes statuses, an emulated servo does the opposite. The [`control_table`] names registers and units.

pub mod code;
pub mod control_table;
mod decoder;
mod fast;
mod packet;
mod request;
mod status;

pub use decoder::{DEFAULT_MAX_LENGTH, Decoder};
pub use fast::{FastBlock, FastReply, encode_fast, parse_fast, parse_fast_bytes};
pub use packet::{BROADCAST_ID, MAX_ID, Packet, PacketError, stuff, unstuff};
pub use request::{BulkRead, BulkWrite, FactoryReset, Instruction, Request};
pub use status::{ErrorByte, HardwareError, PingReply, Status, StatusError};
