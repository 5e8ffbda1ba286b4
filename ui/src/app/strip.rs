//! The second row of the top bar: who commands the live station, how far it is armed, how fast its loop runs; STOP; and
//! below it what the operator must read.

use egui::{Align, Layout, RichText, accesskit::Role};
use palpate_wire::proto::{ControlState, control_state::Phase};

use super::StudioApp;
use crate::{
    screens::control::wording::{phase_color, phase_mark_ui, phase_word, stop_word},
    store::{Connection, control::Holder},
    theme::Palette,
};

/// Height of the row.
pub(super) const STRIP_HEIGHT: f32 = 40.0;
/// Width of the STOP button.
pub(super) const STOP_WIDTH: f32 = 132.0;
/// Width of the field with the operator's name.
const NAME_WIDTH: f32 = 110.0;

/// What the row remembers between frames.
#[derive(Debug, Default)]
pub(super) struct StripState {
    /// The holder whose lease somebody asked to take, while the question is on the screen.
    take_over: Option<String>,
}

impl StudioApp {
    /// Asks for the lease; if somebody else has it, asks the person first.
    pub(super) fn ask_for_control(&mut self) {
        match self.store.control.holder(self.store.control_state()) {
            Holder::Me => {}
            Holder::Nobody => self.store.control.acquire(false),
            Holder::Other(name) => self.strip.take_over = Some(name),
        }
    }

    /// The stop. It acts when it is pressed, not when it is let go.
    pub(super) fn stop_ui(&mut self, ui: &mut egui::Ui, rect: egui::Rect, palette: &Palette) {
        // Neither red nor yellow: ISO 13850 keeps these for stops that work without software and cannot be carried away.
        let button = egui::Button::new("").fill(palette.real).corner_radius(8.0);
        let response = ui.put(rect, button).on_hover_text(
            "Stops every motor by software, from any page. Space does the same while armed. It does not replace a \
             switch that cuts the power.",
        );
        response.widget_info(|| egui::WidgetInfo::labeled(Role::Button, true, "STOP (software)"));
        let center = rect.center();
        let line = |below: f32, text: &str, size: f32| {
            let (at, font) = (center + egui::vec2(0.0, below), egui::FontId::proportional(size));
            ui.painter().text(at, egui::Align2::CENTER_CENTER, text, font, palette.surface);
        };
        line(-9.0, "STOP", 26.0);
        line(17.0, "(software)", 15.0);
        let (pressed, released) =
            ui.input(|input| (input.pointer.primary_pressed(), input.pointer.primary_released()));
        let by_pointer = response.is_pointer_button_down_on() && pressed;
        // A click that no pointer ended came from a key or from a screen reader.
        if by_pointer || (response.clicked() && !released) {
            self.store.control.stop();
        }
    }

    /// The row itself.
    pub(super) fn strip_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        let Some(state) = self.store.control_state().cloned() else {
            ui.horizontal_centered(|ui| {
                ui.label(RichText::new("Waiting for the station\u{2026}").color(palette.text_weak));
            });
            return;
        };
        let frozen = self.store.frozen_since(now_s).map(|(since, _)| since.to_owned());
        ui.horizontal_centered(|ui| {
            self.armed_ui(ui, palette, &state, frozen.as_deref());
            ui.separator();
            self.holder_ui(ui, palette, &state, frozen.is_some());
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                loop_ui(ui, palette, &state, frozen.is_some());
            });
        });
    }

    /// How far it is armed, in words, and the step that is next.
    fn armed_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, state: &ControlState, frozen: Option<&str>) {
        let phase = state.phase();
        let (word, color) = match frozen {
            Some(since) => (format!("LAST SEEN {} AT {since}", phase_word(phase)), palette.mismatch),
            None => (phase_word(phase).to_owned(), phase_color(phase, palette)),
        };
        phase_mark_ui(ui, phase, color);
        let label = ui.label(RichText::new(word).strong().color(color));
        if !state.reason.is_empty() {
            label.on_hover_text(&state.reason);
        }
        if phase == Phase::Stopped {
            ui.label(RichText::new(stop_word(state)).color(color));
        }
        let link = &self.store.control;
        let may = frozen.is_none() && link.is_open() && link.holder(Some(state)) == Holder::Me;
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
        let usable = self.store.control.is_open() && !frozen;
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
                self.operator_ui(ui);
                let waits = self.store.control.waits_for("Take control");
                let button = egui::Button::new(RichText::new("Take control").strong());
                if ui.add_enabled(usable && !waits, button).clicked() {
                    self.store.control.acquire(false);
                }
            }
            Holder::Other(name) => {
                ui.label(RichText::new(format!("{name} has control")).strong().color(palette.warning))
                    .on_hover_text("You can watch, and press STOP");
                self.operator_ui(ui);
                let response = ui
                    .add_enabled(usable, egui::Button::new("Take over\u{2026}"))
                    .on_hover_text("Asks you once more, naming who has control");
                response.widget_info(|| egui::WidgetInfo::labeled(Role::Button, usable, "Take over"));
                if response.clicked() {
                    self.strip.take_over = Some(name);
                }
            }
        }
    }

    fn operator_ui(&mut self, ui: &mut egui::Ui) {
        let field = egui::TextEdit::singleline(&mut self.store.control.operator)
            .hint_text("Your name")
            .desired_width(NAME_WIDTH)
            .char_limit(40)
            .min_size(egui::vec2(0.0, 30.0));
        let response = ui.add(field).accessible_name("Your name");
        if response.lost_focus() {
            self.platform.save_operator(self.store.control.operator.trim());
        }
    }

    /// The one question before control is taken from somebody.
    pub(super) fn take_over_ui(&mut self, ctx: &egui::Context) {
        let Some(name) = self.strip.take_over.clone() else { return };
        if self.store.control.holder(self.store.control_state()) == Holder::Me {
            self.strip.take_over = None;
            return;
        }
        let modal = egui::Modal::new(egui::Id::unique("take over")).show(ctx, |ui| {
            ui.set_width(420.0);
            ui.heading(format!("Take control from {name}?"));
            ui.label(format!(
                "The station disarms, and {name} cannot command any more. Speak to {name} first if you can: a hand may \
                 be near the robot."
            ));
            ui.add_space(8.0);
            ui.horizontal(|ui| {
                let take = ui.button(RichText::new(format!("Take over from {name}")).strong()).clicked();
                let leave = ui.button(format!("Leave it to {name}")).clicked();
                (take, leave)
            })
            .inner
        });
        let (take, leave) = modal.inner;
        if take {
            self.store.control.acquire(true);
        }
        if take || leave || modal.should_close() {
            self.strip.take_over = None;
        }
    }

    /// What must be read: why the station holds or stopped, what was refused, what cannot be sent.
    pub(super) fn notes_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        let state = self.store.control_state();
        let frozen = self.store.frozen_since(now_s);
        let mut notes: Vec<(egui::Color32, String)> = Vec::new();
        // A lost stream has its own line above.
        if let Some((since, _)) = frozen
            && self.store.connection == Connection::Open
        {
            let text = format!(
                "Nothing has come from the station since {since}. What is shown is as of then; see the server's log."
            );
            notes.push((palette.mismatch, text));
        }
        if let Some(state) = state.filter(|state| !state.reason.is_empty() && frozen.is_none()) {
            notes.push((phase_color(state.phase(), palette), state.reason.clone()));
        }
        let link = &self.store.control;
        if link.stop_unsent {
            let text = "STOP could not be sent: there is no connection. Cut the power. It is sent as soon as the \
                        connection is back.";
            notes.push((palette.mismatch, text.to_owned()));
        } else if let Connection::Lost { since, .. } = &link.connection {
            let text = format!(
                "Commands have not reached the station since {since}. It holds by itself; cut the power if it must stop \
                 now."
            );
            notes.push((palette.mismatch, text));
        }
        if link.lease() != 0 && !self.platform.is_watched() {
            let text = "This window does not have the focus, so the station is not told that you are there, and holds. \
                        Click on the page.";
            notes.push((palette.warning, text.to_owned()));
        }
        let (refusals, is_frozen) = (link.refusals.clone(), frozen.is_some());
        if notes.is_empty() && refusals.is_empty() {
            return;
        }
        let mut dismissed = false;
        egui::Panel::top("control_notes").resizable(false).show(ui, |ui| {
            for (color, text) in &notes {
                ui.horizontal_wrapped(|ui| {
                    ui.label(RichText::new("\u{26a0}").color(*color));
                    ui.label(text);
                });
            }
            for (idx, refusal) in refusals.iter().enumerate() {
                ui.horizontal_wrapped(|ui| {
                    ui.label(
                        RichText::new(format!("\u{26a0} {} {}: refused", refusal.at, refusal.what))
                            .strong()
                            .color(palette.mismatch),
                    );
                    ui.label(&refusal.why);
                    if idx + 1 == refusals.len() {
                        dismissed = ui.button("Dismiss").clicked();
                    }
                });
            }
        });
        if dismissed {
            self.store.control.dismiss();
        }
        if is_frozen || !notes.is_empty() {
            ui.ctx().request_repaint_after(std::time::Duration::from_millis(500));
        }
    }
}

/// Loop rate and latency.
fn loop_ui(ui: &mut egui::Ui, palette: &Palette, state: &ControlState, frozen: bool) {
    if frozen {
        ui.label(RichText::new("not live").strong().color(palette.mismatch));
        return;
    }
    ui.label(format!("latency {:.0} ms", state.latency_ms)).on_hover_text(format!(
        "From a device's byte to this page's message: {:.1} ms now, 95 of 100 below {:.1} ms in the last ten seconds",
        state.latency_ms, state.latency_p95_ms
    ));
    ui.separator();
    ui.label(format!("loop {:.0} Hz", state.loop_hz)).on_hover_text(format!(
        "Control loop: {:.1} Hz over the last second, {:.1} Hz on average, {:.1} Hz in its worst second",
        state.loop_hz, state.loop_mean_hz, state.loop_worst_hz
    ));
}
