//! The electronics of one stream: sampling, firmware, and the way to the host.

use std::collections::VecDeque;

use palpate_robot_model::StreamConfig;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::noise::gaussian;
use crate::secrets::{ChannelSecrets, StreamSecrets};
use crate::truth::StreamTruth;
use crate::world::spans::Frozen;

/// How long the firmware averages after power-up before it has a reference, s.
pub(crate) const REFERENCE_S: f64 = 0.8;
/// Samples leave the transport at least this long after one another, ns.
const FASTEST_NS: i64 = 50_000;

/// A sample that has reached the host.
#[derive(Clone, Debug, PartialEq)]
pub struct Arrival {
    /// When it arrived, ns since the take's start.
    pub host_ns: i64,
    /// When it was taken, by the device's clock, ns since its power-up.
    pub device_ns: u64,
    /// Readings, one for each channel of the stream, raw units.
    pub raw: Vec<f32>,
    /// What the firmware takes for touched, one for each channel.
    pub active: Vec<bool>,
}

/// Samples its channels at its own pace and decides what is touched.
#[derive(Clone, Debug)]
pub(crate) struct Device {
    config: StreamConfig,
    truth: StreamTruth,
    period_s: f64,
    /// When power came, s since the take's start.
    power_up_s: f64,
    num_sampled: u64,
    /// Sum of readings while the reference is being taken.
    sums: Vec<f64>,
    num_summed: u64,
    /// What the comparators say, and for how many samples they have said so.
    touched: Vec<bool>,
    num_touched: Vec<u64>,
    /// What the firmware believes.
    active: Vec<bool>,
    /// Samples of touch before it is believed.
    debounce: u64,
    wraps: Vec<bool>,
    stuck_raw: Vec<Option<f64>>,
    /// How fast the clock runs that stamps samples.
    stamp_skew: f64,
    frozen: Option<Frozen>,
    last_raw: Vec<f32>,
    queue: VecDeque<Arrival>,
    last_arrival_ns: i64,
    rng: ChaCha8Rng,
}

impl Device {
    pub(crate) fn new(
        mut config: StreamConfig,
        mut truth: StreamTruth,
        rate_hz: f64,
        channels: &[ChannelSecrets],
        secrets: &StreamSecrets,
        power_up_s: f64,
        rng: ChaCha8Rng,
    ) -> Self {
        let num_channels = channels.len();
        if let Some(fraction) = secrets.off_fraction {
            config.off_threshold = fraction * config.on_threshold;
        }
        truth.latency_s += secrets.delay_s;
        truth.clock_skew += secrets.stamp_skew;
        Self {
            config,
            truth,
            period_s: 1.0 / rate_hz,
            power_up_s,
            num_sampled: 0,
            sums: vec![0.0; num_channels],
            num_summed: 0,
            touched: vec![false; num_channels],
            num_touched: vec![0; num_channels],
            active: vec![false; num_channels],
            debounce: (secrets.min_on_s * rate_hz).round() as u64,
            wraps: channels.iter().map(|channel| channel.wraps).collect(),
            stuck_raw: channels.iter().map(|channel| channel.stuck_raw).collect(),
            stamp_skew: secrets.stamp_skew,
            frozen: secrets.hold.map(|hold| Frozen::new(hold, &rng)),
            last_raw: Vec::new(),
            queue: VecDeque::new(),
            last_arrival_ns: i64::MIN,
            rng,
        }
    }

    /// Whether a sample is due at `now_s`.
    pub(crate) fn due(&self, now_s: f64) -> bool {
        now_s + 1e-9 >= self.power_up_s + self.device_s() / (1.0 + self.truth.clock_skew)
    }

    /// The device's own time, s since its power-up: it counts periods by its clock, which runs a little fast or slow.
    fn device_s(&self) -> f64 {
        self.num_sampled as f64 * self.period_s
    }

    /// Samples `analog_raw`; to be called when a sample is due.
    pub(crate) fn sample(&mut self, now_s: f64, analog_raw: &[f64]) {
        let device_s = self.device_s();
        self.num_sampled += 1;
        let mut raw = Vec::with_capacity(self.active.len());
        for analog in analog_raw {
            let noisy = analog + self.truth.noise_raw * gaussian(&mut self.rng);
            raw.push(noisy.round().clamp(self.config.raw_min, self.config.raw_max) as f32);
        }
        if device_s < REFERENCE_S {
            self.num_summed += 1;
            for (sum, reading) in self.sums.iter_mut().zip(&raw) {
                *sum += f64::from(*reading);
            }
        } else {
            self.store(now_s, &mut raw);
            self.decide(&raw);
        }
        if let Some(frozen) = &mut self.frozen
            && frozen.at(now_s)
        {
            raw.clone_from(&self.last_raw);
            self.active.clone_from(&frozen.active);
        } else {
            self.last_raw.clone_from(&raw);
            if let Some(frozen) = &mut self.frozen {
                frozen.active.clone_from(&self.active);
            }
        }
        let delay_s = self.truth.latency_s - self.truth.jitter_s * (1.0 - self.rng.random::<f64>()).ln();
        let stamp_s = now_s + delay_s + self.stamp_skew * now_s;
        let arrival_ns = (stamp_s * 1e9).round() as i64;
        self.last_arrival_ns = arrival_ns.max(self.last_arrival_ns.saturating_add(FASTEST_NS));
        self.queue.push_back(Arrival {
            host_ns: self.last_arrival_ns,
            device_ns: (device_s * 1e9).round() as u64,
            raw,
            active: self.active.clone(),
        });
    }

    /// What the converter's registers make of good readings, once there is a reference.
    fn store(&self, now_s: f64, raw: &mut [f32]) {
        for (idx, reading) in raw.iter_mut().enumerate() {
            let reference = self.sums[idx] / self.num_summed as f64;
            if self.wraps[idx] {
                // The tared value is signed; whoever stores it takes its bits for those of an unsigned number.
                let tared = (f64::from(*reading) - reference).round() as i16;
                *reading = (reference + f64::from(tared.cast_unsigned())) as f32;
            }
            if let Some(rise) = self.stuck_raw[idx]
                && now_s >= 0.0
            {
                *reading = (reference + rise).round() as f32;
            }
        }
    }

    /// Comparators with hysteresis, then a counter that waits for them to be sure.
    fn decide(&mut self, raw: &[f32]) {
        for (idx, reading) in raw.iter().enumerate() {
            let rise = f64::from(*reading) - self.sums[idx] / self.num_summed as f64;
            let threshold =
                if self.touched[idx] { self.config.off_threshold } else { self.config.on_threshold };
            self.touched[idx] = rise > threshold;
            self.num_touched[idx] = if self.touched[idx] { self.num_touched[idx] + 1 } else { 0 };
            self.active[idx] = self.num_touched[idx] > self.debounce;
        }
    }

    /// What the firmware took for no touch after power-up, of the channel in `column`, raw units.
    pub(crate) fn reference(&self, column: usize) -> f64 {
        self.sums[column] / self.num_summed.max(1) as f64
    }

    /// The next sample that has arrived by `now_ns`.
    pub(crate) fn arrived(&mut self, now_ns: i64) -> Option<Arrival> {
        if self.queue.front()?.host_ns <= now_ns { self.queue.pop_front() } else { None }
    }
}
