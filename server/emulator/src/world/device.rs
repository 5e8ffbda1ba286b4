//! The electronics of one stream: sampling, firmware, and the way to the host.

use std::collections::VecDeque;

use palpate_robot_model::StreamConfig;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::truth::StreamTruth;

/// How long the firmware averages after power-up before it has a reference, s.
pub(crate) const REFERENCE_S: f64 = 0.8;
/// Samples leave the transport at least this long after one another, ns.
const FASTEST_NS: i64 = 50_000;

/// A sample that has reached the host.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Arrival {
    /// When it arrived, ns since the take's start.
    pub(crate) host_ns: i64,
    /// When it was taken, by the device's clock, ns since its power-up.
    pub(crate) device_ns: u64,
    pub(crate) raw: Vec<f32>,
    pub(crate) active: Vec<bool>,
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
    active: Vec<bool>,
    queue: VecDeque<Arrival>,
    last_arrival_ns: i64,
    rng: ChaCha8Rng,
}

impl Device {
    pub(crate) fn new(
        config: StreamConfig,
        truth: StreamTruth,
        rate_hz: f64,
        num_channels: usize,
        power_up_s: f64,
        rng: ChaCha8Rng,
    ) -> Self {
        Self {
            config,
            truth,
            period_s: 1.0 / rate_hz,
            power_up_s,
            num_sampled: 0,
            sums: vec![0.0; num_channels],
            num_summed: 0,
            active: vec![false; num_channels],
            queue: VecDeque::new(),
            last_arrival_ns: i64::MIN,
            rng,
        }
    }

    /// Samples `analog_raw` if a sample is due at `now_s`.
    pub(crate) fn tick<'a>(&mut self, now_s: f64, analog_raw: impl Iterator<Item = &'a f64>) {
        // The device counts periods by its own clock, which runs a little fast or slow.
        let device_s = self.num_sampled as f64 * self.period_s;
        let due_s = self.power_up_s + device_s / (1.0 + self.truth.clock_skew);
        if now_s + 1e-9 < due_s {
            return;
        }
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
            for ((active, reading), reference) in self.active.iter_mut().zip(&raw).zip(self.sums.iter()) {
                let rise = f64::from(*reading) - reference / self.num_summed as f64;
                let threshold = if *active { self.config.off_threshold } else { self.config.on_threshold };
                *active = rise > threshold;
            }
        }
        let delay_s = self.truth.latency_s - self.truth.jitter_s * (1.0 - self.rng.random::<f64>()).ln();
        let arrival_ns = ((now_s + delay_s) * 1e9).round() as i64;
        self.last_arrival_ns = arrival_ns.max(self.last_arrival_ns.saturating_add(FASTEST_NS));
        self.queue.push_back(Arrival {
            host_ns: self.last_arrival_ns,
            device_ns: (device_s * 1e9).round() as u64,
            raw,
            active: self.active.clone(),
        });
    }

    /// The next sample that has arrived by `now_ns`.
    pub(crate) fn arrived(&mut self, now_ns: i64) -> Option<Arrival> {
        if self.queue.front()?.host_ns <= now_ns { self.queue.pop_front() } else { None }
    }

    /// The firmware's reference reading of each channel, raw units.
    pub(crate) fn reference(&self) -> impl Iterator<Item = f64> + '_ {
        let count = self.num_summed.max(1) as f64;
        self.sums.iter().map(move |sum| sum / count)
    }
}

/// A standard normal deviate (Box and Muller).
pub(crate) fn gaussian(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}
