//! The second row of the top bar: who commands the live station, how far it is armed, how fast its loop runs. On a narrow
//! page, its state is in the bar and the rest in the menu.

use egui::{Align, Layout, RichText, accesskit::Role};
use palpate_wire::{
    api::Scope,
    proto::{ControlState, control_state::Phase},
};

use super::{StudioApp, bars::elided, overlays::dialog};
use crate::{
    screens::{
        announce,
        control::wording::{phase_color, phase_mark_ui, phase_word, stop_word},
        heading_ui,
    },
    store::control::{Holder, StopProgress},
    theme::Palette,
};

/// Names of people in the bar are no longer than this.
const MAX_NAME: usize = 24;
/// The name of who sits here, beside the button that takes control, is shorter still.
const MAX_OWN_NAME: usize = 14;
/// Loop rate and latency are left out where less room is left, points.
const LOOP_WIDTH: f32 = 190.0;

/// What the row remembers between frames.
#[derive(Debug, Default)]
pub(super) struct StripState {
    /// The holder whose lease somebody asked to take, while the question is on the screen.
    take_over: Option<String>,
}

impl StripState {
    /// Asks the person whether control shall be taken from `holder`.
    pub(super) fn ask_to_take_over(&mut self, holder: String) {
        self.take_over = Some(holder);
    }
}

impl StudioApp {
    /// The row itself.
    pub(super) fn strip_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        let Some(state) = self.store.control_state().cloned() else {
            ui.horizontal_centered(|ui| waiting_ui(ui, palette));
            return;
        };
        let frozen = self.store.frozen_since(now_s).map(|(since, _)| since.to_owned());
        ui.horizontal_centered(|ui| {
            self.phase_ui(ui, palette, &state, frozen.as_deref());
            self.arming_ui(ui, &state, frozen.is_some());
            ui.separator();
            self.holder_ui(ui, palette, &state, frozen.is_some());
            if ui.available_width() >= LOOP_WIDTH {
                ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                    loop_ui(ui, palette, &state, frozen.is_some());
                });
            }
        });
    }

    /// What of the row a narrow page has room for: the state.
    pub(super) fn narrow_strip_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        let Some(state) = self.store.control_state().cloned() else { return waiting_ui(ui, palette) };
        let frozen = self.store.frozen_since(now_s).map(|(since, _)| since.to_owned());
        self.phase_ui(ui, palette, &state, frozen.as_deref());
    }

    /// The rest of the row, in the menu of a narrow page.
    pub(super) fn strip_menu_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        let Some(state) = self.store.control_state().cloned() else { return };
        let frozen = self.store.frozen_since(now_s).is_some();
        self.arming_ui(ui, &state, frozen);
        ui.separator();
        self.holder_ui(ui, palette, &state, frozen);
        ui.separator();
        loop_ui(ui, palette, &state, frozen);
    }

    /// How far it is armed, in words.
    fn phase_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, state: &ControlState, frozen: Option<&str>) {
        let phase = state.phase();
        let (word, color) = match frozen {
            Some(since) => (format!("LAST SEEN {} AT {since}", phase_word(phase)), palette.mismatch),
            None => (phase_word(phase).to_owned(), phase_color(phase, palette)),
        };
        phase_mark_ui(ui, phase, color);
        let label = ui.add(egui::Label::new(RichText::new(&word).strong().color(color)).truncate());
        announce(&label, &word, false);
        if !state.reason.is_empty() {
            label.on_hover_text(&state.reason);
        }
        let stop = match self.store.control.stop_progress() {
            _ if self.store.control.stop_unsent => Some("STOP not sent"),
            StopProgress::Stopping => Some("Stopping\u{2026}"),
            StopProgress::Confirmed { .. } => Some("Stopped, confirmed"),
            StopProgress::Unconfirmed { .. } => Some("Stop not confirmed"),
            StopProgress::None => (phase == Phase::Stopped).then(|| stop_word(state)),
        };
        if let Some(stop) = stop {
            ui.add(egui::Label::new(RichText::new(stop).strong().color(color)).truncate());
        }
    }

    /// The step of arming that is next.
    fn arming_ui(&mut self, ui: &mut egui::Ui, state: &ControlState, frozen: bool) {
        let phase = state.phase();
        let link = &self.store.control;
        let may = !frozen && link.is_open() && link.holder(Some(state)) == Holder::Me;
        let why_not = "Take control first";
        match phase {
            Phase::Stopped => {
                let enabled = may && !link.waits_for("Reset stop");
                let button = egui::Button::new("Reset stop");
                let response = ui.add_enabled(enabled, button).on_disabled_hover_text(why_not).on_hover_text(
                    "First see why it was stopped and that nobody is in the way. The station stays disarmed.",
                );
                if response.clicked() {
                    self.store.control.reset_stop();
                }
            }
            Phase::Disarmed | Phase::Unspecified => {
                let enabled = may && !link.waits_for("Arm");
                let response = ui
                    .add_enabled(enabled, egui::Button::new("Arm"))
                    .on_disabled_hover_text(why_not)
                    .on_hover_text("Torque on, where the joints are now");
                if response.clicked() {
                    self.store.control.arm();
                }
            }
            Phase::Arming | Phase::Armed | Phase::Holding | Phase::Disarming => {
                let enabled = may && phase != Phase::Disarming && !link.waits_for("Disarm");
                let response = ui
                    .add_enabled(enabled, egui::Button::new("Disarm"))
                    .on_disabled_hover_text(why_not)
                    .on_hover_text("Torque off, in an orderly way");
                if response.clicked() {
                    self.store.control.disarm();
                }
            }
        }
    }

    /// Who commands, and how that changes.
    fn holder_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, state: &ControlState, frozen: bool) {
        let holder = self.store.control.holder(Some(state));
        let lacks = self.store.people.lacks(palpate_wire::api::Role::Operator, Scope::Control);
        let usable = self.store.control.is_open() && !frozen && lacks.is_none();
        let why_not = lacks.map_or_else(String::new, |me| {
            format!(
                "You are {} ({}): you can watch, and press STOP. Operators take control.",
                me.name, me.role
            )
        });
        match holder {
            Holder::Me => {
                ui.label(RichText::new("You have control").strong());
                let waits = self.store.control.waits_for("Give back control");
                let button = egui::Button::new("Give back control");
                let response = ui.add_enabled(usable && !waits, button);
                if response.on_hover_text("Disarms, and lets somebody else command").clicked() {
                    self.store.control.release();
                }
            }
            Holder::Nobody => {
                ui.label(RichText::new("Nobody has control").color(palette.text_weak));
                let waits = self.store.control.waits_for("Take control");
                let button = egui::Button::new(RichText::new("Take control").strong());
                let mut response = ui.add_enabled(usable && !waits, button);
                if !why_not.is_empty() {
                    response = response.on_disabled_hover_text(why_not);
                }
                if response.clicked() {
                    self.acquire(false);
                }
                self.who_ui(ui, palette);
            }
            Holder::Other(name) => {
                let shown = format!("{} has control", elided(&name, MAX_NAME));
                ui.label(RichText::new(shown).strong().color(palette.warning))
                    .on_hover_text(format!("{name} has control. You can watch, and press STOP"));
                let mut response = ui
                    .add_enabled(usable, egui::Button::new("Take over\u{2026}"))
                    .on_hover_text("Asks you once more, naming who has control");
                if !why_not.is_empty() {
                    response = response.on_disabled_hover_text(why_not);
                }
                response.widget_info(|| egui::WidgetInfo::labeled(Role::Button, usable, "Take over"));
                if response.clicked() {
                    self.strip.take_over = Some(name);
                }
            }
        }
    }

    /// Under which name control is asked for, and how to change it.
    fn who_ui(&mut self, ui: &mut egui::Ui, palette: &Palette) {
        // Whoever logged in is called by that name, which stands in the bar.
        if !self.store.control.has_name() || self.store.people.login().is_some() {
            return;
        }
        let name = elided(self.store.control.operator.trim(), MAX_OWN_NAME);
        let button =
            egui::Button::new(RichText::new(format!("as {name}")).color(palette.text_weak)).frame(false);
        let response = ui.add(button).on_hover_text("Change the name");
        response.widget_info(|| egui::WidgetInfo::labeled(Role::Button, true, format!("as {name}, change")));
        if response.clicked() {
            self.change_name();
        }
    }

    /// The one question before control is taken from somebody.
    pub(super) fn take_over_ui(&mut self, ctx: &egui::Context) {
        let Some(name) = self.strip.take_over.clone() else { return };
        if self.store.control.holder(self.store.control_state()) == Holder::Me {
            self.strip.take_over = None;
            return;
        }
        let modal = dialog(ctx, "take over", 420.0, |ui| {
            heading_ui(ui, format!("Take control from {name}?"));
            ui.label(format!(
                "The station disarms, and {name} cannot command any more. Speak to {name} first if you can: a hand may \
                 be near the robot."
            ));
            ui.add_space(8.0);
            ui.horizontal_wrapped(|ui| {
                let take = ui.button(RichText::new(format!("Take over from {name}")).strong()).clicked();
                let leave = ui.button(format!("Leave it to {name}")).clicked();
                (take, leave)
            })
            .inner
        });
        let (take, leave) = modal.inner;
        if take {
            self.acquire(true);
        }
        if take || leave || modal.should_close() {
            self.strip.take_over = None;
        }
    }
}

fn waiting_ui(ui: &mut egui::Ui, palette: &Palette) {
    ui.label(RichText::new("Waiting for the station\u{2026}").color(palette.text_weak));
}

/// From here on what is shown of the station is late enough to be told, ms.
const LATE_MS: f32 = 150.0;
/// A loop slower than this share of its own mean is told.
const SLOW_SHARE: f32 = 0.9;

/// Loop rate and latency, where they are not as they should be; Devices on Hand always has both.
fn loop_ui(ui: &mut egui::Ui, palette: &Palette, state: &ControlState, frozen: bool) {
    if frozen {
        ui.label(RichText::new("not live").strong().color(palette.mismatch));
        return;
    }
    if state.latency_p95_ms > LATE_MS {
        let text = format!("picture {:.0} ms late", state.latency_p95_ms);
        ui.label(RichText::new(text).color(palette.warning)).on_hover_text(
            "From a device's byte to this page's message, 95 of 100 in the last ten seconds are below that",
        );
    }
    if state.loop_mean_hz > 0.0 && state.loop_hz < SLOW_SHARE * state.loop_mean_hz {
        let text = format!("control loop slow: {:.0} Hz", state.loop_hz);
        ui.label(RichText::new(text).color(palette.warning))
            .on_hover_text(format!("Over the last second; {:.0} Hz on average", state.loop_mean_hz));
    }
}
