//! The tactile boards: one thread for each, which reads its serial line.
//!
//! Boards only speak. What their bytes mean is [`decode`]'s; here are the port and the clock, and what a board that
//! sends nothing or nonsense is called.

mod decode;

use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serialport::{ClearBuffer, SerialPort};

use crate::clock_map::ClockMap;
use crate::context::DeviceContext;
use crate::event::{DeviceEvent, Link};
use decode::{BoardDecoder, Sample};

/// A read ends after this long without a byte, so that the thread can be told to end.
const READ: Duration = Duration::from_millis(50);
/// A board without a byte for this long is lost, one without a sample has a fault, ns.
const SILENT_NS: u64 = 1_000_000_000;
const CHUNK: usize = 4096;

/// What the driver has to know about a board.
#[derive(Clone, Debug)]
pub(crate) struct BoardSetup {
    /// Its port.
    pub(crate) port: PathBuf,
    /// Bits per second; boards that are USB devices themselves do not care.
    pub(crate) baud: u32,
    /// Which stream of the layout.
    pub(crate) stream: usize,
    /// First of its channels within the stream.
    pub(crate) first_channel: usize,
    /// How many channels it has.
    pub(crate) num_channels: usize,
    /// Lines for a sample: 1, or the rows of a matrix. Binary frames are recognised by themselves.
    pub(crate) lines_per_sample: usize,
}

/// Reads the board until the context says stop.
pub(crate) fn run(context: &DeviceContext, setup: &BoardSetup) {
    context.keep_connected(|_| open(setup), |context, port| Reading::new(context, setup).run(port));
}

fn open(setup: &BoardSetup) -> Result<Box<dyn SerialPort>, String> {
    let path = setup.port.to_string_lossy();
    let port = serialport::new(path.as_ref(), setup.baud).timeout(READ).open();
    let port = port.map_err(|error| explain_open(&setup.port, &error))?;
    // What waited since before is of no known time. A port that cannot forget it is read all the same.
    let _older = port.clear(ClearBuffer::Input);
    Ok(port)
}

/// Why a port cannot be opened, and what to do.
fn explain_open(path: &Path, error: &serialport::Error) -> String {
    let mend = if !path.exists() {
        "it is not there: check plug and power of the board, and the port in the station's file"
    } else if matches!(error.kind, serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied)) {
        "this user may not: add it to the group that owns the port, often `dialout`, and log in again"
    } else {
        "maybe another program has it open: end that"
    };
    format!("cannot open {} ({error}); {mend}", path.display())
}

/// One opening's worth of reading.
struct Reading<'a> {
    context: &'a DeviceContext,
    setup: &'a BoardSetup,
    decoder: BoardDecoder,
    clock_map: ClockMap,
    last_host_ns: u64,
    num_bad: u64,
    num_gaps: u64,
}

impl<'a> Reading<'a> {
    fn new(context: &'a DeviceContext, setup: &'a BoardSetup) -> Self {
        let decoder = BoardDecoder::new(setup.num_channels, setup.lines_per_sample);
        Self {
            context,
            setup,
            decoder,
            clock_map: ClockMap::default(),
            last_host_ns: 0,
            num_bad: 0,
            num_gaps: 0,
        }
    }

    fn run(&mut self, mut port: Box<dyn SerialPort>) -> Result<(), String> {
        let clock = &self.context.clock;
        let mut bytes = vec![0; CHUNK];
        let mut heard_ns = clock.now_ns();
        let mut understood_ns = heard_ns;
        while !self.context.stop.is_set() {
            #[cfg(test)]
            self.context.panic_if_asked();
            let count = match port.read(&mut bytes) {
                Ok(0) => return Err(format!("{} hung up; check its plug", self.setup.port.display())),
                Ok(count) => count,
                Err(error) if is_passing(&error) => 0,
                Err(error) => {
                    return Err(format!("{} broke off ({error}); check its plug", self.setup.port.display()));
                }
            };
            let now_ns = clock.now_ns();
            if count > 0 {
                heard_ns = now_ns;
                let samples = self.decoder.feed(now_ns, &bytes[..count]);
                if !samples.is_empty() {
                    understood_ns = now_ns;
                    self.context.link(Link::Ready, "");
                }
                samples.into_iter().for_each(|sample| self.tell(sample));
                self.count();
            }
            if now_ns.saturating_sub(heard_ns) > SILENT_NS {
                return Err(format!(
                    "{} is open, but the board has sent nothing for {:.0} s; check its power, or press its reset",
                    self.setup.port.display(),
                    now_ns.saturating_sub(heard_ns) as f64 * 1e-9
                ));
            }
            if now_ns.saturating_sub(understood_ns) > SILENT_NS {
                self.context.link(Link::Fault, self.decoder.problem());
            }
        }
        Ok(())
    }

    fn tell(&mut self, sample: Sample) {
        let received_ns = sample.received_ns;
        let device_ns = sample.device_us.map(|device_us| device_us.saturating_mul(1000));
        let host_ns =
            device_ns.map_or(received_ns, |device_ns| self.clock_map.observe(device_ns, received_ns));
        // A board without a clock may be heard twice at once; what is not later than the newest is left out of takes.
        let host_ns = host_ns.max(self.last_host_ns + 1);
        self.last_host_ns = host_ns;
        self.context.health.sample(received_ns);
        if device_ns.is_some() {
            self.context.health.set_skew_ppm(self.clock_map.skew_ppm());
        }
        self.context.send(DeviceEvent::Tactile {
            device: self.context.index,
            received_ns,
            host_ns,
            device_ns,
            sequence: sample.sequence,
            stream: self.setup.stream,
            first_channel: self.setup.first_channel,
            raw: sample.raw,
        });
    }

    /// Adds what is new to the counts.
    fn count(&mut self) {
        let (bad, gaps) = (self.decoder.num_bad(), self.decoder.num_gaps());
        if bad > self.num_bad {
            self.context.health.add_bad_frames(bad - self.num_bad);
        }
        if gaps > self.num_gaps {
            self.context.health.add_gaps(gaps - self.num_gaps);
        }
        (self.num_bad, self.num_gaps) = (bad, gaps);
    }
}

fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
}

#[cfg(test)]
mod tests;
