//! One module per screen, and what they share: the context they get, and their empty, loading and error states.

mod about;
pub mod calibrate;
pub mod control;
pub mod controls;
pub mod copy_as;
pub mod diagnose;
pub mod hand;
pub mod help;
pub mod home;
pub mod jobs;
pub mod models;
pub mod objects;
pub mod plans;
pub mod record;
pub mod run_controls;
pub mod sessions;
pub mod settings;
pub mod timelines;
pub mod trials;

use std::sync::Arc;

pub use about::{About, Subject, View};
pub use help::{help_ui, said_ui, topic_heading_ui, topic_ui};
pub use palpate_reports::wording::words;
use palpate_robot_model::Station;
use palpate_wire::api::SessionSummary;

use crate::{
    playback::Playback,
    route::{Route, Screen},
    store::{Loadable, Store},
    surface::Surface,
    theme::{Palette, is_narrow},
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
        let Some(sessions) = sessions_ui(ui, cx) else { return false };
        let Some(session) = sessions.iter().find(|session| session.error.is_none()) else {
            no_sessions_ui(ui, cx);
            return false;
        };
        cx.playback.session = Some(session.id.clone());
    }
    let Some(session) = cx.playback.session.clone() else { return false };
    let detail = cx.store.session(&session);
    if let Some(take) = cx.playback.take.clone() {
        // A link to what is not there says so, rather than what the server says to programs.
        let known = detail.ready().is_none_or(|detail| detail.takes.iter().any(|known| known.id == take));
        let session_is_missing = detail.error().is_some() && is_missing(cx, &session);
        if known && !session_is_missing {
            return true;
        }
        if !session_is_missing {
            let first = detail.ready().and_then(|detail| detail.takes.first()).map(|take| take.id.clone());
            missing_take_ui(ui, cx, &session, &take, first);
            return false;
        }
    }
    if detail.error().is_some() && is_missing(cx, &session) {
        missing_session_ui(ui, cx, &session);
        return false;
    }
    let [looking, failed] = [format!("Opening session {session}"), format!("Session {session} did not open")];
    let Some(detail) = loaded_ui(ui, cx, detail, &looking, &failed) else { return false };
    let first = detail.takes.iter().find(|take| take.accepted).or(detail.takes.first());
    if let Some(take) = first {
        cx.playback.open(&session, &take.id);
        return true;
    }
    let text = "Record or import takes into it, or choose another session.";
    if empty_ui(ui, &format!("Session {session} holds no takes"), text, "Choose a session") {
        cx.go_to_screen(Screen::Sessions);
    }
    false
}

/// Whether the list of sessions is here and has no `session`.
pub fn is_missing(cx: &mut ScreenContext<'_>, session: &str) -> bool {
    cx.store.sessions().ready().is_some_and(|sessions| sessions.iter().all(|known| known.id != session))
}

/// A link to a session that is not there.
pub fn missing_session_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, session: &str) {
    let text = "It may have been renamed, or moved to the trash; its link is as it was.";
    if empty_ui(ui, &format!("There is no session {session}"), text, "All sessions") {
        cx.playback.session = None;
        cx.playback.take = None;
        *cx.go_to = Some(Route::to(Screen::Sessions));
    }
}

fn missing_take_ui(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    session: &str,
    take: &str,
    first: Option<String>,
) {
    let text = "The session is there; this take is not part of it.";
    let button = first.as_ref().map_or_else(|| "All sessions".to_owned(), |first| format!("Open {first}"));
    if empty_ui(ui, &format!("Session {session} has no take {take}"), text, &button) {
        match first {
            Some(first) => cx.playback.open(session, &first),
            None => *cx.go_to = Some(Route::to(Screen::Sessions)),
        }
    }
}

/// A link to a screen that this version does not have.
pub fn lost_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, slug: &str) {
    let text = "The link may come from another version, or have a slip in it.";
    if empty_ui(ui, &format!("There is no screen \u{201c}{slug}\u{201d}"), text, "Go to Home") {
        *cx.go_to = Some(Route::to(Screen::Home));
    }
}

/// What the server said, without the half sentence that tells programs which route to ask.
pub fn for_people(error: &str) -> &str {
    error.split_once("; GET /api/").map_or(error, |(said, _)| said)
}

/// One half of a screen that has a list or a form, and what was chosen with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The list or the form.
    Choice,
    /// What was chosen.
    Chosen,
}

/// Width of the list or form on a wide page.
const CHOICE_WIDTH: f32 = 292.0;

/// The two halves beside each other; on a narrow page one at a time, with tabs called `names`. There the second one
/// comes up when `chosen` changes, because something was chosen.
pub fn two_parts_ui(
    ui: &mut egui::Ui,
    id: &str,
    names: [&str; 2],
    chosen: Option<&str>,
    mut part_ui: impl FnMut(&mut egui::Ui, Part),
) {
    if !is_narrow(ui.ctx()) {
        egui::Panel::left(id.to_owned()).resizable(false).exact_size(CHOICE_WIDTH).show(ui, |ui| {
            egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| part_ui(ui, Part::Choice));
        });
        egui::CentralPanel::default().show(ui, |ui| part_ui(ui, Part::Chosen));
        return;
    }
    let key = egui::Id::unique(id).with("shown part");
    let known: Option<(Option<String>, Part)> = ui.data(|data| data.get_temp(key));
    let chosen = chosen.map(str::to_owned);
    let mut part = match known {
        Some((before, part)) if before == chosen => part,
        _ if chosen.is_some() => Part::Chosen,
        _ => Part::Choice,
    };
    ui.horizontal(|ui| {
        for (value, name) in [Part::Choice, Part::Chosen].into_iter().zip(names) {
            let response = ui.selectable_label(part == value, egui::RichText::new(name).size(16.0));
            response.widget_info(|| {
                egui::WidgetInfo::selected(egui::accesskit::Role::RadioButton, true, part == value, name)
            });
            if response.clicked() {
                part = value;
            }
        }
    });
    ui.data_mut(|data| data.insert_temp(key, (chosen, part)));
    ui.separator();
    match part {
        Part::Choice => {
            egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| part_ui(ui, part));
        }
        Part::Chosen => part_ui(ui, part),
    }
}

fn no_sessions_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let text = "A session is a set of takes: recordings of the hand touching a known object. \
        Replay, comparison and calibration all start from one.";
    if empty_ui(ui, "No session yet", text, "Bring in a session") {
        cx.go_to_screen(Screen::Sessions);
    }
}

/// A heading, for those who do not see that it is large too.
pub fn heading_ui(ui: &mut egui::Ui, text: impl Into<egui::RichText>) -> egui::Response {
    let text = text.into();
    let words = text.text().to_owned();
    let response = ui.label(text.heading());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Heading, true, &words));
    response
}

/// A line that screen readers speak when it comes up or changes: at once if it is `urgent`.
pub fn announced_ui(ui: &mut egui::Ui, text: impl Into<egui::RichText>, urgent: bool) -> egui::Response {
    let text = text.into();
    let words = text.text().to_owned();
    let response = ui.label(text);
    announce(&response, &words, urgent);
    response
}

/// As [`announced_ui`], for a label that is there already.
pub fn announce(response: &egui::Response, words: &str, urgent: bool) {
    use egui::accesskit::Role;
    let role = if urgent { Role::Alert } else { Role::Status };
    response.widget_info(|| egui::WidgetInfo::labeled(role, true, words));
}

/// An empty state: what this is for, and the one button that fills it. True when the button was pressed.
pub fn empty_ui(ui: &mut egui::Ui, title: &str, text: &str, button: &str) -> bool {
    centered(ui, |ui| {
        heading_ui(ui, title);
        said_ui(ui, text);
        ui.add_space(8.0);
        ui.button(button).clicked()
    })
}

/// Something is on its way: what.
pub fn loading_ui(ui: &mut egui::Ui, what: &str) {
    centered(ui, |ui| {
        ui.spinner();
        announced_ui(ui, format!("{what}\u{2026}"), false);
    });
}

/// What was asked for, if it is here; if not, the screen says that it is `looking` for it or that `failed`.
pub fn loaded_ui<T>(
    ui: &mut egui::Ui,
    cx: &mut ScreenContext<'_>,
    wanted: Loadable<T>,
    looking: &str,
    failed: &str,
) -> Option<T> {
    match wanted {
        Loadable::Ready(value) => return Some(value),
        Loadable::Failed(error) => failed_ui(ui, cx, failed, &error),
        Loadable::Idle | Loadable::Loading => loading_ui(ui, looking),
    }
    None
}

/// The list of sessions, if it is here; else the screen says why not.
pub fn sessions_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) -> Option<Arc<Vec<SessionSummary>>> {
    let sessions = cx.store.sessions();
    loaded_ui(ui, cx, sessions, "Looking for sessions", "The list of sessions did not arrive")
}

/// Something did not come: what, why, and a way to try again.
pub fn failed_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, what: &str, why: &str) {
    let mismatch = cx.palette.mismatch;
    let again = centered(ui, |ui| {
        heading_ui(ui, egui::RichText::new(format!("\u{26a0} {what}")).color(mismatch));
        said_ui(ui, for_people(why));
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

/// What people call the channel `id` of `station`; the id itself where the station does not know it.
pub fn channel_label(station: Option<&Station>, id: &str) -> String {
    let known = station.and_then(|station| {
        let channel = station.layout.channels.iter().position(|channel| channel.id == id)?;
        Some(station.layout.channel_label(channel))
    });
    known.unwrap_or_else(|| id.to_owned())
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
    as_sentence(&id.replace(['_', '-'], " "))
}

/// `text` with a capital at its beginning.
pub fn as_sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::{duration_text, for_people};

    #[test]
    fn routes_are_not_for_people() {
        let said = "no session \"nope\"; GET /api/v1/sessions lists them";
        assert_eq!(for_people(said), "no session \"nope\"");
        assert_eq!(
            for_people("take-02: 3 readings missing; import it again"),
            "take-02: 3 readings missing; import it again"
        );
    }

    #[test]
    fn durations_read_as_people_say_them() {
        let texts = [0.04, 12.44, 59.94, 59.96, 325.5, 3600.0, 3725.0].map(duration_text);
        let expected = ["0.0 s", "12.4 s", "59.9 s", "1 min 00 s", "5 min 26 s", "1 h 00 min", "1 h 02 min"];
        assert_eq!(texts, expected);
        assert_eq!(duration_text(f64::NAN), "unknown");
    }
}
