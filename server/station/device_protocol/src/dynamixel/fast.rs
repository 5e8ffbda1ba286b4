//! The joint answer to a fast synchronous or bulk read: one packet to which every device appends its block.
//!
//! `FF FF FD 00 FE length 55 {error id data crc} ...`: the checksum of each block covers all bytes from the header on, so
//! the last one is the checksum of the packet. A device that stays silent leaves the packet short, and those behind it
//! silent too.

use crate::crc16::crc16;

use super::code;
use super::packet::{BROADCAST_ID, HEADER, PREFIX_LEN, Packet, PacketError, prefix};
use super::status::ErrorByte;

/// One device's part of a joint answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FastBlock {
    /// The device.
    pub id: u8,
    /// Whether it obeyed, and whether it asks for attention.
    pub error: ErrorByte,
    /// The bytes asked for.
    pub data: Vec<u8>,
}

/// What could be read from a joint answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FastReply {
    /// The blocks whose checksum and id are right, in the order asked, up to the first that is not.
    pub blocks: Vec<FastBlock>,
    /// The first device whose block is missing or damaged, if any.
    pub first_missing: Option<u8>,
}

/// Reads a complete joint answer. `expected` has the devices asked, in that order, with the number of bytes of each.
pub fn parse_fast(packet: &Packet, expected: &[(u8, u16)]) -> Result<FastReply, PacketError> {
    if !packet.is_fast_status() {
        return Err(PacketError::Params {
            id: packet.id,
            code: packet.instruction,
            num_bytes: packet.params.len(),
            expected: "a joint status (0x55) of id 254",
        });
    }
    Ok(parse_fast_bytes(&packet.encode()?, expected))
}

/// Reads as many blocks as there are in `bytes`, which begin with a header and may end anywhere, as
/// [`super::Decoder::pending`] does after a time-out.
pub fn parse_fast_bytes(bytes: &[u8], expected: &[(u8, u16)]) -> FastReply {
    let mut blocks = Vec::new();
    let mut at = PREFIX_LEN + 1;
    let begins = bytes.starts_with(&HEADER) && bytes.get(4) == Some(&BROADCAST_ID);
    if begins && bytes.get(PREFIX_LEN) == Some(&code::STATUS) {
        for &(id, length) in expected {
            let end = at + 2 + usize::from(length);
            let Some([low, high]) = bytes.get(end..end + 2) else { break };
            if bytes[at + 1] != id || crc16(&bytes[..end]) != u16::from_le_bytes([*low, *high]) {
                break;
            }
            blocks.push(FastBlock { id, error: ErrorByte(bytes[at]), data: bytes[at + 2..end].to_vec() });
            at = end + 2;
        }
    }
    let first_missing = expected.get(blocks.len()).map(|&(id, _)| id);
    FastReply { blocks, first_missing }
}

/// The joint answer on the line. The length field promises all of `expected`; the bytes end behind the last of `blocks`,
/// as on a line where the next device stays silent.
pub fn encode_fast(blocks: &[FastBlock], expected: &[(u8, u16)]) -> Result<Vec<u8>, PacketError> {
    let promised: usize = expected.iter().map(|&(_, length)| usize::from(length) + 4).sum();
    let mut bytes = prefix(BROADCAST_ID, 1 + promised)?;
    bytes.push(code::STATUS);
    for (block, &(id, length)) in blocks.iter().zip(expected) {
        if block.id != id || block.data.len() != usize::from(length) {
            return Err(PacketError::DataLength {
                id: block.id,
                expected: usize::from(length),
                found: block.data.len(),
            });
        }
        bytes.extend([block.error.0, block.id]);
        bytes.extend_from_slice(&block.data);
        let crc = crc16(&bytes);
        bytes.extend_from_slice(&crc.to_le_bytes());
    }
    Ok(bytes)
}
