//! Boards: filters, wander, mains, rounding, and ways to the host.

use palpate_robot_model::{Place, SensorKind, Station, StreamConfig};
use palpate_truth::Hidden;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::imperfections::{BoardConfig, Imperfections};
use super::{Kept, normal, value, within};

/// Samples as the host has them.
#[derive(Default)]
pub(super) struct Samples {
    pub(super) times_s: Vec<f64>,
    /// `num_samples x num_channels`: readings, or 0 and 1.
    pub(super) values: Vec<f64>,
}

/// The board of one stream.
pub(super) struct Board {
    config: BoardConfig,
    kind: SensorKind,
    threshold: f64,
    raw: [f64; 2],
    rates: Rates,
    lines: Vec<Line>,
    faults: Faults,
    /// Slow wander of the board as a whole, in thresholds.
    wander: f64,
    hum_phase: f64,
    next_s: f64,
    samples: Samples,
    channels: std::ops::Range<usize>,
}

struct Rates {
    period_s: f64,
    rc_s: f64,
    latency_s: f64,
    skew: f64,
}

/// One channel on the board.
struct Line {
    gain: f64,
    /// At rest, raw units.
    rest: f64,
    /// Filtered, in thresholds.
    filtered: f64,
    wander: f64,
    drift_per_s: f64,
    bending: Option<Bending>,
}

/// A gain that changes with a joint.
struct Bending {
    dof: usize,
    per_rad: f64,
    middle_rad: f64,
}

/// What is hidden in the board as a whole.
struct Faults {
    leak: f64,
    hum: f64,
    dead: Vec<usize>,
    /// Channel, and how far above rest it stands, raw units.
    stuck: Vec<(usize, f64)>,
    swapped: Vec<(usize, usize)>,
}

/// Time in which wander forgets where it was, s.
const WANDER_S: f64 = 20.0;
/// Time in which a drifting amplifier is warm, s.
const WARM_S: f64 = 120.0;
const MAINS_HZ: f64 = 50.0;
/// Reading of a force resistor at which it switches, as a share of full scale, over one less that: what its conductance
/// is then.
const PAD_POWER: f64 = 0.85;
/// The firmware takes its reference from the first half second, s.
const TARE_S: f64 = 0.5;

impl Board {
    pub(super) fn new(
        station: &Station,
        stream_idx: usize,
        imperfections: &Imperfections,
        hidden: &[Hidden],
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let (layout, switching) = (&station.layout, &station.streams[stream_idx]);
        let stream = &layout.streams[stream_idx];
        let config = imperfections.boards[stream_idx];
        let threshold = switching.on_threshold;
        let of = |id: &str, size: &str| value(hidden, id, size, &stream.id);
        let is_fsr = stream.kind == SensorKind::Proximity;
        let mut spread = Spread::of(hidden, &stream.id);
        let lines = layout.channels[stream.channels.clone()].iter().enumerate().map(|(idx, channel)| {
            let patch = &layout.patches[channel.patch];
            let bending = hidden.iter().find(|hidden| {
                let is_there = match &hidden.place {
                    Place::Group(id) => *id == patch.group,
                    Place::Patch(id) => *id == patch.id,
                    _ => false,
                };
                hidden.id == "joint_dependent_gain" && is_there
            });
            let bending = bending.and_then(|hidden| {
                let name = hidden.joint.as_deref()?;
                let size = |name: &str| hidden.parameters.get(name).copied().unwrap_or(0.0);
                Some(Bending {
                    dof: station.robot.dofs().position(|joint| joint.name == name)?,
                    per_rad: size("per_rad"),
                    middle_rad: size("middle"),
                })
            });
            Line {
                gain: imperfections.gains[stream.channels.start + idx] * spread.gain(),
                rest: if is_fsr { 20.0 * rng.random::<f64>() } else { 8000.0 + 300.0 * normal(rng) },
                filtered: 0.0,
                wander: config.wander[0] * normal(rng),
                drift_per_s: of("baseline_drift", "rate_raw_per_s").unwrap_or(0.0) / threshold,
                bending,
            }
        });
        let ids = || layout.channels[stream.channels.clone()].iter().enumerate();
        let at = |id: &str| ids().find(|(_, channel)| channel.id == *id).map(|(idx, _)| idx);
        let swapped = hidden.iter().filter(|hidden| hidden.id == "swapped_channels").filter_map(|hidden| {
            let Place::Channels(pair) = &hidden.place else { return None };
            Some((at(pair.first()?)?, at(pair.get(1)?)?))
        });
        let faults = Faults {
            leak: of("electrical_crosstalk", "leak").unwrap_or(0.0),
            hum: of("mains_hum", "amplitude_raw").unwrap_or(0.0) / threshold,
            dead: ids()
                .filter(|(_, channel)| value(hidden, "dead_channel", "", &channel.id).is_some())
                .map(|(idx, _)| idx)
                .collect(),
            stuck: ids()
                .filter_map(|(idx, channel)| {
                    Some((idx, value(hidden, "stuck_channel", "rise_raw", &channel.id)?))
                })
                .collect(),
            swapped: swapped.collect(),
        };
        Self {
            kind: stream.kind,
            threshold,
            raw: [switching.raw_min, switching.raw_max],
            rates: Rates {
                period_s: 1.0 / stream.rate_hz,
                rc_s: config.rc_s + of("low_pass", "time_s").unwrap_or(0.0),
                latency_s: config.latency_s + of("latency", "delay_s").unwrap_or(0.0),
                skew: config.skew + of("clock_skew", "skew").unwrap_or(0.0),
            },
            lines: lines.collect(),
            faults,
            wander: config.wander[1] * normal(rng),
            hum_phase: std::f64::consts::TAU * rng.random::<f64>(),
            next_s: within(rng, [0.0, 1.0 / stream.rate_hz]),
            samples: Samples::default(),
            channels: stream.channels.clone(),
            config,
        }
    }

    /// Goes on by `step_s`, with what all channels of the hand `felt` and the links at `links`.
    pub(super) fn step(
        &mut self,
        now_s: f64,
        step_s: f64,
        felt: &[f64],
        _station: &Station,
        links: &[f64],
        rng: &mut ChaCha8Rng,
    ) {
        let filter = 1.0 - (-step_s / self.rates.rc_s).exp();
        for (line, felt) in self.lines.iter_mut().zip(&felt[self.channels.clone()]) {
            let bent = line.bending.as_ref().map_or(1.0, |bending| {
                (1.0 + bending.per_rad * (links[bending.dof] - bending.middle_rad)).max(0.05)
            });
            let reading = conducted(self.kind, felt * line.gain * bent, self.raw[1] / self.threshold);
            line.filtered += filter * (reading - line.filtered);
        }
        if now_s < self.next_s {
            return;
        }
        let period_s = self.rates.period_s;
        self.next_s += period_s;
        let [of_line, of_board] = self.config.wander;
        let step = |wander: f64, size: f64, rng: &mut ChaCha8Rng| {
            wander * (1.0 - period_s / WANDER_S) + size * (2.0 * period_s / WANDER_S).sqrt() * normal(rng)
        };
        self.wander = step(self.wander, of_board, rng);
        let hum = (std::f64::consts::TAU * MAINS_HZ * now_s + self.hum_phase).sin();
        let hum = (self.config.hum + self.faults.hum) * hum;
        let warm_s = WARM_S * (1.0 - (-now_s / WARM_S).exp());
        let analog: Vec<f64> = self.lines.iter().map(|line| line.filtered).collect();
        let mut readings = Vec::with_capacity(analog.len());
        for (idx, line) in self.lines.iter_mut().enumerate() {
            line.wander = step(line.wander, of_line, rng);
            let neighbours = [idx.checked_sub(1), Some(idx + 1)].into_iter().flatten();
            let neighbours = neighbours.filter_map(|other| analog.get(other));
            let leaked: f64 = neighbours.map(|other| self.faults.leak * (other - analog[idx])).sum();
            let touch = if self.faults.dead.contains(&idx) { 0.0 } else { analog[idx] + leaked };
            let quiet =
                line.wander + self.wander + hum + line.drift_per_s * warm_s + self.config.noise * normal(rng);
            readings
                .push((line.rest + self.threshold * (touch + quiet)).round().clamp(self.raw[0], self.raw[1]));
        }
        for &(idx, rise) in &self.faults.stuck {
            // It reads rightly before, so that its reference is that of rest.
            if now_s > TARE_S + STUCK_AFTER_S {
                readings[idx] = (self.lines[idx].rest + rise).round();
            }
        }
        for &(one, other) in &self.faults.swapped {
            readings.swap(one, other);
        }
        if rng.random::<f64>() < self.config.lost {
            return;
        }
        let jitter_s = -self.config.jitter_s * (1.0 - rng.random::<f64>()).ln();
        let stamped_s = now_s * (1.0 + self.rates.skew) + self.rates.latency_s + jitter_s;
        let after_s = self.samples.times_s.last().map_or(0.0, |last_s| last_s + 1e-6);
        self.samples.times_s.push(stamped_s.max(after_s));
        self.samples.values.extend(readings);
    }

    /// What was recorded: readings, or the events that the firmware makes of them.
    pub(super) fn finish(self, switching: &StreamConfig, kept: Kept) -> Samples {
        if kept == Kept::Readings {
            return self.samples;
        }
        let width = self.lines.len();
        let quiet = self.samples.times_s.iter().take_while(|time_s| **time_s < TARE_S).count().max(1);
        let rows = || self.samples.values.chunks_exact(width);
        let tare: Vec<f64> = (0..width)
            .map(|idx| rows().take(quiet).map(|row| row[idx]).sum::<f64>() / quiet as f64)
            .collect();
        let mut on = vec![false; width];
        let mut events = Vec::with_capacity(self.samples.values.len());
        for row in rows() {
            for ((on, reading), tare) in on.iter_mut().zip(row).zip(&tare) {
                let threshold = if *on { switching.off_threshold } else { switching.on_threshold };
                *on = reading - tare > threshold;
                events.push(f64::from(u8::from(*on)));
            }
        }
        Samples { values: events, ..self.samples }
    }
}

/// After the reference is taken, a stuck channel sticks, s.
const STUCK_AFTER_S: f64 = 2.0;

/// The reading for what is felt, in thresholds, of a converter that ends at `full`.
fn conducted(kind: SensorKind, felt: f64, full: f64) -> f64 {
    match kind {
        SensorKind::Pressure => felt,
        // A divider: conductance goes with a power of the load (Interlink FSR 402), and ends at full scale.
        SensorKind::Proximity => {
            let at_threshold = 1.0 / (full - 1.0);
            let conductance = at_threshold * felt.max(0.0).powf(PAD_POWER);
            full * conductance / (1.0 + conductance)
        }
    }
}

/// Gains of channels that differ, drawn one after the other.
struct Spread {
    size: f64,
    rng: Option<ChaCha8Rng>,
}

impl Spread {
    fn of(hidden: &[Hidden], stream: &str) -> Self {
        let size = value(hidden, "sensitivity_spread", "spread", stream).unwrap_or(0.0);
        let draw = value(hidden, "sensitivity_spread", "draw", stream);
        let rng = draw.map(|draw| rand::SeedableRng::seed_from_u64(draw as u64));
        Self { size, rng }
    }

    fn gain(&mut self) -> f64 {
        let size = self.size;
        self.rng.as_mut().map_or(1.0, |rng| (size * normal(rng)).exp())
    }
}
