//! The self-contained HTML report: find, name, add, show.
//!
//! [`html()`] gives one file without any reference outside itself: styles inline, pictures as SVG, light and dark by the
//! reader's own setting. The JSON report is [`palpate_reports::DiagnosisReport`] itself.

mod pictures;
mod tables;

use maud::{Markup, html};
use palpate_calibration::report::{ReportSource, page, section};
use palpate_reports::{DiagnosisReport, NamedEffect, Verdict, wording};
use palpate_sim::SensorModel;

/// The report as one HTML page. `model` is the one with the named effects.
pub fn html(source: ReportSource<'_>, report: &DiagnosisReport, model: &SensorModel) -> String {
    let (verdict, class) = match report.verdict {
        Verdict::Explained => ("explained", "good"),
        Verdict::PartlyExplained => ("partly explained", "so-so"),
        Verdict::Unexplained => ("unexplained", "bad"),
        Verdict::NoDiscrepancy => ("no discrepancy", "plain"),
        Verdict::CannotBeJudged => ("cannot be judged", "so-so"),
    };
    let header = html! {
        p.kicker {
            "Touch diagnosis · session " (source.session) " · station " (source.station) " · "
            span class=(class) { (verdict) }
        }
        h1 { (report.sentence) }
        @for effect in &report.in_doubt { p.note { (wording::in_doubt_sentence(effect)) "." } }
        @for note in &report.notes { p.note { "Note: " (note.trim_end_matches('.')) "." } }
    };
    let sections = html! {
        (section("Find: where simulation and hand disagree", &find(report)))
        (section("Name: what is missing", &names(report)))
        (section("Add: the model with the effects", &add(report, model)))
        (section("Show: the gap shrinks", &show(report)))
        (section("Provenance", &provenance(source, report, model)))
    };
    page(
        &format!("Touch diagnosis of {}", source.session),
        include_str!("report/style.css"),
        &header,
        &sections,
    )
}

fn find(report: &DiagnosisReport) -> Markup {
    html! {
        @if report.cells.is_empty() {
            p { "No part of the data stands out over the noise." }
        } @else {
            p { "Most of the calibrated model's excess over the noise lies here." }
            (tables::cells(&report.cells))
        }
        (pictures::residual_maps(report))
    }
}

fn names(report: &DiagnosisReport) -> Markup {
    let words = |ids: &[String]| ids.iter().map(|id| wording::words(id)).collect::<Vec<_>>().join(" and ");
    html! {
        @if report.effects.is_empty() { p { "Nothing was named." } }
        @for effect in &report.effects { (named(report, effect)) }
        (pictures::evidence(report))
        @if let Some(next) = &report.next_experiment {
            p.next {
                strong { "Next experiment." } " " (next.sentence) " It tells " (words(&next.separates)) " apart by "
                (wording::number(next.expected_gain)) " standard deviations of the noise."
            }
        }
    }
}

fn named(report: &DiagnosisReport, effect: &NamedEffect) -> Markup {
    html! {
        article {
            p.said { (wording::effect_sentences(effect, report)) }
            @if let Some(rivals) = wording::rivals_sentence(effect) { p.note { (rivals) } }
            details {
                summary {
                    "Evidence: " (wording::number(effect.evidence)) " against a bar of " (wording::number(report.bar.evidence))
                    " (" (wording::chance(effect.p_value)) ")"
                }
                (tables::effect(effect))
            }
        }
    }
}

fn add(report: &DiagnosisReport, model: &SensorModel) -> Markup {
    html! {
        p {
            @if report.effects.is_empty() {
                "The calibrated model, as nothing was named."
            } @else {
                "The calibrated model with every named effect: replay, live twin and training load this file."
            }
        }
        details { summary { "The model file" } pre { (model.to_toml()) } }
    }
}

fn show(report: &DiagnosisReport) -> Markup {
    let left = &report.unexplained;
    html! {
        (pictures::waterfall(report))
        (tables::metrics(report))
        h3 { "What stays unexplained" }
        p {
            (wording::percent(left.fraction)) " of the calibrated model's excess is left. "
            @if left.significant {
                "It repeats between repetitions of one motion more than chance would: something is missing that the library does "
                "not hold, or that these takes do not show."
            } @else {
                "It does not repeat, as noise does not."
            }
        }
        @if !left.cells.is_empty() { (tables::cells(&left.cells)) }
    }
}

fn provenance(source: ReportSource<'_>, report: &DiagnosisReport, model: &SensorModel) -> Markup {
    html! {
        ul {
            li { "session " (source.session) ", station " (source.station) }
            @if !source.created.is_empty() { li { "diagnosed at " (source.created) } }
            @for (part, takes) in &report.takes {
                li { (part) ": " @if takes.is_empty() { "none" } @else { (takes.join(", ")) } }
            }
            @for line in &model.provenance { li { (line) } }
            li {
                @match report.bar.null_sessions {
                    0 => "the bar is the shipped default, not set for this station",
                    sessions => { "the bar comes from " (sessions) " simulated sessions with nothing missing" }
                }
            }
            li { (format!("{:.1} s", report.seconds)) }
        }
    }
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
