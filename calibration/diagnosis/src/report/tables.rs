//! Tables of figures.

use maud::{Markup, html};
use palpate_reports::{Cell, DiagnosisReport, Metrics, NamedEffect, wording};

pub(super) fn cells(cells: &[Cell]) -> Markup {
    html! {
        div.scroll { table {
            thead { tr {
                th.text { "Where" } th { "Share of the excess" } th { "Effect size" } th { "Against chance" }
            } }
            tbody {
                @for cell in cells {
                    tr {
                        td.text { (wording::cell(cell)) }
                        td { (wording::percent(cell.excess)) }
                        td { (wording::number(cell.effect_size)) }
                        td { (wording::p_value(cell.p_value)) }
                    }
                }
            }
        } }
    }
}

pub(super) fn effect(effect: &NamedEffect) -> Markup {
    let mut rows = vec![("Effect".to_owned(), wording::effect_at(&effect.id, &effect.place))];
    for (name, &value) in &effect.parameters {
        let interval = effect.interval.get(name).map_or_else(String::new, |&interval| {
            format!(" (95 % interval {})", wording::range(name, interval))
        });
        rows.push((wording::parameter_name(name), format!("{}{interval}", wording::quantity(name, value))));
    }
    rows.push(("Takes that it improves".to_owned(), effect.takes_improved.replace('/', " of ")));
    let gap = format!("{} → {}", wording::number(effect.gap_before), wording::number(effect.gap_after));
    rows.push(("Gap on the judging takes".to_owned(), gap));
    for rival in &effect.rivals {
        let (name, gap) = (wording::effect_at(&rival.id, &rival.place), wording::number(rival.gap_after));
        rows.push(("Instead of it".to_owned(), format!("{name}: gap {gap}")));
    }
    html! {
        div.scroll { table { tbody {
            @for (name, value) in rows { tr { td { (name) } td.text { (value) } } }
        } } }
    }
}

/// Event metrics on confirm takes; nothing without any.
pub(super) fn metrics(report: &DiagnosisReport) -> Markup {
    let texts = |metrics: &Metrics| {
        let Metrics { onset_error_ms, offset_error_ms, f1, fpr, onset_coverage, .. } = *metrics;
        let text = |value: Option<f64>, factor: f64, digits: usize| {
            value.map_or_else(|| "–".to_owned(), |value| format!("{:.digits$}", value * factor))
        };
        [
            text(onset_error_ms, 1.0, 0),
            text(offset_error_ms, 1.0, 0),
            text(f1, 1.0, 3),
            text(fpr, 100.0, 2),
            text(onset_coverage, 100.0, 0),
        ]
    };
    let models = ["nominal", "calibrated", "diagnosed"];
    let rows = models.into_iter().filter_map(|name| Some((name, report.metrics.get(name)?)));
    html! {
        @if !report.metrics.is_empty() {
            div.scroll { table {
                thead { tr {
                    th { "On the judging takes" } th { "Onset error, ms" } th { "Offset error, ms" } th { "Activation F1" }
                    th { "False positive rate, %" } th { "Coverage, %" }
                } }
                tbody {
                    @for (name, metrics) in rows {
                        tr {
                            td class={ "is-" (name) } { (name) }
                            @for text in texts(metrics) { td { (text) } }
                        }
                    }
                }
            } }
        }
    }
}
