//! What an import understood, in words.

use palpate_recording::import::{ColumnReport, FileReport, ImportReport, TakeReport};

use super::output;

/// The report as text, without a line end.
pub(super) fn text(report: &ImportReport) -> String {
    let mut lines = vec![format!("station {}: {}", report.station, report.station_because)];
    match &report.mapping {
        Some(mapping) => lines.push(format!("mapping file {mapping}")),
        None => lines.push("no mapping file".to_owned()),
    }
    for (idx, take) in report.takes.iter().enumerate() {
        lines.push(String::new());
        add_take(&mut lines, take, idx.checked_sub(1).map(|before| &report.takes[before]));
    }
    lines.push(String::new());
    let num_bad = report.takes.iter().filter(|take| take.problem.is_some()).count();
    lines.push(match num_bad {
        0 => format!("{} takes, all can be imported; nothing was written", report.takes.len()),
        _ => format!("{num_bad} of {} takes cannot be imported; nothing was written", report.takes.len()),
    });
    lines.join("\n")
}

fn add_take(lines: &mut Vec<String>, take: &TakeReport, before: Option<&TakeReport>) {
    let kept = if take.binary { "events (0 and 1)" } else { "readings" };
    let fixture = if take.fixture_trusted { "trusted" } else { "not trusted" };
    lines.push(format!(
        "take {}: {:?} on object {:?}, fixture {fixture}, {kept}",
        take.take, take.primitive, take.object
    ));
    for file in &take.files {
        let same = before.and_then(|before| before.files.iter().find(|other| same_columns(other, file)));
        add_file(lines, file, same.is_some().then(|| before.map_or("", |before| before.take.as_str())));
    }
    if !take.streams.is_empty() {
        lines.push(format!(
            "  {} to {} s, {}",
            take.first_s,
            take.last_s,
            output::duration(take.last_s - take.first_s)
        ));
    }
    for stream in &take.streams {
        lines.push(format!(
            "  {}: {} samples at {:.2} Hz, the station says {:.2} Hz; {}, longest step {:.3} s",
            stream.stream,
            stream.samples,
            stream.rate_hz,
            stream.nominal_rate_hz,
            match stream.gaps {
                0 => "no gap".to_owned(),
                1 => "1 gap".to_owned(),
                gaps => format!("{gaps} gaps"),
            },
            stream.longest_gap_s
        ));
    }
    if let Some([start_s, end_s]) = take.baseline_s {
        lines.push(format!("  without touch from {start_s} to {end_s} s"));
    }
    for [start_s, end_s] in &take.later_baselines_s {
        lines.push(format!(
            "  and from {start_s} to {end_s} s, from when on readings count from what they are there"
        ));
    }
    match (take.repetitions.len(), take.repetitions_from.as_str()) {
        _ if take.streams.is_empty() => {}
        (0, _) => {
            lines.push("  no repetitions: none marked, and the joint path does not repeat itself".to_owned());
        }
        (num, "joint path") => {
            lines.push(format!("  {num} repetitions, found in the joint path because none are marked:"));
        }
        (num, _) => lines.push(format!("  {num} repetitions, as marked:")),
    }
    for repetition in &take.repetitions {
        lines.push(format!(
            "    {:.3} to {:.3} s: {}",
            repetition.start_s, repetition.end_s, repetition.label
        ));
    }
    lines.extend(take.notes.iter().map(|note| format!("  note: {note}")));
    lines.extend(take.warnings.iter().map(|warning| format!("  warning: {warning}")));
    lines.extend(take.problem.iter().map(|problem| format!("  error: {problem}")));
}

fn add_file(lines: &mut Vec<String>, file: &FileReport, columns_as_in: Option<&str>) {
    lines.push(format!(
        "  {}: {} rows, {} to {} s; times: {}; columns by {}",
        file.file, file.rows, file.first_s, file.last_s, file.time, file.columns_by
    ));
    match columns_as_in {
        Some(take) => lines.push(format!("    columns as in take {take}")),
        None => lines.extend(file.columns.iter().map(|column| format!("    {}", column_text(column)))),
    }
    for ignored in &file.ignored {
        lines.push(format!("    column {} {:?} ignored", ignored.column, ignored.header));
    }
}

/// `column 3 (curl [deg]) is joint "curl": deg to rad, polarity -1, 0.1 to 0.5 rad`.
fn column_text(column: &ColumnReport) -> String {
    let ColumnReport { column: number, header, what, id, unit, to_unit, .. } = column;
    let header = if header.is_empty() { String::new() } else { format!(" ({header})") };
    let mut text = format!("column {number}{header} is {what} {id:?}: ");
    if column.scale != 1.0 || column.offset != 0.0 {
        text += &format!("times {} plus {}, ", column.scale, column.offset);
    }
    if unit != to_unit {
        text += &format!("{unit} to {to_unit}, ");
    }
    if column.polarity < 0 {
        text += "falls under load, ";
    }
    if column.constant {
        text + &format!("always {:.6} {to_unit}", column.min)
    } else {
        text + &format!("{:.6} to {:.6} {to_unit}", column.min, column.max)
    }
}

fn same_columns(a: &FileReport, b: &FileReport) -> bool {
    let same = |a: &ColumnReport, b: &ColumnReport| {
        (a.column, &a.header, &a.id, &a.unit, a.polarity) == (b.column, &b.header, &b.id, &b.unit, b.polarity)
            && (a.scale, a.offset, a.constant) == (b.scale, b.offset, b.constant)
    };
    a.columns.len() == b.columns.len() && a.columns.iter().zip(&b.columns).all(|(a, b)| same(a, b))
}
