//! The curves of a job: a small chart for each number that it tells from step to step.

use egui::{Align2, FontId, Pos2, Rect, Sense, Stroke, Ui, pos2, vec2};

use crate::{screens::controls::file_link_ui, store::Curves, theme::Palette};

const SIZE: egui::Vec2 = vec2(250.0, 130.0);
/// Charts that are drawn before somebody asks for the rest.
const FEW: usize = 6;

/// Draws the `curves` of a job, all of them if `shows_all`.
pub(super) fn curves_ui(ui: &mut Ui, palette: &Palette, job: &str, curves: &Curves, shows_all: &mut bool) {
    let names = curves.names();
    if names.is_empty() {
        return;
    }
    ui.horizontal_wrapped(|ui| {
        ui.strong("Curves");
        file_link_ui(ui, "CSV", "Download the curves", "jobs/{}/metrics.csv", &[job]);
    });
    ui.horizontal_wrapped(|ui| {
        for name in names.iter().take(if *shows_all { usize::MAX } else { FEW }) {
            if let Some(points) = curves.points(name) {
                chart_ui(ui, palette, name, points);
            }
        }
    });
    if names.len() > FEW {
        ui.checkbox(shows_all, format!("All {} curves", names.len()));
    }
}

fn chart_ui(ui: &mut Ui, palette: &Palette, name: &str, points: &[(f64, f64)]) {
    let size = vec2(SIZE.x.min(ui.available_width()), SIZE.y);
    let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
    let (Some(&(first, _)), Some(&(last, newest))) = (points.first(), points.last()) else { return };
    response.widget_info(|| {
        let label = format!("Curve {name}: {} at step {last}", number(newest));
        egui::WidgetInfo::labeled(egui::accesskit::Role::Image, true, label)
    });
    let (low, high) = value_range(points);
    let painter = ui.painter_at(rect);
    let font = FontId::proportional(12.5);
    let title = format!("{name}  {}", number(newest));
    painter.text(rect.left_top() + vec2(2.0, 0.0), Align2::LEFT_TOP, title, font.clone(), palette.real);
    let inner = Rect::from_min_max(rect.min + vec2(46.0, 20.0), rect.max - vec2(8.0, 18.0));
    painter.rect_filled(inner, 0.0, palette.surface);
    painter.rect_stroke(inner, 0.0, Stroke::new(1.0, palette.line), egui::StrokeKind::Outside);
    let share = |value: f64, low: f64, high: f64| {
        if high > low { ((value - low) / (high - low)) as f32 } else { 0.5 }
    };
    let at = |&(step, value): &(f64, f64)| {
        pos2(
            egui::lerp(inner.x_range(), share(step, first, last)),
            egui::lerp(inner.bottom()..=inner.top(), share(value, low, high)),
        )
    };
    let drawn: Vec<Pos2> = points.iter().map(at).collect();
    if let [one] = drawn[..] {
        painter.circle_filled(one, 2.5, palette.calibrated);
    } else {
        painter.line(drawn, Stroke::new(1.6, palette.calibrated));
    }
    for (value, y) in [(high, inner.top()), (low, inner.bottom())] {
        painter.text(
            pos2(inner.left() - 4.0, y),
            Align2::RIGHT_CENTER,
            number(value),
            font.clone(),
            palette.text_weak,
        );
    }
    for (step, x, align) in
        [(first, inner.left(), Align2::LEFT_TOP), (last, inner.right(), Align2::RIGHT_TOP)]
    {
        painter.text(pos2(x, inner.bottom() + 2.0), align, number(step), font.clone(), palette.text_weak);
    }
    if let Some(pointer) = response.hover_pos().filter(|pointer| inner.contains(*pointer)) {
        let distance = |point: &(f64, f64)| (at(point).x - pointer.x).abs();
        if let Some(nearest) = points.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))) {
            painter.circle_filled(at(nearest), 3.5, palette.calibrated);
            response.on_hover_text_at_pointer(format!("step {}: {name} {}", nearest.0, number(nearest.1)));
        }
    }
}

/// What the axis of values spans: the values, or where all are the same, them and zero, or zero to one.
fn value_range(points: &[(f64, f64)]) -> (f64, f64) {
    let low = points.iter().map(|point| point.1).fold(f64::INFINITY, f64::min);
    let high = points.iter().map(|point| point.1).fold(f64::NEG_INFINITY, f64::max);
    match high > low {
        true => (low, high),
        false if low == 0.0 => (0.0, 1.0),
        false => (low.min(0.0), high.max(0.0)),
    }
}

/// About three digits, with a true minus.
fn number(value: f64) -> String {
    let text = match value.abs() {
        0.0 => "0".to_owned(),
        size if !(1e-3..1e6).contains(&size) => format!("{value:.1e}"),
        size if size >= 100.0 || value.fract() == 0.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        _ => format!("{value:.3}"),
    };
    text.replace('-', "\u{2212}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_that_never_changes_has_an_axis_all_the_same() {
        let range =
            |values: &[f64]| value_range(&values.iter().map(|&value| (0.0, value)).collect::<Vec<_>>());
        assert_eq!(range(&[0.5, 2.0, 1.0]), (0.5, 2.0));
        assert_eq!(
            [range(&[1.0, 1.0]), range(&[-3.0]), range(&[0.0, 0.0])],
            [(0.0, 1.0), (-3.0, 0.0), (0.0, 1.0)]
        );
    }

    #[test]
    fn numbers_are_short() {
        let shown = [0.0, 0.25, 12.34, 1234.5, 3.0, -0.5, 2.5e7, 1e-5].map(number);
        let expected = ["0", "0.250", "12.3", "1234", "3", "\u{2212}0.500", "2.5e7", "1.0e\u{2212}5"];
        assert_eq!(shown, expected);
    }
}
