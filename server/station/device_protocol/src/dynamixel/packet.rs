//! One packet on the line: `FF FF FD 00 | id | length | instruction | parameters | CRC`, integers little-endian.

use crate::crc16::crc16;

use super::code;

/// Addresses every device on the line.
pub const BROADCAST_ID: u8 = 0xFE;
/// The largest id that a device may have.
pub const MAX_ID: u8 = 252;

pub(super) const HEADER: [u8; 4] = [0xFF, 0xFF, 0xFD, 0x00];
/// Bytes in front of those that the length field counts.
pub(super) const PREFIX_LEN: usize = 7;

/// A packet whose checksum was right, its parameters without stuffing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Packet {
    /// The device addressed or answering, or [`BROADCAST_ID`].
    pub id: u8,
    /// The instruction code; 0x55 marks a status.
    pub instruction: u8,
    /// What follows the instruction code, up to the checksum. A status begins with its error byte.
    pub params: Vec<u8>,
}

/// Why a packet cannot be built from, or understood as, what was asked for.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// The id cannot be on the line.
    #[error("id {id} does not exist, expected 0 to 252 or 254 (all)")]
    Id {
        /// The id asked for.
        id: u8,
    },
    /// The length field has 16 bits.
    #[error("{num_bytes} bytes after the length field, expected at most 65535: split the request")]
    TooLong {
        /// What the length field would have to hold.
        num_bytes: usize,
    },
    /// The instruction is none of Protocol 2.0.
    #[error("instruction {code:#04x} of id {id} is not known")]
    UnknownInstruction {
        /// The id in the packet.
        id: u8,
        /// The instruction code in the packet.
        code: u8,
    },
    /// The parameters do not have the shape that the instruction needs.
    #[error("parameters of instruction {code:#04x} to id {id}: {num_bytes} bytes, expected {expected}")]
    Params {
        /// The id in the packet.
        id: u8,
        /// The instruction code.
        code: u8,
        /// Parameter bytes found.
        num_bytes: usize,
        /// What the instruction needs, in words.
        expected: &'static str,
    },
    /// A device's data in a synchronous write has another length than the request declares.
    #[error("data for id {id}: {found} bytes, expected {expected} for every device of a synchronous write")]
    DataLength {
        /// The device.
        id: u8,
        /// Bytes the request declares for each device.
        expected: usize,
        /// Bytes given for this device.
        found: usize,
    },
}

impl Packet {
    /// Whether this is the joint answer to a fast synchronous or bulk read, the only packet that is never stuffed.
    pub fn is_fast_status(&self) -> bool {
        is_fast_status(self.id, self.instruction)
    }

    /// The bytes on the line.
    pub fn encode(&self) -> Result<Vec<u8>, PacketError> {
        if self.id > MAX_ID && self.id != BROADCAST_ID {
            return Err(PacketError::Id { id: self.id });
        }
        let mut body = Vec::with_capacity(1 + self.params.len());
        body.push(self.instruction);
        body.extend_from_slice(&self.params);
        if !self.is_fast_status() {
            body = stuff(&body);
        }
        let mut bytes = prefix(self.id, body.len() + 2)?;
        bytes.extend_from_slice(&body);
        let crc = crc16(&bytes);
        bytes.extend_from_slice(&crc.to_le_bytes());
        Ok(bytes)
    }
}

/// Header, id and length field.
pub(super) fn prefix(id: u8, length: usize) -> Result<Vec<u8>, PacketError> {
    let field = u16::try_from(length).map_err(|_| PacketError::TooLong { num_bytes: length })?;
    let mut bytes = Vec::with_capacity(PREFIX_LEN + length);
    bytes.extend_from_slice(&HEADER);
    bytes.push(id);
    bytes.extend_from_slice(&field.to_le_bytes());
    Ok(bytes)
}

pub(super) fn is_fast_status(id: u8, instruction: u8) -> bool {
    id == BROADCAST_ID && instruction == code::STATUS
}

/// Inserts `FD` after every `FF FF FD`, so that no header appears inside a packet.
pub fn stuff(body: &[u8]) -> Vec<u8> {
    let mut stuffed = Vec::with_capacity(body.len() + 2);
    for (idx, &byte) in body.iter().enumerate() {
        stuffed.push(byte);
        if byte == 0xFD && idx >= 2 && body[idx - 2..idx] == [0xFF, 0xFF] {
            stuffed.push(0xFD);
        }
    }
    stuffed
}

/// Removes what [`stuff`] inserted. An `FF FF FD` that is not followed by `FD` stays as it is, because a widespread
/// client forgets to stuff what it sends.
pub fn unstuff(stuffed: &[u8]) -> Vec<u8> {
    let mut body = Vec::with_capacity(stuffed.len());
    let mut bytes = stuffed.iter().copied().peekable();
    while let Some(byte) = bytes.next() {
        body.push(byte);
        if body.ends_with(&[0xFF, 0xFF, 0xFD]) && bytes.peek() == Some(&0xFD) {
            bytes.next();
        }
    }
    body
}
