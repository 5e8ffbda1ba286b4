//! What can be done from the keyboard: one table for the shortcuts, the list under `?` and the command palette.

use std::borrow::Cow;

use egui::{Key, KeyboardShortcut, Modifiers};

use crate::route::Screen;

/// Something that the operator can do from anywhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Open a screen.
    Open(Screen),
    /// Stop every motor, in software.
    Stop,
    /// End a latched stop.
    ResetStop,
    /// Ask for the lease.
    TakeControl,
    /// Give the lease back.
    GiveBackControl,
    /// Torque on.
    Arm,
    /// Torque off.
    Disarm,
    /// What the taxels read now is their zero.
    Tare,
    /// Play, or pause.
    PlayPause,
    /// One joint frame back.
    PreviousFrame,
    /// One joint frame on.
    NextFrame,
    /// Jump to the mismatch before the cursor.
    PreviousMismatch,
    /// Jump to the mismatch after the cursor.
    NextMismatch,
    /// Show the whole take.
    FitTake,
    /// The take before.
    PreviousTake,
    /// The take after.
    NextTake,
    /// Light or dark.
    ToggleTheme,
    /// The list of shortcuts.
    Shortcuts,
    /// The manual, and what words mean.
    Help,
    /// The address of what is on the screen, to the clipboard.
    CopyLink,
    /// Keeps a picture of what is on the screen.
    SavePicture,
    /// The command palette.
    Palette,
}

impl Command {
    /// Every command, in the order of the palette.
    pub fn all() -> impl Iterator<Item = Self> + Clone {
        Screen::ALL.iter().copied().map(Self::Open).chain(Self::OTHERS)
    }

    /// Those that open no screen.
    const OTHERS: [Self; 21] = [
        Self::Stop,
        Self::ResetStop,
        Self::TakeControl,
        Self::GiveBackControl,
        Self::Arm,
        Self::Disarm,
        Self::Tare,
        Self::PlayPause,
        Self::PreviousFrame,
        Self::NextFrame,
        Self::PreviousMismatch,
        Self::NextMismatch,
        Self::FitTake,
        Self::PreviousTake,
        Self::NextTake,
        Self::ToggleTheme,
        Self::Shortcuts,
        Self::Help,
        Self::CopyLink,
        Self::SavePicture,
        Self::Palette,
    ];

    /// What it does, in words.
    pub fn label(self) -> Cow<'static, str> {
        Cow::Borrowed(match self {
            Self::Open(screen) => return format!("Go to {}", screen.label()).into(),
            Self::Stop => "STOP (software)",
            Self::ResetStop => "Reset stop",
            Self::TakeControl => "Take control",
            Self::GiveBackControl => "Give back control",
            Self::Arm => "Arm",
            Self::Disarm => "Disarm",
            Self::Tare => "Set zero of touch",
            Self::PlayPause => "Play or pause",
            Self::PreviousFrame => "One frame back",
            Self::NextFrame => "One frame on",
            Self::PreviousMismatch => "Previous mismatch",
            Self::NextMismatch => "Next mismatch",
            Self::FitTake => "Show the whole take",
            Self::PreviousTake => "Previous take",
            Self::NextTake => "Next take",
            Self::ToggleTheme => "Light or dark theme",
            Self::Shortcuts => "Show keyboard shortcuts",
            Self::Help => "Help: documents and what words mean",
            Self::CopyLink => "Copy link",
            Self::SavePicture => "Save picture of the screen",
            Self::Palette => "Find a command",
        })
    }

    /// Whether it means anything here: what concerns a live station is left out where there is none.
    pub fn is_offered(self, commandable: bool) -> bool {
        match self {
            Self::Open(screen) => screen.is_offered(commandable),
            Self::Stop
            | Self::ResetStop
            | Self::TakeControl
            | Self::GiveBackControl
            | Self::Arm
            | Self::Disarm
            | Self::Tare => commandable,
            _ => true,
        }
    }

    /// Its keys; `None` for what is better not done by a slip of the hand.
    pub fn shortcut(self) -> Option<KeyboardShortcut> {
        let plain = |key| Some(KeyboardShortcut::new(Modifiers::NONE, key));
        let alt = |key| Some(KeyboardShortcut::new(Modifiers::ALT, key));
        match self {
            Self::Open(screen) => alt(screen.about().key?),
            // The space bar means one of the two at any moment: see `pressed`.
            Self::Stop | Self::PlayPause => plain(Key::Space),
            Self::ResetStop
            | Self::TakeControl
            | Self::GiveBackControl
            | Self::Arm
            | Self::Disarm
            | Self::Tare
            | Self::CopyLink
            | Self::SavePicture => None,
            Self::PreviousFrame => plain(Key::Comma),
            Self::NextFrame => plain(Key::Period),
            Self::PreviousMismatch => plain(Key::OpenBracket),
            Self::NextMismatch => plain(Key::CloseBracket),
            Self::FitTake => plain(Key::F),
            Self::PreviousTake => plain(Key::PageUp),
            Self::NextTake => plain(Key::PageDown),
            Self::ToggleTheme => plain(Key::T),
            Self::Shortcuts => plain(Key::Questionmark),
            Self::Help => plain(Key::F1),
            Self::Palette => Some(KeyboardShortcut::new(Modifiers::COMMAND, Key::K)),
        }
    }

    /// Its keys in words, e.g. `Ctrl+K`; empty for none.
    pub fn shortcut_text(self) -> String {
        let Some(shortcut) = self.shortcut() else { return String::new() };
        let key = match shortcut.logical_key {
            Key::Space if self == Self::Stop => "Space while armed",
            Key::Space => "Space",
            Key::Questionmark => "?",
            key => key.symbol_or_name(),
        };
        if shortcut.modifiers.command {
            format!("Ctrl+{key}")
        } else if shortcut.modifiers.alt {
            format!("Alt+{key}")
        } else {
            key.to_owned()
        }
    }

    /// The stop of the space bar, while it `stops`: when motors have torque. It comes before everything, a focused button
    /// included; only a text field keeps its spaces.
    pub fn stop_pressed(ctx: &egui::Context, stops: bool) -> bool {
        let typing = ctx.text_edit_focused();
        stops
            && !typing
            && ctx.input_mut(|input| {
                // Whatever else is held: a hand that reaches for the space bar may rest on Shift.
                let pressed = input.key_pressed(Key::Space);
                input.events.retain(|event| !matches!(event, egui::Event::Key { key: Key::Space, .. }));
                pressed
            })
    }

    /// The commands whose keys were pressed in this frame. Plain keys belong to a text field while one has the focus, and to
    /// Help while it is open and somebody `reads`.
    pub fn pressed(ctx: &egui::Context, commandable: bool, reads: bool) -> Vec<Self> {
        let typing = ctx.text_edit_focused();
        // A focused button takes the space bar for itself.
        let focused = ctx.memory(|memory| memory.focused().is_some());
        ctx.input_mut(|input| {
            Self::all()
                .filter(|command| *command != Self::Stop && command.is_offered(commandable))
                .filter(|command| {
                    let Some(shortcut) = command.shortcut() else { return false };
                    let is_help = shortcut.logical_key == Key::F1;
                    let taken =
                        reads || (typing && !is_help) || (focused && shortcut.logical_key == Key::Space);
                    if taken && shortcut.modifiers.is_none() {
                        return false;
                    }
                    if *command == Self::Shortcuts {
                        // `?` needs shift on many layouts, and some report it as text only.
                        return input
                            .events
                            .iter()
                            .any(|event| matches!(event, egui::Event::Text(text) if text.as_str() == "?"))
                            || input.key_pressed(Key::Questionmark);
                    }
                    input.consume_shortcut(&shortcut)
                })
                .collect()
        })
    }

    /// Whether `words` (any order, any case) all occur in the command's label.
    pub fn matches(self, words: &str) -> bool {
        let label = self.label().to_lowercase();
        words.to_lowercase().split_whitespace().all(|word| label.contains(word))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_commands_share_keys_or_words() {
        for (idx, command) in Command::all().enumerate() {
            for other in Command::all().skip(idx + 1) {
                let space = [other, command] == [Command::PlayPause, Command::Stop];
                let shared = command.shortcut().is_some() && command.shortcut() == other.shortcut();
                assert!(!shared || space, "{command:?} {other:?}");
                assert_ne!(command.label(), other.label());
                assert!(
                    shared
                        || command.shortcut_text() != other.shortcut_text()
                        || command.shortcut().is_none()
                );
            }
        }
    }

    #[test]
    fn without_a_station_nothing_moves() {
        let left: Vec<_> = Command::all().filter(|command| !command.is_offered(false)).collect();
        assert!(left.contains(&Command::Stop) && left.contains(&Command::Open(Screen::Record)));
        assert!(Command::all().all(|command| command.is_offered(true)));
    }

    #[test]
    fn palette_finds_by_any_words() {
        let found: Vec<_> = Command::all().filter(|command| command.matches("MISM next")).collect();
        assert_eq!(found, [Command::NextMismatch]);
        assert!(Command::all().all(|command| command.matches("  ")));
    }
}
