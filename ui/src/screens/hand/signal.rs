//! What a taxel says at a moment: recorded, live or simulated, and how that is coloured.

use egui::Color32;
use nalgebra::Isometry3;
use palpate_messages::bits;
use palpate_robot_model::{PoseConfig, SensorKind, Station};
use palpate_wire::proto::{LiveFrame, ReplayTrace};

use crate::{
    take_data::{TakeData, index_at},
    theme::{Palette, taxel_scale},
};

/// The upper end of the colour scale, in thresholds. Fixed: a colour means the same in every frame and every take.
pub(super) const FULL_SCALE_THRESHOLDS: f32 = 4.0;
/// A simulated distance has no natural zero: one step of the scale is this far, m.
pub(super) const DISTANCE_STEP_M: f32 = 0.005;

/// Whose touch is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub(super) enum Signal {
    /// What the hardware (or the emulated station) reported.
    #[default]
    Real,
    /// The nominal simulation of the same motion.
    Nominal,
    /// The compared simulation, usually a calibrated one.
    Calibrated,
    /// The simulation with effects that a diagnosis named.
    Diagnosed,
}

impl Signal {
    /// How many there are.
    pub(super) const COUNT: usize = 4;
    /// All of them: in the order of the paper's figure, and what a diagnosis adds.
    pub(super) const ALL: [Self; Self::COUNT] =
        [Self::Real, Self::Nominal, Self::Calibrated, Self::Diagnosed];

    /// In words.
    pub(super) fn label(self) -> &'static str {
        match self {
            Self::Real => "Real",
            Self::Nominal => "Nominal",
            Self::Calibrated => "Calibrated",
            Self::Diagnosed => "Diagnosed",
        }
    }

    /// Its colour everywhere on the page.
    pub(super) fn color(self, palette: &Palette) -> Color32 {
        match self {
            Self::Real => palette.real,
            Self::Nominal => palette.nominal,
            Self::Calibrated => palette.calibrated,
            Self::Diagnosed => palette.diagnosed,
        }
    }
}

/// How taxels are coloured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub(super) enum Coloring {
    /// By how much they read, on the fixed scale.
    #[default]
    Reading,
    /// By whether they are active.
    Active,
    /// By how much simulation and recording differ over the confirm takes of a diagnosis: what the reading at the cursor
    /// has no part in.
    Mismatch,
}

/// What one channel says at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub(super) struct Sample {
    /// Raw units, Pa or m; `None` where nothing but events is known.
    pub reading: Option<f32>,
    /// What the reading is compared with, same unit.
    pub threshold: Option<f32>,
    /// `None` before the stream's first sample.
    pub active: Option<bool>,
    /// The reading is a distance: it falls as contact gets closer.
    pub is_distance: bool,
}

impl Sample {
    /// The reading in thresholds: 1 where it switches, 0 without touch. `None` without a reading.
    pub(super) fn in_thresholds(&self) -> Option<f32> {
        let (reading, threshold) = (self.reading?, self.threshold?);
        let ratio = if self.is_distance {
            1.0 + (threshold - reading) / DISTANCE_STEP_M
        } else {
            reading / threshold
        };
        ratio.is_finite().then_some(ratio.max(0.0))
    }

    /// Its colour. Without a reading, what is known (active or not) takes the scale's ends.
    pub(super) fn color(&self, coloring: Coloring, signal: Signal, palette: &Palette) -> Color32 {
        let Some(active) = self.active else { return palette.dead };
        match coloring {
            Coloring::Reading => taxel_scale(
                self.in_thresholds()
                    .map_or(if active { 1.0 } else { 0.0 }, |ratio| ratio / FULL_SCALE_THRESHOLDS),
            ),
            Coloring::Active if active => signal.color(palette),
            Coloring::Active => palette.line,
            // Known to the diagnosis alone.
            Coloring::Mismatch => palette.dead,
        }
    }

    /// In words: `34 counts, active`.
    pub(super) fn text(&self, raw_unit: &str, kind: SensorKind, signal: Signal) -> String {
        let state = match self.active {
            Some(true) => "active",
            Some(false) => "not active",
            None => "no sample yet",
        };
        match self.reading {
            Some(reading) => format!("{}, {state}", reading_text(reading, raw_unit, kind, signal)),
            None => state.to_owned(),
        }
    }
}

/// A reading with its unit and sensible digits.
pub(super) fn reading_text(reading: f32, raw_unit: &str, kind: SensorKind, signal: Signal) -> String {
    // Zero added makes 0 of the -0 that a small negative number is rounded to.
    let rounded = reading.round() + 0.0;
    match (signal, kind) {
        (Signal::Real, _) => format!("{rounded:.0} {raw_unit}"),
        (_, SensorKind::Proximity) => format!("{:.1} mm", reading * 1e3),
        (_, SensorKind::Pressure) if reading.abs() >= 1e3 => format!("{:.2} kPa", reading / 1e3),
        (_, SensorKind::Pressure) => format!("{rounded:.0} Pa"),
    }
}

/// What every channel really said at `time_s` of a take, at the streams' own rates.
pub(super) fn recorded(station: &Station, take: &TakeData, time_s: f64) -> Vec<Sample> {
    let num_channels = station.layout.num_channels();
    let frame = take.frame_at(time_s);
    let mut samples = Vec::with_capacity(num_channels);
    for (channel, info) in station.layout.channels.iter().enumerate() {
        let stream_info = &station.layout.streams[info.stream];
        let native = take.stream(&stream_info.id).and_then(|stream| {
            let started = stream.times_s.first().is_some_and(|&first_s| first_s <= time_s);
            let sample_idx = index_at(&stream.times_s, time_s).filter(|_| started)?;
            let width = stream_info.channels.len();
            Some(bits::get(&stream.active, sample_idx * width + channel - stream_info.channels.start))
        });
        samples.push(Sample {
            reading: take.raw_at(time_s, channel, station),
            threshold: station.streams.get(info.stream).map(|stream| stream.on_threshold as f32),
            active: native.or_else(|| frame.map(|frame| take.real_active(frame, channel, num_channels))),
            is_distance: false,
        });
    }
    samples
}

/// What a simulation says every channel felt at `time_s` of a take, on the joint frame in effect.
pub(super) fn simulated(
    station: &Station,
    take: &TakeData,
    replay: &ReplayTrace,
    time_s: f64,
) -> Vec<Sample> {
    let num_channels = station.layout.num_channels();
    let frame = take.frame_at(time_s);
    (0..num_channels)
        .map(|channel| {
            let at = frame.map(|frame| frame * num_channels + channel);
            Sample {
                reading: at.and_then(|at| replay.raw.get(at)).copied(),
                threshold: replay.thresholds.get(channel).copied(),
                active: at.map(|at| bits::get(&replay.active, at)),
                is_distance: kind_of(station, channel) == SensorKind::Proximity,
            }
        })
        .collect()
}

/// What every channel of the live station said last.
pub(super) fn live(station: &Station, frame: &LiveFrame) -> Vec<Sample> {
    station
        .layout
        .channels
        .iter()
        .enumerate()
        .map(|(channel, info)| Sample {
            reading: frame.raw.get(channel).copied(),
            threshold: station.streams.get(info.stream).map(|stream| stream.on_threshold as f32),
            active: (frame.active.len() * 8 >= station.layout.num_channels())
                .then(|| bits::get(&frame.active, channel)),
            is_distance: false,
        })
        .collect()
}

/// How the sensor of a channel works.
pub(super) fn kind_of(station: &Station, channel: usize) -> SensorKind {
    let info = &station.layout.channels[channel];
    station.layout.streams[info.stream].kind
}

/// A pose as the server writes it: x, y, z, then w, x, y, z. `None` if it is none.
pub(super) fn pose_from(numbers: &[f64]) -> Option<Isometry3<f64>> {
    let &[x, y, z, qw, qx, qy, qz] = numbers else { return None };
    PoseConfig { position_m: [x, y, z], quaternion_wxyz: [qw, qx, qy, qz] }.to_isometry().ok()
}

/// A contact of one channel, s since the take's start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Contact {
    /// When it began.
    pub start_s: f64,
    /// When it ended; `None` while it lasts at the end of the take.
    pub end_s: Option<f64>,
}

/// All contacts in a row of samples.
pub(super) fn contacts(times_s: &[f64], active: impl Fn(usize) -> bool) -> Vec<Contact> {
    let mut contacts: Vec<Contact> = Vec::new();
    let mut touching = false;
    for (idx, &time_s) in times_s.iter().enumerate() {
        let now = active(idx);
        if now && !touching {
            contacts.push(Contact { start_s: time_s, end_s: None });
        } else if !now
            && touching
            && let Some(last) = contacts.last_mut()
        {
            last.end_s = Some(time_s);
        }
        touching = now;
    }
    contacts
}

/// The real contacts of a channel, at its stream's own rate where that was recorded.
pub(super) fn real_contacts(station: &Station, take: &TakeData, channel: usize) -> Vec<Contact> {
    let stream_info = &station.layout.streams[station.layout.channels[channel].stream];
    match take.stream(&stream_info.id) {
        Some(stream) => {
            let (width, offset) = (stream_info.channels.len(), channel - stream_info.channels.start);
            contacts(&stream.times_s, |sample_idx| bits::get(&stream.active, sample_idx * width + offset))
        }
        None => contacts(&take.trace.frame_times_s, |frame| {
            take.real_active(frame, channel, station.layout.num_channels())
        }),
    }
}

/// The simulated contacts of a channel.
pub(super) fn simulated_contacts(
    station: &Station,
    take: &TakeData,
    replay: &ReplayTrace,
    channel: usize,
) -> Vec<Contact> {
    let num_channels = station.layout.num_channels();
    contacts(&take.trace.frame_times_s, |frame| bits::get(&replay.active, frame * num_channels + channel))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn one_is_the_threshold_whatever_the_unit() {
        let pressure =
            Sample { reading: Some(40.0), threshold: Some(40.0), active: Some(true), is_distance: false };
        let distance =
            Sample { reading: Some(0.002), threshold: Some(0.002), active: Some(true), is_distance: true };
        assert_eq!(pressure.in_thresholds(), Some(1.0));
        assert_eq!(distance.in_thresholds(), Some(1.0));
        let deeper = Sample { reading: Some(-0.003), ..distance };
        assert!((deeper.in_thresholds().expect("a reading") - 2.0).abs() < 1e-5);
        let far = Sample { reading: Some(0.3), ..distance };
        assert_eq!(far.in_thresholds(), Some(0.0));
        let broken = Sample { threshold: Some(0.0), reading: Some(0.0), ..pressure };
        assert_eq!(broken.in_thresholds(), None);
    }

    #[test]
    fn colours_keep_their_meaning() {
        let palette = Palette::LIGHT;
        let on = Sample { reading: None, threshold: None, active: Some(true), is_distance: false };
        assert_eq!(on.color(Coloring::Active, Signal::Nominal, &palette), palette.nominal);
        assert_eq!(on.color(Coloring::Reading, Signal::Real, &palette), taxel_scale(1.0));
        let unknown = Sample::default();
        assert_eq!(unknown.color(Coloring::Reading, Signal::Real, &palette), palette.dead);
    }

    #[test]
    fn poses_that_are_none_are_refused() {
        assert!(pose_from(&[0.0; 7]).is_none());
        assert!(pose_from(&[]).is_none());
        let pose = pose_from(&[1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0]).expect("a pose");
        assert_eq!(pose.translation.vector.as_slice(), &[1.0, 2.0, 3.0]);
    }

    proptest! {
        #[test]
        fn contacts_are_the_active_spans(active in prop::collection::vec(any::<bool>(), 0..60)) {
            let times: Vec<f64> = (0..active.len()).map(|idx| idx as f64 * 0.1).collect();
            let found = contacts(&times, |idx| active[idx]);
            for (idx, &time_s) in times.iter().enumerate() {
                let inside = found.iter().any(|c| c.start_s <= time_s && c.end_s.is_none_or(|end_s| time_s < end_s));
                prop_assert_eq!(inside, active[idx]);
            }
        }
    }
}
