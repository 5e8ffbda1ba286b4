//! Packets out of a byte stream that may be damaged.
//!
//! A header alone proves nothing: joint answers are not stuffed, and a widespread client does not stuff either, so
//! `FF FF FD 00` occurs inside good packets. The decoder therefore follows every header it sees until that packet would
//! be complete, and the first one with a right checksum wins. A damaged length field thus never hides the packets behind
//! it, and what is delivered depends only on the bytes, not on how they were split.

use std::collections::VecDeque;

use crate::{DecodeCounters, crc16::crc16};

use super::code;
use super::packet::{BROADCAST_ID, HEADER, MAX_ID, PREFIX_LEN, Packet, is_fast_status, unstuff};

/// The largest length field that a decoder believes unless told otherwise. A joint answer of 16 servos to a read of 10
/// bytes has 225; one of 60 servos to a read of the whole table would need more.
pub const DEFAULT_MAX_LENGTH: u16 = 1024;

/// Instruction code and checksum: the least that the length field counts.
const MIN_LENGTH: u16 = 3;

/// Incremental decoder for one line and one direction.
#[derive(Debug, Clone)]
pub struct Decoder {
    buffer: Vec<u8>,
    /// Packets that have begun, by their first byte in `buffer`.
    begun: VecDeque<Span>,
    max_length: u16,
    counters: DecodeCounters,
}

#[derive(Debug, Clone, Copy)]
struct Span {
    start: usize,
    end: usize,
}

enum Rejected {
    Crc,
    Malformed,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::with_max_length(DEFAULT_MAX_LENGTH)
    }
}

impl Decoder {
    /// A decoder with another bound for the length field. The bound limits memory and work on damaged streams; a packet
    /// above it counts as malformed.
    pub fn with_max_length(max_length: u16) -> Self {
        Self {
            buffer: Vec::new(),
            begun: VecDeque::new(),
            max_length: max_length.max(MIN_LENGTH),
            counters: DecodeCounters::default(),
        }
    }

    /// Takes the next bytes of the stream and gives the packets that they complete.
    pub fn feed(&mut self, bytes: &[u8]) -> Vec<Packet> {
        bytes.iter().filter_map(|&byte| self.feed_byte(byte)).collect()
    }

    /// What became of the bytes so far.
    pub fn counters(&self) -> DecodeCounters {
        self.counters
    }

    /// The bytes of a packet that may have begun. After a time-out [`super::parse_fast_bytes`] finds in them the blocks
    /// of those devices that did answer.
    pub fn pending(&self) -> &[u8] {
        &self.buffer
    }

    /// Gives up what is pending and counts it as dropped, for instance before the next request.
    pub fn flush(&mut self) {
        self.counters.drop_bytes(self.buffer.len());
        self.buffer.clear();
        self.begun.clear();
    }

    fn feed_byte(&mut self, byte: u8) -> Option<Packet> {
        self.buffer.push(byte);
        self.begin();
        let end = self.buffer.len();
        let mut idx = 0;
        while let Some(&span) = self.begun.get(idx) {
            if span.end != end {
                idx += 1;
                continue;
            }
            self.begun.remove(idx);
            match check(&self.buffer[span.start..]) {
                Ok(packet) => {
                    self.counters.drop_bytes(span.start);
                    self.counters.deliver(end - span.start);
                    self.buffer.clear();
                    self.begun.clear();
                    return Some(packet);
                }
                Err(Rejected::Crc) => self.counters.crc_errors += 1,
                Err(Rejected::Malformed) => self.counters.malformed += 1,
            }
        }
        self.trim();
        None
    }

    /// Notes a packet whose length field has just become complete.
    fn begin(&mut self) {
        let Some(start) = self.buffer.len().checked_sub(PREFIX_LEN) else { return };
        let [h0, h1, h2, h3, id, low, high] = self.buffer[start..] else { return };
        if [h0, h1, h2, h3] != HEADER {
            return;
        }
        let length = u16::from_le_bytes([low, high]);
        if (id > MAX_ID && id != BROADCAST_ID) || length < MIN_LENGTH || length > self.max_length {
            self.counters.malformed += 1;
        } else {
            self.begun.push_back(Span { start, end: start + PREFIX_LEN + usize::from(length) });
        }
    }

    /// Drops what no packet can begin in.
    fn trim(&mut self) {
        let keep_from = match self.begun.front() {
            Some(span) => span.start,
            None => {
                let len = self.buffer.len();
                (len.saturating_sub(PREFIX_LEN - 1)..len)
                    .find(|&at| may_begin(&self.buffer[at..]))
                    .unwrap_or(len)
            }
        };
        if keep_from > 0 {
            self.buffer.drain(..keep_from);
            self.counters.drop_bytes(keep_from);
            for span in &mut self.begun {
                span.start -= keep_from;
                span.end -= keep_from;
            }
        }
    }
}

fn may_begin(bytes: &[u8]) -> bool {
    bytes.iter().zip(HEADER).all(|(&byte, expected)| byte == expected)
}

fn check(bytes: &[u8]) -> Result<Packet, Rejected> {
    let (covered, crc) = bytes.split_last_chunk::<2>().ok_or(Rejected::Malformed)?;
    if crc16(covered) != u16::from_le_bytes(*crc) {
        return Err(Rejected::Crc);
    }
    let id = covered[4];
    let body = &covered[PREFIX_LEN..];
    let body = if is_fast_status(id, body[0]) { body.to_vec() } else { unstuff(body) };
    let (&instruction, params) = body.split_first().ok_or(Rejected::Malformed)?;
    if instruction == code::STATUS && params.is_empty() {
        return Err(Rejected::Malformed);
    }
    Ok(Packet { id, instruction, params: params.to_vec() })
}
