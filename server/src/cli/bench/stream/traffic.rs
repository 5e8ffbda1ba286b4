//! What the emulated boards sent, and when, against what the takes hold of it.

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use palpate_emulator::StationControl;
use palpate_recording::Take;
use palpate_robot_model::{DeviceKind, Station};
use palpate_server::Error;
use serde::Serialize;

/// Counters are read this often: well below the time between two samples.
const LOOK: Duration = Duration::from_millis(1);

/// What the takes hold of one stream.
#[derive(Debug, Default, Serialize)]
pub(super) struct RecordedStream {
    /// Samples in all takes.
    pub(super) samples: usize,
    /// Samples that the devices sent from each take's first to its last, where the emulation counts them.
    pub(super) sent: Option<usize>,
    /// Samples per second of take.
    pub(super) rate_hz: f64,
    /// Between two samples, ms.
    pub(super) longest_gap_ms: f64,
}

/// Watches the devices of `control` until it is dropped or asked for its log.
pub(super) struct TrafficWatch {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<SendTimes>>,
}

/// When each whole sample of each stream of the layout left its devices, ns since 1970, oldest first.
type SendTimes = Vec<Vec<u64>>;

impl TrafficWatch {
    pub(super) fn start(control: StationControl) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            let lines = lines_of_streams(control.station());
            let mut times: SendTimes = vec![Vec::new(); lines.len()];
            let mut before: Option<Vec<u64>> = None;
            while !stopped.load(Ordering::Relaxed) {
                let traffic = control.snapshot().traffic;
                let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos() as u64;
                // A sample is whole once every one of its boards has sent all of its lines.
                let whole = |boards: &Vec<(usize, u64)>| {
                    boards
                        .iter()
                        .map(|&(line, per_sample)| traffic[line].sent / per_sample)
                        .min()
                        .unwrap_or(0)
                };
                let sent: Vec<u64> = lines.iter().map(whole).collect();
                if let Some(before) = &before {
                    for ((times, now_sent), before) in times.iter_mut().zip(&sent).zip(before) {
                        times.extend((*before..*now_sent).map(|_| now));
                    }
                }
                before = Some(sent);
                thread::sleep(LOOK);
            }
            times
        });
        Self { stop, thread: Some(thread) }
    }

    pub(super) fn end(mut self) -> SendTimes {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().and_then(|thread| thread.join().ok()).unwrap_or_default()
    }
}

impl Drop for TrafficWatch {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// For each stream of the layout: its boards' places among the serial lines, with lines a sample.
fn lines_of_streams(station: &Station) -> Vec<Vec<(usize, u64)>> {
    // The emulation's lines are the station's devices but for the arm.
    let serial = station.devices.iter().filter(|device| !matches!(device.kind, DeviceKind::Xarm(_)));
    let mut streams = vec![Vec::new(); station.layout.streams.len()];
    for (line, device) in serial.enumerate() {
        if let DeviceKind::Lines(board) = &device.kind {
            streams[board.stream_idx].push((line, board.lines_per_sample as u64));
        }
    }
    streams
}

/// How many takes lie in the session's folder, and what all of them hold.
pub(super) fn recorded(
    session: &Path,
    sent: &SendTimes,
) -> Result<(usize, BTreeMap<String, RecordedStream>), Error> {
    let mut takes = Vec::new();
    for entry in fs::read_dir(session).map_err(Error::io("read", session))? {
        let path = entry.map_err(Error::io("read", session))?.path();
        if path.extension().is_some_and(|extension| extension == "mcap") {
            takes.push(Take::read(&path)?);
        }
    }
    let mut streams: BTreeMap<String, RecordedStream> = BTreeMap::new();
    let mut lengths_s: BTreeMap<String, f64> = BTreeMap::new();
    for take in &takes {
        let layout = &take.station.layout;
        let logs = layout
            .streams
            .iter()
            .zip(&take.streams)
            .zip(sent.iter().map(Some).chain(std::iter::repeat(None)));
        let logs = logs.map(|((stream, log), sent)| (stream.id.as_str(), &log.times_s, sent));
        for (id, times_s, sent) in logs.chain([("joints", &take.joints.times_s, None)]) {
            let stream = streams.entry(id.to_owned()).or_default();
            let (Some(first), Some(last)) = (times_s.first(), times_s.last()) else { continue };
            stream.samples += times_s.len();
            *lengths_s.entry(id.to_owned()).or_default() += last - first;
            let gaps = times_s.windows(2).map(|pair| (pair[1] - pair[0]) * 1e3);
            stream.longest_gap_ms = gaps.fold(stream.longest_gap_ms, f64::max);
            if let Some(sent) = sent {
                let at = |time_s: f64| take.start_unix_ns + (time_s * 1e9) as u64;
                *stream.sent.get_or_insert(0) += sent_between(sent, at(*first), at(*last));
            }
        }
    }
    for (id, stream) in &mut streams {
        let length_s = lengths_s.get(id).copied().unwrap_or(0.0);
        stream.rate_hz = if length_s > 0.0 { stream.samples as f64 / length_s } else { 0.0 };
    }
    Ok((takes.len(), streams))
}

/// How many samples were sent from the one that was received at `first_ns` to the one at `last_ns`, both included: each
/// was sent just before. Half a period of slack makes up for counters that are looked at now and then.
fn sent_between(sent_ns: &[u64], first_ns: u64, last_ns: u64) -> usize {
    let period_ns = match sent_ns {
        [first, .., last] => (last - first) / (sent_ns.len() as u64 - 1),
        _ => return 0,
    };
    let until = |at_ns: u64| sent_ns.partition_point(|&sent| sent <= at_ns + period_ns / 2);
    (until(last_ns) + 1).saturating_sub(until(first_ns))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn samples_are_counted_from_the_first_to_the_last() {
        let sent: Vec<u64> = (0..100).map(|sample| sample * 10 * MS).collect();
        // Received a little later than sent, or looked at a little late.
        for late in [0, MS, 3 * MS] {
            assert_eq!(sent_between(&sent, 200 * MS + late, 600 * MS + late), 41);
        }
        let seen_late: Vec<u64> = sent.iter().map(|at| at + 2 * MS).collect();
        assert_eq!(sent_between(&seen_late, 200 * MS, 600 * MS), 41);
        assert_eq!(sent_between(&[], 0, 600 * MS), 0);
    }
}
