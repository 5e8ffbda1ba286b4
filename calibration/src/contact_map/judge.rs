//! What a map is worth: how well events of the hardware agree with those of a simulation, with it and without it.

use std::collections::BTreeMap;

use palpate_reports::{ContactMapReport, ContactRow};
use palpate_robot_model::TactileLayout;

use super::MapTake;
use crate::bootstrap::intervals_95;
use crate::metrics::{MetricsSum, compare_take};

/// What thresholds or a map make of readings, beside what a sensor model makes of geometry, on takes that judge.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// `thresholds` or [`MAP`].
    pub hardware: String,
    /// Name of the sensor model.
    pub simulation: String,
    /// By take, stream by stream.
    pub takes: Vec<Vec<MetricsSum>>,
}

/// What a row of a map says of its hardware.
pub const MAP: &str = "contact map";
/// The same of the station's firmware.
pub const THRESHOLDS: &str = "thresholds";

/// Compares the events of the hardware in one take with those of a simulation, `[frame * num_channels + channel]` both, stream
/// by stream.
///
/// # Panics
/// If the lengths do not fit each other: a caller's bug.
pub fn compare(
    layout: &TactileLayout,
    take: &MapTake,
    hardware: &[bool],
    simulated: &[bool],
) -> Vec<MetricsSum> {
    let of_channels = compare_take(&take.frame_times_s, layout.num_channels(), hardware, simulated);
    let streams = layout.streams.iter();
    streams.map(|stream| of_channels[stream.channels.clone()].iter().sum()).collect()
}

/// The rows of a report, with intervals from `resamples` draws of takes. The map's comparison is the last; the others are
/// judged on the same takes in the same order.
pub fn rows(
    layout: &TactileLayout,
    comparisons: &[Comparison],
    resamples: usize,
    seed: u64,
) -> Vec<ContactRow> {
    let totals = |comparison: &Comparison| -> Vec<MetricsSum> {
        comparison.takes.iter().map(|streams| streams.iter().sum()).collect()
    };
    let Some((map, others)) = comparisons.split_last() else { return Vec::new() };
    let of_map = totals(map);
    let row = |comparison: &Comparison, is_map: bool| {
        let of_takes = totals(comparison);
        let intervals = intervals_95(&of_takes, &of_map, resamples, seed);
        let streams = layout.streams.iter().enumerate();
        let by_stream = streams.map(|(idx, stream)| {
            let sum: MetricsSum = comparison.takes.iter().filter_map(|take| take.get(idx)).sum();
            (stream.id.clone(), sum.metrics())
        });
        ContactRow {
            hardware: comparison.hardware.clone(),
            simulation: comparison.simulation.clone(),
            metrics: of_takes.iter().sum::<MetricsSum>().metrics(),
            by_stream: by_stream.collect::<BTreeMap<_, _>>(),
            intervals_95: intervals.as_ref().map(|intervals| intervals.nominal.clone()),
            map_less_this_95: intervals.filter(|_| !is_map).map(|intervals| intervals.change),
        }
    };
    others.iter().map(|other| row(other, false)).chain([row(map, true)]).collect()
}

/// The result in sentences: one for each row beside the map's, about F1 and the onset error.
pub fn sentences(report: &ContactMapReport) -> Vec<String> {
    let Some((map, others)) = report.rows.split_last() else { return Vec::new() };
    let sentence = |row: &ContactRow| {
        let change = row.map_less_this_95.clone().unwrap_or_default();
        let f1 = verdict(change.f1, true);
        let onset = verdict(change.onset_error_ms, false);
        format!(
            "Against {} with the {} model: F1 {} instead of {}, {f1}; onset error {} instead of {} ms, {onset}.",
            row.hardware,
            row.simulation,
            number(map.metrics.f1, 3),
            number(row.metrics.f1, 3),
            number(map.metrics.onset_error_ms, 0),
            number(row.metrics.onset_error_ms, 0),
        )
    };
    others.iter().map(sentence).collect()
}

/// What the interval of a change says.
fn verdict(change: Option<[f64; 2]>, more_is_better: bool) -> &'static str {
    match change {
        None => "with too few takes to say whether that is chance",
        Some([low, _]) if low > 0.0 => {
            if more_is_better {
                "better"
            } else {
                "worse"
            }
        }
        Some([_, high]) if high < 0.0 => {
            if more_is_better {
                "worse"
            } else {
                "better"
            }
        }
        Some(_) => "no clear difference",
    }
}

/// `value` with so many digits, a dash for none.
pub fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

#[cfg(test)]
mod tests {
    use palpate_reports::{MetricIntervals, Metrics};

    use super::*;

    #[test]
    fn sentences_claim_no_more_than_the_intervals() {
        let row = |hardware: &str, f1, change: Option<[f64; 2]>| ContactRow {
            hardware: hardware.to_owned(),
            simulation: "calibrated".to_owned(),
            metrics: Metrics { f1: Some(f1), ..Metrics::default() },
            by_stream: BTreeMap::new(),
            intervals_95: None,
            map_less_this_95: change.map(|f1| MetricIntervals { f1: Some(f1), ..Default::default() }),
        };
        let says = |change| {
            let report = ContactMapReport {
                session: String::new(),
                station: String::new(),
                target: String::new(),
                fitted_takes: Vec::new(),
                judged_takes: Vec::new(),
                leave_one_out: false,
                rows: vec![row(THRESHOLDS, 0.5, change), row(MAP, 0.6, None)],
                streams: BTreeMap::new(),
                resamples: 0,
                seed: 0,
                notes: Vec::new(),
            };
            sentences(&report).remove(0)
        };
        assert!(says(Some([0.01, 0.2])).contains("F1 0.600 instead of 0.500, better;"));
        assert!(says(Some([-0.01, 0.2])).contains("no clear difference"));
        assert!(says(Some([-0.2, -0.01])).contains("worse"));
        assert!(says(None).contains("too few takes"));
    }
}
