//! What was measured in a take, frame by frame.

use std::ops::Range;

use palpate_recording::{SpanKind, StreamLog, Take};
use palpate_robot_model::{JointKind, ObjectModel, Station};
use palpate_sim::effects::TakeScene;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::moments::Moments;
use crate::DiagnosisError;
use crate::engine::Series;

/// Rows between repetitions that are not marked are cut into blocks of this length, s.
const BLOCK_S: f64 = 5.0;

/// Standard deviation of simulated joint noise, rad: a servo's encoder and its interpolation.
const JOINT_NOISE_RAD: f64 = 3e-4;
/// Standard deviation of the logarithm of how hard simulated touches press a channel.
const TOUCH_SPREAD: f64 = 0.05;

/// A standard normal deviate (Box and Muller).
fn gaussian(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

/// A take, as a diagnosis compares it.
#[derive(Clone)]
pub(crate) struct Observed<'a> {
    pub(crate) take: &'a Take,
    pub(crate) object: &'a ObjectModel,
    pub(crate) has_raw: bool,
    /// Moments at which touch is simulated: those of the joint frames and, near contact, more between them.
    moments: Moments,
    /// Joint positions at the moments, as in [`TakeScene::positions`].
    positions: Vec<f64>,
    /// Per stream, when the sample in effect at each moment arrived, s.
    pub(crate) arrivals_s: Vec<Vec<f64>>,
    /// As [`TakeScene::frozen_for_s`]; empty without raw readings, whose noise is what tells.
    frozen_for_s: Vec<Vec<f64>>,
    /// The same at the joint frames.
    frozen_at_frames_s: Vec<Vec<f64>>,
    /// Frame by frame, as [`super::TactileDomain`] numbers them.
    pub(crate) signals: Vec<Vec<f64>>,
    /// Ranges of frames that belong together.
    pub(crate) blocks: Vec<Range<usize>>,
    /// The same as ranges of frames, with the label of the repetition (empty between repetitions).
    pub(crate) repetitions: Vec<(Range<usize>, String)>,
    /// Per channel, standard deviation of raw readings without touch, in units of the threshold; 0 without raw.
    pub(crate) noise: Vec<f64>,
    /// Per channel, highest raw reading the device can give, in units of the threshold.
    pub(crate) ceilings: Vec<f64>,
}

impl<'a> Observed<'a> {
    pub(crate) fn new(station: &'a Station, take: &'a Take) -> Result<Self, DiagnosisError> {
        let object = station.objects.get(&take.meta.object).ok_or_else(|| {
            let known: Vec<&str> = station.objects.keys().map(String::as_str).collect();
            DiagnosisError::Input(format!(
                "take {:?} touches object {:?}, which station {:?} does not know (it knows {}); add the object to the \
                 station file, or correct the take's object",
                take.id,
                take.meta.object,
                station.id,
                known.join(", ")
            ))
        })?;
        let layout = &station.layout;
        let (num_frames, num_channels) = (take.num_frames(), layout.num_channels());
        let frame_times_s = &take.joints.times_s;
        let moments = Moments::new(frame_times_s, &felt_s(take));
        let mut signals = vec![vec![f64::NAN; num_frames]; num_channels * 2];
        let mut arrivals_s = Vec::new();
        let mut frozen_for_s = Vec::new();
        let mut noise = vec![0.0; num_channels];
        let mut ceilings = vec![f64::INFINITY; num_channels];
        for ((stream, config), log) in layout.streams.iter().zip(&station.streams).zip(&take.streams) {
            let width = stream.channels.len();
            let repeated_for_s = repeated_for_s(log, width);
            let mut frozen = vec![0.0; moments.times_s().len()];
            let mut arrivals = moments.times_s().to_vec();
            for (moment, arrival) in arrivals.iter_mut().enumerate() {
                let Some(sample) = sample_in_effect(log, *arrival) else { continue };
                *arrival = log.times_s[sample];
                frozen[moment] = repeated_for_s.get(sample).copied().unwrap_or(0.0);
            }
            for (frame, &time_s) in frame_times_s.iter().enumerate() {
                let Some(sample) = sample_in_effect(log, time_s) else { continue };
                for (idx, channel) in stream.channels.clone().enumerate() {
                    signals[2 * channel][frame] = f64::from(u8::from(log.active[sample * width + idx]));
                    if let (Some(raw), Some(reference)) =
                        (log.raw.get(sample * width + idx), log.reference.get(idx))
                    {
                        signals[2 * channel + 1][frame] = f64::from(raw - reference) / config.on_threshold;
                    }
                }
            }
            arrivals_s.push(arrivals);
            frozen_for_s.push(frozen);
            for (idx, channel) in stream.channels.clone().enumerate() {
                if let Some(reference) = log.reference.get(idx) {
                    ceilings[channel] = (config.raw_max - f64::from(*reference)) / config.on_threshold;
                    noise[channel] = quiet_noise(take, log, idx, width) / config.on_threshold;
                }
            }
        }
        let repetitions = repetitions(take);
        let blocks = repetitions.iter().map(|(frames, _)| frames.clone()).collect();
        let has_raw = take.has_raw();
        let positions = moments.interpolated(&take.joints.positions, station.robot.num_dofs());
        if !has_raw {
            frozen_for_s.clear();
        }
        let at_frames = |of_moments: &Vec<f64>| moments.frames().iter().map(|&at| of_moments[at]).collect();
        let frozen_at_frames_s = frozen_for_s.iter().map(at_frames).collect();
        Ok(Self {
            take,
            object,
            has_raw,
            moments,
            positions,
            arrivals_s,
            frozen_for_s,
            frozen_at_frames_s,
            signals,
            blocks,
            repetitions,
            noise,
            ceilings,
        })
    }

    /// Lengths of the spans for which `stream` was frozen, s.
    pub(crate) fn frozen_spans_s(&self, stream: usize) -> impl Iterator<Item = f64> + '_ {
        let log = &self.take.streams[stream];
        let repeated_for_s = if self.has_raw {
            repeated_for_s(log, log.active.len() / log.times_s.len().max(1))
        } else {
            Vec::new()
        };
        let ends: Vec<f64> = (0..repeated_for_s.len())
            .filter(|&sample| {
                repeated_for_s[sample] > 0.0 && repeated_for_s.get(sample + 1).is_none_or(|next| *next == 0.0)
            })
            .map(|sample| repeated_for_s[sample])
            .collect();
        ends.into_iter()
    }

    /// This take with what a model predicts in place of what was measured, and noise.
    pub(crate) fn simulated(&self, station: &Station, predicted: &[Series], rng: &mut ChaCha8Rng) -> Self {
        let num_channels = station.layout.num_channels();
        let num_dofs = station.robot.num_dofs();
        let mut positions = self.take.joints.positions.clone();
        for (dof, joint) in station.robot.dofs().enumerate() {
            if joint.kind == JointKind::Revolute {
                for frame in positions.chunks_exact_mut(num_dofs) {
                    frame[dof] += JOINT_NOISE_RAD * gaussian(rng);
                }
            }
        }
        let mut simulated = self.clone();
        simulated.positions = self.moments.interpolated(&positions, num_dofs);
        let off_fractions: Vec<f64> = station
            .layout
            .channels
            .iter()
            .map(|channel| station.streams[channel.stream].off_fraction())
            .collect();
        let mut on = vec![false; num_channels];
        for block in &self.blocks {
            // No two touches press a channel quite alike.
            let shares: Vec<f64> = (0..num_channels).map(|_| 1.0 + TOUCH_SPREAD * gaussian(rng)).collect();
            for frame in block.clone() {
                for channel in 0..num_channels {
                    let (event, raw) = (2 * channel, 2 * channel + 1);
                    let noise = self.noise[channel] * gaussian(rng);
                    let reading = predicted[raw][frame] * shares[channel] + noise;
                    on[channel] = reading > if on[channel] { off_fractions[channel] } else { 1.0 };
                    if !self.signals[event][frame].is_nan() {
                        simulated.signals[event][frame] = f64::from(u8::from(on[channel]));
                    }
                    if !self.signals[raw][frame].is_nan() {
                        simulated.signals[raw][frame] = reading;
                    }
                }
            }
        }
        simulated
    }

    /// What the simulation needs of it, at the moments at which touch is simulated.
    pub(crate) fn scene<'s>(&'s self, station: &'s Station) -> TakeScene<'s> {
        TakeScene {
            station,
            object: self.object,
            base_from_object: &self.take.meta.base_from_object,
            frame_times_s: self.moments.times_s(),
            positions: &self.positions,
            arrival_times_s: &self.arrivals_s,
            frozen_for_s: &self.frozen_for_s,
        }
    }

    /// The same at the joint frames alone, as whoever replays the take sees it.
    pub(crate) fn scene_at_frames<'s>(&'s self, station: &'s Station) -> TakeScene<'s> {
        TakeScene {
            frame_times_s: &self.take.joints.times_s,
            positions: &self.take.joints.positions,
            arrival_times_s: &[],
            frozen_for_s: &self.frozen_at_frames_s,
            ..self.scene(station)
        }
    }

    /// Of values at the moments, those at the joint frames.
    pub(crate) fn at_frames(&self, of_moments: &[f64]) -> Series {
        self.moments.frames().iter().map(|&moment| of_moments[moment]).collect()
    }
}

/// When anything was felt, s.
fn felt_s(take: &Take) -> Vec<f64> {
    let of_stream = |log: &StreamLog| -> Vec<f64> {
        let width = log.active.len() / log.times_s.len().max(1);
        let samples = log.times_s.iter().zip(log.active.chunks_exact(width.max(1)));
        samples.filter(|(_, active)| active.contains(&true)).map(|(&time_s, _)| time_s).collect()
    };
    take.streams.iter().flat_map(of_stream).collect()
}

/// The last sample of `log` that had arrived by `time_s`.
fn sample_in_effect(log: &StreamLog, time_s: f64) -> Option<usize> {
    log.times_s.partition_point(|&arrival_s| arrival_s <= time_s).checked_sub(1)
}

/// Samples that are all the same before a device counts as frozen: two alike may be chance.
const LEAST_REPEATED: usize = 4;

/// For how long each sample of `log` had been repeated to the bit, s; empty without raw readings. `width` is its number of
/// channels.
fn repeated_for_s(log: &StreamLog, width: usize) -> Vec<f64> {
    let samples: Vec<(f64, &[f32])> =
        log.times_s.iter().copied().zip(log.raw.chunks_exact(width.max(1))).collect();
    let runs = samples.chunk_by(|(_, one), (_, other)| one == other);
    runs.flat_map(|run| {
        let repeated = run.len() >= LEAST_REPEATED;
        run.iter().map(move |(time_s, _)| if repeated { time_s - run[0].0 } else { 0.0 })
    })
    .collect()
}

/// Standard deviation of a channel's raw readings in the baseline spans, raw units: about their mean, or from one reading
/// to the next where that is less, as it is where the readings wander.
fn quiet_noise(take: &Take, log: &StreamLog, idx: usize, width: usize) -> f64 {
    let baselines: Vec<_> = take.spans.iter().filter(|span| span.kind == SpanKind::Baseline).collect();
    let readings: Vec<f64> = log
        .times_s
        .iter()
        .enumerate()
        .filter(|(_, time_s)| baselines.iter().any(|span| (span.start_s..=span.end_s).contains(*time_s)))
        .map(|(sample, _)| f64::from(log.raw[sample * width + idx]))
        .collect();
    let count = readings.len() as f64;
    if readings.len() < 2 {
        return 0.0;
    }
    let mean = readings.iter().sum::<f64>() / count;
    let about_mean = readings.iter().map(|reading| (reading - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let steps = readings.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>() / (count - 1.0);
    about_mean.min(0.5 * steps).sqrt()
}

/// Frames of each marked repetition, and of what lies between, in order: together all frames.
fn repetitions(take: &Take) -> Vec<(Range<usize>, String)> {
    let times_s = &take.joints.times_s;
    let frame_at = |time_s: f64| times_s.partition_point(|&frame_s| frame_s < time_s);
    let mut parts = Vec::new();
    let mut next = 0;
    let between = |from: usize, to: usize, parts: &mut Vec<(Range<usize>, String)>| {
        let mut from = from;
        while from < to {
            let end = frame_at(times_s[from] + BLOCK_S).clamp(from + 1, to);
            parts.push((from..end, String::new()));
            from = end;
        }
    };
    for span in take.spans.iter().filter(|span| span.kind == SpanKind::Repetition) {
        let (start, end) = (frame_at(span.start_s).max(next), frame_at(span.end_s));
        if start >= end {
            continue;
        }
        between(next, start, &mut parts);
        parts.push((start..end, span.label.clone()));
        next = end;
    }
    between(next, times_s.len(), &mut parts);
    parts
}
