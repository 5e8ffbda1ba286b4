//! The safety layer in words, signs and colours.

use egui::{Color32, Rect, Sense, Stroke, Vec2};
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

/// A mark for the same, painted: state is never colour alone.
pub fn phase_mark_ui(ui: &mut egui::Ui, phase: Phase, color: Color32) {
    let (rect, _) = ui.allocate_exact_size(Vec2::splat(16.0), Sense::hover());
    let (painter, center) = (ui.painter(), rect.center());
    match phase {
        Phase::Unspecified | Phase::Disarmed => {
            painter.circle_stroke(center, 6.0, Stroke::new(2.0, color));
        }
        Phase::Arming | Phase::Disarming => {
            painter.circle_stroke(center, 6.0, Stroke::new(2.0, color));
            painter.circle_filled(center, 3.0, color);
        }
        Phase::Armed => {
            painter.circle_filled(center, 7.0, color);
        }
        Phase::Holding => {
            for x in [-4.0, 4.0] {
                let bar = Rect::from_center_size(center + Vec2::new(x, 0.0), Vec2::new(4.0, 13.0));
                painter.rect_filled(bar, 0.0, color);
            }
        }
        Phase::Stopped => {
            painter.rect_filled(Rect::from_center_size(center, Vec2::splat(13.0)), 0.0, color);
        }
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
