//! The objective as pictures: a heat map over (alpha, lambda_pre) and a curve over lambda_con, optima marked.

use egui::{Align2, Color32, FontId, Pos2, Rect, Sense, Stroke, Ui, pos2, vec2};
use palpate_reports::{CalibrationReport, Objective, StreamThetaReport, ThetaReport};

use crate::theme::{Palette, taxel_scale};

const LEFT: f32 = 58.0;
const BOTTOM: f32 = 40.0;
const TOP: f32 = 44.0;
const RIGHT: f32 = 14.0;

pub(super) fn objective_ui(ui: &mut Ui, palette: &Palette, report: &CalibrationReport) {
    let width = ((ui.available_width() - 24.0) / 2.0).clamp(260.0, 620.0);
    let size = vec2(width, 236.0);
    ui.horizontal_wrapped(|ui| {
        if report.streams.is_empty() {
            let of = Picture {
                of: String::new(),
                objective: &report.objective,
                nominal: whole(&report.nominal_theta),
                theta: whole(&report.theta),
            };
            heat_map_ui(ui, palette, &of, size);
            curve_ui(ui, palette, &of, size);
        }
        for (id, fit) in &report.streams {
            let of = Picture {
                of: format!(", {id}"),
                objective: &fit.objective,
                nominal: fit.nominal_theta,
                theta: fit.theta,
            };
            // A stream has one kind of sensor, and so one of the pictures.
            match fit.theta.lambda_con_m {
                Some(_) => curve_ui(ui, palette, &of, size),
                None => heat_map_ui(ui, palette, &of, size),
            }
        }
    });
}

/// A search to draw: of all channels, or of a stream that has its own theta.
struct Picture<'a> {
    /// What follows the titles: whose channels.
    of: String,
    objective: &'a Objective,
    nominal: StreamThetaReport,
    theta: StreamThetaReport,
}

fn whole(theta: &ThetaReport) -> StreamThetaReport {
    StreamThetaReport {
        lambda_con_m: Some(theta.lambda_con_m),
        alpha_per_m: Some(theta.alpha_per_m),
        lambda_pre_pa: Some(theta.lambda_pre_pa),
    }
}

fn frame(
    ui: &mut Ui,
    palette: &Palette,
    size: egui::Vec2,
    title: &str,
) -> (Rect, egui::Response, egui::Painter) {
    let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
    let painter = ui.painter_at(rect);
    painter.text(
        rect.left_top() + vec2(2.0, 0.0),
        Align2::LEFT_TOP,
        title,
        FontId::proportional(14.0),
        palette.real,
    );
    let inner = Rect::from_min_max(rect.min + vec2(LEFT, TOP), rect.max - vec2(RIGHT, BOTTOM));
    (inner, response, painter)
}

fn empty(painter: &egui::Painter, palette: &Palette, inner: Rect, text: &str) {
    painter.rect_stroke(inner, 0.0, Stroke::new(1.0, palette.line), egui::StrokeKind::Inside);
    painter.text(inner.center(), Align2::CENTER_CENTER, text, FontId::proportional(13.5), palette.text_weak);
}

fn heat_map_ui(ui: &mut Ui, palette: &Palette, picture: &Picture<'_>, size: egui::Vec2) {
    let Picture { of, objective, nominal, theta } = picture;
    let of_theta =
        |theta: &StreamThetaReport| [theta.alpha_per_m, theta.lambda_pre_pa].map(Option::unwrap_or_default);
    let ([nominal_alpha, nominal_lambda], [alpha, lambda]) = (of_theta(nominal), of_theta(theta));
    let (alphas, lambdas) = (&objective.alphas_per_m, &objective.lambda_pres_pa);
    let title = format!("Pressure mismatch{of} (bright is better)");
    let (inner, response, painter) = frame(ui, palette, size, &title);
    let name = format!(
        "Objective over alpha and lambda_pre{of}; optimum at alpha {alpha:.0} per m, lambda_pre {lambda:.0} Pa"
    );
    response.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Image, true, &name));
    let cells = objective.pressure_l1.iter().flatten();
    let (Some(&low), Some(&high)) = (cells.clone().min(), cells.max()) else {
        return empty(&painter, palette, inner, "This layout has no pressure taxels.");
    };
    let (num_rows, num_columns) = (alphas.len(), lambdas.len());
    let cell_size = vec2(inner.width() / num_columns as f32, inner.height() / num_rows as f32);
    let cell_rect = |row: usize, column: usize| {
        // Small alphas below, as on any axis.
        let min =
            pos2(inner.left() + column as f32 * cell_size.x, inner.bottom() - (row + 1) as f32 * cell_size.y);
        Rect::from_min_size(min, cell_size)
    };
    let span = (high - low).max(1) as f32;
    for (row, values) in objective.pressure_l1.iter().enumerate() {
        for (column, &l1) in values.iter().enumerate() {
            // The interesting valley is narrow: the root spreads the colours over it.
            let share = 1.0 - ((l1 - low) as f32 / span).sqrt();
            painter.rect_filled(cell_rect(row, column).expand(0.4), 0.0, taxel_scale(share));
        }
    }
    let at = |alpha: f64, lambda: f64| {
        let row = fractional_index(alphas, alpha) as f32 + 0.5;
        let column = fractional_index(lambdas, lambda) as f32 + 0.5;
        pos2(inner.left() + column * cell_size.x, inner.bottom() - row * cell_size.y)
    };
    let (nominal_at, optimum_at) = (at(nominal_alpha, nominal_lambda), at(alpha, lambda));
    // Names stand away from each other, however near the marks are.
    let optimum_above = optimum_at.y <= nominal_at.y;
    mark(&painter, nominal_at, palette.nominal, "nominal", inner, !optimum_above);
    mark(&painter, optimum_at, palette.calibrated, "optimum", inner, optimum_above);

    x_axis(&painter, palette, inner, "\u{3bb}pre, kPa", &axis_ends(lambdas, 1e-3));
    y_axis(&painter, palette, inner, "\u{3b1}, 1/m", &axis_ends(alphas, 1.0));
    if let Some(pointer) = response.hover_pos().filter(|pointer| inner.contains(*pointer)) {
        let column = (((pointer.x - inner.left()) / cell_size.x) as usize).min(num_columns - 1);
        let row = (((inner.bottom() - pointer.y) / cell_size.y) as usize).min(num_rows - 1);
        painter.rect_stroke(
            cell_rect(row, column),
            0.0,
            Stroke::new(1.5, Color32::WHITE),
            egui::StrokeKind::Inside,
        );
        let l1 = objective.pressure_l1.get(row).and_then(|values| values.get(column)).copied().unwrap_or(0);
        response.on_hover_text_at_pointer(format!(
            "\u{3b1} {} /m, \u{3bb}pre {} kPa: {l1} channel-frames differ",
            number(alphas[row]),
            number(lambdas[column] * 1e-3)
        ));
    }
}

fn curve_ui(ui: &mut Ui, palette: &Palette, picture: &Picture<'_>, size: egui::Vec2) {
    let Picture { of, objective, nominal, theta } = picture;
    let [nominal_m, optimum_m] = [nominal, theta].map(|theta| theta.lambda_con_m.unwrap_or_default());
    let (lambdas, values) = (&objective.lambda_cons_m, &objective.proximity_l1);
    let title = format!("Proximity mismatch{of}");
    let (inner, response, painter) = frame(ui, palette, size, &title);
    let name = format!("Objective over lambda_con{of}; optimum at {:.2} mm", optimum_m * 1e3);
    response.widget_info(|| egui::WidgetInfo::labeled(egui::accesskit::Role::Image, true, &name));
    let (Some(&high), Some(&first), Some(&last)) = (values.iter().max(), lambdas.first(), lambdas.last())
    else {
        return empty(&painter, palette, inner, "This layout has no proximity patches.");
    };
    painter.rect_filled(inner, 0.0, palette.surface);
    let x_of = |lambda: f64| {
        let share = if last > first { (lambda - first) / (last - first) } else { 0.5 };
        egui::lerp(inner.x_range(), share.clamp(0.0, 1.0) as f32)
    };
    let y_of = |l1: u64| inner.bottom() - inner.height() * (l1 as f32 / high.max(1) as f32) * 0.95;
    let points: Vec<Pos2> = lambdas.iter().zip(values).map(|(&x, &l1)| pos2(x_of(x), y_of(l1))).collect();
    painter.line(points, Stroke::new(1.8, palette.real));
    for (lambda, colour, text) in
        [(nominal_m, palette.nominal, "nominal"), (optimum_m, palette.calibrated, "optimum")]
    {
        let x = x_of(lambda);
        painter.vline(x, inner.y_range(), Stroke::new(1.5, colour));
        let align = if x > inner.center().x { Align2::RIGHT_TOP } else { Align2::LEFT_TOP };
        let offset = if x > inner.center().x { -4.0 } else { 4.0 };
        let y = if text == "optimum" { inner.top() + 18.0 } else { inner.top() + 2.0 };
        let colour = palette.text_of(colour);
        painter.text(pos2(x + offset, y), align, text, FontId::proportional(13.0), colour);
    }
    painter.rect_stroke(inner, 0.0, Stroke::new(1.0, palette.line), egui::StrokeKind::Outside);
    x_axis(&painter, palette, inner, "\u{3bb}con, mm", &axis_ends(lambdas, 1e3));
    let y_ends = [(0.0, "0".to_owned()), (0.95, high.to_string())];
    y_axis(&painter, palette, inner, "channel-frames", &y_ends);
    if let Some(pointer) = response.hover_pos().filter(|pointer| inner.contains(*pointer)) {
        let nearest = lambdas
            .iter()
            .zip(values)
            .min_by(|(a, _), (b, _)| (x_of(**a) - pointer.x).abs().total_cmp(&(x_of(**b) - pointer.x).abs()));
        if let Some((&lambda, &l1)) = nearest {
            painter.circle_filled(pos2(x_of(lambda), y_of(l1)), 4.0, palette.calibrated);
            response.on_hover_text_at_pointer(format!(
                "\u{3bb}con {:.2} mm: {l1} channel-frames differ",
                lambda * 1e3
            ));
        }
    }
}

fn mark(painter: &egui::Painter, at: Pos2, colour: Color32, text: &str, inner: Rect, above: bool) {
    let at = inner.clamp(at);
    painter.circle(at, 6.0, Color32::WHITE, Stroke::new(3.0, colour));
    let galley = painter.layout_no_wrap(text.to_owned(), FontId::proportional(13.0), Color32::WHITE);
    // A name that has no room on its side goes to the other one: it must not cover its mark.
    let reach = 15.0 + galley.size().y;
    let above = if above { at.y - reach > inner.top() } else { at.y + reach > inner.bottom() };
    let (align, offset_y) = if above { (Align2::CENTER_BOTTOM, -11.0) } else { (Align2::CENTER_TOP, 11.0) };
    let text_rect = align.anchor_size(at + vec2(0.0, offset_y), galley.size());
    // At the edge of the map the name moves inward.
    let room = inner.shrink(4.0);
    let inward =
        (room.min - text_rect.min).max(vec2(0.0, 0.0)) + (room.max - text_rect.max).min(vec2(0.0, 0.0));
    let text_rect = text_rect.translate(inward);
    painter.rect_filled(text_rect.expand(3.0), 3.0, Color32::from_black_alpha(170));
    painter.galley(text_rect.min, galley, Color32::WHITE);
}

/// First, middle and last value of an axis, at the centres of their cells, with their texts.
fn axis_ends(values: &[f64], factor: f64) -> Vec<(f32, String)> {
    let len = values.len().max(1) as f32;
    [0, values.len() / 2, values.len().saturating_sub(1)]
        .into_iter()
        .filter_map(|idx| Some(((idx as f32 + 0.5) / len, number(values.get(idx)? * factor))))
        .collect()
}

/// About three digits: `0.36`, `42.2`, `409`, with a true minus.
pub(super) fn number(value: f64) -> String {
    let text = match value.abs() {
        0.0 => "0".to_owned(),
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    };
    text.replace('-', "\u{2212}")
}

fn x_axis(painter: &egui::Painter, palette: &Palette, inner: Rect, title: &str, ticks: &[(f32, String)]) {
    let font = FontId::proportional(13.0);
    for (share, text) in ticks {
        let at = pos2(egui::lerp(inner.x_range(), *share), inner.bottom() + 3.0);
        painter.text(at, Align2::CENTER_TOP, text, font.clone(), palette.text_weak);
    }
    let at = pos2(inner.center().x, inner.bottom() + 20.0);
    painter.text(at, Align2::CENTER_TOP, title, font, palette.real);
}

fn y_axis(painter: &egui::Painter, palette: &Palette, inner: Rect, title: &str, ticks: &[(f32, String)]) {
    let font = FontId::proportional(13.0);
    for (share, text) in ticks {
        let at = pos2(inner.left() - 5.0, egui::lerp(inner.bottom()..=inner.top(), *share));
        painter.text(at, Align2::RIGHT_CENTER, text, font.clone(), palette.text_weak);
    }
    let at = pos2(inner.left() - LEFT + 2.0, inner.top() - 21.0);
    painter.text(at, Align2::LEFT_TOP, title, font, palette.real);
}

/// Where `value` lies among ascending `values`, as an index with a fraction; clamped to the ends.
fn fractional_index(values: &[f64], value: f64) -> f64 {
    let upper = values.partition_point(|&v| v < value);
    if upper == 0 {
        return 0.0;
    }
    let Some(&above) = values.get(upper) else { return (values.len() - 1) as f64 };
    let below = values[upper - 1];
    (upper - 1) as f64 + if above > below { (value - below) / (above - below) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::fractional_index;

    #[test]
    fn marks_fall_between_the_cells_they_belong_to() {
        let values = [0.0, 10.0, 40.0];
        let found = [-5.0, 0.0, 5.0, 10.0, 25.0, 40.0, 99.0].map(|v| fractional_index(&values, v));
        assert_eq!(found, [0.0, 0.0, 0.5, 1.0, 1.5, 2.0, 2.0]);
    }
}
