//! What lies over the screens: the list of shortcuts and the command palette. `Esc` closes either.

use egui::{Key, RichText};

use crate::{commands::Command, theme::Palette};

/// Which overlay is open, and what was chosen in it.
#[derive(Debug, Default)]
pub(super) struct Overlays {
    shortcuts_open: bool,
    palette: Option<PaletteState>,
    chosen: Option<Command>,
}

#[derive(Debug, Default)]
struct PaletteState {
    words: String,
    marked_idx: usize,
    has_focus: bool,
}

impl Overlays {
    pub(super) fn palette_is_open(&self) -> bool {
        self.palette.is_some()
    }

    pub(super) fn toggle_shortcuts(&mut self) {
        self.shortcuts_open = !self.shortcuts_open;
    }

    pub(super) fn open_palette(&mut self) {
        self.shortcuts_open = false;
        self.palette = Some(PaletteState::default());
    }

    /// What was chosen in the palette since the last call.
    pub(super) fn take_chosen(&mut self) -> Option<Command> {
        self.chosen.take()
    }

    pub(super) fn ui(&mut self, ctx: &egui::Context) {
        if self.shortcuts_open {
            self.shortcuts_ui(ctx);
        }
        if self.palette.is_some() {
            self.palette_ui(ctx);
        }
    }

    fn shortcuts_ui(&mut self, ctx: &egui::Context) {
        let palette = Palette::of(ctx.theme());
        let modal = egui::Modal::new(egui::Id::unique("shortcuts")).show(ctx, |ui| {
            ui.set_width(420.0);
            ui.heading("Keyboard shortcuts");
            ui.add_space(6.0);
            // Rows to read, not to hit: all of them must fit into 800 points.
            ui.spacing_mut().interact_size.y = 20.0;
            let list = egui::Grid::new("shortcut list").num_columns(2).spacing([24.0, 5.0]).striped(true);
            list.show(ui, |ui| {
                for command in Command::ALL {
                    ui.label(RichText::new(command.shortcut_text()).monospace().strong());
                    ui.label(command.label());
                    ui.end_row();
                }
                for (keys, what) in GESTURES {
                    ui.label(RichText::new(keys).color(palette.text_weak));
                    ui.label(what);
                    ui.end_row();
                }
            });
            ui.add_space(6.0);
            ui.add(egui::Button::new("Close shortcuts").min_size(egui::vec2(0.0, 32.0))).clicked()
        });
        if modal.should_close() || modal.inner {
            self.shortcuts_open = false;
        }
    }

    fn palette_ui(&mut self, ctx: &egui::Context) {
        let Some(state) = &mut self.palette else { return };
        let mut chosen = None;
        let modal = egui::Modal::new(egui::Id::unique("palette")).show(ctx, |ui| {
            ui.set_width(440.0);
            let (up, down, enter) = ui.input_mut(|input| {
                (
                    input.consume_key(egui::Modifiers::NONE, Key::ArrowUp),
                    input.consume_key(egui::Modifiers::NONE, Key::ArrowDown),
                    input.consume_key(egui::Modifiers::NONE, Key::Enter),
                )
            });
            let field = ui
                .add(
                    egui::TextEdit::singleline(&mut state.words)
                        .hint_text("Type a command")
                        .desired_width(f32::INFINITY)
                        .min_size(egui::vec2(0.0, 32.0)),
                )
                .accessible_name("Command");
            if !state.has_focus {
                state.has_focus = true;
                field.request_focus();
            }
            if field.changed() {
                state.marked_idx = 0;
            }
            let found: Vec<Command> = Command::ALL
                .into_iter()
                .filter(|command| *command != Command::Palette && command.matches(&state.words))
                .collect();
            if found.is_empty() {
                ui.label("No command has these words. Delete a word to see more.");
            }
            let last_idx = found.len().saturating_sub(1);
            state.marked_idx = (state.marked_idx + usize::from(down)).min(last_idx);
            state.marked_idx = state.marked_idx.saturating_sub(usize::from(up));
            for (idx, command) in found.iter().enumerate() {
                let button = egui::Button::selectable(idx == state.marked_idx, command.label())
                    .min_size(egui::vec2(ui.available_width(), 32.0))
                    .right_text(command.shortcut_text());
                let response = ui.add(button);
                response.widget_info(|| {
                    let marked = idx == state.marked_idx;
                    egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, marked, command.label())
                });
                if response.clicked() || (enter && idx == state.marked_idx) {
                    chosen = Some(*command);
                }
            }
        });
        if chosen.is_some() || modal.should_close() {
            self.palette = None;
            self.chosen = chosen;
            ctx.request_repaint();
        }
    }
}

/// What the mouse does on the timelines and on the hand.
const GESTURES: [(&str, &str); 5] = [
    ("Wheel", "Zoom at the pointer"),
    ("Drag", "Move the view"),
    ("Click", "Put the cursor there"),
    ("Double click", "Show the whole take, or reset the view"),
    ("Esc", "Close what is open"),
];
