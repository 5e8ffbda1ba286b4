//! Rows around the picture: where the data comes from, named views, what colours mean, live rates.

use egui::{RichText, accesskit::Role};
use palpate_reports::wording;
use palpate_robot_model::Station;

use super::{
    HandState, Shot,
    flat_map::FlatMap,
    scene::Geometry,
    signal::{Coloring, FULL_SCALE_THRESHOLDS, Signal},
    view3d::Moment,
};
use crate::{
    playback::HandSource,
    route::Screen,
    screens::{
        ScreenContext,
        controls::{compared_ui, diagnosed_ui},
        duration_text, topic_ui,
    },
    theme::{Palette, taxel_scale_ui},
};

/// Where the data comes from, and what colours the taxels.
pub(super) fn controls_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    state: &mut HandState,
    shot: &Shot,
    has_residual: bool,
) {
    ui.horizontal_wrapped(|ui| {
        ui.label(RichText::new(&shot.banner.source).strong().size(16.0).color(shot.banner.color));
        topic_ui(ui, Screen::Hand);
        // An empty label would put what follows over what is before.
        if !shot.banner.about.is_empty() {
            ui.label(&shot.banner.about);
        }
        if cx.store.is_live() {
            ui.separator();
            ui.selectable_value(&mut cx.playback.hand_source, HandSource::Recorded, "Recorded");
            ui.selectable_value(&mut cx.playback.hand_source, HandSource::Live, "Live");
        }
        if cx.playback.hand_source == HandSource::Recorded {
            ui.separator();
            // A screen that has nothing to offer yet is absent, and so is a signal.
            let offered = |signal: &Signal| *signal != Signal::Diagnosed || cx.playback.diagnosed.is_some();
            for signal in Signal::ALL.into_iter().filter(offered) {
                let text = RichText::new(signal.label())
                    .strong()
                    .color(cx.palette.text_of(signal.color(&cx.palette)));
                let chosen = state.signal == signal;
                let response = ui.selectable_label(chosen, text).on_hover_text(signal_hint(signal));
                response.widget_info(|| {
                    egui::WidgetInfo::selected(Role::RadioButton, true, chosen, signal.label())
                });
                if response.clicked() {
                    state.signal = signal;
                }
            }
            if state.signal == Signal::Calibrated {
                compared_ui(ui, cx);
                if shot.banner.nothing_to_compare && ui.button("Calibrate first").clicked() {
                    cx.go_to_screen(Screen::Calibrate);
                }
            }
            if state.signal == Signal::Diagnosed {
                diagnosed_ui(ui, cx);
            }
        }
        ui.separator();
        ui.selectable_value(&mut state.coloring, Coloring::Reading, "Reading")
            .on_hover_text("Colour taxels by how much they read");
        ui.selectable_value(&mut state.coloring, Coloring::Active, "Active")
            .on_hover_text("Colour taxels by whether they are active");
        if has_residual {
            ui.selectable_value(&mut state.coloring, Coloring::Mismatch, "Mismatch").on_hover_text(
                "Colour taxels by how much simulation and hand differ on the takes that judged the diagnosis",
            );
        }
        if let Some(missing) = &shot.banner.missing {
            ui.label(
                RichText::new(format!("\u{26a0} {}: {missing}", state.signal.label()))
                    .color(cx.palette.warning),
            );
        }
    });
}

fn signal_hint(signal: Signal) -> &'static str {
    match signal {
        Signal::Real => "What the hand reported",
        Signal::Nominal => "What the nominal simulation of the same motion says",
        Signal::Calibrated => "What the compared simulation says, usually a calibrated one",
        Signal::Diagnosed => "What the simulation says with the effects that a diagnosis named",
    }
}

/// Named views and what is shown.
pub(super) fn views_ui(ui: &mut egui::Ui, state: &mut HandState, geometry: &Geometry, moment: &Moment<'_>) {
    ui.horizontal_wrapped(|ui| {
        ui.label("View");
        for (idx, view) in geometry.views.iter().enumerate() {
            let hint = format!("Look at: {} (key {})", view.label, idx + 1);
            let response = ui.button(&view.label).on_hover_text(hint);
            response.widget_info(|| {
                egui::WidgetInfo::labeled(Role::Button, true, format!("View: {}", view.label))
            });
            if response.clicked() {
                state.view.look_at(geometry, moment, view);
            }
        }
        let reset = ui.button("Reset").on_hover_text("The view this screen opens with (key R)");
        reset.widget_info(|| egui::WidgetInfo::labeled(Role::Button, true, "Reset view"));
        if reset.clicked() {
            state.view.reset(geometry, moment);
        }
        ui.separator();
        ui.checkbox(&mut state.view.shown.object, "Object");
        ui.checkbox(&mut state.view.shown.arm, "Robot arm");
        if !moment.commanded_from_link.is_empty() {
            ui.checkbox(&mut state.view.ghost, "Ghost")
                .on_hover_text("The hand where it is told to be, translucent");
        }
        ui.checkbox(&mut state.view.labels, "Labels");
        ui.checkbox(&mut state.view.follow, "Follow").on_hover_text("The camera moves with the hand");
    });
}

/// What the colours mean. The scale is fixed, in thresholds.
pub(super) fn legend_ui(
    ui: &mut egui::Ui,
    map: &FlatMap<'_>,
    (coloring, full_scale_per_s): (Coloring, Option<f64>),
    palette: &Palette,
) {
    match coloring {
        Coloring::Mismatch => {
            ui.horizontal(|ui| {
                ui.label("0");
                taxel_scale_ui(ui, 150.0);
                let full = full_scale_per_s.map_or_else(String::new, wording::number);
                ui.label(format!("{full} a second")).on_hover_text(
                    "Mismatch of simulation and hand a second, all phases of contact together. The scale is the same \
                     before and after.",
                );
            });
        }
        Coloring::Reading => {
            ui.horizontal(|ui| {
                ui.label("0");
                let response = taxel_scale_ui(ui, 170.0);
                let rect = response.rect;
                let tick = egui::lerp(rect.x_range(), 1.0 / FULL_SCALE_THRESHOLDS);
                ui.painter().vline(tick, rect.expand(3.0).y_range(), egui::Stroke::new(2.0, palette.real));
                let name = format!("Scale: violet is no touch, the mark is the threshold, yellow is {FULL_SCALE_THRESHOLDS} thresholds or more");
                response.widget_info(|| egui::WidgetInfo::labeled(Role::Image, true, name.clone()));
                response.on_hover_text(
                    "Readings in thresholds: the mark is where a taxel switches. A simulated distance counts one step \
                     for every 5 mm past its threshold.",
                );
                ui.label(format!("{FULL_SCALE_THRESHOLDS} \u{d7} threshold"));
            });
        }
        Coloring::Active => {
            ui.horizontal(|ui| {
                let (rect, _) = ui.allocate_exact_size(egui::vec2(14.0, 14.0), egui::Sense::hover());
                ui.painter().circle_filled(rect.center(), 6.0, map.signal.color(palette));
                ui.label("active");
                let (rect, _) = ui.allocate_exact_size(egui::vec2(14.0, 14.0), egui::Sense::hover());
                ui.painter().circle(
                    rect.center(),
                    4.5,
                    palette.line,
                    egui::Stroke::new(1.0, palette.text_weak),
                );
                ui.label("not active");
            });
        }
    }
    if map.real.is_some() {
        ui.label(RichText::new("Hollow: simulated only. Red line: real only.").color(palette.text_weak));
    }
}

/// Measured rates of the live station.
pub(super) fn live_rates_ui(ui: &mut egui::Ui, cx: &ScreenContext<'_>, station: &Station) {
    let Some(frame) = cx.store.live_frame() else { return };
    ui.horizontal_wrapped(|ui| {
        ui.label(format!("Running for {}", duration_text(frame.time_s)));
        let names = std::iter::once("joints")
            .chain(station.layout.streams.iter().map(|stream| stream.label.as_str()));
        for (name, rate_hz) in names.zip(&frame.rates_hz) {
            ui.separator();
            ui.label(format!("{name} {rate_hz:.1} Hz"));
        }
    });
}
