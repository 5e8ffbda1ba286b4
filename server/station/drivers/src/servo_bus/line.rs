//! One serial line with servos: requests out, answers in, nothing believed whose checksum is wrong.

use std::io::{self, Read as _, Write as _};
use std::path::Path;
use std::time::Duration;

use palpate_device_protocol::dynamixel::{
    BROADCAST_ID, Decoder, FastBlock, Instruction, PacketError, Request, Status, StatusError,
    parse_fast_bytes,
};
use serialport::{ClearBuffer, SerialPort};

use crate::clock::HostClock;

/// Bits of a byte on the line: start, eight, stop.
const BITS_PER_BYTE: u64 = 10;
/// Silence after which no more bytes of a damaged answer are expected.
const SILENCE: Duration = Duration::from_millis(1);
/// Bytes around the data of one servo's status: header, id, length, instruction, error, checksum.
const STATUS_BYTES: usize = 11;
/// Bytes of a joint answer in front of the first servo's block, and around the data of each block.
const FAST_PREFIX_BYTES: usize = 8;
const FAST_BLOCK_BYTES: usize = 4;

/// Why a request to one servo failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RequestError {
    /// The port itself failed.
    #[error("the port failed: {0}")]
    Port(#[from] io::Error),
    /// The servo said nothing that could be understood.
    #[error("servo {id} does not answer")]
    Silent { id: u8 },
    /// The servo refused.
    #[error("servo {id}: {error}")]
    Refused { id: u8, error: StatusError },
    /// The request cannot be put on a line.
    #[error(transparent)]
    Request(#[from] PacketError),
}

/// What several servos answered to one request.
#[derive(Debug, Default)]
pub(crate) struct Reading {
    /// When the request was sent and when the last byte had come, host time.
    pub(crate) sent_ns: u64,
    pub(crate) received_ns: u64,
    /// Id, whether the servo asks for attention, and the bytes asked for; only servos whose answer was whole.
    pub(crate) answers: Vec<Answer>,
}

/// One servo's part of a [`Reading`].
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Answer {
    pub(crate) id: u8,
    pub(crate) alert: bool,
    pub(crate) data: Vec<u8>,
}

/// How long an answer may take. It follows what answers do take, so that a lost one costs little and a busy host loses
/// none.
#[derive(Debug)]
struct Patience {
    /// Longest time of late beyond that of the bytes on the line, slowly forgotten.
    peak: Duration,
    /// The time that answers take on average beyond that of the bytes on the line.
    mean: Duration,
    /// Whether the last answer did not come in time.
    gave_up: bool,
    /// An answer is not waited for longer than this, unless answers take longer as a rule.
    most: Option<Duration>,
}

impl Patience {
    const SHORTEST: Duration = Duration::from_millis(4);
    const LONGEST: Duration = Duration::from_millis(50);

    fn limit(&self) -> Duration {
        let limit = (2 * self.peak + Duration::from_millis(2)).clamp(Self::SHORTEST, Self::LONGEST);
        // A line that is always slow keeps the time that its answers take.
        let usual = 2 * self.mean + Duration::from_millis(2);
        self.most.map_or(limit, |most| limit.min(most.max(usual)))
    }

    fn answered(&mut self, took: Duration) {
        self.gave_up = false;
        self.peak = took.max(self.peak.mul_f64(0.995));
        self.mean = self.mean.mul_f64(0.98) + took.mul_f64(0.02);
    }

    fn too_short(&mut self) {
        self.peak = (2 * self.peak + Duration::from_millis(1)).min(Self::LONGEST / 2);
    }
}

/// What a line needs of its port.
pub(crate) trait Port: io::Read + io::Write + Send {
    /// How long a read waits for its first byte.
    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()>;
    /// Throws away what has come and was not read; whether there was anything.
    fn discard_input(&mut self) -> io::Result<bool>;
}

impl Port for Box<dyn SerialPort> {
    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        Ok(SerialPort::set_timeout(&mut **self, timeout)?)
    }

    fn discard_input(&mut self) -> io::Result<bool> {
        let is_late = self.bytes_to_read()? > 0;
        if is_late {
            self.clear(ClearBuffer::Input)?;
        }
        Ok(is_late)
    }
}

/// An open line.
pub(crate) struct Line {
    port: Box<dyn Port>,
    clock: HostClock,
    byte_ns: u64,
    patience: Patience,
    bad_frames: u64,
    /// Whether the request before the newest one was given up, so that its answer may come now: late, not damaged.
    is_owed: bool,
    /// When a servo last gave a whole answer.
    heard_ns: u64,
    buffer: Vec<u8>,
}

impl Line {
    /// Opens the port for this process alone.
    pub(crate) fn open(path: &Path, baud: u32, clock: &HostClock) -> Result<Self, serialport::Error> {
        let name = path.to_string_lossy();
        let port = serialport::new(name, baud).timeout(Duration::from_millis(100)).open()?;
        Ok(Self::over(Box::new(port), baud, clock))
    }

    /// The line behind an open port.
    pub(crate) fn over(port: Box<dyn Port>, baud: u32, clock: &HostClock) -> Self {
        Self {
            port,
            byte_ns: BITS_PER_BYTE * 1_000_000_000 / u64::from(baud.max(1)),
            patience: Patience {
                peak: Duration::from_millis(15),
                mean: Duration::from_millis(1),
                gave_up: false,
                most: None,
            },
            bad_frames: 0,
            is_owed: false,
            heard_ns: clock.now_ns(),
            buffer: Vec::with_capacity(1024),
            clock: clock.clone(),
        }
    }

    /// From now on no answer is waited for longer than this, so that one servo that has fallen silent does not hold up the
    /// others: unless answers take longer as a rule.
    pub(crate) fn limit_waits(&mut self, most: Duration) {
        self.patience.most = Some(most);
    }

    /// Frames with a wrong checksum or form since the last call.
    pub(crate) fn take_bad_frames(&mut self) -> u64 {
        std::mem::take(&mut self.bad_frames)
    }

    /// When a servo last gave a whole answer, host time.
    pub(crate) fn heard_ns(&self) -> u64 {
        self.heard_ns
    }

    /// What answers take on average beyond the time of their bytes on the line.
    pub(crate) fn mean_delay(&self) -> Duration {
        self.patience.mean
    }

    /// Asks one servo, once. Nobody is asked again and again here: other servos wait for the line meanwhile.
    pub(crate) fn ask(&mut self, id: u8, instruction: Instruction) -> Result<Status, RequestError> {
        let num_data = match &instruction {
            Instruction::Read { length, .. } => usize::from(*length),
            Instruction::Ping => 3,
            _ => 0,
        };
        let request = Request { id, instruction }.encode()?;
        let (_, statuses) = self.statuses(&request, &[id], num_data)?;
        let Some(status) = statuses.into_iter().next() else { return Err(RequestError::Silent { id }) };
        match status.error.error() {
            None => Ok(status),
            // The request was damaged on its way.
            Some(StatusError::Crc) => Err(RequestError::Silent { id }),
            Some(error) => Err(RequestError::Refused { id, error }),
        }
    }

    /// Reads registers of one servo.
    pub(crate) fn read(&mut self, id: u8, address: u16, length: u16) -> Result<Status, RequestError> {
        self.ask(id, Instruction::Read { address, length })
    }

    /// Writes registers of one servo, which confirms it.
    pub(crate) fn write(&mut self, id: u8, address: u16, data: &[u8]) -> Result<(), RequestError> {
        self.ask(id, Instruction::Write { address, data: data.to_vec() }).map(|_| ())
    }

    /// Writes registers of many servos, none of which confirms it.
    pub(crate) fn sync_write(&mut self, address: u16, data: Vec<(u8, Vec<u8>)>) -> Result<(), RequestError> {
        let Some(length) = data.first().and_then(|(_, bytes)| u16::try_from(bytes.len()).ok()) else {
            return Ok(());
        };
        let instruction = Instruction::SyncWrite { address, length, data };
        let request = Request { id: BROADCAST_ID, instruction }.encode()?;
        self.discard_late()?;
        self.port.write_all(&request)?;
        Ok(())
    }

    /// Reads the same registers of many servos; each answers with a packet of its own.
    pub(crate) fn sync_read(
        &mut self,
        address: u16,
        length: u16,
        ids: &[u8],
    ) -> Result<Reading, RequestError> {
        let instruction = Instruction::SyncRead { address, length, ids: ids.to_vec() };
        let request = Request { id: BROADCAST_ID, instruction }.encode()?;
        let (mut reading, statuses) = self.statuses(&request, ids, usize::from(length))?;
        let obeyed = statuses.into_iter().filter(|status| status.error.error().is_none());
        reading.answers = obeyed
            .map(|status| Answer { id: status.id, alert: status.error.alert(), data: status.data })
            .collect();
        Ok(reading)
    }

    /// Reads the same registers of many servos, which answer with one packet together.
    pub(crate) fn fast_sync_read(
        &mut self,
        address: u16,
        length: u16,
        ids: &[u8],
    ) -> Result<Reading, RequestError> {
        let instruction = Instruction::FastSyncRead { address, length, ids: ids.to_vec() };
        let request = Request { id: BROADCAST_ID, instruction }.encode()?;
        let expected: Vec<(u8, u16)> = ids.iter().map(|&id| (id, length)).collect();
        let num_bytes = FAST_PREFIX_BYTES + ids.len() * (usize::from(length) + FAST_BLOCK_BYTES);
        let mut blocks: Vec<FastBlock> = Vec::new();
        let mut reading = self.exchange(&request, num_bytes, |bytes| {
            if bytes.len() >= num_bytes {
                blocks = longest_fast_answer(bytes, &expected);
            }
            blocks.len() == expected.len()
        })?;
        if blocks.len() < expected.len() {
            // The packet ended early or is damaged further on; what is in front of that is whole.
            blocks = longest_fast_answer(&self.buffer, &expected);
            self.count_bad(u64::from(self.buffer.len() >= num_bytes));
        }
        if !blocks.is_empty() {
            self.heard_ns = reading.received_ns;
        }
        reading.answers = blocks
            .into_iter()
            .filter(|block| block.error.error().is_none())
            .map(|block| Answer { id: block.id, alert: block.error.alert(), data: block.data })
            .collect();
        Ok(reading)
    }

    /// Sends a request and gives the whole statuses of the servos asked, each with `num_data` bytes unless it refuses.
    fn statuses(
        &mut self,
        request: &[u8],
        ids: &[u8],
        num_data: usize,
    ) -> Result<(Reading, Vec<Status>), RequestError> {
        let mut decoder = Decoder::default();
        let mut statuses: Vec<Status> = Vec::with_capacity(ids.len());
        let mut num_fed = 0;
        let mut num_strange = 0;
        let num_bytes = ids.len() * (STATUS_BYTES + num_data);
        let reading = self.exchange(request, num_bytes, |bytes| {
            for packet in decoder.feed(&bytes[num_fed..]) {
                match Status::from_packet(&packet) {
                    Ok(status)
                        if ids.contains(&status.id)
                            && statuses.iter().all(|earlier| earlier.id != status.id)
                            && (status.data.len() == num_data || status.error.error().is_some()) =>
                    {
                        statuses.push(status);
                    }
                    // Nobody was asked for this: a damaged id, or an answer to an earlier request.
                    _ => num_strange += 1,
                }
            }
            num_fed = bytes.len();
            statuses.len() == ids.len()
        })?;
        let counters = decoder.counters();
        // An answer that was cut off by the time limit is late, not damaged.
        let leftover = counters.dropped_bytes > 0 || (num_fed >= num_bytes && !decoder.pending().is_empty());
        self.count_bad((counters.crc_errors + counters.malformed).max(u64::from(leftover)) + num_strange);
        if !statuses.is_empty() {
            self.heard_ns = reading.received_ns;
        }
        Ok((reading, statuses))
    }

    /// Sends a request and gathers bytes until `is_done` with them, or nothing more is to be expected.
    fn exchange(
        &mut self,
        request: &[u8],
        num_bytes: usize,
        mut is_done: impl FnMut(&[u8]) -> bool,
    ) -> io::Result<Reading> {
        self.is_owed = self.patience.gave_up;
        self.discard_late()?;
        self.buffer.clear();
        let sent_ns = self.clock.now_ns();
        self.port.write_all(request)?;
        let on_line = Duration::from_nanos(self.byte_ns * (request.len() + num_bytes) as u64);
        let limit_ns = u64::try_from((on_line + self.patience.limit()).as_nanos()).unwrap_or(u64::MAX);
        let deadline_ns = sent_ns.saturating_add(limit_ns);
        let mut chunk = [0; 1024];
        loop {
            let left = Duration::from_nanos(deadline_ns.saturating_sub(self.clock.now_ns()));
            if left.is_zero() {
                self.patience.gave_up = true;
                break;
            }
            let all_there = self.buffer.len() >= num_bytes;
            self.port.set_timeout(if all_there { left.min(SILENCE) } else { left })?;
            match self.port.read(&mut chunk) {
                Ok(0) => return Err(io::Error::from(io::ErrorKind::BrokenPipe)),
                Ok(count) => {
                    self.buffer.extend_from_slice(&chunk[..count]);
                    if is_done(&self.buffer) {
                        let took = Duration::from_nanos(self.clock.now_ns().saturating_sub(sent_ns));
                        self.patience.answered(took.saturating_sub(on_line));
                        break;
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::TimedOut => {
                    self.patience.gave_up = !all_there;
                    break;
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(Reading { sent_ns, received_ns: self.clock.now_ns(), answers: Vec::new() })
    }

    fn count_bad(&mut self, count: u64) {
        if !self.is_owed {
            self.bad_frames += count;
        }
    }

    /// What comes after it was given up is no answer to the next request.
    fn discard_late(&mut self) -> io::Result<()> {
        if self.port.discard_input()? && std::mem::take(&mut self.patience.gave_up) {
            self.patience.too_short();
        }
        Ok(())
    }
}

/// The most blocks that a joint answer somewhere in `bytes` has; noise may come before it.
fn longest_fast_answer(bytes: &[u8], expected: &[(u8, u16)]) -> Vec<FastBlock> {
    let starts =
        (0..bytes.len()).filter(|&at| bytes[at..].starts_with(&[0xFF, 0xFF, 0xFD, 0x00, BROADCAST_ID]));
    let answers = starts.map(|at| parse_fast_bytes(&bytes[at..], expected).blocks);
    answers.max_by_key(Vec::len).unwrap_or_default()
}

/// The latency timer of a USB serial adapter of FTDI, ms, if the port has one.
pub(crate) fn latency_timer_ms(path: &Path) -> Option<(String, u32)> {
    let device = std::fs::canonicalize(path).ok()?;
    let name = device.file_name()?.to_str()?.to_owned();
    let file = format!("/sys/bus/usb-serial/devices/{name}/latency_timer");
    let timer_ms = std::fs::read_to_string(&file).ok()?.trim().parse().ok()?;
    Some((file, timer_ms))
}
