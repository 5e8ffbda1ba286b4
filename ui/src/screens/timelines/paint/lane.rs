//! One lane: its name and numbers, its bars, its raw trace, its onset arrows.

use egui::{Align2, Color32, FontId, Rangef, Rect, Sense, Stroke, StrokeKind, accesskit::Role, pos2, vec2};

use super::{
    super::{
        bars::Bars,
        events::Event,
        lanes::{Lane, RawTrace, SimRow},
        view::TimeView,
    },
    Axis, Picture, ScreenContext, plot_pointer,
};

const STREAM_BAR: f32 = 16.0;
const CHANNEL_BAR: f32 = 10.0;
const TRACE_HEIGHT: f32 = 26.0;
const MIN_HEIGHT: f32 = 32.0;
/// Onset arrows appear when a second is at least this wide, points.
const ARROW_PX_PER_S: f32 = 70.0;

pub(super) fn lane_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    picture: &Picture<'_>,
    axis: &Axis,
    lane: &Lane,
    view: &mut TimeView,
) {
    let bar = if lane.channel.is_some() { CHANNEL_BAR } else { STREAM_BAR };
    let raw = lane.channel.and_then(|channel| picture.lanes.raw.get(channel)?.as_ref());
    let bars_height = bar * (1 + picture.simulations.len()) as f32;
    let height = (bars_height + if raw.is_some() { TRACE_HEIGHT } else { 0.0 }).max(MIN_HEIGHT);
    let (row, _) = ui.allocate_exact_size(vec2(ui.available_width(), height), Sense::hover());
    let rect = Rect::from_x_y_ranges(axis.range(), row.y_range());
    let names = Rect::from_min_max(row.min, pos2(axis.left - 8.0, row.bottom()));

    let marked = lane.channel.is_some() && picture.at.map(|(_, mismatch)| mismatch.channel) == lane.channel;
    if marked && picture.jumped {
        ui.scroll_to_rect(row, Some(egui::Align::Center));
    }
    // Lanes out of sight still exist for those who do not look: their node is made, nothing is painted.
    name_ui(ui, cx, picture, lane, names, bar);
    if !ui.is_rect_visible(row) {
        return;
    }
    let id = ui.scope_id().with(("lane", lane.stream, lane.channel));
    // Not a stop for the keyboard: the time cursor and the names are.
    let response = ui.interact(rect, id, Sense::CLICK | Sense::DRAG);
    if response.hovered() && lane.channel.is_some() {
        cx.playback.hovered = lane.channel;
    }
    let about = response.hover_pos().map(|pos| contacts_at(picture, lane, axis.time_s(pos.x)));
    let response = match about {
        Some(lines) if !lines.is_empty() => response.on_hover_text_at_pointer(lines.join("\n")),
        _ => response,
    };
    plot_pointer(&response, cx, axis, view);

    let painter = ui.painter().with_clip_rect(rect.intersect(ui.clip_rect()));
    let highlighted = lane.channel.is_some() && cx.playback.highlighted() == lane.channel;
    let ground = if highlighted { cx.palette.line } else { cx.palette.surface };
    painter.rect_filled(rect, 0.0, ground);
    if marked {
        let whole = Rect::from_min_max(row.min, rect.max).shrink(1.0);
        let stroke = Stroke::new(2.0, cx.palette.warning);
        ui.painter().rect_stroke(whole, 3.0, stroke, StrokeKind::Inside);
    }
    let pixels_per_point = ui.ctx().pixels_per_point();
    let mut shapes = Vec::new();
    let mut y = Rangef::new(rect.top() + 1.0, rect.top() + bar - 1.0);
    let bars = Bars { plot: axis.range(), view_s: [axis.view.from_s, axis.view.to_s], pixels_per_point };
    bars.filled(&lane.real, y, cx.palette.real, &mut shapes);
    for simulation in picture.simulations {
        y = Rangef::new(y.min + bar, y.max + bar);
        if let Some(sim) = simulation.row.and_then(|row| lane.sims.get(row)) {
            bars.filled(&sim.both, y, simulation.colour, &mut shapes);
            bars.hollow(&sim.simulated_only, y, simulation.colour, &mut shapes);
            let underline = Rangef::new(y.max - 1.5, y.max + 0.5);
            bars.filled(&sim.real_only, underline, cx.palette.mismatch, &mut shapes);
        }
    }
    painter.extend(shapes);
    if axis.px_per_s() >= ARROW_PX_PER_S {
        let mut y = rect.top() + bar / 2.0;
        for simulation in picture.simulations {
            y += bar;
            if let Some(sim) = simulation.row.and_then(|row| lane.sims.get(row)) {
                arrows(&painter, axis, sim, y, cx.palette.real);
            }
        }
    }
    if let (Some(raw), Some(channel)) = (raw, lane.channel) {
        let trace_rect = Rect::from_min_max(pos2(rect.left(), rect.top() + bars_height + 2.0), rect.max);
        trace(&painter, cx, picture, axis, raw, channel, trace_rect);
    }
}

/// The lane's name with the numbers under the cursor; pressing it keeps the channel in the side panel.
fn name_ui(
    ui: &egui::Ui,
    cx: &mut ScreenContext<'_>,
    picture: &Picture<'_>,
    lane: &Lane,
    rect: Rect,
    bar: f32,
) {
    let time_s = cx.playback.time_s;
    let on = |events: &[Event]| event_at(events, time_s).is_some();
    let real_on = on(&lane.real);
    let mut states = vec![("real", cx.palette.real, Some(real_on))];
    for simulation in picture.simulations {
        let sim = simulation.row.and_then(|row| lane.sims.get(row));
        let sim_on = sim.map(|sim| on(&sim.contacts));
        states.push((simulation.label, simulation.colour, sim_on));
    }
    let reading = lane.channel.and_then(|channel| {
        let value = picture.take.raw_at(time_s, channel, picture.station)?;
        // Adding zero turns "-0" into "0".
        Some(format!("{:.0} {}", value.round() + 0.0, picture.station.layout.streams[lane.stream].raw_unit))
    });

    let sense = if lane.channel.is_some() { Sense::click() } else { Sense::hover() };
    let response = ui.interact(rect, ui.scope_id().with(("lane name", lane.stream, lane.channel)), sense);
    let pinned = lane.channel.is_some() && cx.playback.pinned == lane.channel;
    response.widget_info(|| {
        let words: Vec<String> = states
            .iter()
            .map(|(label, _, on)| match on {
                Some(true) => format!("{label} touched"),
                Some(false) => format!("{label} not touched"),
                None => format!("{label} unknown"),
            })
            .chain(reading.clone())
            .collect();
        let mut info = if lane.channel.is_some() {
            egui::WidgetInfo::selected(Role::Button, true, pinned, &lane.name)
        } else {
            egui::WidgetInfo::labeled(Role::Image, true, &lane.name)
        };
        info.current_text_value = Some(words.join(", "));
        info
    });
    if response.clicked() {
        cx.playback.pinned = if pinned { None } else { lane.channel };
    }
    if response.hovered() && lane.channel.is_some() {
        cx.playback.hovered = lane.channel;
    }
    if !ui.is_rect_visible(rect) {
        return;
    }

    let painter = ui.painter().with_clip_rect(rect.intersect(ui.clip_rect()));
    if pinned || response.hovered() {
        painter.rect_filled(rect, 2.0, cx.palette.line);
    }
    let font = FontId::proportional(13.0);
    let strong = if pinned { cx.palette.calibrated } else { cx.palette.real };
    painter.text(
        rect.left_top() + vec2(4.0, 1.0),
        Align2::LEFT_TOP,
        &lane.name,
        FontId::proportional(14.0),
        strong,
    );
    if let Some(reading) = &reading {
        painter.text(
            rect.left_bottom() + vec2(4.0, -2.0),
            Align2::LEFT_BOTTOM,
            reading,
            FontId::monospace(13.0),
            cx.palette.text_weak,
        );
    }
    for (idx, (label, colour, on)) in states.iter().enumerate() {
        let y = rect.top() + bar * (idx as f32 + 0.5);
        let centre = pos2(rect.right() - 6.0, y);
        match on {
            Some(true) => painter.circle_filled(centre, 4.0, *colour),
            _ => painter.circle_stroke(centre, 3.5, Stroke::new(1.0, *colour)),
        };
        // Rows of single channels are too low for words; the order is that of the legend.
        if lane.channel.is_none() {
            let colour = cx.palette.text_of(*colour);
            painter.text(centre - vec2(9.0, 0.0), Align2::RIGHT_CENTER, *label, font.clone(), colour);
        }
    }
}

/// The contacts of `lane` that hold at `time_s`, a line each, and how much later the simulated ones begin.
fn contacts_at(picture: &Picture<'_>, lane: &Lane, time_s: f64) -> Vec<String> {
    let line = |label: &str, event: &Event| {
        let length_s = event.end_s - event.start_s;
        format!("{label}: {:.2} s to {:.2} s ({length_s:.2} s)", event.start_s, event.end_s)
    };
    let real = event_at(&lane.real, time_s);
    let mut lines: Vec<String> = real.map(|event| line("real", event)).into_iter().collect();
    for simulation in picture.simulations {
        let Some(sim) = simulation.row.and_then(|row| lane.sims.get(row)) else { continue };
        let Some(event) = event_at(&sim.contacts, time_s) else { continue };
        let pair = sim.onsets.iter().find(|pair| pair.simulated_s == event.start_s);
        let late = pair.map_or(", no real partner".to_owned(), |pair| {
            format!(", onset {}", offset_text(pair.simulated_s - pair.real_s))
        });
        lines.push(line(simulation.label, event) + &late);
    }
    lines
}

/// How much later, in milliseconds with a sign.
fn offset_text(late_s: f64) -> String {
    let late_ms = late_s * 1e3;
    if late_ms.abs() < 0.5 { "0 ms".to_owned() } else { format!("{late_ms:+.0} ms") }
}

fn event_at(events: &[Event], time_s: f64) -> Option<&Event> {
    let idx = events.partition_point(|event| event.end_s <= time_s);
    events.get(idx).filter(|event| event.start_s <= time_s)
}

/// From each real onset in view to the simulated one, with how much later it is.
fn arrows(painter: &egui::Painter, axis: &Axis, sim: &SimRow, y: f32, colour: Color32) {
    let first_idx = sim.onsets.partition_point(|pair| pair.real_s.max(pair.simulated_s) < axis.view.from_s);
    for pair in &sim.onsets[first_idx..] {
        if pair.real_s.min(pair.simulated_s) > axis.view.to_s {
            break;
        }
        let (from_x, to_x) = (axis.x(pair.real_s), axis.x(pair.simulated_s));
        let stroke = Stroke::new(1.0, colour);
        if (to_x - from_x).abs() > 3.0 {
            painter.line_segment([pos2(from_x, y), pos2(to_x, y)], stroke);
            let back = if to_x > from_x { -4.0 } else { 4.0 };
            painter.line_segment([pos2(to_x, y), pos2(to_x + back, y - 3.0)], stroke);
            painter.line_segment([pos2(to_x, y), pos2(to_x + back, y + 3.0)], stroke);
        }
        let text = offset_text(pair.simulated_s - pair.real_s);
        let galley = painter.layout_no_wrap(text, FontId::proportional(13.0), colour);
        let size = galley.size();
        let corner = pos2(from_x.min(to_x) - size.x - 4.0, y - size.y / 2.0);
        painter.galley(corner, galley, colour);
    }
}

/// The raw reading as a thin line: every sample when there is room, else lowest to highest of each point.
fn trace(
    painter: &egui::Painter,
    cx: &ScreenContext<'_>,
    picture: &Picture<'_>,
    axis: &Axis,
    raw: &RawTrace,
    channel: usize,
    rect: Rect,
) {
    let stream = &picture.station.layout.streams[picture.station.layout.channels[channel].stream];
    let Some(samples) = picture.take.stream(&stream.id) else { return };
    let times_s = &samples.times_s;
    let [low, high] = raw.range;
    let y = |value: f32| egui::remap_clamp(value, low..=high, rect.bottom() - 1.0..=rect.top());
    let threshold_y = y(raw.threshold);
    painter.hline(rect.x_range(), threshold_y, Stroke::new(1.0, cx.palette.warning.gamma_multiply(0.7)));

    let from_idx = times_s.partition_point(|&time_s| time_s < axis.view.from_s).saturating_sub(1);
    let to_idx = (times_s.partition_point(|&time_s| time_s <= axis.view.to_s) + 1).min(times_s.len());
    let mut points = Vec::new();
    let stroke = Stroke::new(1.0, cx.palette.text_weak);
    if (to_idx.saturating_sub(from_idx)) as f32 <= axis.width {
        for (idx, &time_s) in times_s.iter().enumerate().take(to_idx).skip(from_idx) {
            if let Some([value, _]) = raw.pyramid.min_max(idx..idx + 1) {
                points.push(pos2(axis.x(time_s), y(value)));
            }
        }
    } else {
        let mut start_idx = from_idx;
        for column in 0..axis.width as usize {
            let column_end_s = axis.time_s(axis.left + column as f32 + 1.0);
            let end_idx =
                start_idx + times_s[start_idx..to_idx].partition_point(|&time_s| time_s < column_end_s);
            if let Some([lowest, highest]) = raw.pyramid.min_max(start_idx..end_idx) {
                let x = axis.left + column as f32 + 0.5;
                points.push(pos2(x, y(lowest)));
                if highest > lowest {
                    points.push(pos2(x, y(highest)));
                }
            }
            start_idx = end_idx;
        }
    }
    painter.line(points, stroke);
}
