//! Reserves STOP's place before anything else is laid out, and paints STOP after everything else.
//!
//! A press on its place is read from the input itself, at the beginning of a frame. Nothing that lies on the page can take
//! that press away, and nothing that is drawn in the frame delays it.

use egui::{Align2, FontId, Id, Order, Rect, Sense, accesskit::Role, pos2, vec2};

use super::StudioApp;
use crate::theme::{NARROW, Palette};

/// Accessible name of STOP.
pub(crate) const STOP_NAME: &str = "STOP (software)";
/// Height of the bar on a wide page that commands a station: two rows.
pub(super) const WIDE_BAR: f32 = 86.0;
/// Height of the bar on a narrow page that commands a station.
pub(super) const NARROW_BAR: f32 = 58.0;
/// Size of STOP on a wide and on a narrow page; touch targets want 44 points at least.
const WIDE_STOP: egui::Vec2 = vec2(132.0, 76.0);
const NARROW_STOP: egui::Vec2 = vec2(92.0, 48.0);
/// From STOP to the edges of the window, and to what is beside it.
pub(super) const GAP: f32 = 8.0;
const TOP_GAP: f32 = 5.0;

/// Where STOP is in a window of `screen`.
pub(super) fn stop_rect(screen: Rect) -> Rect {
    let size = if screen.width() < NARROW { NARROW_STOP } else { WIDE_STOP };
    let right_top = pos2(screen.right() - GAP, screen.top() + TOP_GAP);
    Rect::from_min_size(pos2(right_top.x - size.x, right_top.y), size)
}

/// Whether a pointer, or any finger, came down on STOP in this frame.
pub(super) fn is_pressed(ctx: &egui::Context) -> bool {
    let rect = stop_rect(ctx.content_rect());
    ctx.input(|input| {
        input.events.iter().any(|event| match event {
            egui::Event::PointerButton {
                pos, button: egui::PointerButton::Primary, pressed: true, ..
            } => rect.contains(*pos),
            // A second finger is no pointer: the first one may hold a jog button down.
            egui::Event::Touch { phase: egui::TouchPhase::Start, pos, .. } => rect.contains(*pos),
            _ => false,
        })
    })
}

impl StudioApp {
    /// Paints STOP over everything, dialogs and tooltips included. It acts when it is pressed (see [`is_pressed`]), not
    /// when it is let go; here only a key or a screen reader can still press it.
    pub(super) fn stop_ui(&mut self, ctx: &egui::Context) {
        let palette = Palette::of(ctx.theme());
        let rect = stop_rect(ctx.content_rect());
        let area = egui::Area::new(Id::unique("stop"))
            .order(Order::Debug)
            .fixed_pos(rect.min)
            .default_size(rect.size())
            .constrain(false)
            .movable(false)
            .sense(Sense::hover())
            .fade_in(false);
        area.show(ctx, |ui| {
            // Neither red nor yellow: ISO 13850 keeps these for stops that work without software and cannot be carried
            // away.
            let button = egui::Button::new("").fill(palette.real).corner_radius(8.0);
            let response = ui.put(rect, button);
            response.widget_info(|| egui::WidgetInfo::labeled(Role::Button, true, STOP_NAME));
            let center = rect.center();
            let line = |below: f32, text: &str, size: f32| {
                let (at, font) = (center + vec2(0.0, below), FontId::proportional(size));
                ui.painter().text(at, Align2::CENTER_CENTER, text, font, palette.surface);
            };
            if rect.height() < WIDE_STOP.y {
                line(0.0, "STOP", 24.0);
            } else {
                line(-9.0, "STOP", 26.0);
                line(17.0, "(software)", 15.0);
            }
            // A click that no pointer ended came from a key or from a screen reader.
            let released = ui.input(|input| input.pointer.primary_released());
            if response.clicked() && !released {
                self.store.control.stop();
            }
            response.on_hover_text(
                "Stops every motor by software, from any page. Space does the same while armed. It does not replace a \
                 switch that cuts the power.",
            );
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stop_fits_every_window_and_can_be_hit() {
        for width in 320..1920 {
            let screen = Rect::from_min_size(pos2(0.0, 0.0), vec2(width as f32, 400.0));
            let rect = stop_rect(screen);
            assert!(screen.contains_rect(rect) && rect.width() >= 44.0 && rect.height() >= 44.0, "{width}");
            let bar = if (width as f32) < NARROW { NARROW_BAR } else { WIDE_BAR };
            assert!(rect.bottom() <= bar, "{width}: it stays in the bar");
        }
    }
}
