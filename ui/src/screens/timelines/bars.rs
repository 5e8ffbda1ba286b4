//! Events as bars on a time axis, no more of them than there are pixels.

use egui::{Color32, Rangef, Rect, Shape, Stroke, StrokeKind};

use super::events::{Event, decimate};

/// Where the axis is, and what of the time it shows.
pub(super) struct Bars {
    /// From its left to its right end, points.
    pub(super) plot: Rangef,
    /// What time these ends are, s.
    pub(super) view_s: [f64; 2],
    pub(super) pixels_per_point: f32,
}

impl Bars {
    /// One for each run of pixels in which `events` are.
    pub(super) fn rects(&self, events: &[Event], y: Rangef) -> impl Iterator<Item = Rect> {
        let width_px = (self.plot.span() * self.pixels_per_point).round() as u32;
        let (left, pixels_per_point) = (self.plot.min, self.pixels_per_point);
        decimate(events, self.view_s, width_px).into_iter().map(move |span| {
            let x = |px: u32| left + px as f32 / pixels_per_point;
            Rect::from_x_y_ranges(x(span.x0)..=x(span.x1), y)
        })
    }

    pub(super) fn filled(&self, events: &[Event], y: Rangef, colour: Color32, shapes: &mut Vec<Shape>) {
        shapes.extend(self.rects(events, y).map(|rect| Shape::rect_filled(rect, 0.0, colour)));
    }

    pub(super) fn hollow(&self, events: &[Event], y: Rangef, colour: Color32, shapes: &mut Vec<Shape>) {
        let stroke = Stroke::new(1.0, colour);
        let rects = self.rects(events, y);
        shapes.extend(rects.map(|rect| Shape::rect_stroke(rect, 0.0, stroke, StrokeKind::Inside)));
    }
}
