//! Learning a map.

use std::collections::BTreeMap;

use palpate_robot_model::{Station, StreamConfig};
use palpate_sim::SensorModel;
use rand::seq::SliceRandom as _;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::network::{Network, logistic_loss};
use super::samples::{LAGS_S, MapTake, num_inputs};
use super::{ContactMap, FittedTake, StreamMap, Switching, patch_columns};
use crate::CalibrationError;

/// How to learn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapConfig {
    /// Units of the hidden layer; 0 leaves the linear one alone.
    pub hidden: usize,
    /// Steps of AdamW.
    pub steps: usize,
    /// Seed of first weights and of the order of samples.
    pub seed: u64,
}

impl Default for MapConfig {
    fn default() -> Self {
        Self { hidden: 8, steps: 2000, seed: 0 }
    }
}

/// A map, and how it fits the takes that it was fitted to.
#[derive(Clone, Debug)]
pub struct MapFit {
    /// The map.
    pub map: ContactMap,
    /// By stream id.
    pub streams: BTreeMap<String, StreamFitted>,
    /// What a reader of the numbers should know.
    pub notes: Vec<String>,
}

/// How the network of a stream fits the takes that it was fitted to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamFitted {
    /// Channel-frames.
    pub samples: usize,
    /// Share of them that are contact, as the geometry says.
    pub contact: f64,
    /// Mean logistic loss.
    pub loss: f64,
    /// F1 over channel-frames.
    pub f1: f64,
}

/// Samples of a step.
const BATCH: usize = 256;
/// Step size of AdamW at the start; it falls to 0 along half a cosine.
const LEARNING_RATE: f64 = 0.02;
/// Decay of the network's weights, as AdamW's.
const WEIGHT_DECAY: f64 = 1e-3;
/// Decay of the offsets of channels: they are for sensors that are off, and few frames may speak for one.
const OFFSET_DECAY: f64 = 0.1;
/// A channel whose readings in contact are known from fewer frames than this has the scale of its stream.
const MIN_CONTACT_FRAMES: usize = 20;
/// How far the scale of a channel may be from that of its stream, as a factor: sensors of one make differ by less, and a
/// channel that is dead must not have its noise taken for readings.
const MAX_GAIN: f64 = 4.0;
/// Of samples without contact and with readings near rest, one in so many is kept, with that weight: most samples are of
/// this kind, and they say the same thing over and over.
const QUIET_SHARE: usize = 8;
/// Readings below this are near rest, units of the channel.
const QUIET: f64 = 0.3;
/// How far below the threshold at which it switches on a channel may switch off, logarithm of the odds.
const RELEASES: [f64; 5] = [0.0, 0.5, 1.0, 2.0, 4.0];
/// Thresholds that are tried with each of these lie in a span of this width, a quarter of it below the best without.
const THRESHOLDS_SPAN: f64 = 6.0;
/// How many are tried.
const NUM_THRESHOLDS: usize = 24;

/// Fits a map to `takes`, all of which it sees: takes to judge it on are the caller's to keep. `targets` say for each take
/// which channels are in contact, `[frame * num_channels + channel]`, as `target` sees them.
///
/// A stream without raw readings, or without contact in `takes`, keeps the station's thresholds, and a note says so. The
/// result depends on the arguments alone, to the bit, for any number of threads.
///
/// # Errors
/// Nothing to learn from: no stream has both raw readings and contact.
pub fn fit(
    config: &MapConfig,
    station: &Station,
    target: &SensorModel,
    takes: &[&MapTake],
    targets: &[&[bool]],
) -> Result<MapFit, CalibrationError> {
    let fail = |problem: String| Err(CalibrationError::Input(problem));
    for (take, target) in takes.iter().zip(targets) {
        if target.len() != take.thresholded.len() {
            return fail(format!(
                "take {:?}: {} contacts, but {} channel-frames; simulate the contacts of this take",
                take.id,
                target.len(),
                take.thresholded.len()
            ));
        }
    }
    let layout = &station.layout;
    let mut notes = Vec::new();
    let mut learnable = Vec::new();
    for (idx, stream) in layout.streams.iter().enumerate() {
        let lacking = takes.iter().find(|take| !take.has_raw(&stream.id));
        let in_contact = takes.iter().zip(targets).any(|(take, target)| {
            target
                .chunks_exact(take.num_channels())
                .any(|frame| frame[stream.channels.clone()].contains(&true))
        });
        let why = match lacking {
            Some(take) => format!("take {:?} holds no raw readings of it", take.id),
            None if !in_contact => "nothing touches it in the fitted takes".to_owned(),
            None => {
                learnable.push(idx);
                continue;
            }
        };
        notes.push(format!("stream {:?} keeps the station's thresholds: {why}", stream.id));
    }
    if learnable.is_empty() {
        return fail(format!("there is nothing to learn a contact map from: {}", notes.join("; ")));
    }
    let learned: Vec<(StreamMap, StreamFitted, Vec<String>)> = learnable
        .into_par_iter()
        .map(|stream| StreamSamples::new(station, stream, takes, targets)?.learn(config))
        .collect::<Result<_, CalibrationError>>()?;
    let mut streams = BTreeMap::new();
    let mut maps = Vec::new();
    for (map, fitted, of_stream) in learned {
        streams.insert(map.id.clone(), fitted);
        notes.extend(of_stream);
        maps.push(map);
    }
    let ids: Vec<&str> = takes.iter().map(|take| take.id.as_str()).collect();
    let map = ContactMap {
        name: format!("contact map for {:?}", target.name),
        station: station.id.clone(),
        lags_s: LAGS_S.to_vec(),
        target: target.to_toml(),
        provenance: vec![
            format!("fitted by palpate {} with seed {}", env!("CARGO_PKG_VERSION"), config.seed),
            format!("fitted takes: {}", ids.join(", ")),
        ],
        takes: takes
            .iter()
            .map(|take| FittedTake { id: take.id.clone(), fingerprint: take.fingerprint.clone() })
            .collect(),
        streams: maps,
    };
    Ok(MapFit { map, streams, notes })
}

/// Everything that the network of a stream learns from.
struct StreamSamples {
    /// Index of the stream, which parts its random numbers from those of others.
    stream: usize,
    id: String,
    channels: Vec<String>,
    scales_raw: Vec<f64>,
    num_inputs: usize,
    /// `[sample * num_inputs + input]`, frame by frame, column by column.
    inputs: Vec<f64>,
    is_contact: Vec<bool>,
    /// Index of the first sample of each take.
    starts: Vec<usize>,
    notes: Vec<String>,
}

impl StreamSamples {
    fn new(
        station: &Station,
        stream: usize,
        takes: &[&MapTake],
        targets: &[&[bool]],
    ) -> Result<Self, CalibrationError> {
        let of_stream = &station.layout.streams[stream];
        let channels: Vec<String> =
            station.layout.channels[of_stream.channels.clone()].iter().map(|c| c.id.clone()).collect();
        let mut notes = Vec::new();
        let scales_raw = scales(&station.streams[stream], &channels, &mut notes, |column| {
            let first = of_stream.channels.start;
            let of_take = move |(take, target): (&&MapTake, &&[bool])| {
                let contacts = target.iter().skip(first + column).step_by(take.num_channels());
                let readings = take.newest_readings(&of_stream.id, column).zip(contacts);
                readings.filter(|(_, contact)| **contact).map(|(reading, _)| reading).collect::<Vec<f64>>()
            };
            takes.iter().zip(targets).flat_map(of_take).collect()
        });
        let mut samples = Self {
            stream,
            id: of_stream.id.clone(),
            num_inputs: num_inputs(&patch_columns(station, stream), LAGS_S.len()),
            channels,
            scales_raw,
            inputs: Vec::new(),
            is_contact: Vec::new(),
            starts: Vec::new(),
            notes,
        };
        let mut input = vec![0.0; samples.num_inputs];
        for (take, target) in takes.iter().zip(targets) {
            samples.starts.push(samples.is_contact.len());
            let inputs = take.stream_inputs(&of_stream.id, &samples.scales_raw)?;
            for (frame, contacts) in target.chunks_exact(take.num_channels()).enumerate() {
                for column in 0..samples.channels.len() {
                    inputs.read(frame, column, &mut input);
                    samples.inputs.extend_from_slice(&input);
                    samples.is_contact.push(contacts[of_stream.channels.start + column]);
                }
            }
        }
        Ok(samples)
    }

    fn input(&self, sample: usize) -> &[f64] {
        &self.inputs[sample * self.num_inputs..(sample + 1) * self.num_inputs]
    }

    fn column(&self, sample: usize) -> usize {
        sample % self.channels.len()
    }

    /// The samples that steps are made of, each with its weight.
    fn chosen(&self, rng: &mut ChaCha8Rng) -> Vec<(usize, f64)> {
        let quiet = QUIET.asinh();
        let choose = |sample: usize| {
            let is_quiet =
                !self.is_contact[sample] && self.input(sample).iter().all(|value| value.abs() < quiet);
            if !is_quiet {
                return Some((sample, 1.0));
            }
            (rng.random_range(0..QUIET_SHARE) == 0).then_some((sample, QUIET_SHARE as f64))
        };
        (0..self.is_contact.len()).filter_map(choose).collect()
    }

    fn learn(self, config: &MapConfig) -> Result<(StreamMap, StreamFitted, Vec<String>), CalibrationError> {
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        rng.set_stream(self.stream as u64);
        let (num_inputs, num_channels) = (self.num_inputs, self.channels.len());
        let num_weights = Network::num_weights(num_inputs, config.hidden);
        // Units begin apart from each other and with no say.
        let size = 1.0 / (num_inputs as f64).sqrt();
        let num_inner = config.hidden * (num_inputs + 1);
        let first = |idx: usize| if idx < num_inner { rng.random_range(-size..size) * 2.0 } else { 0.0 };
        let weights: Vec<f64> = (0..num_weights).map(first).collect();
        let Some(mut network) = Network::new(num_inputs, config.hidden, weights) else {
            return Err(CalibrationError::Input("a network of another shape than its weights".to_owned()));
        };
        let mut offsets = vec![0.0; num_channels];
        let mut chosen = self.chosen(&mut rng);
        let mut optimiser = AdamW::new(num_weights + num_channels);
        let mut gradient = vec![0.0; num_weights + num_channels];
        let mut next = chosen.len();
        for step in 0..config.steps {
            gradient.fill(0.0);
            let mut weight_sum = 0.0;
            for _ in 0..BATCH.min(chosen.len()) {
                if next == chosen.len() {
                    chosen.shuffle(&mut rng);
                    next = 0;
                }
                let (sample, weight) = chosen[next];
                next += 1;
                weight_sum += weight;
                let (input, column) = (self.input(sample), self.column(sample));
                let logit = network.logit(input) + offsets[column];
                let slope = weight * logistic_loss(logit, self.is_contact[sample]).1;
                network.add_gradient(input, slope, &mut gradient[..num_weights]);
                gradient[num_weights + column] += slope;
            }
            gradient.iter_mut().for_each(|slope| *slope /= weight_sum);
            let done = step as f64 / config.steps as f64;
            let rate = LEARNING_RATE * 0.5 * (1.0 + (std::f64::consts::PI * done).cos());
            optimiser.steps += 1;
            optimiser.step(&mut network.weights, &gradient, 0, rate, WEIGHT_DECAY);
            optimiser.step(&mut offsets, &gradient, num_weights, rate, OFFSET_DECAY);
        }
        let logits: Vec<f64> = (0..self.is_contact.len())
            .map(|sample| network.logit(self.input(sample)) + offsets[self.column(sample)])
            .collect();
        if logits.iter().any(|logit| !logit.is_finite()) {
            return Err(CalibrationError::Input(format!(
                "stream {:?}: the contact map did not converge; look for readings that are out of bounds with `palpate \
                 session check`",
                self.id
            )));
        }
        let switched =
            Switched { logits: &logits, is_contact: &self.is_contact, num_channels, starts: &self.starts };
        let (switching, f1) = switched.best();
        let losses =
            logits.iter().zip(&self.is_contact).map(|(&logit, &contact)| logistic_loss(logit, contact).0);
        let num_samples = logits.len().max(1) as f64;
        let fitted = StreamFitted {
            samples: logits.len(),
            contact: self.is_contact.iter().filter(|&&contact| contact).count() as f64 / num_samples,
            loss: losses.sum::<f64>() / num_samples,
            f1,
        };
        let map = StreamMap {
            id: self.id,
            channels: self.channels,
            scales_raw: self.scales_raw,
            offsets,
            switching,
            network,
        };
        Ok((map, fitted, self.notes))
    }
}

/// One unit of each channel's inputs, raw units: the stream's threshold, more for channels that read more in contact than
/// others. Readings in contact of each column come from `in_contact`. The threshold is a unit only, since any would do: what
/// counts as contact is learned.
fn scales(
    config: &StreamConfig,
    channels: &[String],
    notes: &mut Vec<String>,
    in_contact: impl Fn(usize) -> Vec<f64>,
) -> Vec<f64> {
    let size = |readings: Vec<f64>| {
        let squares: f64 = readings.iter().map(|reading| reading * reading).sum();
        (readings.len() >= MIN_CONTACT_FRAMES).then(|| (squares / readings.len() as f64).sqrt())
    };
    let sizes: Vec<Option<f64>> = (0..channels.len()).map(|column| size(in_contact(column))).collect();
    let untouched: Vec<&str> =
        channels.iter().zip(&sizes).filter(|(_, size)| size.is_none()).map(|(id, _)| id.as_str()).collect();
    if !untouched.is_empty() {
        notes.push(format!(
            "touched in fewer than {MIN_CONTACT_FRAMES} frames of the fitted takes, so with the scale of their stream {:?}: {}",
            config.stream,
            untouched.join(", ")
        ));
    }
    let mut known: Vec<f64> = sizes.iter().flatten().copied().collect();
    known.sort_unstable_by(f64::total_cmp);
    let typical = known.get(known.len() / 2).copied().unwrap_or(1.0).max(f64::MIN_POSITIVE);
    let unit = if config.on_threshold > 0.0 { config.on_threshold } else { 1.0 };
    let scale =
        |size: Option<f64>| unit * size.map_or(1.0, |size| (size / typical).clamp(1.0 / MAX_GAIN, MAX_GAIN));
    sizes.into_iter().map(scale).collect()
}

/// The threshold with the largest F1, halfway between two logits, and that F1.
fn best_threshold(logits: &[f64], is_contact: &[bool]) -> (f64, f64) {
    let mut order: Vec<usize> = (0..logits.len()).collect();
    order.sort_unstable_by(|&one, &other| logits[other].total_cmp(&logits[one]).then(one.cmp(&other)));
    let num_contact = is_contact.iter().filter(|&&contact| contact).count();
    let (mut best, mut true_positives) = ((f64::INFINITY, 0.0), 0_usize);
    for (rank, &sample) in order.iter().enumerate() {
        true_positives += usize::from(is_contact[sample]);
        let below = order.get(rank + 1).map_or(f64::NEG_INFINITY, |&next| logits[next]);
        if below == logits[sample] {
            continue;
        }
        let f1 = 2.0 * true_positives as f64 / (rank + 1 + num_contact) as f64;
        if f1 > best.1 {
            let threshold =
                if below.is_finite() { 0.5 * (below + logits[sample]) } else { logits[sample] - 1.0 };
            best = (threshold, f1);
        }
    }
    // Without any contact nothing is one.
    if best.0.is_finite() { best } else { (logits.iter().copied().fold(0.0, f64::max), 0.0) }
}

/// Logits of the fitted takes, frame by frame, channel by channel.
struct Switched<'a> {
    logits: &'a [f64],
    is_contact: &'a [bool],
    num_channels: usize,
    /// Index of the first sample of each take, where every channel is off.
    starts: &'a [usize],
}

impl Switched<'_> {
    /// How channels switch with the largest F1, among thresholds near the best without hysteresis; and that F1.
    fn best(&self) -> (Switching, f64) {
        let (threshold, f1) = best_threshold(self.logits, self.is_contact);
        let mut best = (Switching { on: threshold, off: threshold }, f1);
        for release in RELEASES {
            for step in 0..=NUM_THRESHOLDS {
                let on = threshold + THRESHOLDS_SPAN * (step as f64 / NUM_THRESHOLDS as f64 - 0.25);
                let switching = Switching { on, off: on - release };
                let f1 = self.f1(switching);
                if f1 > best.1 {
                    best = (switching, f1);
                }
            }
        }
        best
    }

    fn f1(&self, switching: Switching) -> f64 {
        let mut active = vec![false; self.num_channels];
        let (mut true_positives, mut num_active, mut num_contact) = (0_usize, 0_usize, 0_usize);
        for (sample, (&logit, &contact)) in self.logits.iter().zip(self.is_contact).enumerate() {
            let column = sample % self.num_channels;
            if column == 0 && self.starts.binary_search(&sample).is_ok() {
                active.fill(false);
            }
            active[column] = switching.is_active(logit, active[column]);
            num_active += usize::from(active[column]);
            num_contact += usize::from(contact);
            true_positives += usize::from(active[column] && contact);
        }
        2.0 * true_positives as f64 / (num_active + num_contact).max(1) as f64
    }
}

/// AdamW (Loshchilov and Hutter 2019) in 64 bits.
struct AdamW {
    steps: i32,
    first: Vec<f64>,
    second: Vec<f64>,
}

impl AdamW {
    fn new(len: usize) -> Self {
        Self { steps: 0, first: vec![0.0; len], second: vec![0.0; len] }
    }

    /// Moves `values`, which are those from `from` on of all that there are.
    fn step(&mut self, values: &mut [f64], gradient: &[f64], from: usize, rate: f64, decay: f64) {
        const BETA_1: f64 = 0.9;
        const BETA_2: f64 = 0.999;
        const EPSILON: f64 = 1e-8;
        let corrections = [1.0 - BETA_1.powi(self.steps), 1.0 - BETA_2.powi(self.steps)];
        for (idx, value) in values.iter_mut().enumerate() {
            let slope = gradient[from + idx];
            let (first, second) = (&mut self.first[from + idx], &mut self.second[from + idx]);
            *first = BETA_1 * *first + (1.0 - BETA_1) * slope;
            *second = BETA_2 * *second + (1.0 - BETA_2) * slope * slope;
            let step = (*first / corrections[0]) / ((*second / corrections[1]).sqrt() + EPSILON);
            *value -= rate * (step + decay * *value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threshold_with_the_largest_f1_is_found() {
        let logits = [2.0, 1.0, 0.0, -1.0, -2.0];
        assert_eq!(best_threshold(&logits, &[true, true, false, false, false]), (0.5, 1.0));
        // Two of three contacts without a mistake have an F1 of 0.8, all three with one mistake 6/7.
        let (threshold, f1) = best_threshold(&logits, &[true, true, false, true, false]);
        assert_eq!((threshold, f1), (-1.5, 6.0 / 7.0));
        assert_eq!(best_threshold(&logits, &[false; 5]), (2.0, 0.0));
    }

    #[test]
    fn a_channel_that_hovers_at_its_threshold_gets_hysteresis() {
        let logits = [0.2, 3.0, 0.5, 3.0, 0.5, 3.0, -9.0, 1.0, 0.2, 0.2, 1.0, 0.2];
        let is_contact = [false, true, true, true, true, true, false, false, false, false, false, false];
        let switched = Switched { logits: &logits, is_contact: &is_contact, num_channels: 1, starts: &[0] };
        let (switching, f1) = switched.best();
        assert_eq!(f1, 1.0);
        assert!(switching.on > 1.0 && switching.off < 0.5, "{switching:?}");
    }

    #[test]
    fn samples_of_equal_logit_are_on_one_side() {
        assert_eq!(best_threshold(&[1.0, 1.0, 0.0], &[true, false, false]), (0.5, 2.0 / 3.0));
    }
}
