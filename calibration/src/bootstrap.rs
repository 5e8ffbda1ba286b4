//! 95 % intervals from resampling whole takes.
//!
//! Frames of one take are not independent, takes nearly are: so takes are what is drawn, with replacement, and both
//! models are judged on the same draw. With few takes the intervals are coarse (three takes have ten distinct draws);
//! they show how much hangs on single takes, no more.

use palpate_reports::{Intervals, MetricIntervals};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::metrics::MetricsSum;

type Metric = fn(&MetricsSum) -> Option<f64>;

const METRICS: [Metric; 4] =
    [MetricsSum::onset_error_ms, MetricsSum::offset_error_ms, MetricsSum::f1, MetricsSum::fpr];

/// Intervals of both models and of their difference; one sum per take and model. `None` with fewer than two takes.
pub(crate) fn intervals_95(
    nominal: &[MetricsSum],
    calibrated: &[MetricsSum],
    resamples: usize,
    seed: u64,
) -> Option<Intervals> {
    let num_takes = nominal.len().min(calibrated.len());
    if num_takes < 2 || resamples == 0 {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // [nominal, calibrated, change][metric][resample]; a resample in which a metric has no meaning adds nothing.
    let mut values: [[Vec<f64>; METRICS.len()]; 3] = Default::default();
    for _ in 0..resamples {
        let (mut nominal_sum, mut calibrated_sum) = (MetricsSum::default(), MetricsSum::default());
        for _ in 0..num_takes {
            let take_idx = rng.random_range(0..num_takes);
            nominal_sum += nominal[take_idx];
            calibrated_sum += calibrated[take_idx];
        }
        for (metric_idx, metric) in METRICS.iter().enumerate() {
            let (before, after) = (metric(&nominal_sum), metric(&calibrated_sum));
            values[0][metric_idx].extend(before);
            values[1][metric_idx].extend(after);
            values[2][metric_idx].extend(before.zip(after).map(|(before, after)| after - before));
        }
    }
    let [nominal, calibrated, change] = values.map(|of_metric| {
        let [onset_error_ms, offset_error_ms, f1, fpr] = of_metric.map(central_95);
        MetricIntervals { onset_error_ms, offset_error_ms, f1, fpr }
    });
    Some(Intervals { nominal, calibrated, change, resamples, seed })
}

/// The 2.5th and 97.5th percentile, linear between values.
fn central_95(mut values: Vec<f64>) -> Option<[f64; 2]> {
    values.sort_unstable_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some([0.025, 0.975].map(|quantile| {
        let position = quantile * last as f64;
        let below = position.floor() as usize;
        let above = (below + 1).min(last);
        values[below] + (values[above] - values[below]) * (position - below as f64)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(true_positives: u64, false_positives: u64, true_negatives: u64) -> MetricsSum {
        MetricsSum { true_positives, false_positives, true_negatives, ..MetricsSum::default() }
    }

    #[test]
    fn equal_takes_have_no_spread() {
        let intervals = intervals_95(&[take(5, 5, 90); 4], &[take(8, 2, 93); 4], 200, 7).expect("four takes");
        assert_eq!(intervals.nominal.f1, Some([10.0 / 15.0; 2]));
        assert_eq!(intervals.calibrated.f1, Some([16.0 / 18.0; 2]));
        assert_eq!(intervals.change.f1, Some([16.0 / 18.0 - 10.0 / 15.0; 2]));
        assert_eq!(intervals.nominal.onset_error_ms, None);
    }

    #[test]
    fn interval_holds_the_estimate_and_depends_on_the_seed_alone() {
        let nominal: Vec<MetricsSum> = (1..9).map(|i| take(40 + 3 * i, 10 * i, 900)).collect();
        let calibrated: Vec<MetricsSum> = (1..9).map(|i| take(60 + 2 * i, 4 * i, 950)).collect();
        let intervals = intervals_95(&nominal, &calibrated, 500, 1).expect("eight takes");
        let estimate = nominal.iter().sum::<MetricsSum>().fpr().expect("negatives");
        let [low, high] = intervals.nominal.fpr.expect("negatives");
        assert!(low < estimate && estimate < high, "{low} {estimate} {high}");
        assert_eq!(Some(&intervals), intervals_95(&nominal, &calibrated, 500, 1).as_ref());
        assert_ne!(Some(&intervals), intervals_95(&nominal, &calibrated, 500, 2).as_ref());
    }

    #[test]
    fn one_take_has_no_interval() {
        assert_eq!(intervals_95(&[take(1, 1, 1)], &[take(1, 1, 1)], 100, 0), None);
    }
}
