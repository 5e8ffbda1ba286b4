//! Tables of figures.

use std::fmt::{self, Write as _};

use palpate_reports::{CalibrationReport, Metrics, StreamFit};

use super::{Escaped, metric_texts};

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
pub(super) fn write_summary(page: &mut String, report: &CalibrationReport) -> fmt::Result {
    let has_held_out = !report.held_out_takes.is_empty();
    page.push_str("<div class=\"scroll\"><table>\n<thead><tr><th></th>");
    for head in HEADS {
        write!(page, "<th>{head}</th>")?;
    }
    page.push_str("<th>Contacts, real / simulated</th></tr></thead>\n<tbody>\n");
    if has_held_out {
        write_row(page, "held-out takes, nominal", "was", &report.held_out.nominal)?;
        write_row(page, "held-out takes, calibrated", "now", &report.held_out.calibrated)?;
    }
    write_row(page, "all takes, nominal", "was", &report.nominal)?;
    write_row(page, "all takes, calibrated", "now", &report.calibrated)?;
    if let Some(intervals) = &report.intervals_95 {
        let rows = [
            ("95 % interval, nominal", &intervals.nominal),
            ("95 % interval, calibrated", &intervals.calibrated),
            ("95 % interval, change", &intervals.change),
        ];
        for (label, interval) in rows {
            write!(page, "<tr class=\"interval\"><td>{label}</td>")?;
            let scaled = [
                (interval.onset_error_ms, 1.0, 0),
                (interval.offset_error_ms, 1.0, 0),
                (interval.f1, 1.0, 3),
                (interval.fpr, 100.0, 2),
            ];
            for (interval, scale, digits) in scaled {
                match interval {
                    Some([low, high]) => {
                        write!(page, "<td>{:.digits$} to {:.digits$}</td>", scale * low, scale * high)?;
                    }
                    None => write!(page, "<td>{NOTHING}</td>")?,
                }
            }
            page.push_str("<td></td><td></td><td></td></tr>\n");
        }
    }
    page.push_str("</tbody>\n</table></div>\n");
    let of = if report.held_out_takes.len() >= 2 { "the held-out takes" } else { "all takes" };
    if report.intervals_95.is_some() {
        writeln!(page, "<p class=\"caption\">Intervals are over {of}.</p>")?;
    }
    Ok(())
}

fn write_row(page: &mut String, label: &str, class: &str, metrics: &Metrics) -> fmt::Result {
    write!(page, "<tr><td class=\"{class}\">{}</td>", Escaped(label))?;
    for text in metric_texts(metrics) {
        write!(page, "<td>{text}</td>")?;
    }
    writeln!(page, "<td>{} / {}</td></tr>", metrics.real_contacts, metrics.simulated_contacts)
}

/// One row for each label: nominal and calibrated.
pub(super) fn write_pairs<'a>(
    page: &mut String,
    kind: &str,
    rows: impl Iterator<Item = (&'a str, &'a Metrics, &'a Metrics)>,
) -> fmt::Result {
    write!(page, "<div class=\"scroll\"><table>\n<thead><tr><th>{kind}</th>")?;
    for head in HEADS {
        write!(page, "<th>{head}</th>")?;
    }
    page.push_str("</tr></thead>\n<tbody>\n");
    for (label, nominal, calibrated) in rows {
        write!(page, "<tr><td>{}</td>", Escaped(label))?;
        for (before, after) in metric_texts(nominal).iter().zip(metric_texts(calibrated)) {
            write_change(page, before, &after)?;
        }
        page.push_str("</tr>\n");
    }
    page.push_str("</tbody>\n</table></div>\n");
    Ok(())
}

/// A cell: a number, nominal and calibrated.
fn write_change(page: &mut String, before: &str, after: &str) -> fmt::Result {
    write!(page, "<td><span class=\"was\">{before}</span> → <span class=\"now\">{after}</span></td>")
}

/// theta before and after; of every stream where each has its own.
pub(super) fn write_parameters(page: &mut String, report: &CalibrationReport) -> fmt::Result {
    if !report.streams.is_empty() {
        return write_streams(page, report);
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
    page.push_str(
        "<div class=\"scroll\"><table>\n<thead><tr><th>Parameter</th><th class=\"text\">Meaning</th><th>Nominal</th><th>Calibrated</th></tr></thead>\n<tbody>\n",
    );
    for (name, meaning, before, after) in rows {
        writeln!(
            page,
            "<tr><td>{name}</td><td class=\"text\">{meaning}</td><td class=\"was\">{}</td><td class=\"now\">{}</td></tr>",
            significant(before),
            significant(after)
        )?;
    }
    page.push_str("</tbody>\n</table></div>\n");
    Ok(())
}

fn write_streams(page: &mut String, report: &CalibrationReport) -> fmt::Result {
    page.push_str(
        "<div class=\"scroll\"><table>\n<thead><tr><th>Stream</th><th>λ_con, mm</th><th>α, 1/m</th><th>λ_pre, Pa</th></tr></thead>\n<tbody>\n",
    );
    for (id, StreamFit { theta, nominal_theta, .. }) in &report.streams {
        write!(page, "<tr><td>{}</td>", Escaped(id))?;
        let pairs = [
            (nominal_theta.lambda_con_m.map(|m| 1e3 * m), theta.lambda_con_m.map(|m| 1e3 * m)),
            (nominal_theta.alpha_per_m, theta.alpha_per_m),
            (nominal_theta.lambda_pre_pa, theta.lambda_pre_pa),
        ];
        for pair in pairs {
            let (Some(before), Some(after)) = pair else {
                write!(page, "<td>{NOTHING}</td>")?;
                continue;
            };
            write_change(page, &significant(before), &significant(after))?;
        }
        page.push_str("</tr>\n");
    }
    page.push_str("</tbody>\n</table></div>\n");
    Ok(())
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
