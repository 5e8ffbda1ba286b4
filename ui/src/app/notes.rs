//! Shows notes below the bar: a server open to the network, the station's reason to hold or stop, refused commands, a lost
//! connection.

use egui::{Color32, RichText};

use super::StudioApp;
use crate::{
    screens::{announced_ui, control::wording::phase_color, controls::name_button},
    store::{Connection, control::StopProgress, notice::Notice},
    theme::Palette,
};

/// Notes take at most this share of the window's height; more of them scroll.
const MAX_SHARE: f32 = 0.3;

/// What pressing a note's button does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Dismiss {
    Notice,
    Stop,
}

/// Something to read.
struct Note {
    color: Color32,
    /// Words before the text, in bold: when, and what it is about.
    when: String,
    text: String,
    dismiss: Option<Dismiss>,
}

impl Note {
    fn new(color: Color32, text: impl Into<String>) -> Self {
        Self { color, when: String::new(), text: text.into(), dismiss: None }
    }
}

impl StudioApp {
    /// A server that anybody in the network can reach says so on every screen, as long as it does.
    pub(super) fn insecure_ui(&self, ui: &mut egui::Ui, palette: &Palette) {
        if !self.store.info.ready().is_some_and(|info| info.insecure) {
            return;
        }
        let frame = egui::Frame::new().fill(palette.mismatch).inner_margin(egui::Margin::symmetric(8, 4));
        egui::Panel::top("insecure").resizable(false).frame(frame).show(ui, |ui| {
            let text = "\u{26a0} Open to the network without a login: anybody there can take control";
            ui.add(egui::Label::new(RichText::new(text).strong().color(palette.background)).wrap());
        });
    }

    /// The notes of a station that takes commands.
    pub(super) fn notes_ui(&mut self, ui: &mut egui::Ui, palette: &Palette, now_s: f64) {
        let notes = self.notes(palette, now_s);
        let refusals = self.store.control.refusals.clone();
        if notes.is_empty() && refusals.is_empty() {
            return;
        }
        let mut dismissed = None;
        let mut refusals_read = false;
        let max_height = (ui.ctx().content_rect().height() * MAX_SHARE).max(44.0);
        egui::Panel::top("control_notes").resizable(false).show(ui, |ui| {
            egui::ScrollArea::vertical().max_height(max_height).show(ui, |ui| {
                for note in &notes {
                    ui.horizontal_wrapped(|ui| {
                        ui.label(RichText::new("\u{26a0}").color(note.color));
                        if !note.when.is_empty() {
                            ui.label(RichText::new(&note.when).strong());
                        }
                        announced_ui(ui, &note.text, true);
                        if note.dismiss.is_some() {
                            let button = ui.button("Dismiss");
                            name_button(&button, "Dismiss notice");
                            if button.clicked() {
                                dismissed = note.dismiss;
                            }
                        }
                    });
                }
                for (idx, refusal) in refusals.iter().enumerate() {
                    ui.horizontal_wrapped(|ui| {
                        ui.label(
                            RichText::new(format!("\u{26a0} {} {}: refused", refusal.at, refusal.what))
                                .strong()
                                .color(palette.mismatch),
                        );
                        announced_ui(ui, &refusal.why, true);
                        if idx + 1 == refusals.len() {
                            refusals_read = ui.button("Dismiss").clicked();
                        }
                    });
                }
            });
        });
        match dismissed {
            Some(Dismiss::Notice) => self.store.notice.dismiss(),
            Some(Dismiss::Stop) => self.store.control.dismiss_stop(),
            None => {}
        }
        if refusals_read {
            self.store.control.dismiss();
        }
        if !notes.is_empty() || self.store.frozen_since(now_s).is_some() {
            ui.ctx().request_repaint_after(std::time::Duration::from_millis(500));
        }
    }

    fn notes(&self, palette: &Palette, now_s: f64) -> Vec<Note> {
        let frozen = self.store.frozen_since(now_s);
        let link = &self.store.control;
        let mut notes = Vec::new();
        if link.stop_unsent {
            let text = "STOP could not be sent: there is no connection. Cut the power. It is sent as soon as the \
                        connection is back.";
            notes.push(Note::new(palette.mismatch, text));
        } else if let Connection::Lost { since, .. } = &link.connection {
            let text = format!(
                "Commands have not reached the station since {since}. It holds by itself; cut the power if it must stop \
                 now."
            );
            notes.push(Note::new(palette.mismatch, text));
        }
        if let StopProgress::Unconfirmed { problem, at } = link.stop_progress() {
            notes.push(Note {
                when: format!("{at}: STOP is not confirmed."),
                dismiss: Some(Dismiss::Stop),
                ..Note::new(palette.mismatch, problem)
            });
        }
        // A lost stream has its own line.
        if let Some((since, _)) = frozen
            && self.store.connection == Connection::Open
        {
            let text = format!(
                "Nothing has come from the station since {since}. What is shown is as of then; see the server's log."
            );
            notes.push(Note::new(palette.mismatch, text));
        }
        if let Some((when, why)) = self.store.notice.text().filter(|_| frozen.is_none()) {
            let phase = self.store.phase();
            notes.push(Note {
                when,
                dismiss: Notice::is_dismissable(phase).then_some(Dismiss::Notice),
                ..Note::new(phase_color(phase, palette), why)
            });
        }
        if link.lease() != 0 {
            if !self.platform.is_watched() {
                let text = "This window does not have the focus, so the station is not told that you are there, and \
                            holds. Click on the page.";
                notes.push(Note::new(palette.warning, text));
            } else if let Some(complaint) = self.frame_rate.complaint() {
                notes.push(Note::new(palette.warning, complaint));
            }
        }
        notes
    }
}
