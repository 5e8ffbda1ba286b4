//! The self-contained HTML report.
//!
//! [`html`] gives one file without any reference outside itself: styles inline, pictures as SVG, light and dark by the
//! reader's own setting. The JSON report is [`palpate_reports::CalibrationReport`] itself.

mod events;
mod objective;
mod tables;

use std::fmt::{self, Display, Write as _};

use palpate_reports::{CalibrationReport, Metrics};

use crate::CalibrationOutcome;

/// Styles that all reports share.
pub const STYLE: &str = include_str!("report/style.css");

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
    let mut page = String::new();
    // Writing to a string cannot fail.
    let _ = write_page(&mut page, source, outcome);
    page
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

fn write_page(page: &mut String, source: ReportSource<'_>, outcome: &CalibrationOutcome) -> fmt::Result {
    let report = &outcome.report;
    write!(
        page,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>Touch calibration of {session}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n\
         <header><p class=\"kicker\">Touch calibration · session {session} · station {station}</p>\n<h1>{headline}</h1>\n",
        session = Escaped(source.session),
        station = Escaped(source.station),
        headline = Escaped(&headline(report)),
    )?;
    for note in &report.notes {
        writeln!(page, "<p class=\"note\">Note: {}.</p>", Escaped(note))?;
    }
    page.push_str("</header>\n");
    section(page, "Trigger events", |page| events::write(page, &outcome.timelines))?;
    section(page, "How well events match", |page| {
        tables::write_summary(page, report)?;
        write_definitions(page)
    })?;
    section(page, "Parameters", |page| tables::write_parameters(page, report))?;
    section(page, "The objective", |page| objective::write(page, report))?;
    section(page, "By kind of sensor", |page| {
        let rows = report.by_modality.iter().map(|(id, pair)| (id.as_str(), &pair.nominal, &pair.calibrated));
        tables::write_pairs(page, "Stream", rows)
    })?;
    section(page, "By take", |page| {
        let labels: Vec<String> = report
            .by_take
            .iter()
            .map(|(id, take)| if take.held_out { format!("{id} (held out)") } else { id.clone() })
            .collect();
        let takes = report.by_take.values().zip(&labels);
        tables::write_pairs(
            page,
            "Take",
            takes.map(|(take, label)| (label.as_str(), &take.nominal, &take.calibrated)),
        )
    })?;
    section(page, "By channel", |page| {
        page.push_str("<details><summary>All channels</summary>\n");
        let rows = report.by_channel.iter().map(|(id, pair)| (id.as_str(), &pair.nominal, &pair.calibrated));
        tables::write_pairs(page, "Channel", rows)?;
        page.push_str("</details>\n");
        Ok(())
    })?;
    section(page, "Provenance", |page| write_provenance(page, source, outcome))?;
    page.push_str("</main>\n</body>\n</html>\n");
    Ok(())
}

fn section(page: &mut String, title: &str, body: impl FnOnce(&mut String) -> fmt::Result) -> fmt::Result {
    writeln!(page, "<section>\n<h2>{}</h2>", Escaped(title))?;
    body(page)?;
    page.push_str("</section>\n");
    Ok(())
}

fn write_definitions(page: &mut String) -> fmt::Result {
    let window_ms = crate::metrics::PAIRING_WINDOW_S * 1e3;
    let chatter_ms = crate::metrics::CHATTER_GAP_S * 1e3;
    write!(
        page,
        "<details><summary>What these figures mean</summary>\n<dl>\n\
         <dt>L1</dt><dd>Channel-frames in which simulation and reality differ; this is what is minimised.</dd>\n\
         <dt>Activation F1</dt><dd>2 TP / (2 TP + FP + FN) over channel-frames.</dd>\n\
         <dt>False positive rate</dt><dd>FP / (FP + TN) over channel-frames: simulated touch where there is none.</dd>\n\
         <dt>Contact</dt><dd>A run of active frames of one channel; gaps up to {chatter_ms} ms do not part it.</dd>\n\
         <dt>Onset and offset error</dt><dd>Mean absolute time between the starts (ends) of paired contacts. A real and a \
         simulated contact of a channel may pair if they overlap or start within {window_ms} ms of each other. Pairs keep \
         the order of time; there are as many as possible, and then as near as possible. A contact that a take's first or \
         last frame cuts has no onset or offset.</dd>\n\
         <dt>Coverage</dt><dd>Real contacts with a partner, of all. A contact without a partner enters no error, so errors \
         compare only at like coverage; it does count in F1 and L1.</dd>\n\
         <dt>95 % interval</dt><dd>From resampling whole takes with replacement, both models on the same draw. With few \
         takes it is coarse.</dd>\n</dl>\n</details>\n"
    )
}

fn write_provenance(
    page: &mut String,
    source: ReportSource<'_>,
    outcome: &CalibrationOutcome,
) -> fmt::Result {
    let report = &outcome.report;
    page.push_str("<ul>\n");
    let mut item = |text: &str| writeln!(page, "<li>{}</li>", Escaped(text));
    item(&format!("session {}, station {}", source.session, source.station))?;
    if !source.created.is_empty() {
        item(&format!("calibrated at {}", source.created))?;
    }
    for line in &outcome.model.provenance {
        item(line)?;
    }
    item(&format!("{} frames, {} channels", report.frames, report.channels))?;
    item(&format!("{} evaluations of the objective in {:.3} s", report.evaluations, report.seconds))?;
    if let Some(intervals) = &report.intervals_95 {
        item(&format!("intervals from {} resamples of takes, seed {}", intervals.resamples, intervals.seed))?;
    }
    page.push_str("</ul>\n");
    Ok(())
}

/// Text with the characters that mean something in HTML replaced.
#[derive(Clone, Copy, Debug)]
pub struct Escaped<'a>(pub &'a str);

impl Display for Escaped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for c in self.0.chars() {
            match c {
                '&' => f.write_str("&amp;")?,
                '<' => f.write_str("&lt;")?,
                '>' => f.write_str("&gt;")?,
                '"' => f.write_str("&quot;")?,
                '\'' => f.write_str("&#39;")?,
                _ => f.write_char(c)?,
            }
        }
        Ok(())
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
