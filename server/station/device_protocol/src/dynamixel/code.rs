//! Instruction codes.
#![expect(missing_docs, reason = "the names are those of the protocol")]

pub const PING: u8 = 0x01;
pub const READ: u8 = 0x02;
pub const WRITE: u8 = 0x03;
pub const REG_WRITE: u8 = 0x04;
pub const ACTION: u8 = 0x05;
pub const FACTORY_RESET: u8 = 0x06;
pub const REBOOT: u8 = 0x08;
pub const CLEAR: u8 = 0x10;
pub const STATUS: u8 = 0x55;
pub const SYNC_READ: u8 = 0x82;
pub const SYNC_WRITE: u8 = 0x83;
pub const FAST_SYNC_READ: u8 = 0x8A;
pub const BULK_READ: u8 = 0x92;
pub const BULK_WRITE: u8 = 0x93;
pub const FAST_BULK_READ: u8 = 0x9A;
