//! Tables of figures.

use std::fmt::{self, Write as _};

use palpate_calibration::report::Escaped;
use palpate_reports::{Cell, DiagnosisReport, Metrics, NamedEffect, wording};

pub(super) fn write_cells(page: &mut String, cells: &[Cell]) -> fmt::Result {
    page.push_str(
        "<div class=\"scroll\"><table>\n<thead><tr><th class=\"text\">Where</th><th>Share of the excess</th><th>Effect size</th>\
         <th>Against chance</th></tr></thead>\n<tbody>\n",
    );
    for cell in cells {
        writeln!(
            page,
            "<tr><td class=\"text\">{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            Escaped(&wording::cell(cell)),
            wording::percent(cell.excess),
            wording::number(cell.effect_size),
            Escaped(&wording::p_value(cell.p_value))
        )?;
    }
    page.push_str("</tbody>\n</table></div>\n");
    Ok(())
}

pub(super) fn write_effect(page: &mut String, effect: &NamedEffect) -> fmt::Result {
    page.push_str("<div class=\"scroll\"><table>\n<tbody>\n");
    let mut row = |name: &str, value: &str| {
        writeln!(page, "<tr><td>{}</td><td class=\"text\">{}</td></tr>", Escaped(name), Escaped(value))
    };
    row("Effect", &wording::effect_at(&effect.id, &effect.place))?;
    for (name, &value) in &effect.parameters {
        let interval = effect.interval.get(name).map_or_else(String::new, |&interval| {
            format!(" (95 % interval {})", wording::range(name, interval))
        });
        let value = format!("{}{interval}", wording::quantity(name, value));
        row(&wording::parameter_name(name), &value)?;
    }
    row("Takes that it improves", &effect.takes_improved.replace('/', " of "))?;
    let gap = format!("{} → {}", wording::number(effect.gap_before), wording::number(effect.gap_after));
    row("Gap on the judging takes", &gap)?;
    for rival in &effect.rivals {
        let text = format!(
            "{}: gap {}",
            wording::effect_at(&rival.id, &rival.place),
            wording::number(rival.gap_after)
        );
        row("Instead of it", &text)?;
    }
    page.push_str("</tbody>\n</table></div>\n");
    Ok(())
}

/// Event metrics on confirm takes.
pub(super) fn write_metrics(page: &mut String, report: &DiagnosisReport) -> fmt::Result {
    if report.metrics.is_empty() {
        return Ok(());
    }
    page.push_str(
        "<div class=\"scroll\"><table>\n<thead><tr><th>On the judging takes</th><th>Onset error, ms</th>\
         <th>Offset error, ms</th><th>Activation F1</th><th>False positive rate, %</th><th>Coverage, %</th></tr></thead>\n\
         <tbody>\n",
    );
    for name in ["nominal", "calibrated", "diagnosed"] {
        let Some(metrics) = report.metrics.get(name) else { continue };
        let Metrics { onset_error_ms, offset_error_ms, f1, fpr, onset_coverage, .. } = metrics;
        let text = |value: &Option<f64>, factor: f64, digits: usize| {
            value.map_or_else(|| "–".to_owned(), |value| format!("{:.digits$}", value * factor))
        };
        writeln!(
            page,
            "<tr><td class=\"is-{name}\">{name}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            text(onset_error_ms, 1.0, 0),
            text(offset_error_ms, 1.0, 0),
            text(f1, 1.0, 3),
            text(fpr, 100.0, 2),
            text(onset_coverage, 100.0, 0)
        )?;
    }
    page.push_str("</tbody>\n</table></div>\n");
    Ok(())
}
