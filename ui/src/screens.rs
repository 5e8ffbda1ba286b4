//! One function per screen, and what they share: the context they get, and their empty, loading and error states.

pub mod calibrate;
pub mod control;
pub mod controls;
pub mod copy_as;
pub mod diagnose;
pub mod hand;
pub mod home;
pub mod jobs;
pub mod objects;
pub mod record;
pub mod run_controls;
pub mod sessions;
pub mod settings;
pub mod timelines;
pub mod trials;

pub use palpate_wire::wording::words;

use crate::{
    playback::Playback,
    route::{Route, Screen},
    store::{Loadable, Store},
    surface::Surface,
    theme::Palette,
};

/// What a screen works with.
pub struct ScreenContext<'a> {
    /// Everything the server said.
    pub store: &'a mut Store,
    /// The shared cursor and selection.
    pub playback: &'a mut Playback,
    /// Colours of the theme in use.
    pub palette: Palette,
    /// Where the address bar says we are.
    pub route: &'a Route,
    /// Set it to go somewhere else after this frame.
    pub go_to: &'a mut Option<Route>,
    /// What wgpu paints on; `None` where nothing paints with wgpu (tests).
    pub surface: Option<Surface>,
    /// The page's clock, s since it opened.
    pub now_s: f64,
    /// A time as RFC 3339 has it, in the operator's time zone with seconds; `None` if it cannot be read.
    pub local_time: &'a dyn Fn(&str) -> Option<String>,
    /// Files that the operator chose in the file dialog or dropped on the page.
    pub picked_files: &'a mut Vec<PickedFile>,
    /// Set it to open the file dialog after this frame.
    pub pick_file: &'a mut bool,
}

/// A file that the operator chose.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PickedFile {
    /// Its name, without a folder.
    pub name: String,
    /// What is in it.
    pub bytes: Vec<u8>,
}

impl ScreenContext<'_> {
    /// Goes to `screen` with the session and take at hand.
    pub fn go_to_screen(&mut self, screen: Screen) {
        *self.go_to = Some(Route {
            session: self.playback.session.clone(),
            take: self.playback.take.clone(),
            ..Route::to(screen)
        });
    }
}

/// Chooses a session and a take where none is chosen: the first that can be opened. `false` while there is none yet;
/// the state (loading, none recorded, failed) is then on the screen already.
pub fn ensure_take_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) -> bool {
    if cx.playback.session.is_none() {
        match cx.store.sessions() {
            Loadable::Ready(sessions) => match sessions.iter().find(|session| session.error.is_none()) {
                Some(session) => cx.playback.session = Some(session.id.clone()),
                None => {
                    no_sessions_ui(ui, cx);
                    return false;
                }
            },
            Loadable::Failed(error) => {
                failed_ui(ui, cx, "The list of sessions did not arrive", &error);
                return false;
            }
            Loadable::Idle | Loadable::Loading => {
                loading_ui(ui, "Looking for sessions");
                return false;
            }
        }
    }
    let Some(session) = cx.playback.session.clone() else { return false };
    if cx.playback.take.is_some() {
        return true;
    }
    match cx.store.session(&session) {
        Loadable::Ready(detail) => {
            let first = detail.takes.iter().find(|take| take.accepted).or(detail.takes.first());
            match first {
                Some(take) => {
                    cx.playback.open(&session, &take.id);
                    true
                }
                None => {
                    let text = "Record or import takes into it, or choose another session.";
                    if empty_ui(ui, &format!("Session {session} holds no takes"), text, "Choose a session") {
                        cx.go_to_screen(Screen::Sessions);
                    }
                    false
                }
            }
        }
        Loadable::Failed(error) => {
            failed_ui(ui, cx, &format!("Session {session} did not open"), &error);
            false
        }
        Loadable::Idle | Loadable::Loading => {
            loading_ui(ui, &format!("Opening session {session}"));
            false
        }
    }
}

fn no_sessions_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let text = "A session is a set of takes: recordings of the hand touching a known object. \
        Replay, comparison and calibration all start from one.";
    if empty_ui(ui, "No session yet", text, "Bring in a session") {
        cx.go_to_screen(Screen::Sessions);
    }
}

/// An empty state: what this is for, and the one button that fills it. True when the button was pressed.
pub fn empty_ui(ui: &mut egui::Ui, title: &str, text: &str, button: &str) -> bool {
    centered(ui, |ui| {
        ui.heading(title);
        ui.label(text);
        ui.add_space(8.0);
        ui.button(button).clicked()
    })
}

/// Something is on its way: what.
pub fn loading_ui(ui: &mut egui::Ui, what: &str) {
    centered(ui, |ui| {
        ui.spinner();
        ui.label(format!("{what}\u{2026}"));
    });
}

/// Something did not come: what, why, and a way to try again.
pub fn failed_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, what: &str, why: &str) {
    let mismatch = cx.palette.mismatch;
    let again = centered(ui, |ui| {
        ui.heading(egui::RichText::new(format!("\u{26a0} {what}")).color(mismatch));
        ui.label(why);
        ui.add_space(8.0);
        ui.button("Try again").clicked()
    });
    if again {
        cx.store.retry_failed();
    }
}

fn centered<R>(ui: &mut egui::Ui, add_contents: impl FnOnce(&mut egui::Ui) -> R) -> R {
    let space = (ui.available_height() * 0.3).min(240.0);
    ui.add_space(space);
    ui.vertical_centered(|ui| {
        // More than there is would be cut on a phone.
        ui.set_max_width(ui.available_width().min(480.0));
        add_contents(ui)
    })
    .inner
}

/// A bar that is empty where nothing is done yet; egui's own begins as a full circle.
pub fn progress_bar(fraction: f64, text: &str) -> egui::ProgressBar {
    let radius = if fraction > 0.0 { 4 } else { 0 };
    egui::ProgressBar::new(fraction as f32).corner_radius(radius).text(text)
}

/// A duration as people say it: `12.4 s`, `5 min 26 s`, `1 h 02 min`.
pub fn duration_text(seconds: f64) -> String {
    if !seconds.is_finite() || seconds < 0.0 {
        return "unknown".to_owned();
    }
    if seconds < 59.95 {
        return format!("{seconds:.1} s");
    }
    let whole = seconds.round() as u64;
    if whole < 3600 {
        format!("{} min {:02} s", whole / 60, whole % 60)
    } else {
        format!("{} h {:02} min", whole / 3600, whole % 3600 / 60)
    }
}

/// `ring_finger` as people write it: `Ring finger`.
pub fn capitalised(id: &str) -> String {
    let words = id.replace(['_', '-'], " ");
    let mut letters = words.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::duration_text;

    #[test]
    fn durations_read_as_people_say_them() {
        let texts = [0.04, 12.44, 59.94, 59.96, 325.5, 3600.0, 3725.0].map(duration_text);
        let expected = ["0.0 s", "12.4 s", "59.9 s", "1 min 00 s", "5 min 26 s", "1 h 00 min", "1 h 02 min"];
        assert_eq!(texts, expected);
        assert_eq!(duration_text(f64::NAN), "unknown");
    }
}
