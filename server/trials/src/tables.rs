//! Results as tables for terminals, spreadsheets and papers, and as a picture.

use std::fmt::Write as _;

use palpate_wire::api::{
    Campaign, CampaignResults, PolicyComparison, PolicyResult, PublishedResult, SuccessRate, TrialVerdict,
};

use crate::{TrialsError, results::rate};

/// What results are written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A table for terminals.
    Text,
    /// Comma-separated values: a row for each policy and object, and for each group.
    Csv,
    /// A LaTeX tabular, for the package `booktabs`.
    Latex,
    /// A picture: rates with Wilson's intervals.
    Svg,
}

impl Format {
    /// The format that files with this ending have.
    pub fn from_ending(ending: &str) -> Option<Self> {
        match ending {
            "txt" => Some(Self::Text),
            "csv" => Some(Self::Csv),
            "tex" => Some(Self::Latex),
            "svg" => Some(Self::Svg),
            _ => None,
        }
    }

    /// Its media type.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Text => "text/plain; charset=utf-8",
            Self::Csv => "text/csv; charset=utf-8",
            Self::Latex => "application/x-tex; charset=utf-8",
            Self::Svg => "image/svg+xml",
        }
    }
}

/// `results` in `format`.
///
/// # Errors
/// Published figures that no trials can have.
pub fn render(results: &CampaignResults, format: Format) -> Result<String, TrialsError> {
    match format {
        Format::Text => text(results),
        Format::Csv => csv(results),
        Format::Latex => latex(results),
        Format::Svg => svg(results),
    }
}

/// A row of a table that has a column for each policy and each published result.
struct Row {
    name: String,
    cells: Vec<Option<SuccessRate>>,
}

/// By object, then seen, unseen and overall. The flag tells where the groups begin.
fn rows(results: &CampaignResults) -> Result<(Vec<Row>, usize), TrialsError> {
    let published =
        |counts: Option<[u64; 2]>| counts.map(|[successes, trials]| rate(successes, trials)).transpose();
    let mut rows = Vec::new();
    let first = results.policies.first();
    for (idx, object) in first.iter().flat_map(|policy| &policy.objects).enumerate() {
        let mut cells: Vec<_> =
            results.policies.iter().map(|policy| policy.objects.get(idx).map(|object| object.rate)).collect();
        for result in &results.published {
            cells.push(published(result.objects.get(&object.object).copied())?);
        }
        rows.push(Row { name: object.object.clone(), cells });
    }
    let groups_from = rows.len();
    type OfPolicy = fn(&PolicyResult) -> Option<SuccessRate>;
    type OfPublished = fn(&PublishedResult) -> [u64; 2];
    let groups: [(&str, OfPolicy, OfPublished); 3] = [
        ("seen", |policy| policy.seen, |result| result.seen),
        ("unseen", |policy| policy.unseen, |result| result.unseen),
        (
            "overall",
            |policy| Some(policy.overall),
            |result| [result.seen[0] + result.unseen[0], result.seen[1] + result.unseen[1]],
        ),
    ];
    for (name, of_policy, of_published) in groups {
        let mut cells: Vec<_> = results.policies.iter().map(of_policy).collect();
        if cells.iter().all(Option::is_none) {
            continue;
        }
        for result in &results.published {
            cells.push(published(Some(of_published(result)))?);
        }
        rows.push(Row { name: name.to_owned(), cells });
    }
    Ok((rows, groups_from))
}

fn columns(results: &CampaignResults) -> Vec<String> {
    let published = results.published.iter().map(|result| format!("{} (published)", result.label));
    results.policies.iter().map(|policy| policy.policy.clone()).chain(published).collect()
}

fn count(cell: Option<&SuccessRate>) -> String {
    cell.map_or_else(|| "-".to_owned(), |rate| format!("{}/{}", rate.successes, rate.trials))
}

/// `16/50 = 32 % (21 to 46)`.
fn count_with_interval(cell: Option<&SuccessRate>) -> String {
    let Some((cell, rate)) = cell.and_then(|cell| Some((cell, cell.rate?))) else { return count(cell) };
    let [low, high] = cell.wilson_95.map(|end| 100.0 * end);
    format!("{}/{} = {:.0} % ({low:.0} to {high:.0})", cell.successes, cell.trials, 100.0 * rate)
}

fn text(results: &CampaignResults) -> Result<String, TrialsError> {
    let (rows, groups_from) = rows(results)?;
    let mut table: Vec<Vec<String>> =
        vec![std::iter::once("object".to_owned()).chain(columns(results)).collect()];
    for (idx, row) in rows.iter().enumerate() {
        let cell = |cell: &Option<SuccessRate>| match idx < groups_from {
            true => count(cell.as_ref()),
            false => count_with_interval(cell.as_ref()),
        };
        table.push(std::iter::once(row.name.clone()).chain(row.cells.iter().map(cell)).collect());
    }
    type Of = fn(&PolicyResult) -> String;
    let further: [(&str, Of); 6] = [
        ("empty grasps (EG)", |policy| policy.failures.empty_grasp.to_string()),
        ("slips (SL)", |policy| policy.failures.slip.to_string()),
        ("emergency stops (ES)", |policy| policy.failures.emergency_stop.to_string()),
        ("void attempts", |policy| policy.void.to_string()),
        ("without a verdict", |policy| policy.open.to_string()),
        ("median time to grasp", |policy| {
            policy.median_time_to_grasp_s.map_or_else(|| "-".to_owned(), |time| format!("{time:.1} s"))
        }),
    ];
    for (name, of) in further {
        let published = results.published.iter().map(|_| "-".to_owned());
        let cells = results.policies.iter().map(of).chain(published);
        table.push(std::iter::once(name.to_owned()).chain(cells).collect());
    }
    let widths: Vec<usize> = (0..table[0].len())
        .map(|column| table.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max())
        .map(Option::unwrap_or_default)
        .collect();
    let mut text = String::new();
    for row in &table {
        let cells: Vec<String> =
            row.iter().zip(&widths).map(|(cell, &width)| format!("{cell:<width$}")).collect();
        text.push_str(cells.join("  ").trim_end());
        text.push('\n');
    }
    let _ = writeln!(
        text,
        "\nIntervals: Wilson, 95 %. {} of {} trials have a verdict.",
        results.scored, results.planned
    );
    for comparison in &results.comparisons {
        let _ = writeln!(text, "{}", sentence(comparison));
    }
    if let Some(agreement) = &results.agreement {
        let kappa = agreement.kappa.map_or_else(String::new, |kappa| format!(", Cohen's kappa {kappa:.2}"));
        let [first, second] = &agreement.scorers;
        let _ = writeln!(
            text,
            "{first} and {second} agree on {} of {} attempts{kappa}.",
            agreement.agreed, agreement.attempts
        );
    }
    for result in &results.published {
        let _ = writeln!(text, "{}: {}.", result.label, result.source);
    }
    Ok(text)
}

/// What a comparison says, in words.
fn sentence(comparison: &PolicyComparison) -> String {
    let PolicyComparison { a, b, pairs, only_a, only_b, p_mcnemar, p_barnard, sequential, .. } = comparison;
    let barnard = p_barnard.map_or_else(String::new, |p| format!("; unpaired p = {p:.3} (Barnard)"));
    let so_far = match (&sequential.better, sequential.is_exhausted, sequential.pairs_to_settle) {
        (Some(better), ..) => format!("{better} is better: the comparison may stop"),
        (None, true, _) => "all planned pairs are made, and neither is shown to be better".to_owned(),
        (None, false, Some(more)) => format!("about {more} more pairs would settle it"),
        (None, false, None) if *pairs == 0 => "no pair has been made".to_owned(),
        (None, false, None) => "the planned pairs will hardly settle it".to_owned(),
    };
    format!(
        "{a} against {b} on {pairs} matched starts: {only_a} won by {a} alone, {only_b} by {b} alone, \
         p = {p_mcnemar:.3} (McNemar, exact){barnard}. Sequential test of {} pairs at {:.0} %: {so_far}.",
        sequential.max_pairs,
        100.0 * sequential.alpha
    )
}

fn csv(results: &CampaignResults) -> Result<String, TrialsError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let header = [
        "policy",
        "object",
        "group",
        "successes",
        "trials",
        "rate",
        "wilson_95_low",
        "wilson_95_high",
        "clopper_pearson_95_low",
        "clopper_pearson_95_high",
        "EG",
        "SL",
        "ES",
        "void",
        "open",
    ];
    writer.write_record(header).map_err(unwritten)?;
    let figures = |rate: &SuccessRate| {
        let ends = rate.wilson_95.into_iter().chain(rate.clopper_pearson_95).map(|end| end.to_string());
        let share = rate.rate.map_or_else(String::new, |rate| rate.to_string());
        [rate.successes.to_string(), rate.trials.to_string(), share]
            .into_iter()
            .chain(ends)
            .collect::<Vec<_>>()
    };
    for policy in &results.policies {
        for object in &policy.objects {
            let group = object.group.clone().unwrap_or_default();
            let failures = &object.failures;
            let counts =
                [failures.empty_grasp, failures.slip, failures.emergency_stop, object.void, object.open];
            let record = [policy.policy.clone(), object.object.clone(), group]
                .into_iter()
                .chain(figures(&object.rate))
                .chain(counts.iter().map(u64::to_string));
            writer.write_record(record).map_err(unwritten)?;
        }
        let groups = [("seen", policy.seen), ("unseen", policy.unseen), ("overall", Some(policy.overall))];
        for (group, rate) in groups {
            let Some(rate) = rate else { continue };
            // Counts of failures are kept for all objects together alone.
            let failures = &policy.failures;
            let counts = match group {
                "overall" => {
                    [failures.empty_grasp, failures.slip, failures.emergency_stop, policy.void, policy.open]
                        .map(|count| count.to_string())
                }
                _ => Default::default(),
            };
            let record = [policy.policy.clone(), String::new(), group.to_owned()]
                .into_iter()
                .chain(figures(&rate))
                .chain(counts);
            writer.write_record(record).map_err(unwritten)?;
        }
    }
    finished(writer)
}

fn unwritten(err: csv::Error) -> TrialsError {
    TrialsError::Argument(format!("the table cannot be written: {err}"))
}

fn finished(writer: csv::Writer<Vec<u8>>) -> Result<String, TrialsError> {
    let bytes = writer.into_inner().map_err(|err| TrialsError::Argument(err.to_string()))?;
    String::from_utf8(bytes).map_err(|err| TrialsError::Argument(err.to_string()))
}

/// Every attempt of every trial of `campaign`, in order, as comma-separated values. A trial that was not begun has a
/// row too.
pub(crate) fn trials_csv(campaign: &Campaign) -> Result<String, TrialsError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let header = [
        "trial",
        "policy",
        "object",
        "group",
        "start",
        "x_m",
        "y_m",
        "yaw_rad",
        "attempt",
        "began",
        "verdict",
        "scores",
        "settled_by",
        "notes",
        "suggested",
        "time_to_grasp_s",
        "held_s",
        "take",
        "record",
    ];
    writer.write_record(header).map_err(unwritten)?;
    for trial in &campaign.trials {
        let object = campaign.plan.objects.iter().find(|object| object.id == trial.object);
        let group = object.and_then(|object| object.group.clone()).unwrap_or_default();
        let start = &trial.start;
        let begins = [
            trial.number.to_string(),
            trial.policy.clone().unwrap_or_default(),
            trial.object.clone(),
            group,
            trial.start_number.to_string(),
            start.x_m.to_string(),
            start.y_m.to_string(),
            start.yaw_rad.to_string(),
        ];
        if trial.attempts.is_empty() {
            let rest = vec![String::new(); header.len() - begins.len()];
            writer.write_record(begins.iter().chain(&rest)).map_err(unwritten)?;
        }
        for (attempt, number) in trial.attempts.iter().zip(0..) {
            let outcome = attempt.outcome.as_ref();
            let name = |verdict: Option<TrialVerdict>| verdict.map_or("", TrialVerdict::name).to_owned();
            let seconds = |time: Option<f64>| time.map_or_else(String::new, |time| time.to_string());
            let scores: Vec<String> = attempt
                .scores
                .iter()
                .map(|score| format!("{}: {}", score.scorer, score.verdict.name()))
                .collect();
            let notes: Vec<String> = attempt
                .scores
                .iter()
                .chain(&attempt.settled)
                .filter(|score| !score.note.is_empty())
                .map(|score| format!("{}: {}", score.scorer, score.note))
                .collect();
            let rest = [
                number.to_string(),
                attempt.began.clone(),
                name(attempt.verdict),
                scores.join("; "),
                attempt.settled.as_ref().map(|score| score.scorer.clone()).unwrap_or_default(),
                notes.join("; "),
                name(outcome.and_then(|outcome| outcome.suggested)),
                seconds(outcome.and_then(|outcome| outcome.time_to_grasp_s)),
                seconds(outcome.and_then(|outcome| outcome.held_s)),
                attempt.take.clone().unwrap_or_default(),
                outcome.and_then(|outcome| outcome.record.clone()).unwrap_or_default(),
            ];
            writer.write_record(begins.iter().chain(&rest)).map_err(unwritten)?;
        }
    }
    finished(writer)
}

fn latex(results: &CampaignResults) -> Result<String, TrialsError> {
    let (rows, groups_from) = rows(results)?;
    let names: Vec<String> = columns(results).iter().map(|name| escape_latex(name)).collect();
    let mut text = format!(
        "% Needs \\usepackage{{booktabs}}. Intervals: Wilson, 95 %.\n\\begin{{tabular}}{{l{}}}\n",
        "c".repeat(names.len())
    );
    let _ = writeln!(text, "\\toprule\nObject & {} \\\\\n\\midrule", names.join(" & "));
    for (idx, row) in rows.iter().enumerate() {
        if idx == groups_from {
            text.push_str("\\midrule\n");
        }
        let cell = |cell: &Option<SuccessRate>| match cell {
            Some(cell) if idx >= groups_from && cell.rate.is_some() => {
                let [low, high] = cell.wilson_95.map(|end| 100.0 * end);
                format!("{}/{} [{low:.0}, {high:.0}]\\,\\%", cell.successes, cell.trials)
            }
            other => count(other.as_ref()),
        };
        let cells: Vec<String> = row.cells.iter().map(cell).collect();
        let _ = writeln!(text, "{} & {} \\\\", escape_latex(&row.name), cells.join(" & "));
    }
    text.push_str("\\bottomrule\n\\end{tabular}\n");
    for result in &results.published {
        let _ = writeln!(text, "% {}: {}", result.label.replace('\n', " "), result.source.replace('\n', " "));
    }
    Ok(text)
}

/// `text` without what LaTeX would take for commands.
fn escape_latex(text: &str) -> String {
    let mut escaped = String::new();
    for c in text.chars() {
        match c {
            '\\' => escaped.push_str("\\textbackslash{}"),
            '~' => escaped.push_str("\\textasciitilde{}"),
            '^' => escaped.push_str("\\textasciicircum{}"),
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => {
                escaped.push('\\');
                escaped.push(c);
            }
            c if c.is_control() => escaped.push(' '),
            c => escaped.push(c),
        }
    }
    escaped
}

/// Rates of all columns by group, each a dot on the line of its interval.
fn svg(results: &CampaignResults) -> Result<String, TrialsError> {
    const LEFT: f64 = 260.0;
    const WIDTH: f64 = 400.0;
    const LINE: f64 = 22.0;
    let (rows, groups_from) = rows(results)?;
    let names = columns(results);
    let num_own = results.policies.len();
    let x = |rate: f64| LEFT + WIDTH * rate;
    let mut body = String::new();
    let mut y = 30.0;
    for row in rows.iter().skip(groups_from) {
        let _ = writeln!(
            body,
            "<text x=\"8\" y=\"{:.1}\" font-weight=\"bold\">{}</text>",
            y + 4.0,
            escape_xml(&row.name)
        );
        y += LINE;
        for (column, cell) in row.cells.iter().enumerate() {
            let name = names.get(column).map_or("", String::as_str);
            let _ = writeln!(body, "<text x=\"20\" y=\"{:.1}\">{}</text>", y + 4.0, escape_xml(&elide(name)));
            if let Some((cell, rate)) = cell.as_ref().and_then(|cell| Some((cell, cell.rate?))) {
                let [low, high] = cell.wilson_95.map(x);
                // Published figures are hollow, so that nobody takes them for the campaign's own.
                let fill = if column < num_own { "#1b62a5" } else { "#ffffff" };
                let _ = writeln!(
                    body,
                    "<line x1=\"{low:.1}\" y1=\"{y:.1}\" x2=\"{high:.1}\" y2=\"{y:.1}\" stroke=\"#1b62a5\" stroke-width=\"2\"/>\
                     <circle cx=\"{:.1}\" cy=\"{y:.1}\" r=\"5\" fill=\"{fill}\" stroke=\"#1b62a5\" stroke-width=\"2\"/>\
                     <text x=\"{:.1}\" y=\"{:.1}\">{}/{}</text>",
                    x(rate),
                    LEFT + WIDTH + 16.0,
                    y + 4.0,
                    cell.successes,
                    cell.trials
                );
            }
            y += LINE;
        }
        y += 0.5 * LINE;
    }
    let mut axis = String::new();
    for percent in [0, 25, 50, 75, 100] {
        let at = x(f64::from(percent) / 100.0);
        let _ = writeln!(
            axis,
            "<line x1=\"{at:.1}\" y1=\"14\" x2=\"{at:.1}\" y2=\"{y:.1}\" stroke=\"#d0d0d0\"/>\
             <text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{percent} %</text>",
            y + 16.0
        );
    }
    Ok(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {:.0} {:.0}\" font-family=\"sans-serif\" font-size=\"13\" role=\"img\">\n\
         <title>Success rates of campaign {} with 95 % intervals (Wilson)</title>\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n{axis}{body}</svg>\n",
        LEFT + WIDTH + 80.0,
        y + 28.0,
        escape_xml(&results.campaign)
    ))
}

/// A name that fits beside the plot.
fn elide(name: &str) -> String {
    const MAX_CHARS: usize = 34;
    if name.chars().count() <= MAX_CHARS {
        return name.to_owned();
    }
    name.chars().take(MAX_CHARS - 1).chain(std::iter::once('…')).collect()
}

fn escape_xml(text: &str) -> String {
    let mut escaped = String::new();
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            c if c.is_control() => escaped.push(' '),
            c => escaped.push(c),
        }
    }
    escaped
}
