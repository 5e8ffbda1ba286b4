//! What every screen is to the rest of the page: what is said of it, and how it is drawn.

use super::ScreenContext;
use crate::commands::Command;

/// What is said of a screen without drawing it.
pub struct About {
    /// The word in the rail.
    pub label: &'static str,
    /// The word in addresses.
    pub slug: &'static str,
    /// With Alt, opens it; `None` for those that are reached by the rail and the palette alone.
    pub key: Option<egui::Key>,
    /// The sign in a rail that is too narrow for words.
    pub icon: &'static str,
    /// One line on what the screen is for.
    pub purpose: &'static str,
    /// Screens of one group stand together in the rail. `None` for those that are about all of it.
    pub group: Option<&'static str>,
    /// The document on the screen, and the address of the heading there, if that is not the first.
    pub document: (&'static str, Option<&'static str>),
    /// What its address names.
    pub subject: Subject,
    /// Whether it has something to offer only beside a live station that takes commands.
    pub needs_station: bool,
    /// Whether what comes in from the live station is drawn at once, and not a few times a second.
    pub shows_stream: bool,
    /// The screen as it is when the page opens.
    pub new: fn() -> Box<dyn View>,
}

/// What the address of a screen names besides the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subject {
    /// A take, or the live station instead.
    Take,
    /// A session: another one is another address.
    Session,
    /// Nothing: it is about what the live station does.
    Station,
    /// Something of its own.
    Other,
}

/// A screen, with what it keeps from frame to frame.
pub trait View {
    /// Draws a frame.
    fn ui(&mut self, ui: &mut egui::Ui, cx: &mut ScreenContext<'_>);

    /// Takes a command for the next frame, if it is one for this screen.
    fn take_command(&mut self, _command: Command) {}

    /// How long a stretch of time is on the screen, s, if it shows one.
    fn shown_span_s(&self) -> Option<f64> {
        None
    }
}
