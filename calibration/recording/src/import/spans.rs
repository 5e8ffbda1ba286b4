//! Spans of a take: those without touch, and repetitions.

use super::{ImportOptions, assemble::Assembled, config::TakeConfig, repetitions, report::RepetitionReport};
use crate::{RecordingError, format::ns_from_secs};

/// Makes an error about a field of `take.toml`.
pub(super) type ConfigError<'a> = &'a dyn Fn(&str, String) -> RecordingError;

/// The spans without touch, by time; none for a binary take that states none.
pub(super) fn baselines(
    config: &TakeConfig,
    binary: bool,
    [first_s, last_s]: [f64; 2],
    error: ConfigError<'_>,
) -> Result<Vec<[f64; 2]>, RecordingError> {
    let (spans, field) = match (&config.baseline_s, config.baseline_first_s) {
        (Some(_), Some(_)) => {
            let problem = "beside baseline_first_s, expected one of them";
            return Err(error("baseline_s", problem.to_owned()));
        }
        (Some(spans), None) => (spans.as_slice().to_vec(), "baseline_s"),
        (None, Some(duration_s)) if duration_s > 0.0 && duration_s.is_finite() => {
            (vec![[first_s, first_s + duration_s]], "baseline_first_s")
        }
        (None, Some(duration_s)) => {
            let problem = format!("{duration_s}, expected a finite number of seconds above zero");
            return Err(error("baseline_first_s", problem));
        }
        (None, None) if binary => return Ok(Vec::new()),
        (None, None) => {
            let problem = "missing; raw readings need a span without touch, from which reference values come: \
                           baseline_s = [t0, t1], or baseline_first_s = SECONDS";
            return Err(error("baseline_s", problem.to_owned()));
        }
    };
    if spans.is_empty() {
        return Err(error(field, "[] has no span, expected [t0, t1], or several of them".to_owned()));
    }
    let place = |idx: usize| match spans.len() {
        1 => field.to_owned(),
        _ => format!("{field}, span {}", idx + 1),
    };
    for (idx, &span) in spans.iter().enumerate() {
        check_span(span, first_s, last_s).map_err(|problem| error(&place(idx), problem))?;
        if let Some(before) =
            idx.checked_sub(1).map(|before| spans[before]).filter(|before| span[0] < before[1])
        {
            let problem = format!(
                "{span:?} begins before {before:?}, the span before it, has ended; give spans one after another"
            );
            return Err(error(&place(idx), problem));
        }
    }
    Ok(spans)
}

/// The repetitions that are marked, or else those that are found where `options` want it.
pub(super) fn repetitions(
    config: &TakeConfig,
    primitive: &str,
    options: ImportOptions<'_>,
    joints: &Assembled,
    [first_s, last_s]: [f64; 2],
    error: ConfigError<'_>,
) -> Result<Vec<RepetitionReport>, RecordingError> {
    let num_marked = config.repetitions_s.as_ref().map_or(0, Vec::len);
    if let Some(labels) = &config.repetition_labels
        && labels.len() != num_marked
    {
        let problem = format!(
            "{} labels for {num_marked} spans of repetitions_s; give one for each, alike for repetitions of the same motion, \
             or leave them out",
            labels.len(),
        );
        return Err(error("repetition_labels", problem));
    }
    let Some(marked) = &config.repetitions_s else {
        if !options.find_repetitions {
            return Ok(Vec::new());
        }
        let num_dofs = joints.table.values.len() / joints.table.times_s.len().max(1);
        let found = repetitions::find(&joints.table.times_s, &joints.table.values, num_dofs);
        let is_one_motion = found.iter().all(|found| found.group == 0);
        let label = |group: usize| {
            if is_one_motion { primitive.to_owned() } else { format!("{primitive} {}", group + 1) }
        };
        let repetition = |found: &repetitions::Found| RepetitionReport {
            start_s: found.start_s,
            end_s: found.end_s,
            label: label(found.group),
        };
        return Ok(found.iter().map(repetition).collect());
    };
    let mut repetitions = Vec::with_capacity(marked.len());
    for (span_idx, &span) in marked.iter().enumerate() {
        check_span(span, first_s, last_s)
            .map_err(|problem| error(&format!("repetitions_s, span {}", span_idx + 1), problem))?;
        let label = config.repetition_labels.as_ref().map_or(primitive, |labels| &labels[span_idx]);
        repetitions.push(RepetitionReport { start_s: span[0], end_s: span[1], label: label.to_owned() });
    }
    Ok(repetitions)
}

fn check_span([start_s, end_s]: [f64; 2], first_s: f64, last_s: f64) -> Result<(), String> {
    if !(start_s.is_finite() && end_s.is_finite()) {
        return Err(format!("[{start_s}, {end_s}] must be finite"));
    }
    if end_s <= start_s {
        return Err(format!("[{start_s}, {end_s}] ends before it starts"));
    }
    if end_s < first_s || start_s > last_s || start_s < first_s.floor() {
        return Err(format!("[{start_s}, {end_s}] lies outside the recording, {first_s}..{last_s} s"));
    }
    // As the take will hold it.
    if ns_from_secs((end_s - last_s).max(0.0)).is_none() {
        return Err(format!("[{start_s}, {end_s}] ends too long after the recording, {first_s}..{last_s} s"));
    }
    Ok(())
}
