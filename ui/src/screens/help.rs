//! The way from a screen into the manual: a `?` beside its heading, and links where a message names a document.

use super::{controls::name_button, heading_ui};
use crate::route::{HelpPlace, Screen};

/// Size of a `?`, points: to be hit by a finger, too.
const BUTTON_SIZE: egui::Vec2 = egui::vec2(28.0, 26.0);

/// What a `?` is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// A screen as a whole.
    Screen(Screen),
    /// The devices of the live station.
    Devices,
}

impl Topic {
    /// Every topic.
    pub fn all() -> impl Iterator<Item = Self> {
        Screen::ALL.iter().copied().map(Self::Screen).chain([Self::Devices])
    }

    /// The document on it, and the address of the heading there, if that is not the first.
    pub fn document(self) -> (&'static str, Option<&'static str>) {
        match self {
            Self::Screen(screen) => screen.about().document,
            Self::Devices => ("hardware", None),
        }
    }
}

impl From<Screen> for Topic {
    fn from(screen: Screen) -> Self {
        Self::Screen(screen)
    }
}

/// The heading of a screen, with a `?` beside it that opens the document on it.
pub fn topic_heading_ui(ui: &mut egui::Ui, text: &str, topic: impl Into<Topic>) {
    ui.horizontal_wrapped(|ui| {
        heading_ui(ui, text);
        topic_ui(ui, topic);
    });
}

/// A `?` that opens the document on `topic`.
pub fn topic_ui(ui: &mut egui::Ui, topic: impl Into<Topic>) {
    let (doc, section) = topic.into().document();
    let words = doc.replace('_', " ");
    let button = egui::Button::new("?").small().min_size(BUTTON_SIZE);
    let button = ui.add(button).on_hover_text(format!("Read about it: {words}"));
    name_button(&button, &format!("Help: {words}"));
    if button.clicked() {
        ask(ui.ctx(), HelpPlace::doc(doc).at(section));
    }
}

/// A button that opens Help at `words`: what stands beside it is explained there.
pub fn help_ui(ui: &mut egui::Ui, words: &str) {
    let button = ui.small_button("?").on_hover_text(format!("What does \u{201c}{words}\u{201d} mean?"));
    name_button(&button, &format!("What does {words} mean?"));
    if button.clicked() {
        ask(ui.ctx(), HelpPlace::words(words));
    }
}

/// Text for people; where it names a document as `docs/jobs.md`, that is a link to it.
pub fn said_ui(ui: &mut egui::Ui, text: &str) {
    let parts = palpate_wire::markdown::named_docs(text);
    if parts.iter().all(|(_, doc)| doc.is_none()) {
        ui.label(text);
        return;
    }
    ui.scope(|ui| {
        // Rows of text, not of controls.
        ui.spacing_mut().interact_size.y = 18.0;
        ui.spacing_mut().item_spacing = egui::Vec2::ZERO;
        ui.horizontal_wrapped(|ui| parts_ui(ui, parts));
    });
}

fn parts_ui(ui: &mut egui::Ui, parts: Vec<(&str, Option<&str>)>) {
    for (part, doc) in parts {
        match doc {
            None => {
                ui.label(part);
            }
            Some(doc) => {
                if ui.link(egui::RichText::new(part).underline()).clicked() {
                    ask(ui.ctx(), HelpPlace::doc(doc));
                }
            }
        }
    }
}

/// Opens Help at `place` after this frame.
fn ask(ctx: &egui::Context, place: HelpPlace) {
    ctx.data_mut(|data| data.insert_temp(asked_id(), place));
}

/// What was asked for since the last call.
pub(crate) fn asked(ctx: &egui::Context) -> Option<HelpPlace> {
    ctx.data_mut(|data| data.remove_temp(asked_id()))
}

fn asked_id() -> egui::Id {
    egui::Id::unique("help asked for")
}
