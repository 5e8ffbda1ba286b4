//! Numbers of reports and trainings as CSV, for spreadsheets and statistics programs. SI units but where a column's name
//! says another one; an empty cell where there is no number.

use std::collections::{BTreeMap, BTreeSet};

use palpate_reports::{CalibrationReport, DiagnosisReport, MetricIntervals, Metrics};
use serde_json::Value;

use crate::Error;

/// Columns of [`Metrics`], in the order of [`cells`].
const METRICS: [&str; 8] = [
    "onset_error_ms",
    "offset_error_ms",
    "f1",
    "fpr",
    "l1",
    "onset_coverage",
    "real_contacts",
    "simulated_contacts",
];

/// A kind of report that has tables.
pub(crate) trait Tables {
    /// Names of the tables, as a message lists them.
    const NAMES: &'static str;

    /// The table `name` as CSV; `None` if there is none of that name.
    fn csv(&self, name: &str) -> Option<Result<String, Error>>;
}

impl Tables for CalibrationReport {
    const NAMES: &'static str = "expected metrics.csv or intervals.csv";

    fn csv(&self, name: &str) -> Option<Result<String, Error>> {
        match name {
            "metrics.csv" => Some(calibration_metrics(self)),
            "intervals.csv" => Some(calibration_intervals(self)),
            _ => None,
        }
    }
}

impl Tables for DiagnosisReport {
    const NAMES: &'static str = "expected effects.csv, metrics.csv or waterfall.csv";

    fn csv(&self, name: &str) -> Option<Result<String, Error>> {
        match name {
            "effects.csv" => Some(effects(self)),
            "metrics.csv" => Some(diagnosis_metrics(self)),
            "waterfall.csv" => Some(waterfall(self)),
            _ => None,
        }
    }
}

/// Both models, on all takes, on those that the fit has not seen, and by sensor type, take and channel.
fn calibration_metrics(report: &CalibrationReport) -> Result<String, Error> {
    let mut table = Table::new(["group", "name", "model"].into_iter().chain(METRICS))?;
    let mut pair = |group: &str, name: &str, nominal: &Metrics, calibrated: &Metrics| {
        for (model, metrics) in [("nominal", nominal), ("calibrated", calibrated)] {
            let names = [group, name, model].map(str::to_owned);
            table.row(names.into_iter().chain(cells(metrics)))?;
        }
        Ok::<_, Error>(())
    };
    pair("all takes", "", &report.nominal, &report.calibrated)?;
    pair("held-out takes", "", &report.held_out.nominal, &report.held_out.calibrated)?;
    for (stream, metrics) in &report.by_modality {
        pair("sensor type", stream, &metrics.nominal, &metrics.calibrated)?;
    }
    for (take, metrics) in &report.by_take {
        let group = if metrics.held_out { "held-out take" } else { "fitted take" };
        pair(group, take, &metrics.nominal, &metrics.calibrated)?;
    }
    for (channel, metrics) in &report.by_channel {
        pair("channel", channel, &metrics.nominal, &metrics.calibrated)?;
    }
    table.finish()
}

/// 95 % intervals of the metrics and of their change.
fn calibration_intervals(report: &CalibrationReport) -> Result<String, Error> {
    let mut table = Table::new(["model", "metric", "low", "high"].into_iter())?;
    let Some(intervals) = &report.intervals_95 else { return table.finish() };
    let of = [
        ("nominal", &intervals.nominal),
        ("calibrated", &intervals.calibrated),
        ("calibrated less nominal", &intervals.change),
    ];
    for (model, MetricIntervals { onset_error_ms, offset_error_ms, f1, fpr }) in of {
        let metrics = METRICS.iter().zip([onset_error_ms, offset_error_ms, f1, fpr]);
        for (metric, ends) in metrics.filter_map(|(metric, ends)| ends.map(|ends| (metric, ends))) {
            let [low, high] = ends.map(|end| end.to_string());
            table.row([model.to_owned(), (*metric).to_owned(), low, high].into_iter())?;
        }
    }
    table.finish()
}

/// Event metrics of each model on confirm takes.
fn diagnosis_metrics(report: &DiagnosisReport) -> Result<String, Error> {
    let mut table = Table::new(["model"].into_iter().chain(METRICS))?;
    for (model, metrics) in &report.metrics {
        table.row([model.clone()].into_iter().chain(cells(metrics)))?;
    }
    table.finish()
}

/// The gap step by step.
fn waterfall(report: &DiagnosisReport) -> Result<String, Error> {
    let mut table = Table::new(["step", "gap", "low_95", "high_95"].into_iter())?;
    for step in &report.waterfall {
        let [low, high] =
            step.interval_95.map_or_else(Default::default, |ends| ends.map(|end| end.to_string()));
        table.row([step.step.clone(), step.gap.to_string(), low, high].into_iter())?;
    }
    table.finish()
}

/// Parameters of the named effects, one a row.
fn effects(report: &DiagnosisReport) -> Result<String, Error> {
    let header = [
        "effect",
        "where",
        "parameter",
        "value",
        "low_95",
        "high_95",
        "gap_before",
        "gap_after",
        "evidence",
        "p_value",
        "takes_improved",
    ];
    let mut table = Table::new(header.into_iter())?;
    for effect in &report.effects {
        let place = serde_json::to_string(&effect.place).map_err(|err| Error::Internal(err.to_string()))?;
        for (parameter, value) in &effect.parameters {
            let ends = effect.interval.get(parameter);
            let [low, high] = ends.map_or_else(Default::default, |ends| ends.map(|end| end.to_string()));
            let row = [
                effect.id.clone(),
                place.clone(),
                parameter.clone(),
                value.to_string(),
                low,
                high,
                effect.gap_before.to_string(),
                effect.gap_after.to_string(),
                effect.evidence.to_string(),
                optional(effect.p_value),
                effect.takes_improved.clone(),
            ];
            table.row(row.into_iter())?;
        }
    }
    table.finish()
}

/// The curves of a job, given as a JSON object a line: a row for each step, a column for each number. Of a step that comes
/// twice, because an attempt went on from a checkpoint, the last value counts. Lines that are no such object are left out.
pub(crate) fn curves(text: &str) -> Result<String, Error> {
    let mut steps: BTreeMap<u64, BTreeMap<String, f64>> = BTreeMap::new();
    for line in text.lines() {
        let Ok(point) = serde_json::from_str::<BTreeMap<String, Value>>(line) else { continue };
        let Some(step) = point.get("step").and_then(Value::as_u64) else { continue };
        let numbers = point.iter().filter(|(name, _)| *name != "step");
        let numbers = numbers.filter_map(|(name, value)| Some((name.clone(), value.as_f64()?)));
        steps.entry(step).or_default().extend(numbers);
    }
    let names: BTreeSet<&String> = steps.values().flat_map(BTreeMap::keys).collect();
    let mut table = Table::new(["step"].into_iter().chain(names.iter().map(|name| name.as_str())))?;
    for (step, numbers) in &steps {
        let numbers = names.iter().map(|name| optional(numbers.get(*name).copied()));
        table.row([step.to_string()].into_iter().chain(numbers))?;
    }
    table.finish()
}

fn cells(metrics: &Metrics) -> [String; 8] {
    let Metrics {
        onset_error_ms,
        offset_error_ms,
        f1,
        fpr,
        l1,
        onset_coverage,
        real_contacts,
        simulated_contacts,
    } = metrics;
    [
        optional(*onset_error_ms),
        optional(*offset_error_ms),
        optional(*f1),
        optional(*fpr),
        l1.to_string(),
        optional(*onset_coverage),
        real_contacts.to_string(),
        simulated_contacts.to_string(),
    ]
}

fn optional(number: Option<f64>) -> String {
    number.map_or_else(String::new, |number| number.to_string())
}

/// A CSV file in memory.
struct Table(csv::Writer<Vec<u8>>);

impl Table {
    fn new<'a>(header: impl Iterator<Item = &'a str>) -> Result<Self, Error> {
        let mut table = Self(csv::Writer::from_writer(Vec::new()));
        table.row(header.map(str::to_owned))?;
        Ok(table)
    }

    fn row(&mut self, cells: impl Iterator<Item = String>) -> Result<(), Error> {
        self.0.write_record(cells).map_err(|err| Error::Internal(format!("failed to write a table: {err}")))
    }

    fn finish(self) -> Result<String, Error> {
        let bytes =
            self.0.into_inner().map_err(|err| Error::Internal(format!("failed to write a table: {err}")))?;
        String::from_utf8(bytes).map_err(|err| Error::Internal(err.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use palpate_reports::WaterfallStep;

    use super::*;

    #[test]
    fn a_step_that_was_repeated_has_its_last_numbers() {
        let text = "{\"step\": 10, \"loss\": 3.5}\n{\"step\": 20, \"loss\": 2, \"rate\": 0.5}\nnot JSON\n{\"step\": 10, \"loss\": \
                    3}\n{\"loss\": 9}\n";
        assert_eq!(curves(text).unwrap(), "step,loss,rate\n10,3,\n20,2,0.5\n");
        assert_eq!(curves("").unwrap(), "step\n");
    }

    #[test]
    fn names_with_commas_and_quotes_stay_one_cell() {
        let step = |step: &str, interval_95| WaterfallStep { step: step.to_owned(), gap: 0.25, interval_95 };
        let report = DiagnosisReport {
            waterfall: vec![step("nominal", Some([0.125, 0.5])), step("a, \"b\"", None)],
            ..empty()
        };
        let expected = "step,gap,low_95,high_95\nnominal,0.25,0.125,0.5\n\"a, \"\"b\"\"\",0.25,,\n";
        assert_eq!(report.csv("waterfall.csv").unwrap().unwrap(), expected);
        assert!(report.csv("intervals.csv").is_none());
    }

    /// A diagnosis that found nothing.
    fn empty() -> DiagnosisReport {
        use palpate_reports::{Bar, Gap, Unexplained, Verdict};
        DiagnosisReport {
            verdict: Verdict::NoDiscrepancy,
            sentence: String::new(),
            effects: Vec::new(),
            in_doubt: Vec::new(),
            candidates: Vec::new(),
            cells: Vec::new(),
            gap: Gap::default(),
            held_out: Gap::default(),
            fitted: Gap::default(),
            waterfall: Vec::new(),
            metrics: BTreeMap::new(),
            unexplained: Unexplained::default(),
            next_experiment: None,
            residual_map: Vec::new(),
            takes: BTreeMap::new(),
            bar: Bar::default(),
            reference_sessions: None,
            notes: Vec::new(),
            seconds: 0.0,
        }
    }
}
