//! The tactile boards: samples of the truth world as the lines that the boards send.

use palpate_device_protocol::lines::{encode_fsr_row, encode_twintac};
use palpate_robot_model::{SensorKind, Station};

use super::faults::{Fault, Faults};

/// Columns of the force resistors' matrix; a frame is as many lines as that takes.
const MATRIX_COLUMNS: usize = 4;

/// One board: some channels of one stream.
#[derive(Clone, Debug)]
pub(crate) struct Board {
    /// Index of the stream in the layout.
    pub(crate) stream: usize,
    kind: SensorKind,
    /// Its channels, counted within the stream.
    channels: std::ops::Range<usize>,
    /// Ids of its channels.
    ids: Vec<String>,
    raw_range: (f64, f64),
    dead: Vec<Option<f64>>,
    /// Drift of each channel, raw units per s, and since when, ns.
    drift: Vec<Option<(f64, u64)>>,
}

impl Board {
    /// The boards of a station: one for each patch of pressure sensors, then one for all force resistors of a stream.
    pub(crate) fn of(station: &Station) -> Vec<Self> {
        let layout = &station.layout;
        let mut boards = Vec::new();
        let mut board = |stream: usize, channels: std::ops::Range<usize>| {
            let first = layout.streams[stream].channels.start;
            let ids: Vec<String> =
                layout.channels[channels.clone()].iter().map(|channel| channel.id.clone()).collect();
            boards.push(Self {
                stream,
                kind: layout.streams[stream].kind,
                channels: channels.start - first..channels.end - first,
                raw_range: (station.streams[stream].raw_min, station.streams[stream].raw_max),
                dead: vec![None; ids.len()],
                drift: vec![None; ids.len()],
                ids,
            });
        };
        let kind_of = |stream: usize| layout.streams[stream].kind;
        for patch in layout.patches.iter().filter(|patch| kind_of(patch.stream) == SensorKind::Pressure) {
            board(patch.stream, patch.channels.clone());
        }
        for (stream_idx, stream) in layout.streams.iter().enumerate() {
            if stream.kind == SensorKind::Proximity {
                board(stream_idx, stream.channels.clone());
            }
        }
        boards
    }

    /// Whether it sends one line for a sample of pressures, or the rows of a matrix.
    pub(crate) fn is_twintac(&self) -> bool {
        self.kind == SensorKind::Pressure
    }

    /// What is wrong from `now_ns` on. A drift that goes on has its beginning.
    pub(crate) fn set_faults(&mut self, faults: &Faults, now_ns: u64) {
        for (idx, id) in self.ids.iter().enumerate() {
            let drifting = self.drift[idx];
            (self.dead[idx], self.drift[idx]) = (None, None);
            for fault in &faults.faults {
                match fault {
                    Fault::DeadTaxel { channel, raw } if channel == id => self.dead[idx] = Some(*raw),
                    Fault::Drift { channel, raw_per_s } if channel == id => {
                        let begun = drifting.filter(|(rate, _)| rate == raw_per_s);
                        self.drift[idx] = Some(begun.unwrap_or((*raw_per_s, now_ns)));
                    }
                    _ => {}
                }
            }
        }
    }

    /// The lines for a sample of the whole stream at `now_ns`.
    pub(crate) fn lines(&self, raw: &[f32], now_ns: u64) -> Vec<Vec<u8>> {
        let (raw_min, raw_max) = self.raw_range;
        let values: Vec<f64> = raw[self.channels.clone()]
            .iter()
            .enumerate()
            .map(|(idx, &raw)| {
                let drifted = self.drift[idx].map_or(0.0, |(raw_per_s, since_ns)| {
                    raw_per_s * now_ns.saturating_sub(since_ns) as f64 * 1e-9
                });
                self.dead[idx].unwrap_or((f64::from(raw) + drifted).clamp(raw_min, raw_max))
            })
            .collect();
        if self.is_twintac() {
            return vec![encode_twintac(&values).into_bytes()];
        }
        let row = |row: &[f64]| {
            let counts: Vec<i32> = row.iter().map(|value| value.round() as i32).collect();
            encode_fsr_row(&counts).into_bytes()
        };
        values.chunks(MATRIX_COLUMNS).map(row).collect()
    }
}
