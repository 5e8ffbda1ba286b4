//! Statistics of features, as LeRobot keeps them to normalise by.

use serde_json::{Map, Value, json};

/// Quantiles that are kept, and their names.
const QUANTILES: [(&str, f64); 5] = [("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)];

/// Statistics of one feature, each a number for each of its dimensions.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Statistics {
    /// Number of frames.
    pub(crate) count: usize,
    /// Name and values: min, max, mean, std (of the population), then quantiles with linear interpolation.
    pub(crate) by_name: Vec<(&'static str, Vec<f64>)>,
}

impl Statistics {
    /// Of `values`, `num_frames x width`, row-major; at least one frame, all finite.
    pub(crate) fn of(values: &[f64], width: usize) -> Self {
        let count = values.len() / width;
        let names = ["min", "max", "mean", "std"].into_iter().chain(QUANTILES.map(|(name, _)| name));
        let mut by_name: Vec<(&'static str, Vec<f64>)> =
            names.map(|name| (name, Vec::with_capacity(width))).collect();
        for dimension in 0..width {
            let mut sorted: Vec<f64> = values.iter().skip(dimension).step_by(width).copied().collect();
            sorted.sort_by(f64::total_cmp);
            let mean = sorted.iter().sum::<f64>() / count as f64;
            let variance = sorted.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count as f64;
            let moments = [sorted[0], sorted[count - 1], mean, variance.sqrt()];
            let quantiles = QUANTILES.map(|(_, share)| quantile(&sorted, share));
            for ((_, of_dimensions), value) in by_name.iter_mut().zip(moments.into_iter().chain(quantiles)) {
                of_dimensions.push(value);
            }
        }
        Self { count, by_name }
    }

    /// As in `meta/stats.json`.
    pub(crate) fn to_json(&self) -> Value {
        let mut entries: Map<String, Value> =
            self.by_name.iter().map(|(name, values)| ((*name).to_owned(), json!(values))).collect();
        entries.insert("count".to_owned(), json!([self.count]));
        Value::Object(entries)
    }
}

/// Between the two values of `sorted` that are nearest to `share` of the way through.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let below = position.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (position - below as f64) * (sorted[above] - sorted[below])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_dimension_has_its_own() {
        // What numpy gives for the columns 4, 1, 3, 2 and 10, 10, 10, 50.
        let statistics = Statistics::of(&[4.0, 10.0, 1.0, 10.0, 3.0, 10.0, 2.0, 50.0], 2);
        let expected: [(&str, [f64; 2]); 9] = [
            ("min", [1.0, 10.0]),
            ("max", [4.0, 50.0]),
            ("mean", [2.5, 20.0]),
            ("std", [1.118_033_988_749_895, 17.320_508_075_688_775]),
            ("q01", [1.03, 10.0]),
            ("q10", [1.3, 10.0]),
            ("q50", [2.5, 10.0]),
            ("q90", [3.7, 38.0]),
            ("q99", [3.97, 48.8]),
        ];
        assert_eq!(statistics.count, 4);
        assert_eq!(statistics.by_name.len(), expected.len());
        for ((name, found), (expected_name, expected)) in statistics.by_name.iter().zip(expected) {
            assert_eq!(*name, expected_name);
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-12, "{name}: {found}, expected {expected}");
            }
        }
        assert_eq!(statistics.to_json()["count"], json!([4]));
    }

    #[test]
    fn one_frame_is_enough() {
        let statistics = Statistics::of(&[7.0], 1);
        let value =
            |name: &str| statistics.by_name.iter().find(|(found, _)| *found == name).map(|(_, of)| of[0]);
        assert_eq!((value("q01"), value("q99"), value("std")), (Some(7.0), Some(7.0), Some(0.0)));
    }
}
