//! The rail on the left and the bar on top.

use egui::{Align, Layout, RichText};
use palpate_wire::api::Source;

use super::{
    StudioApp,
    strip::{STOP_WIDTH, STRIP_HEIGHT},
};
use crate::{
    playback::HandSource,
    route::{Route, Screen},
    store::{Connection, Loadable},
    theme::Palette,
};

/// Height of the bar's first row.
const BAR_HEIGHT: f32 = 46.0;

impl StudioApp {
    /// From light to dark and back, for the next visit too.
    pub(super) fn toggle_theme(&mut self, ctx: &egui::Context) {
        let other = match ctx.theme() {
            egui::Theme::Dark => egui::Theme::Light,
            egui::Theme::Light => egui::Theme::Dark,
        };
        ctx.set_theme(other);
        self.platform.save_theme(other);
    }

    pub(super) fn rail_ui(&mut self, ui: &mut egui::Ui, go_to: &mut Option<Route>) {
        let palette = Palette::of(ui.ctx().theme());
        egui::Panel::left("rail").resizable(false).exact_size(132.0).show(ui, |ui| {
            ui.add_space(10.0);
            ui.label(RichText::new("Palpate").strong().size(18.0));
            ui.add_space(10.0);
            let commandable = self.store.is_commandable();
            for screen in Screen::ALL.into_iter().filter(|screen| screen.is_offered(commandable)) {
                let chosen = self.route.screen == screen;
                let text = RichText::new(format!("{}  {}", icon(screen), screen.label())).size(15.0);
                let button = egui::Button::selectable(chosen, text)
                    .min_size(egui::vec2(ui.available_width(), 40.0))
                    .right_text("");
                let response = ui.add(button).on_hover_text(screen.purpose());
                // The icon is decoration: the name is the word.
                response.widget_info(|| {
                    egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, chosen, screen.label())
                });
                if response.clicked() && !chosen {
                    *go_to = Some(self.route_of(screen));
                }
            }
            ui.with_layout(Layout::bottom_up(Align::Min), |ui| {
                ui.add_space(10.0);
                if let Loadable::Ready(info) = &self.store.info {
                    let version = format!("{} {}", info.name, info.version);
                    ui.label(RichText::new(version).color(palette.text_weak).small());
                }
                let shortcuts = ui.add_sized([ui.available_width(), 32.0], egui::Button::new("Shortcuts  ?"));
                shortcuts.widget_info(|| {
                    egui::WidgetInfo::labeled(egui::accesskit::Role::Button, true, "Keyboard shortcuts")
                });
                if shortcuts.clicked() {
                    self.overlays.toggle_shortcuts();
                }
                let commands = ui.add_sized([ui.available_width(), 32.0], egui::Button::new("Find  Ctrl+K"));
                commands.widget_info(|| {
                    egui::WidgetInfo::labeled(egui::accesskit::Role::Button, true, "Command palette")
                });
                if commands.clicked() {
                    self.overlays.open_palette();
                }
                let name = if palette.dark { "Light theme" } else { "Dark theme" };
                if ui.add_sized([ui.available_width(), 32.0], egui::Button::new(name)).clicked() {
                    self.toggle_theme(ui.ctx());
                }
            });
        });
    }

    /// One row that says what is looked at; where a station takes commands, a second one for it, and STOP beside both.
    pub(super) fn top_bar_ui(&mut self, ui: &mut egui::Ui, now_s: f64) {
        let palette = Palette::of(ui.ctx().theme());
        let commandable = self.store.is_commandable();
        let height = if commandable { BAR_HEIGHT + STRIP_HEIGHT } else { BAR_HEIGHT };
        egui::Panel::top("top_bar").resizable(false).exact_size(height).show(ui, |ui| {
            let all = ui.max_rect();
            let mut rows = all;
            if commandable {
                rows.max.x -= STOP_WIDTH + 8.0;
                let stop = egui::Rect::from_min_max(egui::pos2(rows.max.x + 8.0, all.min.y), all.max);
                self.stop_ui(ui, stop.shrink2(egui::vec2(0.0, 5.0)), &palette);
            }
            let middle = if commandable { all.min.y + BAR_HEIGHT - 6.0 } else { all.max.y };
            let first = egui::Rect::from_min_max(rows.min, egui::pos2(rows.max.x, middle));
            ui.scope_builder(egui::UiBuilder::new().max_rect(first), |ui| {
                self.what_is_shown_ui(ui, &palette, now_s);
            });
            if commandable {
                let second = egui::Rect::from_min_max(egui::pos2(rows.min.x, middle), rows.max);
                ui.scope_builder(egui::UiBuilder::new().max_rect(second), |ui| {
                    self.strip_ui(ui, &palette, now_s);
                });
            }
            ui.advance_cursor_after_rect(all);
        });
        if commandable {
            self.notes_ui(ui, &palette, now_s);
        }
        if let Connection::Lost { since, since_s } = &self.store.connection {
            let ago_s = (now_s - since_s).max(0.0);
            egui::Panel::top("lost").resizable(false).show(ui, |ui| {
                ui.horizontal_wrapped(|ui| {
                    ui.label(RichText::new("\u{26a0} CONNECTION LOST").strong().color(palette.mismatch));
                    ui.label(format!(
                        "Nothing on this page has changed since {since} ({}). Trying to connect again; check that \
                         `palpate serve` is running.",
                        crate::screens::duration_text(ago_s.floor())
                    ));
                });
            });
            ui.ctx().request_repaint_after(std::time::Duration::from_millis(500));
        }
    }

    fn what_is_shown_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        ui.horizontal_centered(|ui| {
            self.station_ui(ui, palette);
            ui.separator();
            let live = matches!(self.route.screen, Screen::Hand | Screen::Timelines)
                && self.playback.hand_source == HandSource::Live;
            if live {
                ui.label(RichText::new("Live station").strong());
                ui.separator();
            } else if let Some(session) = &self.playback.session {
                ui.label(RichText::new(session).strong());
                if let Some(take) = &self.playback.take {
                    ui.label(take);
                }
                ui.separator();
            }
            let in_use = self.playback.diagnosed.as_ref().or(self.playback.compared.as_ref());
            let model = self.store.compared_label(in_use);
            ui.label(RichText::new("Model").color(palette.text_weak));
            ui.label(model);
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                self.connection_ui(ui, palette, now_s);
            });
        });
    }

    fn station_ui(&self, ui: &mut egui::Ui, palette: &Palette) {
        let info = match &self.store.info {
            Loadable::Ready(info) => info,
            Loadable::Failed(error) => {
                ui.label(RichText::new("\u{26a0} No server").color(palette.mismatch)).on_hover_text(error);
                return;
            }
            Loadable::Idle | Loadable::Loading => {
                ui.label("Connecting\u{2026}");
                return;
            }
        };
        let (word, colour) = match info.source {
            Source::Real => ("REAL", palette.mismatch),
            Source::Emulated => ("EMULATED", palette.warning),
            Source::Replay => ("REPLAY", palette.text_weak),
        };
        ui.label(RichText::new(word).strong().color(colour));
        ui.label(info.station.as_deref().unwrap_or("recordings only"));
    }

    fn connection_ui(&self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        match &self.store.connection {
            Connection::Open => {
                dot_ui(ui, "Connected", palette.diagnosed, true);
                // Where a station takes commands, the row below says more.
                let rates = self.store.live_frame().filter(|frame| frame.control.is_none());
                if let Some(rate_hz) = rates.and_then(|frame| frame.rates_hz.first().copied()) {
                    ui.label(format!("joints {rate_hz:.0} Hz"));
                }
                if self.store.dropped_messages > 0 {
                    ui.label(format!("{} dropped", self.store.dropped_messages))
                        .on_hover_text("Messages left out because this page read too slowly");
                }
            }
            Connection::Connecting => {
                dot_ui(ui, "Connecting", palette.text_weak, false);
            }
            Connection::Lost { since_s, .. } => {
                let ago = crate::screens::duration_text((now_s - since_s).max(0.0).floor());
                dot_ui(ui, &format!("Lost {ago} ago"), palette.mismatch, false);
            }
        }
    }
}

/// A word with a dot: full when live.
fn dot_ui(ui: &mut egui::Ui, word: &str, colour: egui::Color32, live: bool) {
    ui.label(RichText::new(word).color(colour));
    let (rect, _) = ui.allocate_exact_size(egui::vec2(12.0, 12.0), egui::Sense::hover());
    if live {
        ui.painter().circle_filled(rect.center(), 5.0, colour);
    } else {
        ui.painter().circle_stroke(rect.center(), 4.5, egui::Stroke::new(1.5, colour));
    }
}

fn icon(screen: Screen) -> &'static str {
    match screen {
        Screen::Hand => "\u{270b}",
        Screen::Record => "\u{23fa}",
        Screen::Timelines => "\u{2630}",
        Screen::Calibrate => "\u{2696}",
        Screen::Diagnose => "\u{1f50d}",
        Screen::Sessions => "\u{1f5c0}",
        Screen::Objects => "\u{1f4e6}",
    }
}
