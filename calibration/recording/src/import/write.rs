//! A checked take on its way into an MCAP file.

use std::{fs, path::Path};

use palpate_robot_model::{Station, StreamConfig};

use super::read::CheckedTake;
use crate::{LogLevel, RecordingError, StreamLog, TactileSampleRef, TakeWriter};

/// What comes next in a take: a joint frame, or a sample of a stream.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Source {
    Joints,
    ObjectPose,
    Stream(usize),
    /// What the axes of a stream measured.
    Axes(usize),
}

pub(super) fn write_take(station: &Station, take: &CheckedTake, path: &Path) -> Result<(), RecordingError> {
    let num_dofs = station.robot.num_dofs();
    let file = fs::File::create_new(path).map_err(RecordingError::io("write", path))?;
    let mut writer = TakeWriter::new(std::io::BufWriter::new(file), station, &take.meta, take.start_unix_ns)?;
    for span in &take.spans {
        writer.span(span)?;
    }
    for note in &take.notes {
        writer.log(0, LogLevel::Info, "import", note)?;
    }

    // In the order of arrival, as a live recording would have it.
    let mut order: Vec<(u64, Source, usize)> = Vec::new();
    order
        .extend(take.joint_times_ns.iter().enumerate().map(|(row, &time_ns)| (time_ns, Source::Joints, row)));
    order.extend(
        take.object_poses.iter().enumerate().map(|(row, (time_ns, _))| (*time_ns, Source::ObjectPose, row)),
    );
    for (stream_idx, stream) in take.streams.iter().enumerate() {
        let source = Source::Stream(stream_idx);
        order.extend(stream.times_ns.iter().enumerate().map(|(row, &time_ns)| (time_ns, source, row)));
        let with_axes = stream.times_ns.iter().filter(|_| !stream.axes.is_empty()).enumerate();
        order.extend(with_axes.map(|(row, &time_ns)| (time_ns, Source::Axes(stream_idx), row)));
    }
    order.sort_unstable();
    for (time_ns, source, row) in order {
        match source {
            Source::Joints => writer.joints(time_ns, take.joints.row(row, num_dofs))?,
            Source::ObjectPose => writer.object_pose(time_ns, &take.object_poses[row].1)?,
            Source::Stream(stream_idx) => {
                let stream = &take.streams[stream_idx];
                let num_channels = station.layout.streams[stream_idx].channels.len();
                let row_cells = row * num_channels..(row + 1) * num_channels;
                let sample = TactileSampleRef {
                    raw: stream.raw.get(row_cells.clone()).unwrap_or_default(),
                    active: &stream.active[row_cells],
                    device_time_ns: 0,
                };
                writer.tactile(stream_idx, time_ns, sample)?;
            }
            Source::Axes(stream_idx) => {
                let stream = &station.layout.streams[stream_idx];
                let width = stream.channels.len() * stream.axes.count();
                let values = take.streams[stream_idx].axes.get(row * width..(row + 1) * width);
                writer.axes(stream_idx, time_ns, values.unwrap_or_default())?;
            }
        }
    }
    let file = writer.finish()?.into_inner().map_err(|error| error.into_error());
    let synced = file.and_then(|file| file.sync_all());
    synced.map_err(RecordingError::io("write", path))
}

/// Firmware's rule: on above `on_threshold` over the reference, off again below `off_threshold`, else as before.
///
/// `log` has readings of `num_channels` channels, and their references.
pub(super) fn activations(config: &StreamConfig, log: &StreamLog, num_channels: usize) -> Vec<bool> {
    let mut state = vec![false; num_channels];
    let mut active = Vec::with_capacity(log.raw.len());
    for (&time_s, readings) in log.times_s.iter().zip(log.raw.chunks_exact(num_channels.max(1))) {
        let reference = log.reference_at(time_s);
        for ((state, &reading), &reference) in state.iter_mut().zip(readings).zip(reference) {
            let excess = f64::from(reading) - f64::from(reference);
            if excess > config.on_threshold {
                *state = true;
            } else if excess < config.off_threshold || config.off_threshold >= config.on_threshold {
                *state = false;
            }
            active.push(*state);
        }
    }
    active
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Reference;

    fn config(on_threshold: f64, off_threshold: f64) -> StreamConfig {
        StreamConfig { stream: "pad".to_owned(), on_threshold, off_threshold, raw_min: 0.0, raw_max: 4095.0 }
    }

    /// Samples a second apart that count from `reference`.
    fn log(raw: &[f32], reference: &[f32]) -> StreamLog {
        let times_s = (0..raw.len() / reference.len()).map(|sample| sample as f64).collect();
        StreamLog { times_s, raw: raw.to_vec(), reference: reference.to_vec(), ..StreamLog::default() }
    }

    #[test]
    fn a_channel_stays_on_between_the_two_thresholds() {
        // Two channels, the second rests at 100.
        let raw = [0.0, 100.0, 21.0, 115.0, 15.0, 121.0, 9.0, 115.0, 15.0, 109.0_f32];
        let active = activations(&config(20.0, 10.0), &log(&raw, &[0.0, 100.0]), 2);
        assert_eq!(active, [false, false, true, false, true, true, false, true, false, false]);
    }

    #[test]
    fn without_hysteresis_only_the_reading_counts() {
        let raw = [20.0, 20.5, 20.0, 19.0, 30.0_f32];
        assert_eq!(
            activations(&config(20.0, 20.0), &log(&raw, &[0.0]), 1),
            [false, true, false, false, true]
        );
    }

    #[test]
    fn readings_count_from_the_newest_reference() {
        let raw = [0.0, 30.0, 30.0, 30.0, 55.0, 5.0_f32];
        let mut log = log(&raw, &[0.0]);
        log.later_references.push(Reference { from_s: 2.0, readings: vec![30.0] });
        log.later_references.push(Reference { from_s: 5.0, readings: vec![5.0] });
        assert_eq!(activations(&config(20.0, 10.0), &log, 1), [false, true, false, false, true, false]);
    }
}
