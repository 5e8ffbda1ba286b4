//! What a servo answers.

use super::code;
use super::packet::{Packet, PacketError};

/// The answer of one device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Status {
    /// The device that answers.
    pub id: u8,
    /// Whether it obeyed, and whether it asks for attention.
    pub error: ErrorByte,
    /// What it was asked for. Still valid when only the alert is set.
    pub data: Vec<u8>,
}

/// The error byte of a status: an alert in bit 7 and an error code in the others.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ErrorByte(pub u8);

/// Why a servo did not do what it was asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum StatusError {
    /// The instruction could not be carried out.
    #[error("the servo failed to carry out the instruction")]
    ResultFail,
    /// The instruction is not known, or an action without a registered write.
    #[error("the servo does not know the instruction")]
    Instruction,
    /// The request arrived damaged.
    #[error("the request arrived damaged (CRC)")]
    Crc,
    /// A value is outside what the register accepts.
    #[error("a value is out of the register's range")]
    DataRange,
    /// The data are shorter than the register.
    #[error("the data are shorter than the register")]
    DataLength,
    /// A value is outside the limits set in the servo.
    #[error("a value is beyond the limits set in the servo")]
    DataLimit,
    /// The register is read-only, undefined, or locked while torque is on.
    #[error("the register is read-only, undefined, or locked while torque is on")]
    Access,
    /// A code that the protocol does not define.
    #[error("error code {0} is not known")]
    Unknown(u8),
}

impl ErrorByte {
    /// No error, no alert.
    pub const OK: Self = Self(0);

    /// An error byte from its parts.
    pub fn new(error: Option<StatusError>, alert: bool) -> Self {
        let code = match error {
            None => 0,
            Some(StatusError::ResultFail) => 1,
            Some(StatusError::Instruction) => 2,
            Some(StatusError::Crc) => 3,
            Some(StatusError::DataRange) => 4,
            Some(StatusError::DataLength) => 5,
            Some(StatusError::DataLimit) => 6,
            Some(StatusError::Access) => 7,
            Some(StatusError::Unknown(code)) => code & 0x7F,
        };
        Self(code | if alert { 0x80 } else { 0 })
    }

    /// Whether the hardware error status asks to be read. It stays set until the servo is rebooted.
    pub fn alert(self) -> bool {
        self.0 & 0x80 != 0
    }

    /// The error of this request, if it failed.
    pub fn error(self) -> Option<StatusError> {
        match self.0 & 0x7F {
            0 => None,
            1 => Some(StatusError::ResultFail),
            2 => Some(StatusError::Instruction),
            3 => Some(StatusError::Crc),
            4 => Some(StatusError::DataRange),
            5 => Some(StatusError::DataLength),
            6 => Some(StatusError::DataLimit),
            7 => Some(StatusError::Access),
            code => Some(StatusError::Unknown(code)),
        }
    }
}

/// The hardware error status (register 70), one bit for each fault; bit 1 is not used.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct HardwareError(pub u8);

impl HardwareError {
    /// The supply voltage is out of its limits.
    pub const INPUT_VOLTAGE: Self = Self(1 << 0);
    /// The temperature is above its limit.
    pub const OVERHEATING: Self = Self(1 << 2);
    /// The encoder fails.
    pub const MOTOR_ENCODER: Self = Self(1 << 3);
    /// The power electronics fail or the supply is too weak.
    pub const ELECTRICAL_SHOCK: Self = Self(1 << 4);
    /// More load than the servo can bear for long.
    pub const OVERLOAD: Self = Self(1 << 5);

    /// Whether all faults of `other` are among these.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// The faults in words, in the order of their bits.
    pub fn names(self) -> Vec<&'static str> {
        [
            (Self::INPUT_VOLTAGE, "input voltage"),
            (Self::OVERHEATING, "overheating"),
            (Self::MOTOR_ENCODER, "motor encoder"),
            (Self::ELECTRICAL_SHOCK, "electrical shock"),
            (Self::OVERLOAD, "overload"),
        ]
        .into_iter()
        .filter_map(|(fault, name)| self.contains(fault).then_some(name))
        .collect()
    }
}

/// What a servo says about itself when pinged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PingReply {
    /// Model number; see [`super::control_table::Model`].
    pub model: u16,
    /// Firmware version.
    pub firmware: u8,
}

impl PingReply {
    /// The data of the status that answers a ping.
    pub fn to_data(self) -> Vec<u8> {
        let [low, high] = self.model.to_le_bytes();
        vec![low, high, self.firmware]
    }
}

impl Status {
    /// The bytes on the line.
    pub fn encode(&self) -> Result<Vec<u8>, PacketError> {
        self.to_packet().encode()
    }

    /// The packet that carries this answer.
    pub fn to_packet(&self) -> Packet {
        let mut params = vec![self.error.0];
        params.extend_from_slice(&self.data);
        Packet { id: self.id, instruction: code::STATUS, params }
    }

    /// Understands a packet as one device's answer. Joint answers are read by [`super::parse_fast`].
    pub fn from_packet(packet: &Packet) -> Result<Self, PacketError> {
        match packet.params.split_first() {
            Some((&error, data)) if packet.instruction == code::STATUS && !packet.is_fast_status() => {
                Ok(Self { id: packet.id, error: ErrorByte(error), data: data.to_vec() })
            }
            _ => Err(PacketError::Params {
                id: packet.id,
                code: packet.instruction,
                num_bytes: packet.params.len(),
                expected: "a status (0x55) of one device, with its error byte",
            }),
        }
    }

    /// The answer to a ping.
    pub fn ping_reply(&self) -> Result<PingReply, PacketError> {
        match self.data[..] {
            [low, high, firmware] => Ok(PingReply { model: u16::from_le_bytes([low, high]), firmware }),
            _ => Err(PacketError::Params {
                id: self.id,
                code: code::STATUS,
                num_bytes: self.data.len() + 1,
                expected: "an error byte, a model number (2) and a firmware version",
            }),
        }
    }
}
