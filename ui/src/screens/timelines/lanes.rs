//! The lanes of a take: contacts of real and simulated touch, and where they differ, worked out once when it opens.

use palpate_messages::bits;
use palpate_robot_model::{SensorKind, Station};
use palpate_wire::proto::ReplayTrace;

use super::{
    events::{Event, OnsetPair, pair_onsets, runs},
    pyramid::MinMaxPyramid,
};
use crate::take_data::TakeData;

/// Onsets farther apart than this are no pair for the arrows, s.
const PAIR_REACH_S: f64 = 1.0;

/// What one simulation says in a lane, set against the real contacts.
#[derive(Clone, Debug, Default)]
pub struct SimRow {
    /// All its contacts.
    pub contacts: Vec<Event>,
    /// Contacts that are real too.
    pub both: Vec<Event>,
    /// Simulated, not real.
    pub simulated_only: Vec<Event>,
    /// Real, not simulated.
    pub real_only: Vec<Event>,
    /// Onsets that belong together.
    pub onsets: Vec<OnsetPair>,
}

/// One channel, or all channels of a stream together.
#[derive(Clone, Debug)]
pub struct Lane {
    /// What it shows, e.g. `Index tip · 3` or `TwinTac, any`.
    pub name: String,
    /// The channel; `None` for a whole stream.
    pub channel: Option<usize>,
    /// Its stream.
    pub stream: usize,
    /// Real contacts.
    pub real: Vec<Event>,
    /// One row per simulation, in the order they were given.
    pub sims: Vec<SimRow>,
}

/// Where a simulation begins to differ from the real contacts of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mismatch {
    /// When, s.
    pub start_s: f64,
    /// On which channel.
    pub channel: usize,
    /// What differs.
    pub kind: MismatchKind,
}

/// What differs, and by how many seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MismatchKind {
    /// The simulated contact begins later than the real one.
    OnsetLate(f64),
    /// It begins earlier.
    OnsetEarly(f64),
    /// The simulated contact ends while the real one goes on.
    ReleaseEarly(f64),
    /// It goes on while the real one has ended.
    ReleaseLate(f64),
    /// Real, and not simulated at all: how long.
    Missed(f64),
    /// Simulated, and not real at all: how long.
    Invented(f64),
}

impl MismatchKind {
    /// In words, e.g. `onset late by 210 ms`.
    pub fn words(self) -> String {
        let (what, seconds) = match self {
            Self::OnsetLate(seconds) => ("onset late by", seconds),
            Self::OnsetEarly(seconds) => ("onset early by", seconds),
            Self::ReleaseEarly(seconds) => ("release early by", seconds),
            Self::ReleaseLate(seconds) => ("release late by", seconds),
            Self::Missed(seconds) => ("real only, for", seconds),
            Self::Invented(seconds) => ("simulated only, for", seconds),
        };
        format!("{what} {:.0} ms", seconds * 1e3)
    }

    /// `event` is real and not simulated.
    fn of_real(event: &Event, row: &SimRow) -> Self {
        let length_s = event.end_s - event.start_s;
        if row.contacts.iter().any(|contact| contact.start_s == event.end_s) {
            Self::OnsetLate(length_s)
        } else if row.contacts.iter().any(|contact| contact.end_s == event.start_s) {
            Self::ReleaseEarly(length_s)
        } else {
            Self::Missed(length_s)
        }
    }

    /// `event` is simulated and not real.
    fn of_simulated(event: &Event, real: &[Event]) -> Self {
        let length_s = event.end_s - event.start_s;
        if real.iter().any(|contact| contact.start_s == event.end_s) {
            Self::OnsetEarly(length_s)
        } else if real.iter().any(|contact| contact.end_s == event.start_s) {
            Self::ReleaseLate(length_s)
        } else {
            Self::Invented(length_s)
        }
    }
}

/// A channel's raw reading.
#[derive(Clone, Debug)]
pub struct RawTrace {
    /// Lowest and highest of any range of samples.
    pub pyramid: MinMaxPyramid,
    /// Lowest and highest of all, with the threshold between them, raw units less the reference value.
    pub range: [f32; 2],
    /// A reading over this is a contact.
    pub threshold: f32,
}

/// Every lane of a take.
#[derive(Clone, Debug, Default)]
pub struct TakeLanes {
    /// One lane per stream, proximity first, as in the paper's figure.
    pub streams: Vec<Lane>,
    /// One lane per channel, in channel order.
    pub channels: Vec<Lane>,
    /// Raw readings, in channel order; `None` for binary takes.
    pub raw: Vec<Option<RawTrace>>,
}

impl TakeLanes {
    /// Works out the lanes. The take and the replays must have been checked against the station.
    pub fn new(take: &TakeData, replays: &[&ReplayTrace], station: &Station) -> Self {
        let layout = &station.layout;
        let num_channels = layout.num_channels();
        let lane = |name: String, channel: Option<usize>, stream: usize, channels: std::ops::Range<usize>| {
            let active = |bytes: &[u8]| -> Vec<bool> {
                (0..take.num_frames())
                    .map(|frame| {
                        channels.clone().any(|channel| bits::get(bytes, frame * num_channels + channel))
                    })
                    .collect()
            };
            let real = active(&take.trace.real_active);
            let sims: Vec<Vec<bool>> = replays.iter().map(|replay| active(&replay.active)).collect();
            build_lane(name, channel, stream, &take.trace.frame_times_s, &real, &sims)
        };
        let mut stream_order: Vec<usize> = (0..layout.streams.len()).collect();
        stream_order.sort_by_key(|&idx| layout.streams[idx].kind != SensorKind::Proximity);
        let streams = stream_order
            .into_iter()
            .map(|idx| {
                let stream = &layout.streams[idx];
                lane(format!("{}, any", stream.label), None, idx, stream.channels.clone())
            })
            .collect();
        let channels = layout
            .channels
            .iter()
            .enumerate()
            .map(|(idx, channel)| lane(layout.channel_label(idx), Some(idx), channel.stream, idx..idx + 1))
            .collect();
        let raw = (0..num_channels).map(|channel| raw_trace(take, channel, station)).collect();
        Self { streams, channels, raw }
    }

    /// Channels that were touched, in reality or in any simulation.
    pub fn touched(&self) -> Vec<usize> {
        self.channels
            .iter()
            .filter(|lane| {
                !lane.real.is_empty() || lane.sims.iter().any(|sim| !sim.simulated_only.is_empty())
            })
            .filter_map(|lane| lane.channel)
            .collect()
    }

    /// Where the differences between real contacts and simulation `sim` begin on any of `channels`, in order of time,
    /// then of channels.
    pub fn mismatches(&self, channels: &[usize], sim: usize) -> Vec<Mismatch> {
        let mut mismatches = Vec::new();
        for &channel in channels {
            let Some(lane) = self.channels.get(channel) else { continue };
            let Some(row) = lane.sims.get(sim) else { continue };
            let kinds = row.real_only.iter().map(|event| (event, MismatchKind::of_real(event, row)));
            let simulated = row.simulated_only.iter();
            let kinds =
                kinds.chain(simulated.map(|event| (event, MismatchKind::of_simulated(event, &lane.real))));
            mismatches.extend(kinds.map(|(event, kind)| Mismatch { start_s: event.start_s, channel, kind }));
        }
        mismatches.sort_by(|a, b| a.start_s.total_cmp(&b.start_s).then(a.channel.cmp(&b.channel)));
        mismatches
    }
}

fn build_lane(
    name: String,
    channel: Option<usize>,
    stream: usize,
    times_s: &[f64],
    real: &[bool],
    sims: &[Vec<bool>],
) -> Lane {
    // The last frame lasts as long as the one before it.
    let end_s = match times_s {
        [.., before_s, last_s] => last_s + (last_s - before_s),
        [only_s] => *only_s,
        [] => 0.0,
    };
    let real_events = runs(times_s, end_s, real.iter().copied());
    let sims = sims
        .iter()
        .map(|sim| {
            let pairs = || real.iter().zip(sim).map(|(&real, &sim)| (real, sim));
            let events = runs(times_s, end_s, sim.iter().copied());
            SimRow {
                both: runs(times_s, end_s, pairs().map(|(real, sim)| real && sim)),
                simulated_only: runs(times_s, end_s, pairs().map(|(real, sim)| sim && !real)),
                real_only: runs(times_s, end_s, pairs().map(|(real, sim)| real && !sim)),
                onsets: pair_onsets(&real_events, &events, PAIR_REACH_S),
                contacts: events,
            }
        })
        .collect();
    Lane { name, channel, stream, real: real_events, sims }
}

fn raw_trace(take: &TakeData, channel: usize, station: &Station) -> Option<RawTrace> {
    let stream_idx = station.layout.channels[channel].stream;
    let stream_info = &station.layout.streams[stream_idx];
    let stream = take.stream(&stream_info.id).filter(|stream| !stream.raw.is_empty())?;
    let width = stream_info.channels.len();
    let offset = channel - stream_info.channels.start;
    let pyramid = MinMaxPyramid::new(stream.raw.iter().skip(offset).step_by(width).copied());
    let threshold = station.streams.get(stream_idx).map_or(0.0, |config| config.on_threshold as f32);
    let [lowest, highest] = pyramid.min_max(0..stream.times_s.len())?;
    Some(RawTrace {
        pyramid,
        range: [lowest.min(0.0), highest.max(threshold * 1.2).max(lowest + 1e-6)],
        threshold,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_told_apart_by_side() {
        let times_s: Vec<f64> = (0..8).map(f64::from).collect();
        let real = [false, true, true, true, false, false, false, false];
        let sim = vec![false, false, true, true, true, false, true, false];
        let lane = build_lane("a".into(), Some(0), 0, &times_s, &real, &[sim]);
        let row = &lane.sims[0];
        assert_eq!(lane.real, [Event { start_s: 1.0, end_s: 4.0 }]);
        assert_eq!(row.both, [Event { start_s: 2.0, end_s: 4.0 }]);
        assert_eq!(row.real_only, [Event { start_s: 1.0, end_s: 2.0 }]);
        assert_eq!(
            row.simulated_only,
            [Event { start_s: 4.0, end_s: 5.0 }, Event { start_s: 6.0, end_s: 7.0 }]
        );
        assert_eq!(row.onsets, [OnsetPair { real_s: 1.0, simulated_s: 2.0 }]);
    }

    #[test]
    fn mismatches_come_in_order_with_their_channel_and_kind() {
        let times_s: Vec<f64> = (0..9).map(f64::from).collect();
        let on = |frames: &[usize]| (0..9).map(|frame| frames.contains(&frame)).collect::<Vec<_>>();
        let a = build_lane("a".into(), Some(0), 0, &times_s, &on(&[4, 5]), &[on(&[5, 6, 7])]);
        let b = build_lane("b".into(), Some(1), 0, &times_s, &on(&[6, 7]), &[on(&[1, 4, 5, 6])]);
        let c = build_lane("c".into(), Some(2), 0, &times_s, &on(&[2]), &[on(&[])]);
        let lanes = TakeLanes { channels: vec![a, b, c], ..Default::default() };
        let told: Vec<_> =
            lanes.mismatches(&[0, 1, 2], 0).iter().map(|m| (m.start_s, m.channel, m.kind.words())).collect();
        let expected = [
            (1.0, 1, "simulated only, for 1000 ms"),
            (2.0, 2, "real only, for 1000 ms"),
            (4.0, 0, "onset late by 1000 ms"),
            (4.0, 1, "onset early by 2000 ms"),
            (6.0, 0, "release late by 2000 ms"),
            (7.0, 1, "release early by 1000 ms"),
        ];
        assert_eq!(told, expected.map(|(start_s, channel, words)| (start_s, channel, words.to_owned())));
        assert_eq!(lanes.mismatches(&[2], 0).len(), 1);
        assert!(lanes.mismatches(&[0, 9], 1).is_empty());
        assert_eq!(lanes.touched(), [0, 1, 2]);
    }
}
