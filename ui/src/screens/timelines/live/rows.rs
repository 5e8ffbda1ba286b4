//! Draws the last seconds, a row for each stream and channel.

use egui::{
    Align2, Color32, FontId, Rangef, Rect, RichText, Sense, Stroke, StrokeKind, accesskit::Role, pos2, vec2,
};

use super::LivePicture;
use crate::{
    screens::{ScreenContext, timelines::bars::Bars},
    store::touch_history::{HISTORY_S, LiveLane},
    theme::Palette,
};

const NAMES_WIDTH: f32 = 250.0;
const RULER_HEIGHT: f32 = 22.0;
const BAR: f32 = 11.0;
const ROW_HEIGHT: f32 = 2.0 * BAR + 4.0;
/// Seconds between marks.
const TICK_S: f64 = 5.0;
/// Below this share of agreement a channel needs a look, and below the second one it is bad.
const AGREES: f32 = 0.95;
const DISAGREES: f32 = 0.8;

pub(super) fn picture_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, picture: &LivePicture<'_>) {
    legend_ui(ui, cx, picture);
    let area = ui.available_rect_before_wrap();
    // The scroll bar of the channels lies to the right of the plot.
    let width = (area.width() - NAMES_WIDTH - ui.spacing().scroll.allocated_width()).max(50.0);
    let plot = Rangef::new(area.left() + NAMES_WIDTH, area.left() + NAMES_WIDTH + width);
    ruler_ui(ui, cx, plot);
    ui.spacing_mut().item_spacing.y = 3.0;
    for (stream, lane) in picture.station.layout.streams.iter().zip(&picture.lanes.streams) {
        let name = format!("{}, any", stream.label);
        let worst = worst(picture, stream.channels.clone());
        row_ui(ui, cx, picture, plot, &Row { name: &name, channel: None, lane, agreement: worst });
    }
    ui.separator();
    egui::ScrollArea::vertical().id_salt("live rows").auto_shrink(false).show(ui, |ui| {
        for &channel in picture.order {
            let Some(lane) = picture.lanes.channels.get(channel) else { continue };
            heading_ui(ui, cx, picture, channel);
            let name = picture.station.layout.channel_label(channel);
            let agreement = picture.agreement.get(channel).copied();
            row_ui(ui, cx, picture, plot, &Row { name: &name, channel: Some(channel), lane, agreement });
        }
    });
}

struct Row<'a> {
    name: &'a str,
    /// `None` for a whole stream.
    channel: Option<usize>,
    lane: &'a LiveLane,
    /// The channel's; the worst of a stream's.
    agreement: Option<f32>,
}

/// The least agreement of some channels.
fn worst(picture: &LivePicture<'_>, channels: std::ops::Range<usize>) -> Option<f32> {
    picture.agreement.get(channels)?.iter().copied().min_by(f32::total_cmp)
}

/// What the colours mean.
fn legend_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, picture: &LivePicture<'_>) {
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        ui.spacing_mut().interact_size.y = 18.0;
        let palette = cx.palette;
        let key = |ui: &mut egui::Ui, text: &str, paint: &dyn Fn(&egui::Painter, Rect)| {
            let (rect, _) = ui.allocate_exact_size(vec2(22.0, 12.0), Sense::hover());
            paint(ui.painter(), rect);
            ui.label(RichText::new(text).small());
            ui.add_space(10.0);
        };
        key(ui, "real", &|painter, rect| {
            painter.rect_filled(rect, 1.0, palette.real);
        });
        key(ui, "simulated", &|painter, rect| {
            painter.rect_filled(rect, 1.0, picture.simulated_colour);
        });
        key(ui, "simulated, not real", &|painter, rect| {
            painter.rect_stroke(rect, 1.0, Stroke::new(1.0, picture.simulated_colour), StrokeKind::Inside);
        });
        key(ui, "real, not simulated", &|painter, rect| {
            painter.hline(rect.x_range(), rect.bottom() - 2.0, Stroke::new(2.5, palette.mismatch));
        });
        key(ui, "nothing simulated", &|painter, rect| {
            painter.rect_filled(rect, 1.0, palette.dead.gamma_multiply(0.3));
        });
        ui.label(RichText::new("Figures: agreement over the last ten seconds").small());
    });
}

/// Seconds before now.
fn ruler_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, plot: Rangef) {
    let (row, _) = ui.allocate_exact_size(vec2(ui.available_width(), RULER_HEIGHT), Sense::hover());
    let font = FontId::proportional(13.0);
    for step in 0..=(HISTORY_S / TICK_S) as usize {
        let ago_s = step as f64 * TICK_S;
        let x = plot.max - (ago_s / HISTORY_S) as f32 * plot.span();
        ui.painter().vline(x, row.y_range(), Stroke::new(1.0, cx.palette.line));
        let (text, align) = match step {
            0 => ("now".to_owned(), Align2::RIGHT_TOP),
            _ => (format!("\u{2212}{ago_s:.0} s"), Align2::LEFT_TOP),
        };
        let x = if step == 0 { x - 3.0 } else { x + 3.0 };
        ui.painter().text(pos2(x, row.top()), align, text, font.clone(), cx.palette.text_weak);
    }
}

/// Before the first channel of a patch with several: its name, and its worst channel.
fn heading_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, picture: &LivePicture<'_>, channel: usize) {
    let layout = &picture.station.layout;
    let patch = &layout.patches[layout.channels[channel].patch];
    if !picture.by_patch || patch.channels.len() == 1 || patch.channels.start != channel {
        return;
    }
    ui.horizontal(|ui| {
        ui.spacing_mut().interact_size.y = 20.0;
        ui.label(RichText::new(&patch.label).strong());
        if let Some(worst) = worst(picture, patch.channels.clone()) {
            let text = format!("worst {}", percent(worst));
            ui.label(RichText::new(text).color(agreement_colour(worst, &cx.palette)));
        }
    });
}

fn row_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    picture: &LivePicture<'_>,
    plot: Rangef,
    row: &Row<'_>,
) {
    let (rect, _) = ui.allocate_exact_size(vec2(ui.available_width(), ROW_HEIGHT), Sense::hover());
    let names = Rect::from_x_y_ranges(rect.left()..=plot.min - 8.0, rect.y_range());
    name_ui(ui, cx, picture, row, names);
    if !ui.is_rect_visible(rect) {
        return;
    }
    let lane_rect = Rect::from_x_y_ranges(plot, rect.y_range());
    let response = ui.interact(lane_rect, ui.scope_id().with(("live lane", row.name)), Sense::HOVER);
    if response.hovered() && row.channel.is_some() {
        cx.playback.hovered = row.channel;
    }
    let highlighted = row.channel.is_some()
        && (cx.playback.highlighted() == row.channel || cx.playback.pinned == row.channel);
    let palette = cx.palette;
    let ground = if highlighted { palette.line } else { palette.surface };
    let painter = ui.painter().with_clip_rect(lane_rect.intersect(ui.clip_rect()));
    painter.rect_filled(lane_rect, 0.0, ground);
    let bars = Bars {
        plot,
        view_s: [picture.now_s - HISTORY_S, picture.now_s],
        pixels_per_point: ui.ctx().pixels_per_point(),
    };
    let real = Rangef::new(rect.top() + 1.0, rect.top() + BAR);
    let simulated = Rangef::new(rect.top() + BAR + 3.0, rect.bottom() - 1.0);
    let mut shapes = Vec::new();
    bars.filled(&picture.lanes.unsimulated, simulated, palette.dead.gamma_multiply(0.3), &mut shapes);
    bars.filled(&row.lane.real, real, palette.real, &mut shapes);
    bars.filled(&row.lane.both, simulated, picture.simulated_colour, &mut shapes);
    bars.hollow(&row.lane.simulated_only, simulated, picture.simulated_colour, &mut shapes);
    let underline = Rangef::new(simulated.max - 2.5, simulated.max);
    bars.filled(&row.lane.real_only, underline, palette.mismatch, &mut shapes);
    painter.extend(shapes);
}

/// The row's name, how it agrees, and what is wrong with it; pressing it keeps the channel.
fn name_ui(ui: &egui::Ui, cx: &mut ScreenContext<'_>, picture: &LivePicture<'_>, row: &Row<'_>, rect: Rect) {
    let sense = if row.channel.is_some() { Sense::click() } else { Sense::hover() };
    let response = ui.interact(rect, ui.scope_id().with(("live name", row.name)), sense);
    let pinned = row.channel.is_some() && cx.playback.pinned == row.channel;
    let warning = picture.warnings.iter().find(|warning| Some(warning.channel as usize) == row.channel);
    response.widget_info(|| {
        let agrees = row.agreement.map_or_else(
            || "nothing simulated".to_owned(),
            |share| match row.channel {
                Some(_) => format!("agrees {}", percent(share)),
                None => format!("worst {}", percent(share)),
            },
        );
        let kind = warning.map_or_else(String::new, |warning| format!(", {}", warning.kind));
        let mut info = if row.channel.is_some() {
            egui::WidgetInfo::selected(Role::Button, true, pinned, row.name)
        } else {
            egui::WidgetInfo::labeled(Role::Image, true, row.name)
        };
        info.current_text_value = Some(format!("{agrees}{kind}"));
        info
    });
    if response.clicked() {
        cx.playback.pinned = if pinned { None } else { row.channel };
    }
    if response.hovered() && row.channel.is_some() {
        cx.playback.hovered = row.channel;
    }
    if !ui.is_rect_visible(rect) {
        return;
    }
    let palette = &cx.palette;
    let painter = ui.painter().with_clip_rect(rect.intersect(ui.clip_rect()));
    if pinned || response.hovered() {
        painter.rect_filled(rect, 2.0, palette.line);
    }
    let at = rect.left_center() + vec2(4.0, 0.0);
    let name_colour = if pinned { palette.calibrated } else { palette.real };
    painter.text(at, Align2::LEFT_CENTER, row.name, FontId::proportional(14.0), name_colour);
    if let Some(warning) = warning {
        let colour = if warning.kind == "stuck" { palette.stuck } else { palette.warning };
        let at = pos2(rect.right() - 104.0, rect.center().y);
        let text = format!("\u{26a0} {}", warning.kind);
        painter.text(at, Align2::RIGHT_CENTER, text, FontId::proportional(13.0), colour);
    }
    let Some(share) = row.agreement else { return };
    let colour = agreement_colour(share, palette);
    let bar = Rect::from_min_size(pos2(rect.right() - 96.0, rect.center().y - 4.0), vec2(44.0, 8.0));
    painter.rect_filled(bar, 2.0, palette.line);
    let filled = Rect::from_min_size(bar.min, vec2(bar.width() * share.clamp(0.0, 1.0), bar.height()));
    painter.rect_filled(filled, 2.0, colour);
    let at = pos2(rect.right() - 2.0, rect.center().y);
    painter.text(at, Align2::RIGHT_CENTER, percent(share), FontId::proportional(13.0), colour);
}

fn agreement_colour(share: f32, palette: &Palette) -> Color32 {
    if share >= AGREES {
        palette.text_weak
    } else if share >= DISAGREES {
        palette.warning
    } else {
        palette.mismatch
    }
}

/// Rounded down, so that 100 % means always.
fn percent(share: f32) -> String {
    format!("{:.0} %", (100.0 * share + 1e-3).floor())
}

#[cfg(test)]
mod tests {
    use super::percent;

    #[test]
    fn all_of_it_is_said_only_of_all_of_it() {
        assert_eq!([1.0, 0.9999, 0.95, 0.0].map(percent), ["100 %", "99 %", "95 %", "0 %"]);
    }
}
