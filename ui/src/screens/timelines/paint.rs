//! Draws the lanes that are in view, pixel by pixel, and turns the pointer into time.

mod lane;

use egui::{Align2, Color32, FontId, Rangef, Rect, RichText, Sense, Stroke, Vec2, accesskit, pos2, vec2};
use palpate_robot_model::Station;

use super::{
    ScreenContext, Simulation,
    lanes::{Mismatch, TakeLanes},
    view::{TimeView, tick_text, ticks},
};
use crate::{take_data::TakeData, theme::is_narrow};

/// Width of the names left of the lanes, points.
const NAMES_WIDTH: f32 = 216.0;
/// The same on a narrow page.
const NARROW_NAMES_WIDTH: f32 = 140.0;
const RULER_HEIGHT: f32 = 40.0;
const MIN_TICK_PX: f32 = 90.0;
/// How far the wheel turns for a zoom by e, points.
const WHEEL_PER_E: f32 = 400.0;

/// What there is to draw.
pub(super) struct Picture<'a> {
    pub(super) take: &'a TakeData,
    pub(super) station: &'a Station,
    pub(super) lanes: &'a TakeLanes,
    pub(super) simulations: &'a [Simulation],
    /// Channels that have a lane.
    pub(super) channels: &'a [usize],
    /// Mismatches in these channels, against the last simulation that is here.
    pub(super) num_mismatches: Option<usize>,
    /// The mismatch that the cursor was put on, and its place among them.
    pub(super) at: Option<(usize, Mismatch)>,
    /// The cursor was put there in this frame: its channel is brought into view.
    pub(super) jumped: bool,
}

/// From time to the screen and back.
#[derive(Clone, Copy)]
struct Axis {
    view: TimeView,
    left: f32,
    width: f32,
}

impl Axis {
    fn x(&self, time_s: f64) -> f32 {
        self.left + ((time_s - self.view.from_s) / self.view.span_s() * f64::from(self.width)) as f32
    }

    fn time_s(&self, x: f32) -> f64 {
        self.view.from_s + f64::from((x - self.left) / self.width) * self.view.span_s()
    }

    fn px_per_s(&self) -> f32 {
        (f64::from(self.width) / self.view.span_s()) as f32
    }

    fn range(&self) -> Rangef {
        Rangef::new(self.left, self.left + self.width)
    }
}

pub(super) fn picture_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    picture: &Picture<'_>,
    view: &mut TimeView,
) {
    legend_ui(ui, cx, picture);
    let area = ui.available_rect_before_wrap();
    // The scroll bar of the channels lies to the right of the plot.
    let names = if is_narrow(ui.ctx()) { NARROW_NAMES_WIDTH } else { NAMES_WIDTH };
    let width = (area.width() - names - ui.spacing().scroll.allocated_width()).max(50.0);
    let plot = Rect::from_min_size(area.min + vec2(names, 0.0), vec2(width, area.height()));
    wheel(ui, plot, view);
    let axis = Axis { view: *view, left: plot.left(), width };

    ruler_ui(ui, cx, picture, &axis, view);
    ui.spacing_mut().item_spacing.y = 4.0;
    for lane in &picture.lanes.streams {
        lane::lane_ui(ui, cx, picture, &axis, lane, view);
    }
    ui.separator();
    if picture.channels.is_empty() {
        ui.label("No channel chosen was touched in this take. Choose \u{201c}All channels\u{201d} to see the quiet ones.");
    }
    egui::ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        for lane in picture.channels.iter().filter_map(|&channel| picture.lanes.channels.get(channel)) {
            lane::lane_ui(ui, cx, picture, &axis, lane, view);
        }
    });
    let painter = ui.painter().with_clip_rect(plot);
    let cursor_x = axis.x(cx.playback.time_s);
    painter.vline(cursor_x, plot.y_range(), Stroke::new(1.5, cx.palette.real));
}

/// What the colours mean, and how the shown simulation fares.
fn legend_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, picture: &Picture<'_>) {
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        let key = |ui: &mut egui::Ui, colour: Color32, fill: bool, underline: bool, text: &str| {
            let (rect, _) = ui.allocate_exact_size(vec2(22.0, 12.0), Sense::hover());
            if underline {
                ui.painter().hline(rect.x_range(), rect.bottom() - 2.0, Stroke::new(2.5, colour));
            } else if fill {
                ui.painter().rect_filled(rect, 1.0, colour);
            } else {
                let stroke = Stroke::new(1.0, colour);
                ui.painter().rect_stroke(rect, 1.0, stroke, egui::StrokeKind::Inside);
            }
            ui.label(RichText::new(text).small());
            ui.add_space(10.0);
        };
        key(ui, cx.palette.real, true, false, "real");
        for simulation in picture.simulations {
            let waiting = simulation.row.is_none() && simulation.error.is_none();
            let text = if waiting {
                format!("{}, simulating\u{2026}", simulation.full_label)
            } else {
                simulation.full_label.clone()
            };
            key(ui, simulation.colour, true, false, &text);
        }
        let hollow = picture.simulations.last().map_or(cx.palette.nominal, |simulation| simulation.colour);
        key(ui, hollow, false, false, "simulated, not real");
        key(ui, cx.palette.mismatch, true, true, "real, not simulated");
        match (picture.num_mismatches, picture.at) {
            (Some(count), Some((idx, mismatch))) => {
                let label = picture.station.layout.channel_label(mismatch.channel);
                let text = format!("{} of {count} mismatches: {label}, {}", idx + 1, mismatch.kind.words());
                ui.label(RichText::new(text).small().strong());
            }
            (Some(count), None) => {
                ui.label(RichText::new(format!("{count} mismatches in the channels shown")).small());
            }
            (None, _) => {}
        }
    });
}

/// The wheel zooms at the pointer, sideways it pans. Over the names it scrolls, as everywhere.
fn wheel(ui: &egui::Ui, plot: Rect, view: &mut TimeView) {
    let Some(pointer) = ui.ctx().pointer_hover_pos().filter(|pos| plot.contains(*pos)) else { return };
    if ui.ctx().layer_id_at(pointer).is_some_and(|layer| layer != ui.layer_id()) {
        return;
    }
    let (scroll, pinch) = ui.input_mut(|input| {
        let scroll = input.smooth_scroll_delta();
        input.smooth_scroll_delta = Vec2::ZERO;
        (scroll, input.zoom_delta())
    });
    let axis = Axis { view: *view, left: plot.left(), width: plot.width() };
    let factor = f64::from(pinch) * f64::from(scroll.y / WHEEL_PER_E).exp();
    view.zoom_at(axis.time_s(pointer.x), factor);
    view.pan(-f64::from(scroll.x) / f64::from(axis.px_per_s()));
}

/// What the pointer does on a stretch of the plot: drag pans, click puts the cursor, double click fits.
fn plot_pointer(response: &egui::Response, cx: &mut ScreenContext<'_>, axis: &Axis, view: &mut TimeView) {
    if response.dragged() {
        view.pan(-f64::from(response.drag_delta().x) / f64::from(axis.px_per_s()));
    }
    if response.double_clicked() {
        *view = TimeView::fit(cx.playback.duration_s);
    } else if response.clicked()
        && let Some(pos) = response.interact_pointer_pos()
    {
        cx.playback.seek(axis.time_s(pos.x));
    }
}

/// Time marks, marked spans, and the cursor as a slider.
fn ruler_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    picture: &Picture<'_>,
    axis: &Axis,
    view: &mut TimeView,
) {
    let (row, _) = ui.allocate_exact_size(vec2(ui.available_width(), RULER_HEIGHT), Sense::hover());
    let rect = Rect::from_x_y_ranges(axis.range(), row.y_range());
    let response = ui.interact(rect, ui.scope_id().with("time cursor"), Sense::click_and_drag());
    // On the ruler itself, dragging moves the cursor.
    if (response.dragged() || response.clicked())
        && let Some(pos) = response.interact_pointer_pos()
    {
        cx.playback.seek(axis.time_s(pos.x));
    }
    if response.double_clicked() {
        *view = TimeView::fit(cx.playback.duration_s);
    }
    let asked_s = ui.input(|input| {
        input
            .accesskit_action_requests(response.id, accesskit::Action::SetValue)
            .filter_map(|request| match request.data {
                Some(accesskit::ActionData::NumericValue(value)) => Some(value),
                _ => None,
            })
            .last()
    });
    if let Some(asked_s) = asked_s {
        cx.playback.seek(asked_s);
        view.reveal(cx.playback.time_s);
    }
    let (time_s, duration_s) = (cx.playback.time_s, cx.playback.duration_s);
    response.widget_info(|| {
        let mut info = egui::WidgetInfo::labeled(accesskit::Role::Slider, true, "Time cursor");
        info.value = Some(time_s);
        info
    });
    ui.ctx().accesskit_node_builder(response.id, |node| {
        node.set_min_numeric_value(0.0);
        node.set_max_numeric_value(duration_s);
        node.add_action(accesskit::Action::SetValue);
    });

    let painter = ui.painter().with_clip_rect(rect.expand2(vec2(0.0, 2.0)));
    let font = FontId::proportional(13.0);
    let bands = Rangef::new(rect.top() + 20.0, rect.bottom() - 2.0);
    for span in &picture.take.trace.spans {
        let x = Rangef::new(axis.x(span.start_s), axis.x(span.end_s));
        let colour = match span.kind.as_str() {
            "baseline" => cx.palette.dead.gamma_multiply(0.45),
            _ => cx.palette.diagnosed.gamma_multiply(0.35),
        };
        let band = Rect::from_x_y_ranges(x.min + 0.5..=(x.max - 0.5).max(x.min + 1.0), bands);
        painter.rect_filled(band, 2.0, colour);
        let text = if span.label.is_empty() { &span.kind } else { &span.label };
        let galley = painter.layout_no_wrap(text.clone(), font.clone(), cx.palette.real);
        // The name stays in sight while its span is.
        let text_left = band.left().max(rect.left()) + 4.0;
        if text_left + galley.size().x + 4.0 <= band.right() {
            painter.galley(pos2(text_left, bands.center() - galley.size().y / 2.0), galley, cx.palette.real);
        }
    }
    let (first_s, step_s) = ticks(&axis.view, axis.width, MIN_TICK_PX);
    for step in 0..=(axis.width / MIN_TICK_PX) as usize + 1 {
        let tick_s = first_s + step as f64 * step_s;
        let x = axis.x(tick_s);
        if x > rect.right() {
            break;
        }
        painter.vline(x, rect.top()..=rect.top() + 18.0, Stroke::new(1.0, cx.palette.line));
        let text = tick_text(tick_s, step_s);
        painter.text(pos2(x + 3.0, rect.top()), Align2::LEFT_TOP, text, font.clone(), cx.palette.text_weak);
    }
    let names = Rect::from_min_max(row.min, pos2(axis.left - 8.0, row.bottom()));
    let frame = picture.take.frame_at(time_s).map_or(0, |frame| frame + 1);
    let time = format!("{time_s:.3} s");
    let text = if is_narrow(ui.ctx()) {
        time
    } else {
        format!("{time}, frame {frame}/{}", picture.take.num_frames())
    };
    ui.painter().with_clip_rect(names).text(
        names.left_center(),
        Align2::LEFT_CENTER,
        text,
        FontId::monospace(13.0),
        cx.palette.real,
    );
}
