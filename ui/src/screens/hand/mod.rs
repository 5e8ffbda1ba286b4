//! Hand: the take at the cursor.

use super::{ScreenContext, ensure_take_ui};

/// The screen.
pub fn hand_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>) {
    if !ensure_take_ui(ui, cx) {
        return;
    }
    ui.label(format!("{:.3} s", cx.playback.time_s));
}
