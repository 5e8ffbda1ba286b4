//! The safety layer in words, signs and colours.

use egui::Color32;
use palpate_wire::proto::{ControlState, control_state::Phase, device_status::Link};

use crate::theme::Palette;

/// A phase in one word.
pub fn phase_word(phase: Phase) -> &'static str {
    match phase {
        Phase::Unspecified => "UNKNOWN",
        Phase::Disarmed => "DISARMED",
        Phase::Arming => "ARMING",
        Phase::Armed => "ARMED",
        Phase::Holding => "HOLDING",
        Phase::Disarming => "DISARMING",
        Phase::Stopped => "STOPPED",
    }
}

/// A sign for the same: state is never colour alone.
pub fn phase_sign(phase: Phase) -> &'static str {
    match phase {
        Phase::Unspecified => "?",
        Phase::Disarmed => "\u{25cb}",
        Phase::Arming | Phase::Disarming => "\u{25d0}",
        Phase::Armed => "\u{25cf}",
        Phase::Holding => "\u{23f8}",
        Phase::Stopped => "\u{25a0}",
    }
}

/// Its colour: what can move wants a look, what stopped is wrong.
pub fn phase_color(phase: Phase, palette: &Palette) -> Color32 {
    match phase {
        Phase::Unspecified | Phase::Disarmed => palette.text_weak,
        Phase::Arming | Phase::Armed | Phase::Holding | Phase::Disarming => palette.warning,
        Phase::Stopped => palette.mismatch,
    }
}

/// Whether telemetry shows that a stop came through.
pub fn stop_word(state: &ControlState) -> &'static str {
    if state.stop_confirmed { "confirmed: no motor moves" } else { "not confirmed yet" }
}

/// A device's connection in words, with its colour.
pub fn link_word(link: Link, palette: &Palette) -> (&'static str, Color32) {
    match link {
        Link::Unspecified => ("unknown", palette.text_weak),
        Link::Connecting => ("connecting", palette.warning),
        Link::Ready => ("ready", palette.diagnosed),
        Link::Fault => ("fault", palette.mismatch),
        Link::Lost => ("lost", palette.mismatch),
    }
}
