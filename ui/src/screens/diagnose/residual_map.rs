//! Where simulation and hand disagree: channels by phases as a heat map, and the same on the flat map of the hand.

use std::sync::Arc;

use egui::{Align2, Color32, FontId, Rect, RichText, Sense, Stroke, accesskit::Role, pos2, vec2};
use palpate_reports::{ChannelResidual, DiagnosisReport, wording};
use palpate_robot_model::Station;
use palpate_wire::api::DiagnosisRun;

use super::details::cells_ui;
use crate::{
    playback::ShownChannels,
    route::Screen,
    screens::{
        ScreenContext, channel_label,
        hand::{channel_map_ui, residual::Residual},
        words,
    },
    store::Loadable,
    theme::{taxel_scale, taxel_scale_ui},
};

const PHASES: [&str; 4] = ["onset", "sustained", "release", "no_contact"];
const NAME_WIDTH: f32 = 84.0;
const ROW_HEIGHT: f32 = 26.0;
const MAP_SIZE: egui::Vec2 = egui::vec2(340.0, 300.0);
/// Room for the map and what stands beside it, which stands below where there is less.
const BESIDE_WIDTH: f32 = MAP_SIZE.x + 280.0;

/// The mismatch of one channel in one phase.
fn value(channel: &ChannelResidual, phase: &str, before: bool) -> Option<f64> {
    let by_phase = if before { &channel.calibrated } else { &channel.diagnosed };
    by_phase.get(phase).copied()
}

pub(super) fn residual_map_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    before: &mut bool,
    run: &DiagnosisRun,
    report: &DiagnosisReport,
) {
    if report.residual_map.is_empty() {
        ui.label("This report holds no residual map.");
        return;
    }
    ui.horizontal_wrapped(|ui| {
        let choices = [
            (true, "Before", "calibrated", cx.palette.calibrated),
            (false, "After", "with the named effects", cx.palette.diagnosed),
        ];
        for (value, name, about, colour) in choices {
            let chosen = *before == value;
            let response = ui.selectable_label(chosen, RichText::new(name).strong().color(colour));
            response.widget_info(|| {
                egui::WidgetInfo::selected(Role::RadioButton, true, chosen, format!("{name}: {about}"))
            });
            if response.on_hover_text(about).clicked() {
                *before = value;
            }
        }
        ui.separator();
        if ui.button("Show on the hand").clicked() {
            cx.playback.residual_of = Some(run.id.clone());
            cx.go_to_screen(Screen::Hand);
        }
        if ui.button("Compare on Timelines").clicked() {
            cx.go_to_screen(Screen::Timelines);
        }
    });
    let station = cx.store.station(&run.request.session);
    let clicked = heat_map_ui(ui, cx, report, *before, station.ready().map(AsRef::as_ref));
    if let (Some(idx), Some(station)) = (clicked, station.ready()) {
        open_channel(cx, station, &report.residual_map[idx].channel);
    }
    ui.add_space(6.0);
    if ui.available_width() >= BESIDE_WIDTH {
        ui.horizontal_top(|ui| {
            on_hand_ui(ui, cx, station, report, *before);
            ui.vertical(|ui| parts_ui(ui, cx, run, report));
        });
    } else {
        on_hand_ui(ui, cx, station, report, *before);
        parts_ui(ui, cx, run, report);
    }
}

/// The parts of the data in which the excess lies.
fn parts_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, run: &DiagnosisRun, report: &DiagnosisReport) {
    if report.cells.is_empty() {
        ui.label("No part of the data stands out over the noise.");
        return;
    }
    ui.label(RichText::new("Most of the calibrated model's excess lies here:").strong());
    cells_ui(ui, cx, &report.cells, &run.request.session);
}

/// The same on the map of the hand, or why there is none.
fn on_hand_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    station: Loadable<Arc<Station>>,
    report: &DiagnosisReport,
    before: bool,
) {
    let size = MAP_SIZE.min(vec2(ui.available_width(), MAP_SIZE.y));
    let (rect, _) = ui.allocate_exact_size(size, Sense::hover());
    match station {
        Loadable::Ready(station) => hand_map_ui(ui, cx, rect, &station, report, before),
        Loadable::Failed(error) => {
            ui.colored_label(cx.palette.mismatch, error);
        }
        Loadable::Idle | Loadable::Loading => {
            ui.put(rect, egui::Spinner::new());
        }
    }
}

fn hand_map_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    rect: Rect,
    station: &Station,
    report: &DiagnosisReport,
    before: bool,
) {
    let residual = Residual::new(report, station);
    let shown = if before { &residual.before } else { &residual.after };
    let of = |channel: usize| shown.get(channel).copied().flatten();
    let colors: Vec<Color32> = (0..station.layout.num_channels())
        .map(|channel| {
            of(channel)
                .map_or(cx.palette.dead, |per_s| taxel_scale((per_s / residual.full_scale_per_s) as f32))
        })
        .collect();
    let name = |channel: usize| {
        let label = station.layout.channel_label(channel);
        match of(channel) {
            Some(per_s) => format!("{label}: mismatch {} a second", wording::number(per_s)),
            None => format!("{label}: not judged"),
        }
    };
    let palette = cx.palette;
    channel_map_ui(ui, rect, station, &colors, &name, cx.playback, &palette);
    if let Some(channel) = cx.playback.highlighted().filter(|&channel| channel < colors.len()) {
        let at = rect.left_bottom() + vec2(8.0, -6.0);
        let font = FontId::proportional(13.0);
        ui.painter().text(at, Align2::LEFT_BOTTOM, name(channel), font, palette.real);
    }
}

/// The heat map; gives the index of a channel that was clicked.
fn heat_map_ui(
    ui: &mut egui::Ui,
    cx: &ScreenContext<'_>,
    report: &DiagnosisReport,
    before: bool,
    station: Option<&Station>,
) -> Option<usize> {
    let palette = cx.palette;
    let channels = &report.residual_map;
    let both = channels.iter().flat_map(|c| c.calibrated.values().chain(c.diagnosed.values()));
    // One scale for both, so that the change can be seen.
    let full = both.copied().fold(f64::MIN_POSITIVE, f64::max);
    let width = (ui.available_width() - NAME_WIDTH - 16.0).clamp(120.0, 1100.0);
    let size = vec2(NAME_WIDTH + width, ROW_HEIGHT * PHASES.len() as f32 + 24.0);
    let (rect, response) = ui.allocate_exact_size(size, Sense::click());
    let total: f64 =
        channels.iter().flat_map(|c| PHASES.iter().filter_map(move |phase| value(c, phase, before))).sum();
    let state = if before { "before" } else { "after" };
    let name = format!("Residual map {state}: {} a second over all channels", wording::number(total));
    response.widget_info(|| egui::WidgetInfo::labeled(Role::Image, true, &name));
    let area =
        Rect::from_min_size(rect.min + vec2(NAME_WIDTH, 0.0), vec2(width, ROW_HEIGHT * PHASES.len() as f32));
    let cell_width = width / channels.len() as f32;
    let cell = |row: usize, column: usize| {
        let min = area.min + vec2(column as f32 * cell_width, row as f32 * ROW_HEIGHT);
        Rect::from_min_size(min, vec2(cell_width, ROW_HEIGHT))
    };
    let painter = ui.painter();
    let font = FontId::proportional(13.0);
    for (row, phase) in PHASES.iter().enumerate() {
        let at = pos2(rect.left() + 2.0, cell(row, 0).center().y);
        painter.text(at, Align2::LEFT_CENTER, words(phase), font.clone(), palette.real);
        for (column, channel) in channels.iter().enumerate() {
            let colour = value(channel, phase, before)
                .map_or(palette.line, |mismatch| taxel_scale((mismatch / full) as f32));
            painter.rect_filled(cell(row, column).shrink(0.5), 0.0, colour);
        }
    }
    patch_names(ui, area, channels, cell_width, &palette);
    let pointed = response.hover_pos().filter(|pos| area.contains(*pos)).map(|pos| {
        let column = ((pos.x - area.left()) / cell_width) as usize;
        let row = ((pos.y - area.top()) / ROW_HEIGHT) as usize;
        (row.min(PHASES.len() - 1), column.min(channels.len() - 1))
    });
    let clicked = response.clicked();
    if let Some((row, column)) = pointed {
        painter.rect_stroke(
            cell(row, column),
            0.0,
            Stroke::new(1.5, palette.real),
            egui::StrokeKind::Outside,
        );
        let text = |before| {
            value(&channels[column], PHASES[row], before)
                .map_or_else(|| "\u{2013}".to_owned(), wording::number)
        };
        response.on_hover_text_at_pointer(format!(
            "{}, {}: {} before, {} after, a second. Click to see it on Timelines.",
            channel_label(station, &channels[column].channel),
            words(PHASES[row]),
            text(true),
            text(false)
        ));
    }
    ui.horizontal_wrapped(|ui| {
        ui.label("0");
        taxel_scale_ui(ui, (0.3 * size.x).min(150.0));
        ui.label(format!("{} mismatch a second", wording::number(full)));
    });
    pointed.filter(|_| clicked).map(|(_, column)| column)
}

/// Names below the columns: what the ids of neighbours have in common, where there is room.
fn patch_names(
    ui: &egui::Ui,
    area: Rect,
    channels: &[ChannelResidual],
    cell_width: f32,
    palette: &crate::theme::Palette,
) {
    let patch_of = |channel: &ChannelResidual| -> String {
        channel.channel.rsplit_once('.').map_or(channel.channel.as_str(), |(patch, _)| patch).to_owned()
    };
    let mut free_from = area.left();
    let mut column = 0;
    for run in channels.chunk_by(|a, b| patch_of(a) == patch_of(b)) {
        let left = area.left() + column as f32 * cell_width;
        column += run.len();
        let right = area.left() + column as f32 * cell_width;
        let galley = ui.painter().layout_no_wrap(
            words(&patch_of(&run[0])),
            FontId::proportional(13.0),
            palette.text_weak,
        );
        let x = (left + right - galley.size().x) / 2.0;
        if column < channels.len() {
            ui.painter().vline(right, area.y_range(), Stroke::new(1.0, palette.background));
        }
        if x >= free_from && x + galley.size().x <= (area.right() + 60.0).min(ui.clip_rect().right()) {
            free_from = x + galley.size().x + 6.0;
            ui.painter().galley(pos2(x, area.bottom() + 3.0), galley, palette.text_weak);
        }
    }
}

fn open_channel(cx: &mut ScreenContext<'_>, station: &Station, id: &str) {
    let Some(channel) = station.layout.channels.iter().position(|channel| channel.id == id) else { return };
    cx.playback.selected.insert(channel);
    cx.playback.pinned = Some(channel);
    cx.playback.shown = ShownChannels::Picked;
    cx.go_to_screen(Screen::Timelines);
}
