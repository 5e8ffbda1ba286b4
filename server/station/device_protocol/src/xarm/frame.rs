//! Frames of requests and responses: transaction, protocol and length (two bytes each, big-endian), register, content.

use crate::DecodeCounters;

/// The largest length field that a decoder believes. The longest frame known has less than a hundred.
pub const MAX_LENGTH: u16 = 1024;

const PREFIX_LEN: usize = 6;
/// What a client sends each second on request, with transaction 0, length 2 and two zero bytes.
const HEARTBEAT: [u8; 8] = [0, 0, 0, 1, 0, 2, 0, 0];

/// What the protocol field says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Protocol {
    /// A heartbeat, which nobody answers.
    Heartbeat,
    /// Requests and responses.
    Plain,
    /// Requests and responses of a client that shows itself alive.
    KeepAlive,
}

impl Protocol {
    /// The number in the frame.
    pub fn code(self) -> u16 {
        match self {
            Self::Heartbeat => 1,
            Self::Plain => 2,
            Self::KeepAlive => 3,
        }
    }
}

/// The box's state byte in every response.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StateFlags(pub u8);

impl StateFlags {
    /// The result means nothing.
    pub const INVALID: Self = Self(0x08);
    /// The arm would not move: stopped or not enabled.
    pub const NOT_READY: Self = Self(0x10);
    /// There is a warning.
    pub const WARNING: Self = Self(0x20);
    /// There is an error.
    pub const ERROR: Self = Self(0x40);

    /// Whether all flags of `other` are set.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// One frame in either direction.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    /// Number of the request, which its response repeats.
    pub transaction: u16,
    /// Kind of frame.
    pub protocol: Protocol,
    /// The register asked for or answered.
    pub register: u8,
    /// What follows the register. A response begins with its [`StateFlags`].
    pub content: Vec<u8>,
}

/// Why a frame cannot be sent or understood.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// More content than a frame may have.
    #[error("register {register:#04x}: {num_bytes} bytes, expected at most {MAX_LENGTH}")]
    TooLong {
        /// The register.
        register: u8,
        /// Bytes of register and content.
        num_bytes: usize,
    },
    /// A response without its state byte.
    #[error("register {register:#04x}: the response has no state byte")]
    NoState {
        /// The register.
        register: u8,
    },
    /// The content does not have the register's layout.
    #[error("register {register:#04x}: {source}")]
    Content {
        /// The register.
        register: u8,
        /// What is wrong.
        source: crate::LayoutError,
    },
}

impl Frame {
    /// The frame that keeps a connection alive without asking anything.
    pub fn heartbeat() -> Self {
        Self { transaction: 0, protocol: Protocol::Heartbeat, register: 0, content: vec![0] }
    }

    /// The bytes on the line.
    pub fn encode(&self) -> Result<Vec<u8>, FrameError> {
        let length = 1 + self.content.len();
        let field = u16::try_from(length)
            .ok()
            .filter(|&field| field <= MAX_LENGTH)
            .ok_or(FrameError::TooLong { register: self.register, num_bytes: length })?;
        let mut bytes = Vec::with_capacity(PREFIX_LEN + length);
        for word in [self.transaction, self.protocol.code(), field] {
            bytes.extend_from_slice(&word.to_be_bytes());
        }
        bytes.push(self.register);
        bytes.extend_from_slice(&self.content);
        Ok(bytes)
    }

    /// Flags and parameters of a response.
    pub fn response(&self) -> Result<(StateFlags, &[u8]), FrameError> {
        let (&state, params) =
            self.content.split_first().ok_or(FrameError::NoState { register: self.register })?;
        Ok((StateFlags(state), params))
    }
}

/// Incremental decoder for one connection and one direction.
#[derive(Debug, Clone, Default)]
pub struct FrameDecoder {
    buffer: Vec<u8>,
    /// Inside bytes that belong to no frame; counted once for each such stretch.
    lost: bool,
    counters: DecodeCounters,
}

impl FrameDecoder {
    /// Takes the next bytes of the stream and gives the frames that they complete.
    pub fn feed(&mut self, bytes: &[u8]) -> Vec<Frame> {
        self.buffer.extend_from_slice(bytes);
        let mut frames = Vec::new();
        let mut at = 0;
        while let Some(prefix) = self.buffer[at..].first_chunk::<PREFIX_LEN>() {
            let Some((protocol, length)) = plausible(prefix) else {
                self.skip();
                at += 1;
                continue;
            };
            let Some(body) = self.buffer[at + PREFIX_LEN..].get(..length) else { break };
            let register = body[0];
            let whole = &self.buffer[at..at + PREFIX_LEN + length];
            let believed = match protocol {
                Protocol::Heartbeat => whole == HEARTBEAT,
                _ => register != 0,
            };
            if !believed {
                self.skip();
                at += 1;
                continue;
            }
            frames.push(Frame {
                transaction: u16::from_be_bytes([prefix[0], prefix[1]]),
                protocol,
                register,
                content: body[1..].to_vec(),
            });
            self.counters.deliver(PREFIX_LEN + length);
            self.lost = false;
            at += PREFIX_LEN + length;
        }
        self.buffer.drain(..at);
        frames
    }

    /// What became of the bytes so far.
    pub fn counters(&self) -> DecodeCounters {
        self.counters
    }

    /// Bytes of a frame that may have begun.
    pub fn pending(&self) -> &[u8] {
        &self.buffer
    }

    fn skip(&mut self) {
        self.counters.drop_bytes(1);
        if !self.lost {
            self.counters.malformed += 1;
        }
        self.lost = true;
    }
}

fn plausible(prefix: &[u8; PREFIX_LEN]) -> Option<(Protocol, usize)> {
    let &[_, _, p0, p1, l0, l1] = prefix;
    let length = u16::from_be_bytes([l0, l1]);
    let protocol = match u16::from_be_bytes([p0, p1]) {
        1 if length == 2 => Protocol::Heartbeat,
        2 => Protocol::Plain,
        3 => Protocol::KeepAlive,
        _ => return None,
    };
    (1..=MAX_LENGTH).contains(&length).then_some((protocol, usize::from(length)))
}
