//! What lies over the screens besides Help: the list of shortcuts and the palette. `Esc` closes each.

use std::borrow::Cow;

use egui::{Align2, Key, RichText, Vec2};

use super::stop;
use crate::{commands::Command, route::Route, screens::heading_ui, theme::Palette};

/// A dialog at most `width` wide below the bar: it scrolls rather than reach over STOP.
pub(super) fn dialog<R>(
    ctx: &egui::Context,
    id: &str,
    width: f32,
    contents: impl FnOnce(&mut egui::Ui) -> R,
) -> egui::ModalResponse<R> {
    modal(ctx, id, width, |ui, height| {
        egui::ScrollArea::vertical().max_height(height).show(ui, contents).inner
    })
}

/// A dialog at most `width` wide below the bar, whose contents keep to the height that they are given. It hangs from its
/// top, because a window of another size has not told its height yet when it is opened again, and its middle would be
/// elsewhere.
pub(super) fn modal<R>(
    ctx: &egui::Context,
    id: &str,
    width: f32,
    contents: impl FnOnce(&mut egui::Ui, f32) -> R,
) -> egui::ModalResponse<R> {
    let screen = ctx.content_rect();
    let below = screen.with_min_y(stop::stop_rect(screen).bottom() + stop::GAP);
    let id = egui::Id::unique(id);
    let area = egui::Modal::default_area(id).anchor(Align2::CENTER_TOP, Vec2::ZERO).constrain_to(below);
    egui::Modal::new(id).area(area).show(ctx, |ui| {
        // Less the frame's margins.
        ui.set_width(width.min(below.width() - 24.0));
        contents(ui, below.height() - 24.0)
    })
}

/// Which overlay is open, and what was chosen in it.
#[derive(Debug, Default)]
pub(super) struct Overlays {
    shortcuts_open: bool,
    palette: Option<PaletteState>,
    chosen: Option<Command>,
    place: Option<Route>,
}

/// Something that the palette finds besides commands: a session, take, model or run, and where it is looked at.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Place {
    /// In words.
    pub(super) label: String,
    /// Where.
    pub(super) route: Route,
}

impl Place {
    fn matches(&self, words: &str) -> bool {
        let label = self.label.to_lowercase();
        words.to_lowercase().split_whitespace().all(|word| label.contains(word))
    }
}

/// So many places are listed; whoever looks for another types one more letter.
const MAX_PLACES: usize = 40;

/// A line of the palette.
enum Found<'a> {
    Command(Command),
    Place(&'a Place),
}

impl Found<'_> {
    fn label(&self) -> Cow<'_, str> {
        match self {
            Self::Command(command) => command.label(),
            Self::Place(place) => Cow::Borrowed(&place.label),
        }
    }

    fn shortcut_text(&self) -> String {
        match self {
            Self::Command(command) => command.shortcut_text(),
            Self::Place(_) => String::new(),
        }
    }
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

    pub(super) fn close_shortcuts(&mut self) {
        self.shortcuts_open = false;
    }

    pub(super) fn open_palette(&mut self) {
        self.shortcuts_open = false;
        self.palette = Some(PaletteState::default());
    }

    /// What was chosen in the palette since the last call.
    pub(super) fn take_chosen(&mut self) -> Option<Command> {
        self.chosen.take()
    }

    /// The place that was chosen in the palette since the last call.
    pub(super) fn take_place(&mut self) -> Option<Route> {
        self.place.take()
    }

    pub(super) fn ui(&mut self, ctx: &egui::Context, commandable: bool, places: &[Place]) {
        if self.shortcuts_open {
            self.shortcuts_ui(ctx, commandable);
        }
        if self.palette.is_some() {
            self.palette_ui(ctx, commandable, places);
        }
    }

    fn shortcuts_ui(&mut self, ctx: &egui::Context, commandable: bool) {
        let palette = Palette::of(ctx.theme());
        let modal = dialog(ctx, "shortcuts", 1180.0, |ui| {
            // At the top, so that it is on the screen however long the lists are.
            let closed = ui
                .horizontal(|ui| {
                    heading_ui(ui, "Keyboard shortcuts");
                    ui.add(egui::Button::new("Close shortcuts").min_size(egui::vec2(0.0, 32.0))).clicked()
                })
                .inner;
            ui.add_space(6.0);
            let one_row = ui.available_width() >= 1100.0;
            let layout = if one_row {
                egui::Layout::left_to_right(egui::Align::Min)
            } else {
                egui::Layout::top_down(egui::Align::Min)
            };
            ui.with_layout(layout, |ui| {
                // Rows to read, not to hit: all of them must fit into 800 points.
                ui.spacing_mut().interact_size.y = 20.0;
                ui.vertical(|ui| {
                    let commands = Command::all()
                        .filter(|command| command.shortcut().is_some() && command.is_offered(commandable))
                        .map(|command| (command.shortcut_text(), command.label().into_owned()));
                    list_ui(ui, &palette, "Everywhere", commands.chain(pairs(&EVERYWHERE)));
                });
                ui.add_space(28.0);
                ui.vertical(|ui| {
                    list_ui(ui, &palette, "Hand", pairs(&ON_HAND));
                    ui.add_space(8.0);
                    list_ui(ui, &palette, "Timelines", pairs(&ON_TIMELINES));
                });
                ui.add_space(28.0);
                ui.vertical(|ui| {
                    if commandable {
                        list_ui(ui, &palette, "Record", pairs(&ON_RECORD));
                        ui.add_space(8.0);
                    }
                    list_ui(ui, &palette, "Calibrate, Diagnose, Sessions", pairs(&ON_OTHERS));
                });
            });
            closed
        });
        if modal.should_close() || modal.inner {
            self.shortcuts_open = false;
        }
    }

    fn palette_ui(&mut self, ctx: &egui::Context, commandable: bool, places: &[Place]) {
        let Some(state) = &mut self.palette else { return };
        let (mut chosen, mut place) = (None, None);
        let modal = dialog(ctx, "palette", 520.0, |ui| {
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
                        .hint_text("A screen, session, take, model, run or command")
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
            let commands = Command::all().filter(|command| {
                *command != Command::Palette
                    && command.is_offered(commandable)
                    && command.matches(&state.words)
            });
            // All commands fit on a list to look through; all takes would not.
            let typed = !state.words.trim().is_empty();
            let places = places.iter().filter(|place| typed && place.matches(&state.words)).take(MAX_PLACES);
            let found: Vec<Found<'_>> =
                commands.map(Found::Command).chain(places.map(Found::Place)).collect();
            if found.is_empty() {
                ui.label("Nothing has these words. Delete a word to see more.");
            }
            let last_idx = found.len().saturating_sub(1);
            state.marked_idx = (state.marked_idx + usize::from(down)).min(last_idx);
            state.marked_idx = state.marked_idx.saturating_sub(usize::from(up));
            // The field stays in sight while the list scrolls.
            let height =
                (ctx.content_rect().height() * 0.6).min(ctx.content_rect().height() - 170.0).max(96.0);
            egui::ScrollArea::vertical().id_salt("commands").max_height(height).show(ui, |ui| {
                for (idx, line) in found.iter().enumerate() {
                    let button = egui::Button::selectable(idx == state.marked_idx, line.label())
                        .truncate()
                        .min_size(egui::vec2(ui.available_width(), 32.0))
                        .right_text(line.shortcut_text());
                    let response = ui.add(button);
                    response.widget_info(|| {
                        let marked = idx == state.marked_idx;
                        egui::WidgetInfo::selected(egui::accesskit::Role::Button, true, marked, line.label())
                    });
                    if (up || down) && idx == state.marked_idx {
                        response.scroll_to_me(None);
                    }
                    if response.clicked() || (enter && idx == state.marked_idx) {
                        match line {
                            Found::Command(command) => chosen = Some(*command),
                            Found::Place(found) => place = Some(found.route.clone()),
                        }
                    }
                }
            });
        });
        if chosen.is_some() || place.is_some() || modal.should_close() {
            self.palette = None;
            self.chosen = chosen;
            self.place = place;
            ctx.request_repaint();
        }
    }
}

/// A titled list of keys and what they do.
fn list_ui(ui: &mut egui::Ui, palette: &Palette, title: &str, rows: impl Iterator<Item = (String, String)>) {
    ui.label(RichText::new(title).color(palette.text_weak));
    egui::Grid::new(title).num_columns(2).min_col_width(96.0).spacing([20.0, 4.0]).show(ui, |ui| {
        for (keys, what) in rows {
            ui.label(RichText::new(keys).monospace().strong());
            ui.label(what);
            ui.end_row();
        }
    });
}

fn pairs<'a>(rows: &'a [(&str, &str)]) -> impl Iterator<Item = (String, String)> + use<'a> {
    rows.iter().map(|(keys, what)| ((*keys).to_owned(), (*what).to_owned()))
}

const EVERYWHERE: [(&str, &str); 2] = [("Tab", "Next control"), ("Esc", "Close what is open")];

const ON_RECORD: [(&str, &str); 9] = [
    ("Enter", "The large button: go on, accept"),
    ("Up, Down", "Another take of the checklist"),
    ("P", "The fixture holds the object, or not"),
    ("G, B", "Go to the start pose; begin from here"),
    ("Esc", "Cancel the motion; what was recorded stays"),
    ("R", "Record the take again"),
    ("Delete, U", "Discard the take; undo that"),
    ("M", "Mark this moment of the take"),
    ("N", "Write a remark"),
];

const ON_HAND: [(&str, &str); 8] = [
    ("R, double click", "Reset the view"),
    ("1 to 9", "Named views, in the order of their buttons"),
    ("Drag", "Turn the view"),
    ("Shift+drag", "Move it; the right button does too"),
    ("Wheel", "Zoom"),
    ("Arrows, + and -", "Turn and zoom once the view has the focus"),
    ("Click a taxel", "Keep it in the side panel; again lets it go"),
    ("Ctrl+click", "Pick several taxels for the timelines"),
];

const ON_TIMELINES: [(&str, &str); 7] = [
    ("Wheel", "Zoom at the pointer; over the names, scroll"),
    ("Shift+wheel, drag", "Move in time"),
    ("Click", "Put the cursor there"),
    ("Drag the ruler", "Move the cursor"),
    ("Double click", "Show the whole take"),
    ("Click a name", "Keep the channel in the side panel of Hand"),
    ("[ and ]", "Jump among the channels shown"),
];

const ON_OTHERS: [(&str, &str); 2] =
    [("Click a row", "Open the take or channel on Timelines"), ("Drop a zip", "Import it as a session")];
