//! Asks for the operator's name once, before control is taken for the first time; the browser keeps it.

use egui::{Key, RichText};

use super::{StudioApp, overlays::dialog};
use crate::{screens::heading_ui, store::control::Holder};

/// Names are no longer than this.
const MAX_LETTERS: usize = 40;

/// The question while it is on the screen.
#[derive(Debug)]
pub(super) struct NameQuestion {
    name: String,
    then: Then,
    has_focus: bool,
}

/// What follows the answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Then {
    Nothing,
    /// Control is asked for, from whoever holds it if `take_over`: that question was answered before.
    Acquire {
        take_over: bool,
    },
}

impl StudioApp {
    /// Asks for the lease. If somebody else has it, the person is asked first; if nobody has said who sits here, that.
    pub(super) fn ask_for_control(&mut self) {
        match self.store.control.holder(self.store.control_state()) {
            Holder::Me => {}
            Holder::Nobody => self.acquire(false),
            Holder::Other(name) => self.strip.ask_to_take_over(name),
        }
    }

    /// Asks the server for the lease, once there is a name to ask under.
    pub(super) fn acquire(&mut self, take_over: bool) {
        if self.store.control.has_name() {
            self.store.control.acquire(take_over);
        } else {
            self.ask_for_name(Then::Acquire { take_over });
        }
    }

    /// Asks who sits here, to change it.
    pub(super) fn change_name(&mut self) {
        self.ask_for_name(Then::Nothing);
    }

    fn ask_for_name(&mut self, then: Then) {
        let name = self.store.control.operator.clone();
        self.name_question = Some(NameQuestion { name, then, has_focus: false });
    }

    pub(super) fn name_ui(&mut self, ctx: &egui::Context) {
        let Some(question) = &mut self.name_question else { return };
        let modal = dialog(ctx, "who", 420.0, |ui| {
            heading_ui(ui, "Who sits here?");
            ui.label(
                "Others see this name while you have control, and the log of the station keeps it. This browser \
                 remembers it.",
            );
            ui.add_space(6.0);
            let field = egui::TextEdit::singleline(&mut question.name)
                .hint_text("Your name")
                .desired_width(f32::INFINITY)
                .char_limit(MAX_LETTERS)
                .min_size(egui::vec2(0.0, 32.0));
            let response = ui.add(field).accessible_name("Your name");
            if !question.has_focus {
                question.has_focus = true;
                response.request_focus();
            }
            let enter = response.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
            let ready = !question.name.trim().is_empty();
            ui.add_space(8.0);
            ui.horizontal(|ui| {
                let next = egui::Button::new(RichText::new("Continue").strong());
                let done = ui.add_enabled(ready, next).on_disabled_hover_text("Write your name first");
                ((done.clicked() || enter) && ready, ui.button("Cancel").clicked())
            })
            .inner
        });
        let (done, cancelled) = modal.inner;
        let close = cancelled || modal.should_close();
        if done {
            let Some(question) = self.name_question.take() else { return };
            question.name.trim().clone_into(&mut self.store.control.operator);
            self.platform.save_operator(&self.store.control.operator);
            match question.then {
                Then::Nothing => {}
                // Who has control may have changed since: nobody is overruled without having been named.
                Then::Acquire { take_over: false } => self.ask_for_control(),
                Then::Acquire { take_over: true } => self.store.control.acquire(true),
            }
        } else if close {
            self.name_question = None;
        }
    }
}
