//! What a host asks of the servos.

use super::code;
use super::packet::{Packet, PacketError};

/// The parameters of the one "clear" that X330 servos know: forget the turns counted, keep the angle within one turn.
const CLEAR_TURNS: [u8; 5] = [0x01, 0x44, 0x58, 0x4C, 0x22];

/// An instruction to one device or to all.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Request {
    /// The device addressed, or [`super::BROADCAST_ID`]; synchronous and bulk instructions are always broadcast.
    pub id: u8,
    /// What it shall do.
    pub instruction: Instruction,
}

/// The instructions of Protocol 2.0.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Instruction {
    /// Answer with model and firmware.
    Ping,
    /// Read `length` bytes from `address` on.
    Read {
        /// First register byte.
        address: u16,
        /// Number of bytes.
        length: u16,
    },
    /// Write `data` from `address` on.
    Write {
        /// First register byte.
        address: u16,
        /// The bytes to write.
        data: Vec<u8>,
    },
    /// As a write, carried out on the next [`Instruction::Action`].
    RegWrite {
        /// First register byte.
        address: u16,
        /// The bytes to write.
        data: Vec<u8>,
    },
    /// Carry out the write that was registered.
    Action,
    /// Back to the values of delivery.
    FactoryReset(FactoryReset),
    /// Restart; torque is off afterwards.
    Reboot,
    /// Forget the turns counted.
    ClearTurns,
    /// Read the same bytes of several devices; each answers with its own status, in this order.
    SyncRead {
        /// First register byte.
        address: u16,
        /// Number of bytes.
        length: u16,
        /// The devices.
        ids: Vec<u8>,
    },
    /// Write the same registers of several devices; nobody answers.
    SyncWrite {
        /// First register byte.
        address: u16,
        /// Bytes for each device.
        length: u16,
        /// Devices and `length` bytes for each.
        data: Vec<(u8, Vec<u8>)>,
    },
    /// As a synchronous read, answered by one joint packet.
    FastSyncRead {
        /// First register byte.
        address: u16,
        /// Number of bytes.
        length: u16,
        /// The devices.
        ids: Vec<u8>,
    },
    /// Read other bytes of every device.
    BulkRead(Vec<BulkRead>),
    /// Write other registers of every device; nobody answers.
    BulkWrite(Vec<BulkWrite>),
    /// As a bulk read, answered by one joint packet.
    FastBulkRead(Vec<BulkRead>),
}

/// What a factory reset spares.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FactoryReset {
    /// Nothing.
    All,
    /// The id.
    KeepId,
    /// The id and the baud rate.
    KeepIdAndBaud,
}

/// One device's part of a bulk read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BulkRead {
    /// The device.
    pub id: u8,
    /// First register byte.
    pub address: u16,
    /// Number of bytes.
    pub length: u16,
}

/// One device's part of a bulk write.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BulkWrite {
    /// The device.
    pub id: u8,
    /// First register byte.
    pub address: u16,
    /// The bytes to write.
    pub data: Vec<u8>,
}

impl Request {
    /// The bytes on the line.
    pub fn encode(&self) -> Result<Vec<u8>, PacketError> {
        self.to_packet()?.encode()
    }

    /// The packet that carries this request.
    pub fn to_packet(&self) -> Result<Packet, PacketError> {
        let (instruction, params) = self.instruction.to_params()?;
        Ok(Packet { id: self.id, instruction, params })
    }

    /// Understands a packet as a request. A servo that gets an error here answers with an instruction or length error.
    pub fn from_packet(packet: &Packet) -> Result<Self, PacketError> {
        Ok(Self { id: packet.id, instruction: Instruction::from_packet(packet)? })
    }
}

impl Instruction {
    fn to_params(&self) -> Result<(u8, Vec<u8>), PacketError> {
        let ids_params = |address: &u16, length: &u16, ids: &[u8]| {
            let mut params = words(&[*address, *length]);
            params.extend_from_slice(ids);
            params
        };
        let write_params = |address: &u16, data: &[u8]| {
            let mut params = words(&[*address]);
            params.extend_from_slice(data);
            params
        };
        Ok(match self {
            Self::Ping => (code::PING, Vec::new()),
            Self::Read { address, length } => (code::READ, words(&[*address, *length])),
            Self::Write { address, data } => (code::WRITE, write_params(address, data)),
            Self::RegWrite { address, data } => (code::REG_WRITE, write_params(address, data)),
            Self::Action => (code::ACTION, Vec::new()),
            Self::FactoryReset(spare) => (
                code::FACTORY_RESET,
                vec![match spare {
                    FactoryReset::All => 0xFF,
                    FactoryReset::KeepId => 0x01,
                    FactoryReset::KeepIdAndBaud => 0x02,
                }],
            ),
            Self::Reboot => (code::REBOOT, Vec::new()),
            Self::ClearTurns => (code::CLEAR, CLEAR_TURNS.to_vec()),
            Self::SyncRead { address, length, ids } => (code::SYNC_READ, ids_params(address, length, ids)),
            Self::FastSyncRead { address, length, ids } => {
                (code::FAST_SYNC_READ, ids_params(address, length, ids))
            }
            Self::SyncWrite { address, length, data } => {
                let mut params = words(&[*address, *length]);
                for (id, bytes) in data {
                    if bytes.len() != usize::from(*length) {
                        return Err(PacketError::DataLength {
                            id: *id,
                            expected: usize::from(*length),
                            found: bytes.len(),
                        });
                    }
                    params.push(*id);
                    params.extend_from_slice(bytes);
                }
                (code::SYNC_WRITE, params)
            }
            Self::BulkRead(reads) => (code::BULK_READ, bulk_read_params(reads)),
            Self::FastBulkRead(reads) => (code::FAST_BULK_READ, bulk_read_params(reads)),
            Self::BulkWrite(writes) => {
                let mut params = Vec::new();
                for write in writes {
                    let length = u16::try_from(write.data.len())
                        .map_err(|_| PacketError::TooLong { num_bytes: write.data.len() })?;
                    params.push(write.id);
                    params.extend(words(&[write.address, length]));
                    params.extend_from_slice(&write.data);
                }
                (code::BULK_WRITE, params)
            }
        })
    }

    fn from_packet(packet: &Packet) -> Result<Self, PacketError> {
        let params = packet.params.as_slice();
        let wrong = |expected| PacketError::Params {
            id: packet.id,
            code: packet.instruction,
            num_bytes: params.len(),
            expected,
        };
        let none = |instruction| if params.is_empty() { Ok(instruction) } else { Err(wrong("none")) };
        let write = || {
            let (address, data) = word(params).filter(|(_, data)| !data.is_empty()).ok_or(())?;
            Ok((address, data.to_vec()))
        };
        let write = || write().map_err(|()| wrong("an address (2) and at least one byte of data"));
        let span = || word(params).and_then(|(address, rest)| Some((address, word(rest)?)));
        Ok(match packet.instruction {
            code::PING => none(Self::Ping)?,
            code::ACTION => none(Self::Action)?,
            code::REBOOT => none(Self::Reboot)?,
            code::READ => match span() {
                Some((address, (length, []))) => Self::Read { address, length },
                _ => return Err(wrong("an address (2) and a length (2)")),
            },
            code::WRITE => write().map(|(address, data)| Self::Write { address, data })?,
            code::REG_WRITE => write().map(|(address, data)| Self::RegWrite { address, data })?,
            code::FACTORY_RESET => Self::FactoryReset(match params {
                [0xFF] => FactoryReset::All,
                [0x01] => FactoryReset::KeepId,
                [0x02] => FactoryReset::KeepIdAndBaud,
                _ => return Err(wrong("one byte: ff, 01 or 02")),
            }),
            code::CLEAR if params == CLEAR_TURNS => Self::ClearTurns,
            code::CLEAR => return Err(wrong("01 44 58 4c 22")),
            code::SYNC_READ | code::FAST_SYNC_READ => {
                let (address, (length, ids)) =
                    span().ok_or_else(|| wrong("an address (2), a length (2) and ids"))?;
                let ids = ids.to_vec();
                if packet.instruction == code::SYNC_READ {
                    Self::SyncRead { address, length, ids }
                } else {
                    Self::FastSyncRead { address, length, ids }
                }
            }
            code::SYNC_WRITE => {
                let expected = "an address (2), a length (2), then an id and `length` bytes for each device";
                let (address, (length, rest)) = span().ok_or_else(|| wrong(expected))?;
                let chunks = rest.chunks_exact(1 + usize::from(length));
                if !chunks.remainder().is_empty() {
                    return Err(wrong(expected));
                }
                let data = chunks.map(|chunk| (chunk[0], chunk[1..].to_vec())).collect();
                Self::SyncWrite { address, length, data }
            }
            code::BULK_READ | code::FAST_BULK_READ => {
                let (chunks, []) = params.as_chunks::<5>() else {
                    return Err(wrong("an id, an address (2) and a length (2) for each device"));
                };
                let reads = chunks.iter().map(|&[id, a0, a1, l0, l1]| BulkRead {
                    id,
                    address: u16::from_le_bytes([a0, a1]),
                    length: u16::from_le_bytes([l0, l1]),
                });
                if packet.instruction == code::BULK_READ {
                    Self::BulkRead(reads.collect())
                } else {
                    Self::FastBulkRead(reads.collect())
                }
            }
            code::BULK_WRITE => Self::BulkWrite(
                bulk_writes(params)
                    .ok_or_else(|| wrong("an id, an address (2), a length (2) and data for each device"))?,
            ),
            code => return Err(PacketError::UnknownInstruction { id: packet.id, code }),
        })
    }
}

fn words(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn word(bytes: &[u8]) -> Option<(u16, &[u8])> {
    let (word, rest) = bytes.split_first_chunk::<2>()?;
    Some((u16::from_le_bytes(*word), rest))
}

fn bulk_read_params(reads: &[BulkRead]) -> Vec<u8> {
    let one = |read: &BulkRead| [vec![read.id], words(&[read.address, read.length])].concat();
    reads.iter().flat_map(one).collect()
}

fn bulk_writes(mut params: &[u8]) -> Option<Vec<BulkWrite>> {
    let mut writes = Vec::new();
    while let Some((&id, rest)) = params.split_first() {
        let (address, rest) = word(rest)?;
        let (length, rest) = word(rest)?;
        let (data, rest) = rest.split_at_checked(usize::from(length))?;
        writes.push(BulkWrite { id, address, data: data.to_vec() });
        params = rest;
    }
    Some(writes)
}
