//! The paper's figure: frames in which any channel is active, real over nominal over calibrated.

use std::fmt::Write as _;

use maud::{Markup, html};

use crate::TakeTimeline;

/// Width of the time axis, in columns of one unit; more detail than that is merged.
const COLUMNS: usize = 860;
const LABEL_WIDTH: usize = 130;
const ROW_HEIGHT: usize = 9;
const STREAM_GAP: usize = 8;
/// More takes than this are left to the studio's timelines, so that the page stays small.
const MAX_TAKES: usize = 60;

pub(super) fn pictures(timelines: &[TakeTimeline]) -> Markup {
    html! {
        p.caption { "Each mark is a frame in which at least one channel of the stream is active." }
        p.legend.caption {
            span style="--swatch: var(--real)" { "real" }
            span style="--swatch: var(--nominal)" { "nominal simulation" }
            span style="--swatch: var(--calibrated)" { "calibrated simulation" }
        }
        @for timeline in timelines.iter().take(MAX_TAKES) { (of_take(timeline)) }
        @if timelines.len() > MAX_TAKES {
            p.caption { (timelines.len() - MAX_TAKES) " more takes are not shown here." }
        }
    }
}

fn of_take(timeline: &TakeTimeline) -> Markup {
    let held_out = if timeline.held_out { ", held out" } else { "" };
    let heading = html! { h3 { (timeline.take) " " span.caption { (timeline.object) (held_out) } } };
    let (Some(&first_s), Some(&last_s)) = (timeline.frame_times_s.first(), timeline.frame_times_s.last())
    else {
        return html! { (heading) p.caption { "no frames" } };
    };
    let stream_height = 3 * ROW_HEIGHT + STREAM_GAP;
    let rows_height = timeline.streams.len() * stream_height;
    let (right, ends_y) = (LABEL_WIDTH + COLUMNS, rows_height + 13);
    html! {
        (heading)
        svg viewBox=(format!("0 0 {right} {}", rows_height + 16)) role="img"
            aria-label={ "Trigger events of " (timeline.take) } {
            @for (idx, stream) in timeline.streams.iter().enumerate() {
                @let top = idx * stream_height;
                text x="0" y=(top + 3 * ROW_HEIGHT / 2 + 4) { (stream.label) }
                @let rows = [("real", &stream.real), ("nominal", &stream.nominal), ("calibrated", &stream.calibrated)];
                @for (row_idx, (class, active)) in rows.into_iter().enumerate() {
                    @let y = top + row_idx * ROW_HEIGHT + ROW_HEIGHT / 2;
                    @let path = event_path(&timeline.frame_times_s, active, y);
                    @if !path.is_empty() { path class=(class) stroke-width=(ROW_HEIGHT - 1) d=(path) {} }
                }
            }
            path.axis d=(format!("M{LABEL_WIDTH} {rows_height}H{right}")) {}
            text x=(LABEL_WIDTH) y=(ends_y) { (format!("{first_s:.1} s")) }
            text x=(right) y=(ends_y) text-anchor="end" { (format!("{last_s:.1} s")) }
        }
    }
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
