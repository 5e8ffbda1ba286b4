//! The objective as pictures: a heat map over (alpha, lambda_pre) and a curve over lambda_con.

use maud::{Markup, html};
use palpate_reports::{CalibrationReport, Objective, StreamFit, StreamThetaReport, ThetaReport};

use super::tables::significant;

const LEFT: f64 = 64.0;
const TOP: f64 = 8.0;
const WIDTH: f64 = 420.0;
const HEIGHT: f64 = 260.0;
/// Steps between the colours of a heat map.
const COLOURS: usize = 64;

pub(super) fn pictures(report: &CalibrationReport) -> Markup {
    html! {
        div.pictures {
            @for picture in searches(report) {
                @let objective = picture.objective;
                @if !objective.pressure_l1.is_empty() && !objective.lambda_pres_pa.is_empty() { (heat_map(&picture)) }
                @if !objective.lambda_cons_m.is_empty() { (curve(&picture)) }
            }
        }
    }
}

/// One search, to be drawn.
struct Picture<'a> {
    /// Whose channels.
    of: String,
    objective: &'a Objective,
    /// What is marked: the nominal parameters, then the calibrated ones.
    marks: [(&'static str, StreamThetaReport); 2],
}

fn searches(report: &CalibrationReport) -> Vec<Picture<'_>> {
    if report.streams.is_empty() {
        let whole = |theta: &ThetaReport| StreamThetaReport {
            lambda_con_m: Some(theta.lambda_con_m),
            alpha_per_m: Some(theta.alpha_per_m),
            lambda_pre_pa: Some(theta.lambda_pre_pa),
        };
        let marks = [("nominal", whole(&report.nominal_theta)), ("calibrated", whole(&report.theta))];
        return vec![Picture { of: String::new(), objective: &report.objective, marks }];
    }
    let of_stream = |(id, fit)| {
        let StreamFit { theta, nominal_theta, objective }: &StreamFit = fit;
        let marks = [("nominal", *nominal_theta), ("calibrated", *theta)];
        Picture { of: format!(" of stream {id}"), objective, marks }
    };
    report.streams.iter().map(of_stream).collect()
}

fn heat_map(picture: &Picture<'_>) -> Markup {
    let Objective { alphas_per_m, lambda_pres_pa, pressure_l1, .. } = picture.objective;
    let values = || pressure_l1.iter().flatten().copied();
    let (least, most) = (values().min().unwrap_or(0), values().max().unwrap_or(0));
    let shade = |l1: u64| {
        // Logarithmic, so that the valley shows beside a peak of many times its height.
        let log = |l1: u64| ((l1 + 1) as f64).ln();
        if most > least { (log(l1) - log(least)) / (log(most) - log(least)) } else { 0.0 }
    };
    let cell_width = WIDTH / lambda_pres_pa.len() as f64;
    let cell_height = HEIGHT / alphas_per_m.len() as f64;
    let rows = pressure_l1.iter().enumerate().map(|(idx, row)| {
        // Small alphas at the bottom. Cells of one colour are one rectangle.
        let y = TOP + HEIGHT - (idx + 1) as f64 * cell_height;
        let colours: Vec<String> = row.iter().map(|&l1| colour(shade(l1))).collect();
        let mut column = 0;
        let runs = colours.chunk_by(|a, b| a == b).map(|run| {
            let x = LEFT + column as f64 * cell_width;
            column += run.len();
            (tenths(x), tenths(run.len() as f64 * cell_width + 0.3), run[0].clone())
        });
        html! {
            @for (x, width, colour) in runs {
                rect x=(x) y=(tenths(y)) width=(width) height=(tenths(cell_height + 0.3)) fill=(colour) {}
            }
        }
    });
    let ring = |theta: &StreamThetaReport| {
        let column = position_on(lambda_pres_pa, theta.lambda_pre_pa?)?;
        let row = position_on(alphas_per_m, theta.alpha_per_m?)?;
        let (x, y) = (LEFT + (column + 0.5) * cell_width, TOP + HEIGHT - (row + 0.5) * cell_height);
        Some((tenths(x), tenths(y)))
    };
    html! {
        figure {
            svg viewBox=(view_box()) role="img"
                aria-label={ "L1 of the pressure channels" (picture.of) " over alpha and lambda_pre" } {
                @for row in rows { (row) }
                @for (class, theta) in &picture.marks {
                    @if let Some((x, y)) = ring(theta) {
                        circle cx=(x) cy=(y) r="7" fill="none" stroke="#fff" stroke-width="5" {}
                        circle class=(class) cx=(x) cy=(y) r="7" stroke-width="2.5" {}
                    }
                }
                (ends(lambda_pres_pa, "λ_pre, Pa", alphas_per_m, "α, 1/m"))
            }
            figcaption {
                "L1 of the pressure channels" (picture.of) " on the fitted takes: " (least) " (dark) to " (most) " (bright). Rings: "
                "nominal (orange, if in view) and calibrated (blue)."
            }
        }
    }
}

fn curve(picture: &Picture<'_>) -> Markup {
    let Objective { lambda_cons_m, proximity_l1, .. } = picture.objective;
    let (low_m, high_m) = (lambda_cons_m[0], lambda_cons_m[lambda_cons_m.len() - 1]);
    let (least, most) =
        (proximity_l1.iter().min().copied().unwrap_or(0), proximity_l1.iter().max().copied().unwrap_or(0));
    let x_of = |lambda_m: f64| LEFT + WIDTH * (lambda_m - low_m) / (high_m - low_m).max(f64::MIN_POSITIVE);
    let y_of = |l1: u64| TOP + HEIGHT * (1.0 - l1 as f64 / most.max(1) as f64);
    let (bottom, right) = (TOP + HEIGHT, LEFT + WIDTH);
    let points: Vec<String> = lambda_cons_m
        .iter()
        .zip(proximity_l1)
        .map(|(&m, &l1)| format!("{:.1} {:.1}", x_of(m), y_of(l1)))
        .collect();
    let mark = |theta: &StreamThetaReport| {
        let at_m = theta.lambda_con_m.filter(|at_m| (low_m..=high_m).contains(at_m))?;
        Some(format!("M{:.1} {TOP}V{bottom}", x_of(at_m)))
    };
    html! {
        figure {
            svg viewBox=(view_box()) role="img"
                aria-label={ "L1 of the proximity channels" (picture.of) " over lambda_con" } {
                path.axis d=(format!("M{LEFT} {TOP}V{bottom}H{right}")) {}
                @for (class, theta) in &picture.marks {
                    @if let Some(path) = mark(theta) {
                        path class=(class) stroke-width="2" stroke-dasharray="4 3" d=(path) {}
                    }
                }
                path.real stroke-width="1.5" d={ "M" (points.join("L")) } {}
                (ends(&[1e3 * low_m, 1e3 * high_m], "λ_con, mm", &[0.0, most as f64], "L1"))
            }
            figcaption {
                "L1 of the proximity channels" (picture.of) " on the fitted takes; the lowest point shown is " (least) ". Dashed: "
                "nominal (orange) and calibrated (blue)."
            }
        }
    }
}

fn view_box() -> String {
    format!("0 0 {} {}", LEFT + WIDTH + 12.0, TOP + HEIGHT + 34.0)
}

/// A length in the picture.
fn tenths(length: f64) -> String {
    format!("{length:.1}")
}

/// Names of the axes and their first and last values.
fn ends(columns: &[f64], columns_name: &str, rows: &[f64], rows_name: &str) -> Markup {
    let ends = |values: &[f64]| {
        let end = |value: Option<&f64>| value.map(|&value| significant(value)).unwrap_or_default();
        (end(values.first()), end(values.last()))
    };
    let ((left, right), (bottom, top)) = (ends(columns), ends(rows));
    let (bottom_y, right_x) = (TOP + HEIGHT, LEFT + WIDTH);
    let (label_x, label_y) = (LEFT - 6.0, bottom_y + 14.0);
    html! {
        text x=(LEFT) y=(label_y) { (left) }
        text x=(right_x) y=(label_y) text-anchor="end" { (right) }
        text x=(LEFT + WIDTH / 2.0) y=(label_y) text-anchor="middle" { (columns_name) }
        text x=(label_x) y=(bottom_y) text-anchor="end" { (bottom) }
        text x=(label_x) y=(TOP + 10.0) text-anchor="end" { (top) }
        text x=(label_x) y=(TOP + HEIGHT / 2.0) text-anchor="end" { (rows_name) }
    }
}

/// Where `value` lies on an ascending axis, in cells from its first; `None` outside of it.
fn position_on(axis: &[f64], value: f64) -> Option<f64> {
    let above = axis.iter().position(|&at| at >= value)?;
    if above == 0 {
        return (axis[0] == value).then_some(0.0);
    }
    let (low, high) = (axis[above - 1], axis[above]);
    // Axes are even in the logarithm but for a leading zero.
    let share = if low > 0.0 { (value / low).ln() / (high / low).ln() } else { (value - low) / (high - low) };
    Some((above - 1) as f64 + share)
}

/// Of viridis, dark to bright.
fn colour(share: f64) -> String {
    // Steps that the eye cannot tell apart are one colour, which keeps the file small.
    let step = (share.clamp(0.0, 1.0) * COLOURS as f64).round() as usize;
    format!("#{:x}", colorous::VIRIDIS.eval_rational(step, COLOURS + 1))
}
