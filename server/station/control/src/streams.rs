//! Readings of tactile boards as samples of the layout's streams: reference values, thresholds, tare.

use palpate_robot_model::{Station, StreamConfig};

use crate::rows::Rows;

/// A board that is silent for longer feels nothing any more, ns.
const SILENT_NS: u64 = 500_000_000;
/// A tare that got no sample of a board for this long after its end fails for that board, ns.
const TARE_PATIENCE_NS: u64 = 1_000_000_000;

/// A board: consecutive channels of one stream, on one device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct BoardPlace {
    /// Id of the device, for messages.
    pub(crate) id: String,
    /// Index of the stream in the layout.
    pub(crate) stream: usize,
    /// First channel, counted within the stream.
    pub(crate) first_channel: usize,
    /// How many.
    pub(crate) num_channels: usize,
}

/// One reading of all channels of a board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BoardReading<'a> {
    /// Which board: its stream, and its first channel within that.
    pub(crate) stream: usize,
    pub(crate) first_channel: usize,
    /// Host time, ns.
    pub(crate) host_ns: u64,
    /// By the board's own clock, where it has one.
    pub(crate) device_ns: Option<u64>,
    /// Raw units.
    pub(crate) raw: &'a [f32],
}

/// A sample of a whole stream, as takes hold them.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StreamSample {
    /// Index of the stream in the layout.
    pub(crate) stream: usize,
    /// Host time, ns; later than that of the stream's sample before.
    pub(crate) host_ns: u64,
    /// By the clock of the stream's first board, where it has one.
    pub(crate) device_ns: Option<u64>,
    /// Raw units, in channel order; the last known where a board has gone, the least there is where it never came.
    pub(crate) raw: Vec<f32>,
    /// In channel order.
    pub(crate) active: Vec<bool>,
}

/// How a tare went.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TareOutcome {
    /// Boards that have new reference values.
    pub(crate) num_boards: usize,
    /// What was not as it should be, in words; empty when all is well.
    pub(crate) problems: Vec<String>,
}

/// What the streams feel at one moment, one entry a channel of the layout.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Touch {
    pub(crate) active: Vec<bool>,
    /// Raw readings less their reference value; 0 where nothing is known.
    pub(crate) raw: Vec<f32>,
}

/// What a channel reads now, and its zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reading {
    /// Raw units.
    pub(crate) raw: f32,
    /// Raw units.
    pub(crate) reference: f64,
    pub(crate) active: bool,
}

/// Every tactile stream of a station.
///
/// A channel is active as the firmware of recorded stations has it: above `on_threshold` over its reference, and until
/// it is no longer above `off_threshold`. References are the mean of the first readings of a board, until a tare.
#[derive(Clone, Debug)]
pub(crate) struct Streams {
    streams: Vec<StreamState>,
    /// Names of the layout's channels.
    channel_ids: Vec<String>,
    /// The first readings of a board, for so long, make its first reference.
    reference_ns: u64,
    tare_until_ns: Option<u64>,
}

#[derive(Clone, Debug)]
struct StreamState {
    config: StreamConfig,
    /// First channel in the layout.
    first_channel: usize,
    boards: Vec<Board>,
    rows: Rows<Stored>,
    raw: Vec<f32>,
    active: Vec<bool>,
    last_ns: Option<u64>,
}

#[derive(Clone, Debug)]
struct Board {
    place: BoardPlace,
    /// Host time of the newest reading that came.
    heard_ns: Option<u64>,
    /// Host time of the newest reading that is in a sample, and the board's own.
    newest: Option<(u64, Option<u64>)>,
    /// One a channel, once there is one.
    reference: Option<Vec<f64>>,
    collecting: Option<Collecting>,
    /// What the newest reference was made of, until a tare reports it.
    collected: Option<Collecting>,
}

/// A board's reading until its row is whole.
#[derive(Clone, Debug)]
struct Stored {
    device_ns: Option<u64>,
    raw: Vec<f32>,
}

/// Readings that become a reference.
#[derive(Clone, Debug)]
struct Collecting {
    from_ns: u64,
    until_ns: u64,
    count: u64,
    sums: Vec<f64>,
    lowest: Vec<f32>,
    highest: Vec<f32>,
}

impl Collecting {
    fn new(from_ns: u64, until_ns: u64, num_channels: usize) -> Self {
        Self {
            from_ns,
            until_ns,
            count: 0,
            sums: vec![0.0; num_channels],
            lowest: vec![f32::INFINITY; num_channels],
            highest: vec![f32::NEG_INFINITY; num_channels],
        }
    }

    fn add(&mut self, raw: &[f32]) {
        self.count += 1;
        for (channel, &reading) in raw.iter().enumerate() {
            self.sums[channel] += f64::from(reading);
            self.lowest[channel] = self.lowest[channel].min(reading);
            self.highest[channel] = self.highest[channel].max(reading);
        }
    }

    fn means(&self) -> Vec<f64> {
        self.sums.iter().map(|sum| sum / self.count as f64).collect()
    }
}

impl Streams {
    /// The streams of `station` as `boards` read them; the first `reference_ns` of a board make its first reference.
    pub(crate) fn new(station: &Station, boards: &[BoardPlace], reference_ns: u64) -> Self {
        let layout = &station.layout;
        let streams = layout.streams.iter().zip(&station.streams).enumerate();
        let streams = streams
            .map(|(stream_idx, (stream, config))| {
                let boards: Vec<Board> = boards
                    .iter()
                    .filter(|place| place.stream == stream_idx)
                    .map(|place| Board {
                        place: place.clone(),
                        heard_ns: None,
                        newest: None,
                        reference: None,
                        collecting: None,
                        collected: None,
                    })
                    .collect();
                StreamState {
                    first_channel: stream.channels.start,
                    rows: Rows::new(boards.len(), (1e9 / stream.rate_hz) as u64),
                    boards,
                    raw: vec![config.raw_min as f32; stream.channels.len()],
                    active: vec![false; stream.channels.len()],
                    config: config.clone(),
                    last_ns: None,
                }
            })
            .collect();
        let channel_ids = layout.channels.iter().map(|channel| channel.id.clone()).collect();
        Self { streams, channel_ids, reference_ns, tare_until_ns: None }
    }

    /// A board's reading; gives the stream's samples that are whole now: mostly none or one.
    ///
    /// Readings of unknown boards, of another number of channels, with numbers that are none, or from before the
    /// board's newest are left out.
    pub(crate) fn board(&mut self, reading: BoardReading<'_>) -> Vec<StreamSample> {
        let stream = self.streams.get_mut(reading.stream);
        let found = stream.and_then(|stream| {
            let is_it = |board: &Board| board.place.first_channel == reading.first_channel;
            let board_idx = stream.boards.iter().position(is_it)?;
            Some((stream, board_idx))
        });
        let Some((stream, board_idx)) = found.filter(|(stream, board_idx)| {
            let board = &stream.boards[*board_idx];
            board.place.num_channels == reading.raw.len()
                && board.heard_ns.is_none_or(|heard_ns| reading.host_ns > heard_ns)
                && reading.raw.iter().all(|value| value.is_finite())
        }) else {
            tracing::debug!(?reading, "a board's reading makes no sense");
            return Vec::new();
        };
        stream.boards[board_idx].heard_ns = Some(reading.host_ns);
        let stored = Stored { device_ns: reading.device_ns, raw: reading.raw.to_vec() };
        stream.rows.push(board_idx, reading.host_ns, stored);
        let row = || stream.rows.pop();
        let rows: Vec<_> = std::iter::from_fn(row).collect();
        rows.into_iter().map(|row| stream.sample(reading.stream, row, self.reference_ns)).collect()
    }

    /// The readings of the next `duration_ns` become the reference of every board. A tare that is under way begins anew.
    pub(crate) fn tare(&mut self, now_ns: u64, duration_ns: u64) {
        let until_ns = now_ns + duration_ns;
        self.tare_until_ns = Some(until_ns);
        for board in self.streams.iter_mut().flat_map(|stream| &mut stream.boards) {
            board.collecting = Some(Collecting::new(now_ns, until_ns, board.place.num_channels));
            board.collected = None;
        }
    }

    /// Ends a tare that is due and says how it went. Boards that sent nothing keep what they had.
    pub(crate) fn finish_tare(&mut self, now_ns: u64) -> Option<TareOutcome> {
        let until_ns = self.tare_until_ns.filter(|until_ns| now_ns >= *until_ns)?;
        let waiting =
            self.streams.iter().flat_map(|stream| &stream.boards).any(|board| board.collecting.is_some());
        if waiting && now_ns < until_ns + TARE_PATIENCE_NS {
            return None;
        }
        self.tare_until_ns = None;
        let mut outcome = TareOutcome { num_boards: 0, problems: Vec::new() };
        for stream in &mut self.streams {
            for board in &mut stream.boards {
                board.collecting = None;
                let Some(collected) = board.collected.take() else {
                    let problem = format!("{} sent nothing during the tare; check its cable", board.place.id);
                    outcome.problems.push(problem);
                    continue;
                };
                outcome.num_boards += 1;
                let first = stream.first_channel + board.place.first_channel;
                for (channel, (lowest, highest)) in
                    collected.lowest.iter().zip(&collected.highest).enumerate()
                {
                    let range = f64::from(highest - lowest);
                    if range > stream.config.on_threshold {
                        outcome.problems.push(format!(
                            "{} moved by {range:.0} during the tare, more than a touch takes ({:.0}); let go of the \
                             hand and tare again",
                            self.channel_ids[first + channel],
                            stream.config.on_threshold
                        ));
                    }
                }
            }
        }
        Some(outcome)
    }

    /// What is felt at `now_ns`. A board that has fallen silent feels nothing.
    pub(crate) fn touch(&self, now_ns: u64) -> Touch {
        let num_channels = self.channel_ids.len();
        let mut touch = Touch { active: vec![false; num_channels], raw: vec![0.0; num_channels] };
        for stream in &self.streams {
            for board in stream.boards.iter().filter(|board| !board.silent(now_ns)) {
                let Some(reference) = &board.reference else { continue };
                for (channel, reference) in reference.iter().enumerate() {
                    let in_stream = board.place.first_channel + channel;
                    let in_layout = stream.first_channel + in_stream;
                    touch.active[in_layout] = stream.active[in_stream];
                    touch.raw[in_layout] = (f64::from(stream.raw[in_stream]) - reference) as f32;
                }
            }
        }
        touch
    }

    /// What every channel of the layout reads at `now_ns`; `None` where its board is silent or has no zero yet.
    pub(crate) fn readings(&self, now_ns: u64) -> Vec<Option<Reading>> {
        let mut readings = vec![None; self.channel_ids.len()];
        for stream in &self.streams {
            for board in stream.boards.iter().filter(|board| !board.silent(now_ns)) {
                for (channel, &reference) in board.reference.iter().flatten().enumerate() {
                    let in_stream = board.place.first_channel + channel;
                    let (raw, active) = (stream.raw[in_stream], stream.active[in_stream]);
                    readings[stream.first_channel + in_stream] = Some(Reading { raw, reference, active });
                }
            }
        }
        readings
    }
}

impl Board {
    fn silent(&self, now_ns: u64) -> bool {
        self.newest.is_none_or(|(newest_ns, _)| newest_ns + SILENT_NS < now_ns)
    }

    fn store(&mut self, host_ns: u64, reading: Stored, reference_ns: u64) {
        self.newest = Some((host_ns, reading.device_ns));
        // After power-up the first readings are the reference, as in the boards' own host software.
        if self.reference.is_none() && self.collecting.is_none() {
            let until_ns = host_ns + reference_ns;
            self.collecting = Some(Collecting::new(host_ns, until_ns, reading.raw.len()));
        }
        self.collect(host_ns, &reading.raw);
    }

    /// Takes a reading into the reference that is being made, if one is, and puts a finished one in force.
    fn collect(&mut self, host_ns: u64, raw: &[f32]) {
        let Some(mut collecting) = self.collecting.take() else { return };
        if (collecting.from_ns..=collecting.until_ns).contains(&host_ns) {
            collecting.add(raw);
        }
        if host_ns < collecting.until_ns || collecting.count == 0 {
            self.collecting = Some(collecting);
            return;
        }
        self.reference = Some(collecting.means());
        self.collected = Some(collecting);
    }
}

impl StreamState {
    /// The stream as it is after `row`, which has an entry for each board.
    fn sample(&mut self, stream: usize, row: Vec<Option<(u64, Stored)>>, reference_ns: u64) -> StreamSample {
        let row_ns = row.iter().flatten().map(|(host_ns, _)| *host_ns).max();
        // A row that one board filled alone may be older than the one before; samples go on in time.
        let host_ns = row_ns.max(self.last_ns.map(|last_ns| last_ns + 1)).unwrap_or(0);
        self.last_ns = Some(host_ns);
        for (board, stored) in self.boards.iter_mut().zip(row) {
            let channels = board.place.first_channel..board.place.first_channel + board.place.num_channels;
            if let Some((read_ns, stored)) = stored {
                self.raw[channels.clone()].copy_from_slice(&stored.raw);
                board.store(read_ns, stored, reference_ns);
            }
            let Some(reference) = board.reference.as_ref().filter(|_| !board.silent(host_ns)) else {
                self.active[channels].fill(false);
                continue;
            };
            for (channel, reference) in channels.zip(reference) {
                let rise = f64::from(self.raw[channel]) - reference;
                let threshold =
                    if self.active[channel] { self.config.off_threshold } else { self.config.on_threshold };
                self.active[channel] = rise > threshold;
            }
        }
        let device_ns =
            self.boards.first().and_then(|board| board.newest).and_then(|(_, device_ns)| device_ns);
        StreamSample { stream, host_ns, device_ns, raw: self.raw.clone(), active: self.active.clone() }
    }
}

#[cfg(test)]
mod tests;
