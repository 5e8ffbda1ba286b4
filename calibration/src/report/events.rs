//! The paper's figure: frames in which any channel is active, real over nominal over calibrated.

use std::fmt::{self, Write as _};

use super::Escaped;
use crate::TakeTimeline;

/// Width of the time axis, in columns of one unit; more detail than that is merged.
const COLUMNS: usize = 860;
const LABEL_WIDTH: usize = 130;
const ROW_HEIGHT: usize = 9;
const STREAM_GAP: usize = 8;
/// More takes than this are left to the studio's timelines, so that the page stays small.
const MAX_TAKES: usize = 60;

pub(super) fn write(page: &mut String, timelines: &[TakeTimeline]) -> fmt::Result {
    page.push_str(
        "<p class=\"caption\">Each mark is a frame in which at least one channel of the stream is active.</p>\n\
         <p class=\"legend caption\"><span style=\"--swatch: var(--real)\">real</span>\
         <span style=\"--swatch: var(--nominal)\">nominal simulation</span>\
         <span style=\"--swatch: var(--calibrated)\">calibrated simulation</span></p>\n",
    );
    for timeline in timelines.iter().take(MAX_TAKES) {
        write_take(page, timeline)?;
    }
    if timelines.len() > MAX_TAKES {
        let hidden = timelines.len() - MAX_TAKES;
        writeln!(page, "<p class=\"caption\">{hidden} more takes are not shown here.</p>")?;
    }
    Ok(())
}

fn write_take(page: &mut String, timeline: &TakeTimeline) -> fmt::Result {
    let held_out = if timeline.held_out { ", held out" } else { "" };
    let (take, object) = (Escaped(&timeline.take), Escaped(&timeline.object));
    writeln!(page, "<h3>{take} <span class=\"caption\">{object}{held_out}</span></h3>")?;
    let (Some(&first_s), Some(&last_s)) = (timeline.frame_times_s.first(), timeline.frame_times_s.last())
    else {
        return writeln!(page, "<p class=\"caption\">no frames</p>");
    };
    let stream_height = 3 * ROW_HEIGHT + STREAM_GAP;
    let rows_height = timeline.streams.len() * stream_height;
    writeln!(
        page,
        "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"Trigger events of {take}\">",
        width = LABEL_WIDTH + COLUMNS,
        height = rows_height + 16,
    )?;
    for (stream_idx, stream) in timeline.streams.iter().enumerate() {
        let top = stream_idx * stream_height;
        let middle = top + 3 * ROW_HEIGHT / 2 + 4;
        writeln!(page, "<text x=\"0\" y=\"{middle}\">{}</text>", Escaped(&stream.label))?;
        let rows = [("real", &stream.real), ("nominal", &stream.nominal), ("calibrated", &stream.calibrated)];
        for (row_idx, (class, active)) in rows.into_iter().enumerate() {
            let y = top + row_idx * ROW_HEIGHT + ROW_HEIGHT / 2;
            let path = event_path(&timeline.frame_times_s, active, y);
            if !path.is_empty() {
                writeln!(page, "<path class=\"{class}\" stroke-width=\"{}\" d=\"{path}\"/>", ROW_HEIGHT - 1)?;
            }
        }
    }
    let right = LABEL_WIDTH + COLUMNS;
    writeln!(
        page,
        "<path class=\"axis\" d=\"M{LABEL_WIDTH} {rows_height}H{right}\"/>\n\
         <text x=\"{LABEL_WIDTH}\" y=\"{y}\">{first_s:.1} s</text>\n\
         <text x=\"{right}\" y=\"{y}\" text-anchor=\"end\">{last_s:.1} s</text>\n</svg>",
        y = rows_height + 13,
    )
}

/// Runs of active columns as horizontal strokes at `y`. A column is active if a frame in it is.
fn event_path(times_s: &[f64], active: &[bool], y: usize) -> String {
    let first_s = times_s[0];
    let duration_s = (times_s[times_s.len() - 1] - first_s).max(f64::MIN_POSITIVE);
    let mut columns = vec![false; COLUMNS];
    let column_of = |frame: usize| {
        let share = (times_s[frame] - first_s) / duration_s;
        ((share * COLUMNS as f64) as usize).min(COLUMNS - 1)
    };
    for frame in (0..active.len()).filter(|&frame| active[frame]) {
        // A frame holds until the next one, so that long contacts have no gaps in a short take.
        let from = column_of(frame);
        let until = if frame + 1 < active.len() { column_of(frame + 1).max(from + 1) } else { from + 1 };
        columns[from..until].fill(true);
    }
    let mut path = String::new();
    let mut column = 0;
    for run in columns.chunk_by(|a, b| a == b) {
        if run[0] {
            let _ = write!(path, "M{} {y}h{}", LABEL_WIDTH + column, run.len());
        }
        column += run.len();
    }
    path
}
