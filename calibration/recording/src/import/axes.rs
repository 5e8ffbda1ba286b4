//! From the axes of taxels to the one reading that everything works with.

use palpate_robot_model::{Station, TaxelAxes};

use super::{assemble::Assembled, report::TakeReport, table::Table};
use crate::{RecordingError, plausible};

/// The readings of stream `stream_idx`, a column for each channel, and what its axes measured: `num_samples x
/// num_channels x num_axes`, row-major, as it is kept. `assembled` has a column for each axis of each channel; each of
/// `baselines_s` holds a sample of it. `report` learns how readings were made.
pub(super) fn readings(
    station: &Station,
    stream_idx: usize,
    assembled: &Assembled,
    baselines_s: &[[f64; 2]],
    report: &mut TakeReport,
) -> Result<(Table, Vec<f32>), RecordingError> {
    let (stream, config) = (&station.layout.streams[stream_idx], &station.streams[stream_idx]);
    let (num_channels, num_axes) = (stream.channels.len(), stream.axes.count());
    let table = &assembled.table;
    // What is kept is single, and gives the same readings again.
    let axes: Vec<f32> = table.values.iter().map(|&value| value as f32).collect();
    let width = num_channels * num_axes;
    let rests = match stream.axes {
        TaxelAxes::Norm { .. } => rests(&table.times_s, &axes, width, baselines_s),
        TaxelAxes::One | TaxelAxes::Normal { .. } => Vec::new(),
    };
    let mut made = Table { times_s: table.times_s.clone(), lines: table.lines.clone(), values: Vec::new() };
    made.values.reserve(table.times_s.len() * num_channels);
    for ((&time_s, &line), sample) in
        table.times_s.iter().zip(&table.lines).zip(axes.chunks_exact(width.max(1)))
    {
        // Before the first span its rest counts too.
        let newest = baselines_s.partition_point(|span| span[0] <= time_s).saturating_sub(1);
        let rest = rests.get(newest).map_or(&[][..], Vec::as_slice);
        for (channel, values) in sample.chunks_exact(num_axes).enumerate() {
            let reading = match stream.axes {
                TaxelAxes::One => f64::from(values[0]),
                TaxelAxes::Normal { axis, falls, .. } => {
                    let along = f64::from(values[axis]);
                    if falls { -along } else { along }
                }
                TaxelAxes::Norm { .. } => {
                    let rest = &rest[channel * num_axes..];
                    let changes = values.iter().zip(rest).map(|(&value, rest)| f64::from(value) - rest);
                    changes.map(|change| change * change).sum::<f64>().sqrt()
                }
            };
            let channel = stream.channels.start + channel;
            let place = || {
                let id = &station.layout.channels[channel].id;
                let of_axes = match stream.axes {
                    TaxelAxes::Normal { axis, .. } => format!("axis {}", TaxelAxes::NAMES[axis]),
                    _ => format!("axes {}", stream.axes.names().join(", ")),
                };
                format!("line {line}, channel {id:?}, {of_axes}")
            };
            if !(reading as f32).is_finite() {
                let problem = format!("the reading {} is too large", plausible::short(reading));
                return Err(RecordingError::content(&assembled.path, place(), problem));
            }
            if let Some(problem) = plausible::below_range(config, reading, &stream.raw_unit) {
                let problem = format!("the reading made of it, {problem}");
                return Err(RecordingError::content(&assembled.path, place(), problem));
            }
            made.values.push(reading);
        }
    }
    let (least, most) =
        made.values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), &reading| {
            (least.min(reading), most.max(reading))
        });
    let how = match stream.axes {
        TaxelAxes::Normal { axis, falls, .. } => {
            format!("axis {}{}", if falls { "-" } else { "" }, TaxelAxes::NAMES[axis])
        }
        _ => format!("the norm of the change of its axes {} from rest", stream.axes.names().join(", ")),
    };
    report.notes.push(format!(
        "stream {:?}: the reading of a channel is {how}, {least:.6} to {most:.6} {}; its axes are kept as well",
        stream.id, stream.raw_unit
    ));
    Ok((made, axes))
}

/// Of each span, the mean of each of `width` columns over the samples in it.
fn rests(times_s: &[f64], axes: &[f32], width: usize, baselines_s: &[[f64; 2]]) -> Vec<Vec<f64>> {
    let of_span = |&[start_s, end_s]: &[f64; 2]| {
        let mut sums = vec![0.0; width];
        let mut num_samples = 0_usize;
        for (time_s, sample) in times_s.iter().zip(axes.chunks_exact(width.max(1))) {
            if (start_s..=end_s).contains(time_s) {
                num_samples += 1;
                sums.iter_mut().zip(sample).for_each(|(sum, &value)| *sum += f64::from(value));
            }
        }
        sums.iter_mut().for_each(|sum| *sum /= num_samples.max(1) as f64);
        sums
    };
    baselines_s.iter().map(of_span).collect()
}
