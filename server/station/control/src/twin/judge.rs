//! How far simulation and hardware agree, and which channels cannot be believed any more. Pure: takes times, knows none.

mod channel;

use std::collections::VecDeque;

use palpate_robot_model::Station;
use palpate_wire::proto::TaxelWarning;

use crate::streams::Reading;
use channel::{ChannelRecord, Moment};

/// Agreement, and what is quiet, is that of so many seconds.
const WINDOW_S: f64 = 10.0;

/// What the simulator expects of every channel now.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected<'a> {
    /// Whether it is on.
    pub(super) active: &'a [bool],
    /// Its load over the one that switches it on.
    pub(super) loads: &'a [f64],
}

/// Keeps account of every channel.
#[derive(Clone, Debug)]
pub(super) struct Judge {
    channels: Vec<ChannelRecord>,
    /// Of each channel.
    streams: Vec<usize>,
    num_streams: usize,
    /// Moments with an expectation, and which channels were as expected, oldest first.
    compared: VecDeque<(f64, Vec<bool>)>,
    /// How many of those each channel was.
    num_agreed: Vec<u32>,
    /// Whether there was an expectation at the newest moment.
    expecting: bool,
}

impl Judge {
    pub(super) fn new(station: &Station) -> Self {
        let layout = &station.layout;
        let channels: Vec<ChannelRecord> = (layout.channels.iter())
            .map(|channel| ChannelRecord::new(&channel.id, &station.streams[channel.stream]))
            .collect();
        Self {
            num_agreed: vec![0; channels.len()],
            streams: layout.channels.iter().map(|channel| channel.stream).collect(),
            num_streams: layout.streams.len(),
            channels,
            compared: VecDeque::new(),
            expecting: false,
        }
    }

    /// Another model expects other loads.
    pub(super) fn forget_loads(&mut self) {
        self.forget_expectations();
        self.channels.iter_mut().for_each(ChannelRecord::forget_loads);
    }

    /// What was expected so far says nothing about what comes: another object.
    pub(super) fn forget_expectations(&mut self) {
        self.compared.clear();
        self.num_agreed.fill(0);
        self.channels.iter_mut().for_each(ChannelRecord::forget_expectations);
    }

    /// One moment of all channels.
    pub(super) fn take_in(
        &mut self,
        at_s: f64,
        readings: &[Option<Reading>],
        expected: Option<Expected<'_>>,
    ) {
        self.expecting = expected.is_some();
        for (idx, (channel, reading)) in self.channels.iter_mut().zip(readings).enumerate() {
            let expected = expected.map(|expected| (expected.active[idx], expected.loads[idx]));
            match reading {
                Some(reading) => channel.take_in(Moment::new(at_s, reading, expected)),
                None => channel.silent(),
            }
        }
        let Some(expected) = expected else { return };
        let felt = readings.iter().map(|reading| reading.is_some_and(|reading| reading.active));
        let agreed: Vec<bool> = felt.zip(expected.active).map(|(felt, expected)| felt == *expected).collect();
        add(&mut self.num_agreed, &agreed);
        self.compared.push_back((at_s, agreed));
        while self.compared.front().is_some_and(|(then_s, _)| then_s + WINDOW_S < at_s) {
            if let Some((_, agreed)) = self.compared.pop_front() {
                for (count, agreed) in self.num_agreed.iter_mut().zip(agreed) {
                    *count -= u32::from(agreed);
                }
            }
        }
    }

    /// Share of the last seconds in which each channel was as expected; empty without an expectation.
    pub(super) fn agreement(&self) -> Vec<f32> {
        if !self.expecting || self.compared.is_empty() {
            return Vec::new();
        }
        let total = self.compared.len() as f32;
        self.num_agreed.iter().map(|&count| count as f32 / total).collect()
    }

    /// Channels that cannot be believed at `now_s`, by channel.
    pub(super) fn warnings(&mut self, now_s: f64) -> Vec<TaxelWarning> {
        // A board that repeats itself altogether has a trouble that its device reports, or is a board at rest whose
        // readings are coarse; one channel that does so among others is not.
        let mut lively = vec![(0_usize, 0_usize); self.num_streams];
        for (channel, &stream) in self.channels.iter().zip(&self.streams) {
            let (changed, all) = &mut lively[stream];
            *changed += usize::from(channel.changed_lately(now_s));
            *all += 1;
        }
        let expecting = self.expecting;
        let channels = self.channels.iter_mut().zip(&self.streams).enumerate();
        channels
            .filter_map(|(idx, (channel, &stream))| {
                let (changed, all) = lively[stream];
                let (kind, text) = channel.judge(now_s, changed * 2 >= all, expecting)?;
                let channel = u32::try_from(idx).ok()?;
                Some(TaxelWarning { channel, kind: kind.to_owned(), text })
            })
            .collect()
    }
}

fn add(counts: &mut [u32], agreed: &[bool]) {
    for (count, agreed) in counts.iter_mut().zip(agreed) {
        *count += u32::from(*agreed);
    }
}

#[cfg(test)]
mod tests;
