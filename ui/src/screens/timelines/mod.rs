//! Timelines: real and simulated touch on one time axis.

use super::{ScreenContext, ensure_take_ui};
use crate::commands::Command;

/// What the screen keeps from frame to frame.
#[derive(Debug, Default)]
pub struct TimelinesState {
    commands: Vec<Command>,
}

impl TimelinesState {
    /// Leaves a command for the screen's next frame.
    pub fn push_command(&mut self, command: Command) {
        self.commands.push(command);
    }
}

/// The screen.
pub fn timelines_ui(ui: &mut egui::Ui, cx: &mut ScreenContext<'_>, state: &mut TimelinesState) {
    state.commands.clear();
    if !ensure_take_ui(ui, cx) {
        return;
    }
    ui.label(format!("{:.3} s", cx.playback.time_s));
}
