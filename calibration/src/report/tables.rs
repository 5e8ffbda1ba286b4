//! Tables of figures.

use maud::{Markup, html};
use palpate_reports::{CalibrationReport, MetricIntervals, Metrics, StreamFit};

use super::metric_texts;

const HEADS: [&str; 6] =
    ["Onset error, ms", "Offset error, ms", "Activation F1", "False positive rate, %", "L1", "Coverage, %"];

const NOTHING: &str = "–";

pub(super) fn milliseconds(value: Option<f64>) -> String {
    value.map_or_else(|| NOTHING.to_owned(), |ms| format!("{ms:.0}"))
}

pub(super) fn share(value: Option<f64>) -> String {
    value.map_or_else(|| NOTHING.to_owned(), |share| format!("{share:.3}"))
}

pub(super) fn percent(value: Option<f64>) -> String {
    value.map_or_else(|| NOTHING.to_owned(), |share| format!("{:.2}", 100.0 * share))
}

/// Both models on held-out takes and on all takes, with intervals.
pub(super) fn summary(report: &CalibrationReport) -> Markup {
    let has_held_out = !report.held_out_takes.is_empty();
    let of = if report.held_out_takes.len() >= 2 { "the held-out takes" } else { "all takes" };
    html! {
        div.scroll { table {
            thead { tr {
                th {}
                @for head in HEADS { th { (head) } }
                th { "Contacts, real / simulated" }
            } }
            tbody {
                @if has_held_out {
                    (row("held-out takes, nominal", "was", &report.held_out.nominal))
                    (row("held-out takes, calibrated", "now", &report.held_out.calibrated))
                }
                (row("all takes, nominal", "was", &report.nominal))
                (row("all takes, calibrated", "now", &report.calibrated))
                @if let Some(intervals) = &report.intervals_95 {
                    (interval_row("95 % interval, nominal", &intervals.nominal))
                    (interval_row("95 % interval, calibrated", &intervals.calibrated))
                    (interval_row("95 % interval, change", &intervals.change))
                }
            }
        } }
        @if report.intervals_95.is_some() { p.caption { "Intervals are over " (of) "." } }
    }
}

fn row(label: &str, class: &str, metrics: &Metrics) -> Markup {
    html! {
        tr {
            td class=(class) { (label) }
            @for text in metric_texts(metrics) { td { (text) } }
            td { (metrics.real_contacts) " / " (metrics.simulated_contacts) }
        }
    }
}

fn interval_row(label: &str, interval: &MetricIntervals) -> Markup {
    let scaled = [
        (interval.onset_error_ms, 1.0, 0),
        (interval.offset_error_ms, 1.0, 0),
        (interval.f1, 1.0, 3),
        (interval.fpr, 100.0, 2),
    ];
    let text = |(interval, scale, digits): (Option<[f64; 2]>, f64, usize)| match interval {
        Some([low, high]) => format!("{:.digits$} to {:.digits$}", scale * low, scale * high),
        None => NOTHING.to_owned(),
    };
    html! {
        tr.interval {
            td { (label) }
            @for one in scaled { td { (text(one)) } }
            td {} td {} td {}
        }
    }
}

/// One row for each label: nominal and calibrated.
pub(super) fn pairs<'a>(
    kind: &str,
    rows: impl Iterator<Item = (String, &'a Metrics, &'a Metrics)>,
) -> Markup {
    html! {
        div.scroll { table {
            thead { tr {
                th { (kind) }
                @for head in HEADS { th { (head) } }
            } }
            tbody {
                @for (label, nominal, calibrated) in rows {
                    tr {
                        td { (label) }
                        @for (before, after) in metric_texts(nominal).iter().zip(metric_texts(calibrated)) {
                            (change(before, &after))
                        }
                    }
                }
            }
        } }
    }
}

/// A cell: a number, nominal and calibrated.
fn change(before: &str, after: &str) -> Markup {
    html! { td { span.was { (before) } " → " span.now { (after) } } }
}

/// theta before and after; of every stream where each has its own.
pub(super) fn parameters(report: &CalibrationReport) -> Markup {
    if !report.streams.is_empty() {
        return streams(report);
    }
    let (before, after) = (&report.nominal_theta, &report.theta);
    let rows = [
        (
            "λ_con, mm",
            "a proximity patch is active if a surface node is nearer to the object than this",
            1e3 * before.lambda_con_m,
            1e3 * after.lambda_con_m,
        ),
        ("α, 1/m", "decay of pressure along the elastomer", before.alpha_per_m, after.alpha_per_m),
        (
            "λ_pre, Pa",
            "a taxel is active if its propagated pressure is above this",
            before.lambda_pre_pa,
            after.lambda_pre_pa,
        ),
    ];
    html! {
        div.scroll { table {
            thead { tr { th { "Parameter" } th.text { "Meaning" } th { "Nominal" } th { "Calibrated" } } }
            tbody {
                @for (name, meaning, before, after) in rows {
                    tr {
                        td { (name) }
                        td.text { (meaning) }
                        td.was { (significant(before)) }
                        td.now { (significant(after)) }
                    }
                }
            }
        } }
    }
}

fn streams(report: &CalibrationReport) -> Markup {
    let pairs_of = |StreamFit { theta, nominal_theta, .. }: &StreamFit| {
        [
            (nominal_theta.lambda_con_m.map(|m| 1e3 * m), theta.lambda_con_m.map(|m| 1e3 * m)),
            (nominal_theta.alpha_per_m, theta.alpha_per_m),
            (nominal_theta.lambda_pre_pa, theta.lambda_pre_pa),
        ]
    };
    html! {
        div.scroll { table {
            thead { tr { th { "Stream" } th { "λ_con, mm" } th { "α, 1/m" } th { "λ_pre, Pa" } } }
            tbody {
                @for (id, fit) in &report.streams {
                    tr {
                        td { (id) }
                        @for pair in pairs_of(fit) {
                            @if let (Some(before), Some(after)) = pair {
                                (change(&significant(before), &significant(after)))
                            } @else {
                                td { (NOTHING) }
                            }
                        }
                    }
                }
            }
        } }
    }
}

/// Four significant digits.
pub(super) fn significant(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let magnitude = value.abs().log10().floor();
    if !(-4.0..7.0).contains(&magnitude) {
        return format!("{value:.3e}");
    }
    let digits = (3 - magnitude as i32).max(0) as usize;
    format!("{value:.digits$}")
}
