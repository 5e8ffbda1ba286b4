//! What was measured in a take, frame by frame.

use std::ops::Range;

use palpate_recording::{SpanKind, StreamLog, Take};
use palpate_robot_model::{JointKind, LinkPoses, ObjectModel, ObjectPath, Station, TactileLayout, Tare};
use palpate_sim::effects::TakeScene;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::Signal;
use super::moments::Moments;
use super::switched::Samples;
use super::wander::Wander;
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
    /// By number of [`limbs`], at which moments its touch is simulated.
    limbs: Vec<Limb>,
    /// Where the object is at the joint frames.
    pub(crate) object_path: ObjectPath,
    /// When references were taken anew.
    tares: Vec<Tare>,
    /// As [`TakeScene::frozen_for_s`], at the joint frames; empty without raw readings, whose noise is what tells.
    frozen_at_frames_s: Vec<Vec<f64>>,
    /// Frame by frame, as [`super::TactileDomain`] numbers them.
    pub(crate) signals: Vec<Vec<f64>>,
    /// Which channels are on in the joint frames, `[frame * num_channels + channel]`.
    pub(crate) active: Vec<bool>,
    /// Ranges of frames that belong together.
    pub(crate) blocks: Vec<Range<usize>>,
    /// The same as ranges of frames, with the label of the repetition (empty between repetitions).
    pub(crate) repetitions: Vec<(Range<usize>, String)>,
    /// Per channel, standard deviation of raw readings without touch, in units of the threshold; 0 without raw.
    pub(crate) noise: Vec<f64>,
    /// Per channel, highest raw reading the device can give, in units of the threshold.
    pub(crate) ceilings: Vec<f64>,
}

/// Patches that touch and let go together, and the moments at which their touch is simulated: those of the joint frames
/// and, while one of them is near contact, more between them.
#[derive(Clone)]
struct Limb {
    moments: Moments,
    /// The links that its patches are on.
    links: Vec<usize>,
    /// Joint positions at the moments, as in [`TakeScene::positions`].
    positions: Vec<f64>,
    /// Where its links, and those before them, are at these positions.
    poses: LinkPoses,
    /// Where the object is at the moments.
    object_path: ObjectPath,
    /// Per stream, when the sample in effect at each moment arrived, s.
    arrivals_s: Vec<Vec<f64>>,
    /// As [`TakeScene::frozen_for_s`]; empty without raw readings.
    frozen_for_s: Vec<Vec<f64>>,
}

impl Limb {
    /// The limb of `take` with patches on `links`, in which something is felt at the times `felt_s`. `repeated_for_s`: of every
    /// stream, see [`repeated_for_s`].
    fn new(
        station: &Station,
        take: &Take,
        links: Vec<usize>,
        felt_s: &[f64],
        repeated_for_s: &[Vec<f64>],
    ) -> Self {
        let moments = Moments::new(&take.joints.times_s, felt_s);
        let mut arrivals_s = Vec::new();
        let mut frozen_for_s = Vec::new();
        for (log, repeated_for_s) in take.streams.iter().zip(repeated_for_s) {
            let mut frozen = vec![0.0; moments.times_s().len()];
            let mut arrivals = moments.times_s().to_vec();
            for (moment, arrival) in arrivals.iter_mut().enumerate() {
                let Some(sample) = sample_in_effect(log, *arrival) else { continue };
                *arrival = log.times_s[sample];
                frozen[moment] = repeated_for_s.get(sample).copied().unwrap_or(0.0);
            }
            arrivals_s.push(arrivals);
            frozen_for_s.push(frozen);
        }
        if !take.has_raw() {
            frozen_for_s.clear();
        }
        let positions = moments.interpolated(&take.joints.positions, station.robot.num_dofs());
        let poses = LinkPoses::new(&station.robot, links.iter().copied(), &positions);
        let object_path = take.object_path_at(moments.times_s());
        Self { moments, links, positions, poses, object_path, arrivals_s, frozen_for_s }
    }

    /// The same with other joint positions at the frames.
    fn follow(&mut self, station: &Station, positions: &[f64]) {
        self.positions = self.moments.interpolated(positions, station.robot.num_dofs());
        self.poses = LinkPoses::new(&station.robot, self.links.iter().copied(), &self.positions);
    }
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
        let has_raw = take.has_raw();
        let mut signals = vec![vec![f64::NAN; num_frames]; num_channels * Signal::COUNT];
        let mut noise = vec![0.0; num_channels];
        let mut ceilings = vec![f64::INFINITY; num_channels];
        for ((stream, config), log) in layout.streams.iter().zip(&station.streams).zip(&take.streams) {
            let width = stream.channels.len();
            for (frame, &time_s) in frame_times_s.iter().enumerate() {
                let Some(sample) = sample_in_effect(log, time_s) else { continue };
                let reference = log.reference_at(log.times_s[sample]);
                for (idx, channel) in stream.channels.clone().enumerate() {
                    signals[Signal::Event.of(channel)][frame] =
                        f64::from(u8::from(log.active[sample * width + idx]));
                    if let (Some(raw), Some(reference)) =
                        (log.raw.get(sample * width + idx), reference.get(idx))
                    {
                        signals[Signal::Reading.of(channel)][frame] =
                            f64::from(raw - reference) / config.on_threshold;
                    }
                }
            }
            for (idx, channel) in stream.channels.clone().enumerate() {
                if !has_raw {
                    signals[Signal::Event.of(channel)] = share_on(log, idx, width, frame_times_s);
                }
                let references = || log.references().filter_map(|reference| reference.get(idx));
                // Where several count in turn, the highest reading that any of them allows.
                if let Some(lowest) = references().copied().reduce(f32::min) {
                    let samples = Samples::new(log, idx, width, config.on_threshold, frame_times_s);
                    if samples.may_count_from_reference(config.off_fraction()) {
                        signals[Signal::Switched.of(channel)] = samples.share_on();
                    }
                    ceilings[channel] = (config.raw_max - f64::from(lowest)) / config.on_threshold;
                    noise[channel] = quiet_noise(take, log, idx, width) / config.on_threshold;
                }
            }
        }
        let repetitions = repetitions(take);
        let blocks = repetitions.iter().map(|(frames, _)| frames.clone()).collect();
        let streams = layout.streams.iter().zip(&take.streams);
        let repeated_for_s: Vec<Vec<f64>> =
            streams.map(|(stream, log)| repeated_for_s(log, stream.channels.len())).collect();
        let felt_s = felt_s(layout, take).into_iter().zip(links(layout));
        let limbs =
            felt_s.map(|(felt_s, links)| Limb::new(station, take, links, &felt_s, &repeated_for_s)).collect();
        let frozen_at_frames_s = if has_raw {
            Limb::new(station, take, Vec::new(), &[], &repeated_for_s).frozen_for_s
        } else {
            Vec::new()
        };
        Ok(Self {
            take,
            object,
            has_raw,
            limbs,
            object_path: take.object_path(),
            tares: take.tares(),
            frozen_at_frames_s,
            signals,
            active: take.active_at_frames(),
            blocks,
            repetitions,
            noise,
            ceilings,
        })
    }

    /// What is expected of the firmware of `channel`: [`Signal::Switched`].
    pub(crate) fn switched(
        &self,
        station: &Station,
        channel: usize,
        off_fraction: f64,
        min_on_s: f64,
    ) -> Series {
        if self.signals[Signal::Switched.of(channel)].iter().all(|share| share.is_nan()) {
            return vec![0.0; self.take.num_frames()].into();
        }
        let stream = station.layout.channels[channel].stream;
        let (log, channels) = (&self.take.streams[stream], &station.layout.streams[stream].channels);
        let on_threshold = station.streams[stream].on_threshold;
        let column = channel - channels.start;
        Samples::new(log, column, channels.len(), on_threshold, &self.take.joints.times_s)
            .expected_share_on(off_fraction, min_on_s)
            .into()
    }

    /// Looks at what the firmware of `channel` makes of its readings no more.
    pub(crate) fn ignore_switching(&mut self, channel: usize) {
        self.signals[Signal::Switched.of(channel)].fill(f64::NAN);
    }

    /// The readings of `channel` without touch, raw units, that count in turn; none without readings.
    pub(crate) fn references(&self, station: &Station, channel: usize) -> impl Iterator<Item = f64> + '_ {
        let stream = station.layout.channels[channel].stream;
        let column = channel - station.layout.streams[stream].channels.start;
        let references = self.take.streams[stream].references();
        references.filter_map(move |reference| reference.get(column)).map(|&reference| f64::from(reference))
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

    /// This take with what a model predicts in place of what was measured, and noise. The readings of each stream
    /// wander as in `wander`.
    pub(crate) fn simulated(
        &self,
        station: &Station,
        predicted: &[Series],
        wander: &[Wander],
        rng: &mut ChaCha8Rng,
    ) -> Self {
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
        for limb in &mut simulated.limbs {
            limb.follow(station, &positions);
        }
        let off_fractions: Vec<f64> = station
            .layout
            .channels
            .iter()
            .map(|channel| station.streams[channel.stream].off_fraction())
            .collect();
        let mut before = vec![(false, 0.0); num_channels];
        for block in &self.blocks {
            // No two touches press a channel quite alike.
            let shares: Vec<f64> = (0..num_channels).map(|_| 1.0 + TOUCH_SPREAD * gaussian(rng)).collect();
            let levels = Wander::levels(wander, &station.layout, || gaussian(rng));
            for frame in block.clone() {
                for channel in 0..num_channels {
                    let (event, raw) = (Signal::Event.of(channel), Signal::Reading.of(channel));
                    let noise = self.noise[channel] * gaussian(rng);
                    let reading = predicted[raw][frame] * shares[channel] + levels[channel] + noise;
                    let (was_on, last) = before[channel];
                    let threshold = if was_on { off_fractions[channel] } else { 1.0 };
                    let is_on = reading > threshold;
                    before[channel] = (is_on, reading);
                    simulated.active[frame * num_channels + channel] = is_on;
                    if !self.signals[event][frame].is_nan() {
                        let since_crossed = (reading - threshold) / (reading - last);
                        simulated.signals[event][frame] = match (was_on, is_on) {
                            (false, true) if !self.has_raw => since_crossed.clamp(0.0, 1.0),
                            (true, false) if !self.has_raw => 1.0 - since_crossed.clamp(0.0, 1.0),
                            _ => f64::from(u8::from(is_on)),
                        };
                    }
                    if !self.signals[raw][frame].is_nan() {
                        simulated.signals[raw][frame] = reading;
                    }
                }
            }
        }
        // The firmware is that of the take.
        for channel in 0..num_channels {
            let idx = Signal::Switched.of(channel);
            for (share, expected) in simulated.signals[idx].iter_mut().zip(predicted[idx].iter()) {
                if !share.is_nan() {
                    *share = *expected;
                }
            }
        }
        simulated
    }

    /// What the simulation of a limb needs of it, at the moments at which its touch is simulated.
    pub(crate) fn scene<'s>(&'s self, station: &'s Station, limb: usize) -> TakeScene<'s> {
        let limb = &self.limbs[limb];
        TakeScene {
            base_from_object: &limb.object_path,
            frame_times_s: limb.moments.times_s(),
            positions: &limb.positions,
            arrival_times_s: &limb.arrivals_s,
            frozen_for_s: &limb.frozen_for_s,
            ..self.scene_at_frames(station)
        }
    }

    /// The same of all limbs at the joint frames alone, as whoever replays the take sees it.
    pub(crate) fn scene_at_frames<'s>(&'s self, station: &'s Station) -> TakeScene<'s> {
        TakeScene {
            station,
            object: self.object,
            base_from_object: &self.object_path,
            surroundings: &self.take.meta.surroundings,
            frame_times_s: &self.take.joints.times_s,
            positions: &self.take.joints.positions,
            arrival_times_s: &[],
            frozen_for_s: &self.frozen_at_frames_s,
            tares: &self.tares,
        }
    }

    /// Where links are along [`TakeScene::positions`] of [`Self::scene`].
    pub(crate) fn poses(&self, limb: usize) -> &LinkPoses {
        &self.limbs[limb].poses
    }

    /// Which moments of a limb the joint frames are.
    pub(crate) fn frames(&self, limb: usize) -> &[usize] {
        self.limbs[limb].moments.frames()
    }
}

/// Per patch, the limb that it is on: a limb is the patches of one group, such as those of a finger. Fingers touch at
/// different times, so that each has moments of its own.
pub(super) fn limbs(layout: &TactileLayout) -> Vec<usize> {
    let mut groups: Vec<&str> = Vec::new();
    let mut limbs = Vec::with_capacity(layout.patches.len());
    for patch in &layout.patches {
        let known = groups.iter().position(|group| *group == patch.group);
        limbs.push(known.unwrap_or(groups.len()));
        if known.is_none() {
            groups.push(&patch.group);
        }
    }
    limbs
}

/// Per limb, the links that its patches are on.
fn links(layout: &TactileLayout) -> Vec<Vec<usize>> {
    let limbs = limbs(layout);
    let num_limbs = limbs.iter().max().map_or(0, |last| last + 1);
    let mut links = vec![Vec::new(); num_limbs];
    for (patch, &limb) in layout.patches.iter().zip(&limbs) {
        links[limb].push(patch.link);
    }
    links
}

/// Per limb, when anything was felt, s.
fn felt_s(layout: &TactileLayout, take: &Take) -> Vec<Vec<f64>> {
    let limbs = limbs(layout);
    let num_limbs = limbs.iter().max().map_or(0, |last| last + 1);
    let mut felt_s = vec![Vec::new(); num_limbs];
    for (stream, log) in layout.streams.iter().zip(&take.streams) {
        let samples = log.times_s.iter().zip(log.active.chunks_exact(stream.channels.len().max(1)));
        for (&time_s, active) in samples {
            let channels = layout.channels[stream.channels.clone()].iter();
            for (channel, _) in channels.zip(active).filter(|(_, active)| **active) {
                felt_s[limbs[channel.patch]].push(time_s);
            }
        }
    }
    felt_s
}

/// The last sample of `log` that had arrived by `time_s`.
fn sample_in_effect(log: &StreamLog, time_s: f64) -> Option<usize> {
    log.times_s.partition_point(|&arrival_s| arrival_s <= time_s).checked_sub(1)
}

/// Per joint frame, the share of the time since the frame before for which the channel `idx` of `width` in `log` was
/// on: what is reported holds until the next sample. At the first frame, whether it is on; NaN before the first sample.
fn share_on(log: &StreamLog, idx: usize, width: usize, frame_times_s: &[f64]) -> Vec<f64> {
    let is_on = |sample: usize| f64::from(u8::from(log.active[sample * width + idx]));
    // Per sample, for how long the channel had been on when it arrived.
    let mut been_on_s = Vec::with_capacity(log.times_s.len());
    let mut on_s = 0.0;
    for (sample, &time_s) in log.times_s.iter().enumerate() {
        if let Some(before) = sample.checked_sub(1) {
            on_s += is_on(before) * (time_s - log.times_s[before]);
        }
        been_on_s.push(on_s);
    }
    let mut before = None;
    let of_frame = |&frame_s: &f64| {
        let Some(sample) = sample_in_effect(log, frame_s) else { return f64::NAN };
        let on_s = been_on_s[sample] + is_on(sample) * (frame_s - log.times_s[sample]);
        match before.replace((frame_s, on_s)) {
            Some((last_s, last_on_s)) => ((on_s - last_on_s) / (frame_s - last_s)).clamp(0.0, 1.0),
            None => is_on(sample),
        }
    };
    frame_times_s.iter().map(of_frame).collect()
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
    let baselines = take.spans.iter().filter(|span| span.kind == SpanKind::Baseline);
    // Each span has a mean of its own, and takes a degree of freedom.
    let (mut about_mean, mut steps, mut freedom) = (0.0, 0.0, 0.0);
    for span in baselines {
        let quiet = log
            .times_s
            .iter()
            .enumerate()
            .filter(|(_, time_s)| (span.start_s..=span.end_s).contains(*time_s));
        let readings: Vec<f64> = quiet.map(|(sample, _)| f64::from(log.raw[sample * width + idx])).collect();
        let mean = readings.iter().sum::<f64>() / readings.len() as f64;
        about_mean += readings.iter().map(|reading| (reading - mean).powi(2)).sum::<f64>();
        steps += readings.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>();
        freedom += (readings.len() as f64 - 1.0).max(0.0);
    }
    if freedom == 0.0 {
        return 0.0;
    }
    (about_mean, steps) = (about_mean / freedom, steps / freedom);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_has_the_share_of_its_time_for_which_a_channel_was_on() {
        // Every 30 ms, the first column on from 60 to 150 ms.
        let times_s: Vec<f64> = (0..10).map(|sample| f64::from(sample) * 0.03).collect();
        let active = (0..10).flat_map(|sample| [(2..5).contains(&sample), true]).collect();
        let log = StreamLog { times_s, active, ..StreamLog::default() };
        let shares = share_on(&log, 0, 2, &[-0.1, 0.0, 0.1, 0.2, 0.3, 0.4]);
        assert!(shares[0].is_nan());
        let expected = [0.0, 0.4, 0.5, 0.0, 0.0];
        for (share, expected) in shares[1..].iter().zip(expected) {
            assert!((share - expected).abs() < 1e-9, "{shares:?}");
        }
        let always = share_on(&log, 1, 2, &[0.05, 0.1, 0.4]);
        assert!(always.iter().all(|share| (share - 1.0).abs() < 1e-9), "{always:?}");
    }
}
