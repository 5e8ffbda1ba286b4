//! The self-contained HTML report.
//!
//! [`html()`] gives one file without any reference outside itself: styles inline, pictures as SVG, light and dark by the
//! reader's own setting. The JSON report is [`palpate_reports::CalibrationReport`] itself.

mod events;
mod objective;
mod tables;

use maud::{DOCTYPE, Markup, PreEscaped, html};
use palpate_reports::{CalibrationReport, Metrics};

use crate::CalibrationOutcome;

/// Styles that all reports share.
const STYLE: &str = include_str!("report/style.css");

/// Where a report comes from.
#[derive(Clone, Copy, Debug)]
pub struct ReportSource<'a> {
    /// Id of the session.
    pub session: &'a str,
    /// Id of the station.
    pub station: &'a str,
    /// When the calibration ran, RFC 3339; empty leaves it out.
    pub created: &'a str,
}

/// The report as one HTML page.
pub fn html(source: ReportSource<'_>, outcome: &CalibrationOutcome) -> String {
    let report = &outcome.report;
    let of_streams =
        report.by_modality.iter().map(|(id, pair)| (id.clone(), &pair.nominal, &pair.calibrated));
    let of_takes = report.by_take.iter().map(|(id, take)| {
        let label = if take.held_out { format!("{id} (held out)") } else { id.clone() };
        (label, &take.nominal, &take.calibrated)
    });
    let of_channels =
        report.by_channel.iter().map(|(id, pair)| (id.clone(), &pair.nominal, &pair.calibrated));
    let header = html! {
        p.kicker { "Touch calibration · session " (source.session) " · station " (source.station) }
        h1 { (headline(report)) }
        @for note in &report.notes { p.note { "Note: " (note) "." } }
    };
    let sections = html! {
        (section("Trigger events", &events::pictures(&outcome.timelines)))
        (section("How well events match", &html! { (tables::summary(report)) (definitions()) }))
        (section("Parameters", &tables::parameters(report)))
        (section("The objective", &objective::pictures(report)))
        (section("By kind of sensor", &tables::pairs("Stream", of_streams)))
        (section("By take", &tables::pairs("Take", of_takes)))
        (section("By channel", &html! {
            details { summary { "All channels" } (tables::pairs("Channel", of_channels)) }
        }))
        (section("Provenance", &provenance(source, outcome)))
    };
    page(&format!("Touch calibration of {}", source.session), "", &header, &sections)
}

/// A report as a page of its own: what stands above its sections and these, with `style` behind the styles that all
/// reports share.
pub fn page(title: &str, style: &str, header: &Markup, sections: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) (PreEscaped(style)) }
            }
            body { main { header { (header) } (sections) } }
        }
    };
    page.into_string()
}

/// A section of a report.
pub fn section(title: &str, body: &Markup) -> Markup {
    html! { section { h2 { (title) } (body) } }
}

/// The result in one sentence, e.g. for a log line or the top of a page.
pub fn headline(report: &CalibrationReport) -> String {
    let (nominal, calibrated, where_) = if report.held_out_takes.is_empty() {
        (&report.nominal, &report.calibrated, "on the takes it was fitted to")
    } else {
        (&report.held_out.nominal, &report.held_out.calibrated, "on takes it has not seen")
    };
    format!(
        "Calibrated: onset error {} → {} ms, F1 {} → {}, false positives {} → {} % {where_}.",
        tables::milliseconds(nominal.onset_error_ms),
        tables::milliseconds(calibrated.onset_error_ms),
        tables::share(nominal.f1),
        tables::share(calibrated.f1),
        tables::percent(nominal.fpr),
        tables::percent(calibrated.fpr),
    )
}

/// What the figures mean, to be unfolded.
fn definitions() -> Markup {
    let window_ms = crate::metrics::PAIRING_WINDOW_S * 1e3;
    let chatter_ms = crate::metrics::CHATTER_GAP_S * 1e3;
    html! {
        details {
            summary { "What these figures mean" }
            dl {
                dt { "L1" }
                dd { "Channel-frames in which simulation and reality differ; this is what is minimised." }
                dt { "Activation F1" }
                dd { "2 TP / (2 TP + FP + FN) over channel-frames." }
                dt { "False positive rate" }
                dd { "FP / (FP + TN) over channel-frames: simulated touch where there is none." }
                dt { "Contact" }
                dd { "A run of active frames of one channel; gaps up to " (chatter_ms) " ms do not part it." }
                dt { "Onset and offset error" }
                dd {
                    "Mean absolute time between the starts (ends) of paired contacts. A real and a simulated contact of a channel may "
                    "pair if they overlap or start within " (window_ms) " ms of each other. Pairs keep the order of time; there are as "
                    "many as possible, and then as near as possible. A contact that a take's first or last frame cuts has no onset or "
                    "offset."
                }
                dt { "Coverage" }
                dd {
                    "Real contacts with a partner, of all. A contact without a partner enters no error, so errors compare only at like "
                    "coverage; it does count in F1 and L1."
                }
                dt { "95 % interval" }
                dd {
                    "From resampling whole takes with replacement, both models on the same draw. With few takes it is coarse."
                }
            }
        }
    }
}

fn provenance(source: ReportSource<'_>, outcome: &CalibrationOutcome) -> Markup {
    let report = &outcome.report;
    html! {
        ul {
            li { "session " (source.session) ", station " (source.station) }
            @if !source.created.is_empty() { li { "calibrated at " (source.created) } }
            @for line in &outcome.model.provenance { li { (line) } }
            li { (report.frames) " frames, " (report.channels) " channels" }
            li { (report.evaluations) " evaluations of the objective in " (format!("{:.3} s", report.seconds)) }
            @if let Some(intervals) = &report.intervals_95 {
                li { "intervals from " (intervals.resamples) " resamples of takes, seed " (intervals.seed) }
            }
        }
    }
}

/// Metrics as text, in the order of every table.
fn metric_texts(metrics: &Metrics) -> [String; 6] {
    [
        tables::milliseconds(metrics.onset_error_ms),
        tables::milliseconds(metrics.offset_error_ms),
        tables::share(metrics.f1),
        tables::percent(metrics.fpr),
        metrics.l1.to_string(),
        tables::percent(metrics.onset_coverage),
    ]
}
