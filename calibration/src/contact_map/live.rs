//! The map, reading by reading.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

use palpate_robot_model::Station;

use super::samples::{InputsOf, TIME_TOLERANCE_S, num_inputs};
use super::{ContactMap, patch_columns};
use crate::CalibrationError;

/// A map that runs beside a robot.
#[derive(Clone, Debug)]
pub struct LiveMap {
    map: Arc<ContactMap>,
    /// Of each of the map's streams, its channels and the columns of its patches.
    streams: Vec<(Range<usize>, Vec<Range<usize>>)>,
    num_channels: usize,
    /// Readings above reference with their times, s, oldest first, as far back as the map looks.
    history: VecDeque<(f64, Vec<f32>)>,
    /// Of each channel, what the map said last.
    was_active: Vec<bool>,
}

impl LiveMap {
    /// `map` on `station`.
    ///
    /// # Errors
    /// A station that the map was not learned on.
    pub fn new(map: Arc<ContactMap>, station: &Station) -> Result<Self, CalibrationError> {
        map.check(station)?;
        let stream = |id: &str| {
            let idx = station.layout.stream_index(id).unwrap_or_default();
            (station.layout.streams[idx].channels.clone(), patch_columns(station, idx))
        };
        Ok(Self {
            streams: map.streams.iter().map(|of| stream(&of.id)).collect(),
            num_channels: station.layout.num_channels(),
            history: VecDeque::new(),
            was_active: vec![false; station.layout.num_channels()],
            map,
        })
    }

    /// Forgets all readings: a new trial begins.
    pub fn restart(&mut self) {
        self.history.clear();
        self.was_active.fill(false);
    }

    /// Takes the readings of every channel at `time_s`, raw units above reference, and puts what the map makes of them into
    /// `active`; channels of streams that the map does not know stay as they are. Times go up until [`LiveMap::restart`].
    ///
    /// # Panics
    /// If there is not one reading and one activation for each channel: a caller's bug.
    pub fn read(&mut self, time_s: f64, above_reference: &[f64], active: &mut [bool]) {
        assert_eq!(above_reference.len(), self.num_channels, "one reading for each channel");
        assert_eq!(active.len(), self.num_channels, "one activation for each channel");
        let oldest_s = time_s - self.map.lags_s.last().copied().unwrap_or_default();
        while self.history.get(1).is_some_and(|(next_s, _)| *next_s <= oldest_s + TIME_TOLERANCE_S) {
            self.history.pop_front();
        }
        self.history.push_back((time_s, above_reference.iter().map(|&reading| reading as f32).collect()));
        let num_lags = self.map.lags_s.len();
        let moments: Vec<usize> = self.map.lags_s.iter().map(|lag_s| self.moment(time_s - lag_s)).collect();
        for (stream, (channels, patches)) in self.map.streams.iter().zip(&self.streams) {
            let readings: Vec<f32> = channels
                .clone()
                .flat_map(|channel| moments.iter().map(move |&moment| (channel, moment)))
                .map(|(channel, moment)| self.history[moment].1[channel])
                .collect();
            let shape = InputsOf { patches, num_lags, scales_raw: &stream.scales_raw };
            let mut input = vec![0.0; num_inputs(patches, num_lags)];
            for (column, channel) in channels.clone().enumerate() {
                shape.read(&readings, column, &mut input);
                let was_active = &mut self.was_active[channel];
                *was_active = stream.is_contact(column, &input, *was_active);
                active[channel] = *was_active;
            }
        }
    }

    /// Index of the newest readings at or before `time_s`; the oldest before that.
    fn moment(&self, time_s: f64) -> usize {
        let later = self.history.partition_point(|(reading_s, _)| *reading_s <= time_s + TIME_TOLERANCE_S);
        later.saturating_sub(1)
    }
}
