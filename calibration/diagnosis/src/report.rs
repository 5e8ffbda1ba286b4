//! The self-contained HTML report: find, name, add, show.
//!
//! [`html`] gives one file without any reference outside itself: styles inline, pictures as SVG, light and dark by the
//! reader's own setting. The JSON report is [`palpate_reports::DiagnosisReport`] itself.

mod pictures;
mod tables;

use std::fmt::{self, Write as _};

use palpate_calibration::report::{Escaped, ReportSource, STYLE};
use palpate_reports::{DiagnosisReport, NamedEffect, Verdict, wording};
use palpate_sim::SensorModel;

/// The report as one HTML page. `model` is the one with the named effects.
pub fn html(source: ReportSource<'_>, report: &DiagnosisReport, model: &SensorModel) -> String {
    let mut page = String::new();
    // Writing to a string cannot fail.
    let _ = write_page(&mut page, source, report, model);
    page
}

fn write_page(
    page: &mut String,
    source: ReportSource<'_>,
    report: &DiagnosisReport,
    model: &SensorModel,
) -> fmt::Result {
    let style = include_str!("report/style.css");
    let (verdict, class) = match report.verdict {
        Verdict::Explained => ("explained", "good"),
        Verdict::PartlyExplained => ("partly explained", "so-so"),
        Verdict::Unexplained => ("unexplained", "bad"),
        Verdict::NoDiscrepancy => ("no discrepancy", "plain"),
        Verdict::CannotBeJudged => ("cannot be judged", "so-so"),
    };
    write!(
        page,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>Touch diagnosis of {session}</title>\n<style>\n{STYLE}{style}</style>\n</head>\n<body>\n<main>\n\
         <header><p class=\"kicker\">Touch diagnosis · session {session} · station {station} · \
         <span class=\"{class}\">{verdict}</span></p>\n<h1>{sentence}</h1>\n",
        session = Escaped(source.session),
        station = Escaped(source.station),
        sentence = Escaped(&report.sentence),
    )?;
    for effect in &report.in_doubt {
        writeln!(page, "<p class=\"note\">{}.</p>", Escaped(&wording::in_doubt_sentence(effect)))?;
    }
    for note in &report.notes {
        writeln!(page, "<p class=\"note\">Note: {}.</p>", Escaped(note.trim_end_matches('.')))?;
    }
    page.push_str("</header>\n");
    section(page, "Find: where simulation and hand disagree", |page| write_find(page, report))?;
    section(page, "Name: what is missing", |page| write_names(page, report))?;
    section(page, "Add: the model with the effects", |page| write_add(page, report, model))?;
    section(page, "Show: the gap shrinks", |page| write_show(page, report))?;
    section(page, "Provenance", |page| write_provenance(page, source, report, model))?;
    page.push_str("</main>\n</body>\n</html>\n");
    Ok(())
}

fn section(page: &mut String, title: &str, body: impl FnOnce(&mut String) -> fmt::Result) -> fmt::Result {
    writeln!(page, "<section>\n<h2>{}</h2>", Escaped(title))?;
    body(page)?;
    page.push_str("</section>\n");
    Ok(())
}

fn write_find(page: &mut String, report: &DiagnosisReport) -> fmt::Result {
    if report.cells.is_empty() {
        page.push_str("<p>No part of the data stands out over the noise.</p>\n");
    } else {
        page.push_str("<p>Most of the calibrated model's excess over the noise lies here.</p>\n");
        tables::write_cells(page, &report.cells)?;
    }
    pictures::write_residual_maps(page, report)
}

fn write_names(page: &mut String, report: &DiagnosisReport) -> fmt::Result {
    if report.effects.is_empty() {
        page.push_str("<p>Nothing was named.</p>\n");
    }
    for effect in &report.effects {
        write_effect(page, report, effect)?;
    }
    pictures::write_evidence(page, report)?;
    if let Some(next) = &report.next_experiment {
        writeln!(
            page,
            "<p class=\"next\"><strong>Next experiment.</strong> {} It tells {} apart by {} standard deviations of the \
             noise.</p>",
            Escaped(&next.sentence),
            Escaped(&next.separates.iter().map(|id| wording::words(id)).collect::<Vec<_>>().join(" and ")),
            wording::number(next.expected_gain)
        )?;
    }
    Ok(())
}

fn write_effect(page: &mut String, report: &DiagnosisReport, effect: &NamedEffect) -> fmt::Result {
    writeln!(
        page,
        "<article>\n<p class=\"said\">{}</p>",
        Escaped(&wording::effect_sentences(effect, report))
    )?;
    if let Some(rivals) = wording::rivals_sentence(effect) {
        writeln!(page, "<p class=\"note\">{}</p>", Escaped(&rivals))?;
    }
    writeln!(
        page,
        "<details><summary>Evidence: {} against a bar of {} ({})</summary>",
        wording::number(effect.evidence),
        wording::number(report.bar.evidence),
        Escaped(&wording::chance(effect.p_value))
    )?;
    tables::write_effect(page, effect)?;
    page.push_str("</details>\n</article>\n");
    Ok(())
}

fn write_add(page: &mut String, report: &DiagnosisReport, model: &SensorModel) -> fmt::Result {
    let text = if report.effects.is_empty() {
        "The calibrated model, as nothing was named."
    } else {
        "The calibrated model with every named effect: replay, live twin and training load this file."
    };
    writeln!(
        page,
        "<p>{text}</p>\n<details><summary>The model file</summary>\n<pre>{}</pre>\n</details>",
        Escaped(&model.to_toml())
    )
}

fn write_show(page: &mut String, report: &DiagnosisReport) -> fmt::Result {
    pictures::write_waterfall(page, report)?;
    tables::write_metrics(page, report)?;
    let left = &report.unexplained;
    let repeats = if left.significant {
        "It repeats between repetitions of one motion more than chance would: something is missing that the library \
         does not hold, or that these takes do not show."
    } else {
        "It does not repeat, as noise does not."
    };
    writeln!(
        page,
        "<h3>What stays unexplained</h3>\n<p>{} of the calibrated model's excess is left. {repeats}</p>",
        wording::percent(left.fraction)
    )?;
    if left.cells.is_empty() { Ok(()) } else { tables::write_cells(page, &left.cells) }
}

fn write_provenance(
    page: &mut String,
    source: ReportSource<'_>,
    report: &DiagnosisReport,
    model: &SensorModel,
) -> fmt::Result {
    page.push_str("<ul>\n");
    let mut item = |text: &str| writeln!(page, "<li>{}</li>", Escaped(text));
    item(&format!("session {}, station {}", source.session, source.station))?;
    if !source.created.is_empty() {
        item(&format!("diagnosed at {}", source.created))?;
    }
    for (part, takes) in &report.takes {
        item(&format!("{part}: {}", if takes.is_empty() { "none".to_owned() } else { takes.join(", ") }))?;
    }
    for line in &model.provenance {
        item(line)?;
    }
    item(&match report.bar.null_sessions {
        0 => "the bar is the shipped default, not set for this station".to_owned(),
        sessions => format!("the bar comes from {sessions} simulated sessions with nothing missing"),
    })?;
    item(&format!("{:.1} s", report.seconds))?;
    page.push_str("</ul>\n");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fixture() -> DiagnosisReport {
        let text = include_str!("../../../tests/fixtures/diagnosis-report.json");
        serde_json::from_str(text).expect("the stored report opens")
    }

    fn model() -> SensorModel {
        let text = "format = 1\nname = \"pad <1>\"\ntheta = { lambda_con_m = 0.001, alpha_per_m = 300.0, \
            lambda_pre_pa = 1500.0 }\n";
        SensorModel::from_toml("model.toml", text).expect("a model")
    }

    fn page(report: &DiagnosisReport) -> String {
        let source = ReportSource { session: "demo & co", station: "xarm6-leap", created: "" };
        html(source, report, &model())
    }

    #[test]
    fn stored_report_survives_its_json() {
        let report = fixture();
        let again = serde_json::from_str(&serde_json::to_string(&report).expect("JSON")).expect("a report");
        assert_eq!(report, again);
    }

    #[test]
    fn page_stands_alone_and_tells_the_four_parts() {
        let report = fixture();
        let page = page(&report);
        for heading in ["<h2>Find", "<h2>Name", "<h2>Add", "<h2>Show"] {
            assert_eq!(page.matches(heading).count(), 1, "{heading}");
        }
        assert!(!page.contains("http") && !page.contains("<script"), "it refers to something outside");
        assert!(
            page.contains("demo &amp; co") && page.contains("pad &lt;1&gt;"),
            "ids and names are escaped"
        );
        for effect in &report.effects {
            assert!(page.contains(&wording::effect_sentences(effect, &report)), "{}", effect.id);
        }
        assert_eq!(page.matches("<article>").count(), report.effects.len());
        // Every open tag is closed.
        for tag in ["svg", "table", "section", "article", "details", "figure", "div"] {
            let opened =
                page.matches(&format!("<{tag}>")).count() + page.matches(&format!("<{tag} ")).count();
            assert_eq!(opened, page.matches(&format!("</{tag}>")).count(), "{tag}");
        }
        assert!(!page.contains("NaN") && !page.contains("inf"), "a picture has a number that is none");
    }

    #[test]
    fn waterfall_has_a_bar_for_every_step_with_its_interval() {
        let report = fixture();
        let page = page(&report);
        let start = page.find("aria-label=\"Gap step by step\"").expect("the picture");
        let picture = &page[start..start + page[start..].find("</svg>").expect("its end")];
        assert_eq!(picture.matches("class=\"bar").count(), report.waterfall.len());
        assert_eq!(picture.matches("class=\"whisker").count(), report.waterfall.len());
    }

    #[test]
    fn report_without_names_or_numbers_is_a_page_too() {
        let mut report = fixture();
        report.effects.clear();
        report.candidates.clear();
        report.cells.clear();
        report.waterfall.clear();
        report.metrics.clear();
        report.residual_map.clear();
        report.next_experiment = None;
        report.verdict = Verdict::NoDiscrepancy;
        let page = page(&report);
        assert!(page.contains("Nothing was named.") && page.contains("no discrepancy"));
        assert!(!page.contains("NaN"));
    }
}
