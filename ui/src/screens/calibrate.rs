//! Calibrate: choose, run, see, keep.

use super::{ScreenContext, failed_ui, loading_ui};
use crate::store::Loadable;

/// The screen.
pub fn calibrate_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    match cx.store.runs() {
        Loadable::Ready(runs) => {
            ui.heading("Calibration runs");
            if runs.is_empty() {
                ui.label("No run yet. `palpate calibrate` fits the sensor model to a session.");
            }
            for run in runs.iter() {
                ui.label(format!("{}: {} ({})", run.id, run.request.session, run.stage));
            }
        }
        Loadable::Failed(error) => failed_ui(ui, cx, "The calibration runs did not arrive", &error),
        Loadable::Idle | Loadable::Loading => loading_ui(ui, "Looking for calibration runs"),
    }
}
