//! What the live station and its twin felt in the last seconds, as lanes to draw.
//!
//! Bounded: what is older than [`HISTORY_S`] is forgotten, whatever the rate at which frames come.

use std::collections::VecDeque;

use palpate_messages::bits;
use palpate_wire::proto::LiveFrame;

use crate::screens::timelines::events::{Event, runs};

/// So much is kept and drawn, s.
pub const HISTORY_S: f64 = 20.0;
/// Without a sample for longer than this nobody knows what was felt, s.
const GAP_S: f64 = 0.5;
/// A station that sends more than this is not listened to more closely.
const MOST_SAMPLES: usize = 4096;

/// The newest seconds of touch, real and simulated.
#[derive(Clone, Debug, Default)]
pub struct TouchHistory {
    /// Time, s since the station started, and one bit per channel; in order.
    real: VecDeque<(f64, Vec<u8>)>,
    /// As `real`; the bits are empty where nothing was simulated.
    simulated: VecDeque<(f64, Vec<u8>)>,
    model: String,
    revision: u64,
}

/// One channel, or all of a stream together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LiveLane {
    /// Real contacts.
    pub real: Vec<Event>,
    /// Felt by both.
    pub both: Vec<Event>,
    /// Simulated, not real.
    pub simulated_only: Vec<Event>,
    /// Real, not simulated.
    pub real_only: Vec<Event>,
}

/// The lanes of every channel and stream.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LiveLanes {
    /// One for each channel.
    pub channels: Vec<LiveLane>,
    /// One for each stream: any of its channels.
    pub streams: Vec<LiveLane>,
    /// Spans in which nothing was simulated.
    pub unsimulated: Vec<Event>,
}

/// One bit a channel.
type Bits<'a> = &'a [u8];

impl TouchHistory {
    /// Takes in the newest frame. What the twin says is of the moment that it looked at, which is a little earlier; what
    /// another model said before is forgotten.
    pub fn take_in(&mut self, frame: &LiveFrame) {
        let newest = self.newest_s();
        if newest.is_some_and(|newest_s| frame.time_s < newest_s) {
            // Another station, or the same one started anew.
            *self = Self { revision: self.revision, ..Self::default() };
        }
        if newest != Some(frame.time_s) && frame.time_s.is_finite() {
            self.real.push_back((frame.time_s, frame.active.clone()));
        }
        if let Some(twin) = frame.control.as_ref().and_then(|control| control.twin.as_ref()) {
            if twin.model != self.model {
                self.model.clone_from(&twin.model);
                self.simulated.clear();
            }
            let newer = self.simulated.back().is_none_or(|(time_s, _)| twin.time_s > *time_s);
            if newer && twin.time_s > 0.0 && twin.time_s.is_finite() {
                self.simulated.push_back((twin.time_s, twin.active.clone()));
            }
        }
        let oldest_s = frame.time_s - HISTORY_S;
        for samples in [&mut self.real, &mut self.simulated] {
            // The newest of the older ones still says what held when the view begins.
            while samples.len() > MOST_SAMPLES || samples.get(1).is_some_and(|(time_s, _)| *time_s < oldest_s)
            {
                samples.pop_front();
            }
        }
        self.revision += 1;
    }

    /// When the newest frame was, s since the station started.
    pub fn newest_s(&self) -> Option<f64> {
        self.real.back().map(|(time_s, _)| *time_s)
    }

    /// Changes with every frame.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Samples that are kept.
    pub fn num_samples(&self) -> usize {
        self.real.len() + self.simulated.len()
    }

    /// The lanes; `streams` are the channels of each stream. A moment that the twin has not got to yet is none at which
    /// the two could be compared.
    pub fn lanes(&self, num_channels: usize, streams: &[std::ops::Range<usize>]) -> LiveLanes {
        // Each moment with its real sample and the simulated one in effect; neither of them within a gap.
        let mut times_s = Vec::with_capacity(self.real.len());
        let mut samples: Vec<(Option<Bits<'_>>, Option<Bits<'_>>)> = Vec::with_capacity(self.real.len());
        let newest_simulated_s = self.simulated.back().map_or(f64::NEG_INFINITY, |(time_s, _)| *time_s);
        let mut next = 0;
        let mut before_s = f64::INFINITY;
        for (time_s, active) in &self.real {
            if time_s - before_s > GAP_S {
                times_s.push(before_s + 1e-3);
                samples.push((None, None));
            }
            before_s = *time_s;
            while self.simulated.get(next).is_some_and(|(at_s, _)| at_s <= time_s) {
                next += 1;
            }
            let in_effect = next.checked_sub(1).and_then(|idx| self.simulated.get(idx));
            let simulated = in_effect.filter(|(at_s, bits)| {
                *time_s <= newest_simulated_s && time_s - at_s <= GAP_S && !bits.is_empty()
            });
            times_s.push(*time_s);
            samples.push((Some(active.as_slice()), simulated.map(|(_, bits)| bits.as_slice())));
        }
        let end_s = self.newest_s().unwrap_or_default();
        let lane = |channels: std::ops::Range<usize>| {
            let any = |bits: &[u8]| channels.clone().any(|channel| bits::get(bits, channel));
            let felt: Vec<(bool, Option<bool>)> =
                samples.iter().map(|(real, simulated)| (real.is_some_and(any), simulated.map(any))).collect();
            let spans = |wanted: &dyn Fn(bool, Option<bool>) -> bool| {
                runs(&times_s, end_s, felt.iter().map(|&(real, simulated)| wanted(real, simulated)))
            };
            LiveLane {
                real: spans(&|real, _| real),
                both: spans(&|real, simulated| real && simulated == Some(true)),
                simulated_only: spans(&|real, simulated| !real && simulated == Some(true)),
                real_only: spans(&|real, simulated| real && simulated == Some(false)),
            }
        };
        LiveLanes {
            channels: (0..num_channels).map(|channel| lane(channel..channel + 1)).collect(),
            streams: streams.iter().cloned().map(lane).collect(),
            unsimulated: runs(
                &times_s,
                end_s,
                samples.iter().zip(&times_s).map(|((_, simulated), time_s)| {
                    // What the twin is still about to say is not missing.
                    simulated.is_none() && (*time_s <= newest_simulated_s || end_s - time_s > GAP_S)
                }),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use palpate_wire::proto::{ControlState, TwinStatus};

    use super::*;

    fn frame(time_s: f64, active: [bool; 3], twin: Option<(f64, &[bool])>) -> LiveFrame {
        let twin = twin.map(|(time_s, active)| TwinStatus {
            model: "m".to_owned(),
            active: bits::pack(active.iter().copied()),
            time_s,
            ..TwinStatus::default()
        });
        let control = Some(ControlState { twin, ..ControlState::default() });
        LiveFrame { time_s, active: bits::pack(active), control, ..LiveFrame::default() }
    }

    fn spans(events: &[Event]) -> Vec<(i64, i64)> {
        events
            .iter()
            .map(|event| ((event.start_s * 10.0).round() as i64, (event.end_s * 10.0).round() as i64))
            .collect()
    }

    /// 10 Hz for four seconds: channel 0 is touched from 1.0 to 2.0, in the simulation from 1.2 on; the twin is 0.1 s behind.
    fn history() -> TouchHistory {
        let mut history = TouchHistory::default();
        for tick in 10..50 {
            let time_s = f64::from(tick) / 10.0;
            let (on, late) = ((10..20).contains(&(tick - 10)), (12..20).contains(&(tick - 11)));
            history.take_in(&frame(
                time_s,
                [on, false, tick == 49],
                Some((time_s - 0.1, &[late, false, false])),
            ));
        }
        history
    }

    #[test]
    fn what_the_twin_says_stands_at_the_moment_that_it_looked_at() {
        let lanes = history().lanes(3, &[0..2, 2..3]);
        let lane = &lanes.channels[0];
        assert_eq!(spans(&lane.real), [(20, 30)]);
        assert_eq!(spans(&lane.both), [(22, 30)]);
        assert_eq!(spans(&lane.real_only), [(20, 22)]);
        assert!(lane.simulated_only.is_empty() && lanes.channels[1] == LiveLane::default());
        assert_eq!(lanes.streams[0], *lane);
        // The newest real sample has no simulated one yet: that is no mismatch, and nothing is missing.
        assert!(lanes.channels[2].real_only.is_empty() && lanes.channels[2].real.len() == 1);
        assert!(lanes.unsimulated.is_empty(), "{:?}", lanes.unsimulated);
    }

    #[test]
    fn without_an_object_nothing_is_compared() {
        let mut history = TouchHistory::default();
        for tick in 10..30 {
            let time_s = f64::from(tick) / 10.0;
            history.take_in(&frame(time_s, [true, false, false], Some((time_s, &[]))));
        }
        let lanes = history.lanes(3, &[]);
        assert!(lanes.channels[0].real_only.is_empty());
        assert_eq!(spans(&lanes.channels[0].real), [(10, 29)]);
        assert_eq!(spans(&lanes.unsimulated), [(10, 29)]);
    }

    #[test]
    fn contacts_do_not_reach_over_a_gap() {
        let mut history = TouchHistory::default();
        for time_s in [1.0, 1.1, 5.0, 5.1] {
            history.take_in(&frame(time_s, [true, false, false], None));
        }
        assert_eq!(spans(&history.lanes(3, &[]).channels[0].real), [(10, 11), (50, 51)]);
    }

    #[test]
    fn old_samples_and_those_of_another_run_are_forgotten() {
        let mut history = TouchHistory::default();
        for tick in 0..60_000 {
            let time_s = f64::from(tick) / 30.0;
            history.take_in(&frame(time_s, [false; 3], Some((time_s, &[false; 3]))));
        }
        assert!(history.num_samples() <= 2 * (30.0 * HISTORY_S) as usize + 4, "{}", history.num_samples());
        history.take_in(&frame(0.5, [true, false, false], None));
        assert_eq!((history.num_samples(), history.newest_s()), (1, Some(0.5)));
        // A flood is bounded too.
        for tick in 0..20_000 {
            history.take_in(&frame(1.0 + f64::from(tick) * 1e-5, [false; 3], None));
        }
        assert!(history.num_samples() <= MOST_SAMPLES);
    }

    #[test]
    fn another_model_starts_anew() {
        let mut history = history();
        let mut other = frame(5.0, [false; 3], Some((4.95, &[true, false, false])));
        if let Some(twin) = other.control.as_mut().and_then(|control| control.twin.as_mut()) {
            twin.model = "other".to_owned();
        }
        history.take_in(&other);
        let lanes = history.lanes(3, &[]);
        assert!(lanes.channels[0].both.is_empty());
        assert_eq!(spans(&lanes.channels[0].real), [(20, 30)], "what was real stays");
    }
}
