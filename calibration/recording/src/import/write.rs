//! A checked take on its way into an MCAP file.

use std::{fs, path::Path};

use palpate_robot_model::{Station, StreamConfig};

use super::read::CheckedTake;
use crate::{LogLevel, RecordingError, TactileSampleRef, TakeWriter};

/// What comes next in a take: a joint frame, or a sample of a stream.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Source {
    Joints,
    ObjectPose,
    Stream(usize),
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
        }
    }
    let file = writer.finish()?.into_inner().map_err(|error| error.into_error());
    let synced = file.and_then(|file| file.sync_all());
    synced.map_err(RecordingError::io("write", path))
}

/// Firmware's rule: on above `on_threshold` over the reference, off again below `off_threshold`, else as before.
///
/// `raw` is `num_samples x num_channels`, row-major; `reference` has one reading per channel.
pub(super) fn activations(config: &StreamConfig, raw: &[f32], reference: &[f32]) -> Vec<bool> {
    let num_channels = reference.len().max(1);
    let mut state = vec![false; num_channels];
    let mut active = Vec::with_capacity(raw.len());
    for (cell, &reading) in raw.iter().enumerate() {
        let channel = cell % num_channels;
        let excess = f64::from(reading) - f64::from(reference[channel]);
        if excess > config.on_threshold {
            state[channel] = true;
        } else if excess < config.off_threshold || config.off_threshold >= config.on_threshold {
            state[channel] = false;
        }
        active.push(state[channel]);
    }
    active
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(on_threshold: f64, off_threshold: f64) -> StreamConfig {
        StreamConfig { stream: "pad".to_owned(), on_threshold, off_threshold, raw_min: 0.0, raw_max: 4095.0 }
    }

    #[test]
    fn a_channel_stays_on_between_the_two_thresholds() {
        // Two channels, the second rests at 100.
        let raw = [0.0, 100.0, 21.0, 115.0, 15.0, 121.0, 9.0, 115.0, 15.0, 109.0_f32];
        let active = activations(&config(20.0, 10.0), &raw, &[0.0, 100.0]);
        assert_eq!(active, [false, false, true, false, true, true, false, true, false, false]);
    }

    #[test]
    fn without_hysteresis_only_the_reading_counts() {
        let raw = [20.0, 20.5, 20.0, 19.0, 30.0_f32];
        assert_eq!(activations(&config(20.0, 20.0), &raw, &[0.0]), [false, true, false, false, true]);
    }
}
