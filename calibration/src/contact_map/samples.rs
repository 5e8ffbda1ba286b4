//! What the map reads: windows of raw readings.

use std::ops::Range;

use palpate_recording::{StreamLog, Take};

use super::patch_columns;
use crate::CalibrationError;

/// How long before now each reading of a window was in effect, s. The first tells how hard a channel is pressed, the next
/// two how fast that changes, and the last two what a soft layer still recovers from. Multiples of a control step at 20 Hz, so
/// that a robot that reads no faster has the same windows.
pub const LAGS_S: [f64; 5] = [0.0, 0.05, 0.1, 0.2, 0.4];

/// What the map reads of a take.
#[derive(Clone, Debug)]
pub struct MapTake {
    /// Id of the take within its session.
    pub id: String,
    /// Id of its object.
    pub object: String,
    /// Of joint path and readings: takes that hold the same have the same, whatever they are called.
    pub fingerprint: String,
    /// Host time of each joint frame since the take's start, s.
    pub frame_times_s: Vec<f64>,
    /// What the station's thresholds say at each frame, `[frame * num_channels + channel]`.
    pub thresholded: Vec<bool>,
    num_channels: usize,
    num_lags: usize,
    streams: Vec<StreamWindows>,
}

/// Windows of the channels of one stream at each frame.
#[derive(Clone, Debug)]
struct StreamWindows {
    id: String,
    channels: Range<usize>,
    /// Columns of each patch.
    patches: Vec<Range<usize>>,
    /// Readings above reference, raw units, `[(frame * num_columns + column) * num_lags + lag]`; empty where the take holds
    /// no raw readings of the stream.
    readings: Vec<f32>,
}

impl MapTake {
    /// Windows of `take` with readings `lags_s` before each joint frame.
    ///
    /// # Errors
    /// A take that holds no raw readings.
    pub fn from_take(take: &Take, lags_s: &[f64]) -> Result<Self, CalibrationError> {
        if !take.has_raw() {
            return Err(CalibrationError::Input(format!(
                "take {:?} holds no raw readings, only what thresholds made of them; record or import it with raw \
                 readings, or leave it out",
                take.id
            )));
        }
        let layout = &take.station.layout;
        let streams = layout.streams.iter().zip(&take.streams).enumerate();
        let streams = streams.map(|(idx, (stream, log))| StreamWindows {
            id: stream.id.clone(),
            channels: stream.channels.clone(),
            patches: patch_columns(&take.station, idx),
            readings: windows(log, stream.channels.len(), &take.joints.times_s, lags_s),
        });
        Ok(Self {
            id: take.id.clone(),
            object: take.meta.object.clone(),
            fingerprint: fingerprint(take),
            frame_times_s: take.joints.times_s.clone(),
            thresholded: take.active_at_frames(),
            num_channels: layout.num_channels(),
            num_lags: lags_s.len(),
            streams: streams.collect(),
        })
    }

    /// Number of joint frames.
    pub fn num_frames(&self) -> usize {
        self.frame_times_s.len()
    }

    /// Number of channels of all streams.
    pub fn num_channels(&self) -> usize {
        self.num_channels
    }

    /// Whether it holds raw readings of this stream.
    pub(crate) fn has_raw(&self, stream: &str) -> bool {
        self.streams.iter().any(|windows| windows.id == stream && !windows.readings.is_empty())
    }

    /// The reading of each frame above its reference, raw units, of the channel in `column` of `stream`.
    pub(crate) fn newest_readings(&self, stream: &str, column: usize) -> impl Iterator<Item = f64> + '_ {
        let windows = self.streams.iter().find(|windows| windows.id == stream);
        let step = windows.map_or(1, |windows| windows.channels.len() * self.num_lags).max(1);
        let readings = windows.map_or(&[][..], |windows| &windows.readings);
        readings.iter().skip(column * self.num_lags).step_by(step).map(|&reading| f64::from(reading))
    }

    /// Inputs of the network of `stream`, whose channels have these scales.
    pub(crate) fn stream_inputs<'a>(
        &'a self,
        stream: &str,
        scales_raw: &'a [f64],
    ) -> Result<Inputs<'a>, CalibrationError> {
        let windows =
            self.streams.iter().find(|windows| windows.id == stream && !windows.readings.is_empty());
        let windows = windows.ok_or_else(|| {
            CalibrationError::Input(format!(
                "take {:?} holds no raw readings of stream {stream:?}, which the contact map reads",
                self.id
            ))
        })?;
        Ok(Inputs {
            channels: windows.channels.clone(),
            patches: &windows.patches,
            num_lags: self.num_lags,
            readings: &windows.readings,
            scales_raw,
        })
    }
}

/// Inputs of the network of one stream at every frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InputsOf<'a> {
    pub(crate) patches: &'a [Range<usize>],
    pub(crate) num_lags: usize,
    pub(crate) scales_raw: &'a [f64],
}

/// The same with the readings of a take.
#[derive(Clone, Debug)]
pub(crate) struct Inputs<'a> {
    /// Channels of the stream, among those of the layout.
    pub(crate) channels: Range<usize>,
    patches: &'a [Range<usize>],
    num_lags: usize,
    readings: &'a [f32],
    scales_raw: &'a [f64],
}

impl Inputs<'_> {
    fn shape(&self) -> InputsOf<'_> {
        InputsOf { patches: self.patches, num_lags: self.num_lags, scales_raw: self.scales_raw }
    }

    /// Numbers of one input.
    pub(crate) fn len(&self) -> usize {
        num_inputs(self.patches, self.num_lags)
    }

    /// The input of the channel in `column` at `frame`.
    pub(crate) fn read(&self, frame: usize, column: usize, input: &mut [f64]) {
        let row = self.channels.len() * self.num_lags;
        self.shape().read(&self.readings[frame * row..(frame + 1) * row], column, input);
    }
}

impl InputsOf<'_> {
    /// The input of the channel in `column`, from the readings of a frame, `[column * num_lags + lag]`.
    pub(crate) fn read(&self, readings: &[f32], column: usize, input: &mut [f64]) {
        let scaled = |column: usize, lag: usize| {
            (f64::from(readings[column * self.num_lags + lag]) / self.scales_raw[column]).asinh()
        };
        let (own, others) = input.split_at_mut(self.num_lags);
        for (lag, own) in own.iter_mut().enumerate() {
            *own = scaled(column, lag);
        }
        if others.is_empty() {
            return;
        }
        others.fill(0.0);
        let Some(patch) = self.patches.iter().find(|patch| patch.contains(&column)) else { return };
        let share = 1.0 / (patch.len().max(2) - 1) as f64;
        for other in patch.clone().filter(|&other| other != column) {
            for (lag, others) in others.iter_mut().enumerate() {
                *others += share * scaled(other, lag);
            }
        }
    }
}

/// Numbers of an input of a stream with these patches.
pub(crate) fn num_inputs(patches: &[Range<usize>], num_lags: usize) -> usize {
    if patches.iter().any(|patch| patch.len() > 1) { 2 * num_lags } else { num_lags }
}

/// Readings of `log` above their reference at each of `times_s` and `lags_s` before.
fn windows(log: &StreamLog, width: usize, times_s: &[f64], lags_s: &[f64]) -> Vec<f32> {
    if log.raw.is_empty() || width == 0 {
        return Vec::new();
    }
    let mut readings = Vec::with_capacity(times_s.len() * width * lags_s.len());
    let mut samples = vec![0; lags_s.len()];
    for &time_s in times_s {
        for (sample, &lag_s) in samples.iter_mut().zip(lags_s) {
            *sample = in_effect(&log.times_s, time_s - lag_s);
        }
        for column in 0..width {
            readings.extend(samples.iter().map(|&sample| {
                let reference = log.reference_at(log.times_s[sample]).get(column).copied();
                log.raw[sample * width + column] - reference.unwrap_or_default()
            }));
        }
    }
    readings
}

/// Index of the newest of `times_s` at or before `time_s`; the first before that.
fn in_effect(times_s: &[f64], time_s: f64) -> usize {
    times_s.partition_point(|&sample_s| sample_s <= time_s + TIME_TOLERANCE_S).saturating_sub(1)
}

/// Where samples come at multiples of a control step, as lags are, neither is exact in binary.
pub(crate) const TIME_TOLERANCE_S: f64 = 1e-6;

/// FNV-1a over times, joint positions and readings: no guard against forgery, but no two recordings share it by chance.
fn fingerprint(take: &Take) -> String {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let mut add = |bits: u64| {
        for byte in bits.to_le_bytes() {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    };
    let joints = take.joints.times_s.iter().chain(&take.joints.positions);
    joints.for_each(|number| add(number.to_bits()));
    for stream in &take.streams {
        stream.raw.iter().for_each(|reading| add(u64::from(reading.to_bits())));
    }
    format!("{hash:016x}")
}
