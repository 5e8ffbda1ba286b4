//! Binary frames for firmware of our own tactile boards. Integers are little-endian.
//!
//! | bytes | what |
//! |---|---|
//! | 2 | start mark `A5 5A` |
//! | 1 | version of the format, 1 |
//! | 1 | number of channels *n*, 1 to 255 |
//! | 4 | sequence: one more with each sample, wraps |
//! | 8 | device time of the sample, microseconds since the device started |
//! | 2 *n* | raw reading of each channel, unsigned |
//! | 2 | CRC-16 (polynomial 0x8005, initial value 0, not reflected) over all bytes before it |
//!
//! As for the servos, a start mark proves nothing: the decoder follows every mark it sees, and the first frame to be
//! complete with a right checksum wins. Damage therefore never hides the frames behind it.

use std::collections::VecDeque;

use crate::{DecodeCounters, crc16::crc16};

const MARK: [u8; 2] = [0xA5, 0x5A];
const VERSION: u8 = 1;
const PREFIX_LEN: usize = 4;

/// One sample of all channels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample {
    /// One more with each sample; a gap is the number of samples lost.
    pub sequence: u32,
    /// Device time in microseconds.
    pub device_time_us: u64,
    /// Raw readings in the order of the channels.
    pub raw: Vec<u16>,
}

/// A frame holds between 1 and 255 channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{num_channels} channels, expected 1 to 255 in a frame")]
pub struct ChannelCountError {
    /// Channels of the sample.
    pub num_channels: usize,
}

impl Sample {
    /// The bytes on the line.
    pub fn encode(&self) -> Result<Vec<u8>, ChannelCountError> {
        let num_channels = self.raw.len();
        let count = u8::try_from(num_channels).ok().filter(|&count| count > 0);
        let count = count.ok_or(ChannelCountError { num_channels })?;
        let mut bytes = vec![MARK[0], MARK[1], VERSION, count];
        bytes.extend_from_slice(&self.sequence.to_le_bytes());
        bytes.extend_from_slice(&self.device_time_us.to_le_bytes());
        bytes.extend(self.raw.iter().flat_map(|raw| raw.to_le_bytes()));
        let crc = crc16(&bytes);
        bytes.extend_from_slice(&crc.to_le_bytes());
        Ok(bytes)
    }
}

/// Incremental decoder for one line.
#[derive(Debug, Clone, Default)]
pub struct SampleDecoder {
    buffer: Vec<u8>,
    /// First byte and end of each frame that has begun.
    begun: VecDeque<(usize, usize)>,
    counters: DecodeCounters,
}

impl SampleDecoder {
    /// Takes the next bytes and gives the samples that they complete.
    pub fn feed(&mut self, bytes: &[u8]) -> Vec<Sample> {
        bytes.iter().filter_map(|&byte| self.feed_byte(byte)).collect()
    }

    /// What became of the bytes so far.
    pub fn counters(&self) -> DecodeCounters {
        self.counters
    }

    /// Bytes of a frame that may have begun.
    pub fn pending(&self) -> &[u8] {
        &self.buffer
    }

    fn feed_byte(&mut self, byte: u8) -> Option<Sample> {
        self.buffer.push(byte);
        let end = self.buffer.len();
        if let Some(start) = end.checked_sub(PREFIX_LEN)
            && self.buffer[start..start + 2] == MARK
        {
            match self.buffer[start + 2..] {
                [VERSION, count] if count > 0 => {
                    self.begun.push_back((start, end + 4 + 8 + 2 * usize::from(count) + 2));
                }
                _ => self.counters.malformed += 1,
            }
        }
        let mut idx = 0;
        while let Some(&(start, span_end)) = self.begun.get(idx) {
            if span_end != end {
                idx += 1;
                continue;
            }
            self.begun.remove(idx);
            if let Some(sample) = check(&self.buffer[start..]) {
                self.counters.drop_bytes(start);
                self.counters.deliver(end - start);
                self.buffer.clear();
                self.begun.clear();
                return Some(sample);
            }
            self.counters.crc_errors += 1;
        }
        self.trim();
        None
    }

    /// Drops what no frame can begin in.
    fn trim(&mut self) {
        let len = self.buffer.len();
        let keep_from = self.begun.front().map_or_else(
            || {
                let may_begin =
                    |&at: &usize| self.buffer[at..].iter().zip(MARK).all(|(&byte, mark)| byte == mark);
                (len.saturating_sub(PREFIX_LEN - 1)..len).find(may_begin).unwrap_or(len)
            },
            |&(start, _)| start,
        );
        if keep_from > 0 {
            self.buffer.drain(..keep_from);
            self.counters.drop_bytes(keep_from);
            for (start, end) in &mut self.begun {
                *start -= keep_from;
                *end -= keep_from;
            }
        }
    }
}

fn check(bytes: &[u8]) -> Option<Sample> {
    let (covered, crc) = bytes.split_last_chunk::<2>()?;
    if crc16(covered) != u16::from_le_bytes(*crc) {
        return None;
    }
    let (sequence, rest) = covered[PREFIX_LEN..].split_first_chunk::<4>()?;
    let (device_time_us, rest) = rest.split_first_chunk::<8>()?;
    let (raw, _) = rest.as_chunks::<2>();
    Some(Sample {
        sequence: u32::from_le_bytes(*sequence),
        device_time_us: u64::from_le_bytes(*device_time_us),
        raw: raw.iter().map(|raw| u16::from_le_bytes(*raw)).collect(),
    })
}
