//! Bringing in a session: a zip that is chosen or dropped on the page.

use egui::RichText;

use crate::{
    route::{Route, Screen},
    screens::{PickedFile, ScreenContext},
    store::Loadable,
};

/// Names of sessions have at most so many letters, as those that Record gives.
const MAX_NAME: usize = 60;

/// A file on its way in.
#[derive(Debug, Default)]
pub(super) struct ImportState {
    /// Whether an answer to an import is expected.
    waits: bool,
    /// Why a dropped or chosen file was not sent.
    refused: Option<String>,
}

/// Sends what was dropped on the page or chosen in the file dialog.
pub(super) fn take_picked_files(cx: &mut ScreenContext<'_>, state: &mut ImportState) {
    let chosen: Vec<PickedFile> = cx.picked_files.drain(..).collect();
    for PickedFile { name, bytes } in chosen {
        match session_name(&name) {
            Some(session) if session.chars().count() > MAX_NAME => {
                state.refused = Some(format!(
                    "{name:?} was not sent: a session is named after its file, in at most {MAX_NAME} letters. Give the \
                     file a shorter name."
                ));
            }
            Some(session) if !bytes.is_empty() => {
                state.refused = None;
                state.waits = true;
                cx.store.import(session, bytes);
            }
            _ => {
                state.refused =
                    Some(format!("{name:?} was not sent: choose a .zip of a folder of takes (CSV or MCAP)."));
            }
        }
    }
    if state.waits
        && let Loadable::Ready(session) = &cx.store.imported
    {
        state.waits = false;
        let id = session.summary.id.clone();
        cx.playback.open_session(&id);
        *cx.go_to = Some(Route::to(Screen::Sessions).with_session(id));
    }
}

/// The session's name from the archive's: `sphere takes.zip` gives `sphere takes`.
fn session_name(file_name: &str) -> Option<&str> {
    let stem = file_name.strip_suffix(".zip").or_else(|| file_name.strip_suffix(".ZIP"))?;
    (!stem.is_empty()).then_some(stem)
}

pub(super) fn import_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut ImportState) {
    let palette = cx.palette;
    let hovering = ui.ctx().input(|input| !input.raw.hovered_files.is_empty());
    let stroke = egui::Stroke::new(
        if hovering { 2.5 } else { 1.0 },
        if hovering { palette.calibrated } else { palette.line },
    );
    egui::Frame::group(ui.style()).stroke(stroke).show(ui, |ui| {
        ui.set_width(ui.available_width() - 8.0);
        ui.label(RichText::new("Import").strong());
        ui.label("Drop a .zip here, or choose one. It holds a folder a take, with joints.csv, one CSV a tactile stream and take.toml, or a recorded session.");
        let busy = cx.store.imported.is_loading() && state.waits;
        if ui.add_enabled(!busy, egui::Button::new("Choose a zip")).clicked() {
            *cx.pick_file = true;
        }
        if busy {
            ui.horizontal(|ui| {
                ui.spinner();
                ui.label("Importing and checking\u{2026}");
            });
        }
        if let Some(refused) = &state.refused {
            ui.colored_label(palette.mismatch, refused);
        }
        if let Loadable::Failed(error) = &cx.store.imported {
            ui.colored_label(palette.mismatch, format!("Not imported, nothing was kept: {error}"));
        }
    });
}

#[cfg(test)]
mod tests {
    use super::session_name;

    #[test]
    fn session_is_named_after_the_archive() {
        assert_eq!(session_name("sphere takes.zip"), Some("sphere takes"));
        assert_eq!(session_name("take.csv"), None);
        assert_eq!(session_name(".zip"), None);
    }
}
