//! Sessions: what has been recorded, and whether it can be used.

use super::{ScreenContext, duration_text, failed_ui, loading_ui};
use crate::{route::Screen, store::Loadable};

/// The screen.
pub fn sessions_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    let sessions = match cx.store.sessions() {
        Loadable::Ready(sessions) => sessions,
        Loadable::Failed(error) => return failed_ui(ui, cx, "The list of sessions did not arrive", &error),
        Loadable::Idle | Loadable::Loading => return loading_ui(ui, "Looking for sessions"),
    };
    ui.heading("Sessions");
    if sessions.is_empty() {
        ui.label("No session yet. `palpate emulate` and `palpate import` make one.");
    }
    for session in sessions.iter() {
        ui.horizontal(|ui| {
            if ui.button(format!("Open {}", session.id)).clicked() {
                cx.playback.session = Some(session.id.clone());
                cx.playback.take = None;
                cx.go_to_screen(Screen::Timelines);
            }
            ui.label(format!("{} takes, {}", session.takes, duration_text(session.duration_s)));
        });
    }
}
