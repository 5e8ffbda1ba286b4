//! A checked take on its way into an MCAP file.

use std::{fs, path::Path};

use palpate_robot_model::Station;

use super::read::CheckedTake;
use crate::{LogLevel, RecordingError, TactileSampleRef, TakeWriter};

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
