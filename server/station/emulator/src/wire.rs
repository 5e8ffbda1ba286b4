//! The way from a device to the host, with what goes wrong on it.

use std::collections::VecDeque;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::faults::{Fault, Faults};

/// Most bytes of garbage in one go.
const MOST_GARBAGE: u32 = 12;

/// What has passed a serial line since the station started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LineTraffic {
    /// Answers or lines that the device sent, those that were lost on the way included.
    pub sent: u64,
    /// Of those, how many arrived with wrong bits.
    pub damaged: u64,
    /// Bytes with a wrong bit, on the servos' line in both directions.
    pub flipped_bytes: u64,
}

/// Messages on their way, in order.
#[derive(Clone, Debug)]
pub(crate) struct Wire {
    device: String,
    queue: VecDeque<(u64, Vec<u8>)>,
    last_due_ns: u64,
    rng: ChaCha8Rng,
    delay_ns: u64,
    lost: f64,
    garbage: f64,
    flip: f64,
    traffic: LineTraffic,
}

impl Wire {
    /// The way of `device`. `number` tells the devices of a station apart, so that what befalls one does not depend on
    /// how much another says.
    pub(crate) fn new(device: &str, seed: u64, number: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream((1 << 32) + number);
        Self {
            device: device.to_owned(),
            queue: VecDeque::new(),
            last_due_ns: 0,
            rng,
            delay_ns: 0,
            lost: 0.0,
            garbage: 0.0,
            flip: 0.0,
            traffic: LineTraffic::default(),
        }
    }

    pub(crate) fn traffic(&self) -> LineTraffic {
        self.traffic
    }

    pub(crate) fn device(&self) -> &str {
        &self.device
    }

    pub(crate) fn set_faults(&mut self, faults: &Faults) {
        (self.delay_ns, self.lost, self.garbage, self.flip) = (0, 0.0, 0.0, 0.0);
        for fault in &faults.faults {
            match fault {
                Fault::Delay { device, delay_s } if *device == self.device => {
                    self.delay_ns = (delay_s * 1e9) as u64;
                }
                Fault::Lost { device, share } if *device == self.device => self.lost = *share,
                Fault::Garbage { device, share } if *device == self.device => self.garbage = *share,
                Fault::Flip { device, share } if *device == self.device => self.flip = *share,
                _ => {}
            }
        }
        if faults.unplugged(&self.device) {
            self.queue.clear();
        }
    }

    /// Sends one answer or line that would arrive at `due_ns`.
    pub(crate) fn send(&mut self, due_ns: u64, mut bytes: Vec<u8>) {
        self.traffic.sent += 1;
        if self.happens(self.lost) {
            return;
        }
        let flipped_before = self.traffic.flipped_bytes;
        self.damage(&mut bytes);
        self.traffic.damaged += u64::from(self.traffic.flipped_bytes > flipped_before);
        if self.happens(self.garbage) {
            let count = self.rng.random_range(1..=MOST_GARBAGE);
            let garbage: Vec<u8> = (0..count).map(|_| self.rng.random()).collect();
            bytes.splice(0..0, garbage);
        }
        self.last_due_ns = self.last_due_ns.max(due_ns + self.delay_ns);
        self.queue.push_back((self.last_due_ns, bytes));
    }

    /// Flips bits of what passes, in place.
    pub(crate) fn damage(&mut self, bytes: &mut [u8]) {
        for byte in bytes {
            if self.happens(self.flip) {
                *byte ^= 1 << self.rng.random_range(0..8);
                self.traffic.flipped_bytes += 1;
            }
        }
    }

    /// What has arrived by `now_ns`.
    pub(crate) fn arrived(&mut self, now_ns: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        while let Some((due_ns, message)) = self.queue.pop_front() {
            if due_ns > now_ns {
                self.queue.push_front((due_ns, message));
                break;
            }
            bytes.extend(message);
        }
        bytes
    }

    /// When the next message arrives.
    pub(crate) fn next_ns(&self) -> Option<u64> {
        self.queue.front().map(|(due_ns, _)| *due_ns)
    }

    /// Draws only where a fault is possible, so that a station in order draws nothing.
    fn happens(&mut self, share: f64) -> bool {
        share > 0.0 && self.rng.random::<f64>() < share
    }
}
