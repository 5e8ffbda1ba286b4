//! Bounds and axes of the search, taken from the layout and the data.

use palpate_robot_model::{Patch, SensorKind, TactileLayout};
use palpate_sim::replay::NEAR_M;

use super::signals::FitData;

/// Weight at the farthest node of a patch for the smallest positive alpha is `exp(-FLAT)`: about flat.
const FLAT: f64 = 0.1;
/// Weight at the next taxel for the largest alpha is `exp(-STEEP)`: under one per cent, so that taxels are apart.
const STEEP: f64 = 5.0;

/// Axes of the paper's grid.
#[derive(Clone, Debug, PartialEq)]
pub struct GridAxes {
    /// Ascending, 1/m.
    pub alphas_per_m: Vec<f64>,
    /// Ascending, m.
    pub lambda_cons_m: Vec<f64>,
    /// Ascending, Pa.
    pub lambda_pres_pa: Vec<f64>,
}

/// `num_alphas` decay rates, 1/m, ascending: zero (every node counts alike), then evenly spaced in the logarithm from
/// "hardly any decay across the largest patch" to "no crosstalk to the nearest taxel".
///
/// Just zero where the layout has no pressure patch with an extent: alpha has no effect then.
pub fn alpha_axis(layout: &TactileLayout, num_alphas: usize) -> Vec<f64> {
    alpha_axis_of(layout, &vec![true; layout.streams.len()], num_alphas)
}

/// [`alpha_axis`] for the patches of the streams in `wanted`.
pub(super) fn alpha_axis_of(layout: &TactileLayout, wanted: &[bool], num_alphas: usize) -> Vec<f64> {
    let mut farthest_m = 0.0_f64;
    let mut nearest_taxels_m = f64::INFINITY;
    let is_wanted =
        |patch: &&Patch| layout.streams[patch.stream].kind == SensorKind::Pressure && wanted[patch.stream];
    for patch in layout.patches.iter().filter(is_wanted) {
        for (taxel_idx, taxel) in patch.taxels_in_link.iter().enumerate() {
            for node in &patch.nodes {
                farthest_m = farthest_m.max((node.pos_in_link - taxel).norm());
            }
            for other in &patch.taxels_in_link[..taxel_idx] {
                let distance_m = (other - taxel).norm();
                if distance_m > 0.0 {
                    nearest_taxels_m = nearest_taxels_m.min(distance_m);
                }
            }
        }
    }
    if farthest_m <= 0.0 || num_alphas < 2 {
        return vec![0.0];
    }
    // A patch with one taxel has no crosstalk; there the steep end is a weight of one per cent halfway out.
    let steep_m = nearest_taxels_m.min(farthest_m / 2.0);
    let mut alphas = vec![0.0];
    alphas.extend(log_spaced(FLAT / farthest_m, STEEP / steep_m, num_alphas - 1));
    alphas
}

impl GridAxes {
    /// Bounded ranges from the data, `num_lambdas` values each.
    ///
    /// - `lambda_con`, linear: the 5th to the 95th percentile of the signed distance over channel-frames in which the
    ///   real proximity channel is active, so from missing nearly all contact to catching nearly all of it.
    /// - `lambda_pre`, logarithmic: from the 10th percentile of positive pressure at the largest alpha to the 95th at
    ///   the smallest, again where the real pressure channel is active. Pressure falls with alpha, so this holds the
    ///   range of every alpha between.
    pub fn from_data(data: &FitData<'_>, alphas_per_m: Vec<f64>, num_lambdas: usize) -> Self {
        let distance = data.proximity();
        let lambda_cons_m = match (distance.active_quantile(0.05), distance.active_quantile(0.95)) {
            (Some(far), Some(deep)) => {
                let (low, high) = if far > deep { (-far, -deep) } else { (-deep, -far) };
                let (low, high) = if high > low { (low, high) } else { (low - 1e-3, high + 1e-3) };
                linear_spaced(low, high.min(NEAR_M), num_lambdas)
            }
            _ => Vec::new(),
        };
        let low = alphas_per_m.last().and_then(|&alpha| data.pressure(alpha).active_quantile(0.1));
        let high = alphas_per_m.first().and_then(|&alpha| data.pressure(alpha).active_quantile(0.95));
        let lambda_pres_pa = match (low, high) {
            (Some(low), Some(high)) => {
                let (low, high) = if high > low { (low, high) } else { (high / 2.0, low * 2.0) };
                log_spaced(low, high, num_lambdas)
            }
            _ => Vec::new(),
        };
        Self { alphas_per_m, lambda_cons_m, lambda_pres_pa }
    }
}

/// `num` values from `low` to `high`, evenly spaced.
pub(crate) fn linear_spaced(low: f64, high: f64, num: usize) -> Vec<f64> {
    let last = num.saturating_sub(1);
    (0..num).map(|i| if i == last { high } else { low + (high - low) * i as f64 / last as f64 }).collect()
}

/// `num` values from `low` to `high`, both positive, evenly spaced in the logarithm.
pub(crate) fn log_spaced(low: f64, high: f64, num: usize) -> Vec<f64> {
    linear_spaced(low.ln(), high.ln(), num).into_iter().map(f64::exp).collect()
}
