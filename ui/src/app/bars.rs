//! The rail on the left and the bar on top.

use egui::{Align, Layout, RichText};
use palpate_wire::api::Source;

use super::{StudioApp, stop};
use crate::{
    playback::HandSource,
    route::{HelpPlace, Route, Screen},
    screens::{Subject, announced_ui, controls::name_button, words},
    store::{Connection, Loadable},
    theme::{Palette, is_narrow},
};

/// Height of the bar's first row.
const BAR_HEIGHT: f32 = 46.0;
/// Width of the rail: icons and words, or icons alone.
const RAIL: f32 = 132.0;
const NARROW_RAIL: f32 = 60.0;
/// Height of a screen's button in the rail, points: as a rule, and where the page is low.
const ROW: f32 = 40.0;
const MIN_ROW: f32 = 28.0;
/// Height of the name of a group of screens, points.
const GROUP: f32 = 16.0;
/// Between rows of the rail, points.
const ROW_GAP: f32 = 2.0;
/// Names of groups, and gaps where a screen of none follows.
const NUM_GROUPS: usize = 5;
/// What the lower end of the rail takes, points.
const RAIL_FOOT: f32 = 150.0;
/// Names in the bar have at most so many letters; fewer where there is little room for the three of them.
const MAX_NAME: usize = 32;
const MIN_NAME: usize = 10;
/// So much room of the row makes a letter of each name, points.
const ROOM_FOR_LETTER: f32 = 42.0;

/// What the recording is compared with is left out where less room than this is left, points.
const ROOM_FOR_COMPARED: f32 = 420.0;

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
        let narrow = is_narrow(ui.ctx());
        let width = if narrow { NARROW_RAIL } else { RAIL };
        egui::Panel::left("rail").resizable(false).exact_size(width).show(ui, |ui| {
            if narrow {
                // The rest of the rail is in the menu.
                egui::ScrollArea::vertical().show(ui, |ui| self.screens_ui(ui, true, ROW, go_to));
                return;
            }
            ui.add_space(10.0);
            ui.label(RichText::new("Palpate").strong().size(18.0));
            ui.add_space(10.0);
            // All screens are seen at once where their names can be read; on a lower page they scroll.
            let room = (ui.available_height() - RAIL_FOOT).max(ROW);
            let groups = NUM_GROUPS as f32 * (GROUP + ROW_GAP);
            let row = (room - groups) / Screen::ALL.len() as f32 - ROW_GAP;
            egui::ScrollArea::vertical().max_height(room).show(ui, |ui| {
                ui.spacing_mut().item_spacing.y = ROW_GAP;
                ui.spacing_mut().interact_size.y = MIN_ROW;
                self.screens_ui(ui, false, row.clamp(MIN_ROW, ROW), go_to);
            });
            ui.with_layout(Layout::bottom_up(Align::Min), |ui| {
                ui.add_space(10.0);
                if let Loadable::Ready(info) = &self.store.info {
                    let version = format!("{} {}", info.name, info.version);
                    ui.label(RichText::new(version).color(palette.text_weak).small());
                }
                self.page_ui(ui);
            });
        });
    }

    /// Buttons of all screens, each as high as `row`, points.
    fn screens_ui(&mut self, ui: &mut egui::Ui, narrow: bool, row: f32, go_to: &mut Option<Route>) {
        let commandable = self.store.is_commandable();
        let palette = Palette::of(ui.ctx().theme());
        let mut group = None;
        for screen in Screen::ALL.iter().copied().filter(|screen| screen.is_offered(commandable)) {
            if screen.about().group != group {
                group = screen.about().group;
                group_ui(ui, &palette, group.filter(|_| !narrow));
            }
            let chosen = self.route.screen == screen && self.route.lost.is_none();
            let text = if narrow {
                RichText::new(screen.about().icon).size(18.0)
            } else {
                RichText::new(format!("{}  {}", screen.about().icon, screen.label())).size(15.0)
            };
            let mut button =
                egui::Button::selectable(chosen, text).min_size(egui::vec2(ui.available_width(), row));
            if !narrow {
                button = button.right_text("");
            }
            let hint = if narrow {
                format!("{}: {}", screen.label(), screen.about().purpose)
            } else {
                screen.about().purpose.to_owned()
            };
            let response = ui.add(button).on_hover_text(hint);
            // The icon is decoration: the name is the word.
            response.widget_info(|| {
                egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, chosen, screen.label())
            });
            if response.clicked() && !chosen {
                *go_to = Some(self.route_of(screen));
            }
        }
    }

    /// What concerns the page itself: help, the palette, the theme.
    fn page_ui(&mut self, ui: &mut egui::Ui) {
        let dark = Palette::of(ui.ctx().theme()).dark;
        let size = [ui.available_width(), 32.0];
        let help = ui
            .add_sized(size, egui::Button::new("Help  F1"))
            .on_hover_text("Documents, what words mean, and keys");
        help.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Button, true, "Help"));
        if help.clicked() {
            self.open_help(HelpPlace::default());
        }
        let commands = ui.add_sized(size, egui::Button::new("Find  Ctrl+K"));
        commands.widget_info(|| {
            egui::WidgetInfo::labeled(
                egui::accesskit::Role::Button,
                true,
                "Find a screen, session or command",
            )
        });
        if commands.clicked() {
            self.overlays.open_palette();
        }
        let name = if dark { "Light theme" } else { "Dark theme" };
        if ui.add_sized(size, egui::Button::new(name)).clicked() {
            self.toggle_theme(ui.ctx());
        }
    }

    /// One row that says what is looked at; where a station takes commands, a second one for it. STOP's place on the right
    /// is left free by both: see [`stop`]. A narrow page has the station's state in one row, and the rest in a menu.
    pub(super) fn top_bar_ui(&mut self, ui: &mut egui::Ui, now_s: f64) {
        let palette = Palette::of(ui.ctx().theme());
        let commandable = self.store.is_commandable();
        let narrow = is_narrow(ui.ctx());
        let height = match (commandable, narrow) {
            (false, _) => BAR_HEIGHT,
            (true, false) => stop::WIDE_BAR,
            (true, true) => stop::NARROW_BAR,
        };
        egui::Panel::top("top_bar").resizable(false).exact_size(height).show(ui, |ui| {
            let all = ui.max_rect();
            let mut rows = all;
            if commandable {
                rows.max.x = stop::stop_rect(ui.ctx().content_rect()).left() - stop::GAP;
            }
            if narrow {
                within(ui, rows, |ui| self.narrow_bar_ui(ui, &palette, now_s));
            } else {
                let middle = if commandable { all.min.y + BAR_HEIGHT - 6.0 } else { all.max.y };
                let first = egui::Rect::from_min_max(rows.min, egui::pos2(rows.max.x, middle));
                within(ui, first, |ui| self.what_is_shown_ui(ui, &palette, now_s));
                if commandable {
                    let second = egui::Rect::from_min_max(egui::pos2(rows.min.x, middle), rows.max);
                    within(ui, second, |ui| self.strip_ui(ui, &palette, now_s));
                }
            }
            ui.advance_cursor_after_rect(all);
        });
        self.insecure_ui(ui, &palette);
        if commandable {
            self.notes_ui(ui, &palette, now_s);
        }
        if let Connection::Lost { since, since_s } = &self.store.connection {
            let ago_s = (now_s - since_s).max(0.0);
            egui::Panel::top("lost").resizable(false).show(ui, |ui| {
                ui.horizontal_wrapped(|ui| {
                    let lost = RichText::new("\u{26a0} CONNECTION LOST").strong().color(palette.mismatch);
                    announced_ui(ui, lost, true);
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

    /// The bar of a narrow page: the station's state, and a menu for the rest.
    fn narrow_bar_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        ui.horizontal_centered(|ui| {
            let button =
                egui::Button::new(RichText::new("\u{2630}").size(20.0)).min_size(egui::vec2(44.0, 44.0));
            let menu = egui::containers::menu::MenuButton::from_button(button);
            let (response, _) = menu.ui(ui, |ui| self.menu_ui(ui, palette, now_s));
            response.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Button, true, "Menu"));
            if self.store.is_commandable() {
                self.narrow_strip_ui(ui, palette, now_s);
            } else {
                self.station_ui(ui, palette, MIN_NAME);
            }
        });
    }

    fn menu_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        let screen = ui.ctx().content_rect();
        ui.set_width((screen.width() - 40.0).min(280.0));
        let height = (screen.height() - stop::NARROW_BAR - 24.0).max(80.0);
        egui::ScrollArea::vertical().max_height(height).show(ui, |ui| {
            if self.store.is_commandable() {
                self.strip_menu_ui(ui, palette, now_s);
                ui.separator();
            }
            ui.horizontal_wrapped(|ui| self.station_ui(ui, palette, MAX_NAME));
            ui.horizontal_wrapped(|ui| self.shown_ui(ui, palette, MAX_NAME));
            ui.horizontal(|ui| self.connection_ui(ui, palette, now_s));
            self.jobs_menu_ui(ui, palette);
            ui.separator();
            self.page_ui(ui);
        });
    }

    fn what_is_shown_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        ui.horizontal_centered(|ui| {
            let letters = ((ui.available_width() / ROOM_FOR_LETTER) as usize).clamp(MIN_NAME, MAX_NAME);
            self.station_ui(ui, palette, letters);
            ui.separator();
            self.shown_ui(ui, palette, letters);
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                self.connection_ui(ui, palette, now_s);
                self.jobs_button_ui(ui, palette);
            });
        });
    }

    /// Session and take, or the live station, and what the recording is compared with. Names are pickers; long ones are
    /// cut in the middle.
    fn shown_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, letters: usize) {
        let shows_take = self.route.screen.about().subject == Subject::Take;
        if shows_take && self.playback.hand_source == HandSource::Live {
            ui.label(RichText::new("Live station").strong());
            ui.separator();
            self.take_away_ui(ui);
            return;
        }
        self.session_picker_ui(ui, letters);
        if shows_take || self.playback.take.is_some() {
            self.take_picker_ui(ui, letters);
        }
        self.take_away_ui(ui);
        // Timelines and Hand say it a second time, beside their own choice.
        if shows_take && ui.available_width() >= ROOM_FOR_COMPARED {
            ui.separator();
            let in_use = self.playback.diagnosed.as_ref().or(self.playback.compared.as_ref());
            let model = self.store.compared_label(in_use);
            ui.label(RichText::new("Compared with").color(palette.text_weak));
            ui.label(elided(&model, letters)).on_hover_text(model);
        }
    }

    fn session_picker_ui(&mut self, ui: &mut egui::Ui, letters: usize) {
        let sessions = self.store.sessions();
        let Some(sessions) = sessions.ready().filter(|sessions| !sessions.is_empty()) else {
            if let Some(session) = &self.playback.session {
                ui.label(RichText::new(elided(session, letters)).strong()).on_hover_text(session);
            }
            return;
        };
        let current = self.playback.session.clone();
        let entries = sessions.iter().filter(|session| session.error.is_none()).map(|session| {
            (session.id.clone(), format!("{}  ({} takes)", elided(&session.id, MAX_NAME), session.takes))
        });
        if let Some(session) = picker_ui(ui, "Session", current.as_deref(), letters, entries) {
            self.look_at_session(&session);
        }
    }

    /// On screens that are about one session, that is another address.
    fn look_at_session(&mut self, session: &str) {
        self.playback.open_session(session);
        if self.route.screen.about().subject == Subject::Session {
            self.go(Route::to(self.route.screen).with_session(session));
        }
    }

    fn take_picker_ui(&mut self, ui: &mut egui::Ui, letters: usize) {
        let Some(session) = self.playback.session.clone() else { return };
        let current = self.playback.take.clone();
        let detail = self.store.session(&session);
        let Some(detail) = detail.ready().filter(|detail| !detail.takes.is_empty()) else {
            if let Some(take) = &current {
                ui.label(elided(take, letters)).on_hover_text(take);
            }
            return;
        };
        let entries = detail.takes.iter().map(|take| {
            let verdict = if take.accepted { "" } else { ", not accepted" };
            (take.id.clone(), format!("{}: {} on {}{verdict}", take.id, words(&take.primitive), take.object))
        });
        if let Some(take) = picker_ui(ui, "Take", current.as_deref(), letters, entries) {
            self.playback.open(&session, &take);
        }
    }

    /// Puts the address of what is on the screen on the clipboard, or keeps a picture of it.
    fn take_away_ui(&mut self, ui: &mut egui::Ui) {
        let link = ui.button("\u{1f517}").on_hover_text("Copy the link to what is on the screen");
        name_button(&link, "Copy link");
        if link.clicked() {
            ui.ctx().copy_text(self.platform.address());
        }
        let picture = ui.button("\u{1f4f7}").on_hover_text("Save a picture of the screen (PNG)");
        name_button(&picture, "Save picture");
        if picture.clicked() {
            self.want_picture(ui.ctx());
        }
        if let Some(problem) = self.picture_problem() {
            ui.label(RichText::new("\u{26a0} no picture").color(Palette::of(ui.ctx().theme()).mismatch))
                .on_hover_text(problem);
        }
    }

    fn station_ui(&self, ui: &mut egui::Ui, palette: &Palette, letters: usize) {
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
        let station = info.station.as_deref().unwrap_or("recordings only");
        ui.label(elided(station, letters)).on_hover_text(station);
    }

    fn connection_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        match &self.store.connection {
            Connection::Open => {
                dot_ui(ui, "Connected", palette.diagnosed, true);
                // Where a station takes commands, the row below says more.
                let rates = self.store.live_frame().filter(|frame| frame.control.is_none());
                if let Some(rate_hz) = rates.and_then(|frame| frame.rates_hz.first().copied()) {
                    ui.label(format!("joints {rate_hz:.0} Hz"));
                }
                if self.lag.is_lagging(self.store.dropped_messages, now_s) {
                    ui.label(RichText::new("This page lags").color(palette.warning)).on_hover_text(
                        "This browser is too slow for everything that comes from the station: what it could not read in \
                         time was left out. Close other windows, or make this one smaller.",
                    );
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

/// Shows `contents` in `rect` and nowhere else: what has no room there can neither be seen nor pressed.
fn within(ui: &mut egui::Ui, rect: egui::Rect, contents: impl FnOnce(&mut egui::Ui)) {
    ui.scope_builder(egui::UiBuilder::new().max_rect(rect), |ui| {
        ui.set_clip_rect(ui.clip_rect().intersect(rect));
        contents(ui);
    });
}

/// `name`, cut in the middle where it has more than `max` letters.
pub(super) fn elided(name: &str, max: usize) -> String {
    let letters: Vec<char> = name.chars().collect();
    if letters.len() <= max {
        return name.to_owned();
    }
    let tail = (max - 1) / 2;
    let head = max - 1 - tail;
    letters[..head].iter().chain(&['\u{2026}']).chain(&letters[letters.len() - tail..]).collect()
}

/// A button called `what` that shows the `current` one and opens a list of others, as ids and lines; gives what was
/// picked.
fn picker_ui(
    ui: &mut egui::Ui,
    what: &str,
    current: Option<&str>,
    letters: usize,
    entries: impl Iterator<Item = (String, String)>,
) -> Option<String> {
    let face = current.map_or_else(|| format!("{what}\u{2026}"), |id| elided(id, letters));
    let name = current.map_or_else(|| format!("{what}, none chosen"), |id| format!("{what} in view: {id}"));
    let height = (ui.ctx().content_rect().height() * 0.6).max(120.0);
    let menu = ui.menu_button(RichText::new(format!("{face} \u{23f7}")).strong(), |ui| {
        let mut picked = None;
        egui::ScrollArea::vertical().max_height(height).show(ui, |ui| {
            for (id, line) in entries {
                let chosen = current == Some(id.as_str());
                let response = ui.selectable_label(chosen, &line);
                response.widget_info(|| {
                    egui::WidgetInfo::selected(egui::accesskit::Role::ListBoxOption, true, chosen, &line)
                });
                if response.clicked() {
                    picked = Some(id).filter(|_| !chosen);
                    ui.close();
                }
            }
        });
        picked
    });
    let button = menu.response.on_hover_text(current.unwrap_or("Choose what to look at"));
    button.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Button, true, &name));
    menu.inner.flatten()
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

/// The name of the group that begins, or a line where there is none to name.
fn group_ui(ui: &mut egui::Ui, palette: &Palette, group: Option<&str>) {
    let size = egui::vec2(ui.available_width(), if group.is_some() { GROUP } else { 6.0 });
    let (rect, _) = ui.allocate_exact_size(size, egui::Sense::hover());
    match group {
        Some(group) => {
            let font = egui::FontId::proportional(12.0);
            let at = rect.left_bottom() + egui::vec2(4.0, -1.0);
            ui.painter().text(at, egui::Align2::LEFT_BOTTOM, group, font, palette.text_weak);
        }
        None => {
            ui.painter().hline(rect.x_range(), rect.center().y, egui::Stroke::new(1.0, palette.line));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::elided;

    #[test]
    fn long_names_keep_both_ends() {
        assert_eq!(elided("monday", 6), "monday");
        assert_eq!(elided("a-session-with-a-long-name-17", 11), "a-ses\u{2026}me-17");
        assert_eq!(elided("\u{e4}\u{e4}\u{e4}\u{e4}", 3), "\u{e4}\u{2026}\u{e4}");
    }
}
