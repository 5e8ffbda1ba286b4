//! The paper's method: a grid over bounded ranges of theta.

use std::sync::atomic::{AtomicUsize, Ordering};

use palpate_robot_model::SensorKind;
use palpate_sim::{
    SensorModel, Theta,
    tactile::{self, Readings, is_active},
};
use rayon::prelude::*;

use super::{FitData, GridAxes, Watch};
use crate::CalibrationError;

/// The objective at every point of the grid. As the two modalities share no parameter, the L1 at a point is the sum of
/// its two parts.
#[derive(Clone, Debug, PartialEq)]
pub struct GridResult {
    /// Where.
    pub axes: GridAxes,
    /// L1 of the pressure channels, `[alpha][lambda_pre]`.
    pub pressure_l1: Vec<Vec<u64>>,
    /// L1 of the proximity channels, `[lambda_con]`.
    pub proximity_l1: Vec<u64>,
    /// Points of the objective that were counted.
    pub evaluations: u64,
}

impl GridResult {
    /// The objective at the best point: both parts, each zero where it has no axis.
    pub fn l1(&self) -> u64 {
        self.best_lambda_con_m().map_or(0, |(_, l1)| l1) + self.best_alpha().map_or(0, |(_, _, l1)| l1)
    }

    /// Best `(lambda_con, L1)`; the lowest where several are as good.
    pub fn best_lambda_con_m(&self) -> Option<(f64, u64)> {
        let points = self.axes.lambda_cons_m.iter().copied().zip(self.proximity_l1.iter().copied());
        points.min_by_key(|&(_, l1)| l1)
    }

    /// Best `(alpha, lambda_pre, L1)`; the first where several are as good.
    pub fn best_alpha(&self) -> Option<(f64, f64, u64)> {
        let points = self.axes.alphas_per_m.iter().zip(&self.pressure_l1).flat_map(|(&alpha, row)| {
            self.axes.lambda_pres_pa.iter().zip(row).map(move |(&lambda_pre, &l1)| (alpha, lambda_pre, l1))
        });
        points.min_by_key(|&(_, _, l1)| l1)
    }
}

/// Counts the objective at every point of `axes`, by comparing events: pressures once per alpha, distances once.
pub fn grid(data: &FitData<'_>, axes: GridAxes, watch: Watch<'_>) -> Result<GridResult, CalibrationError> {
    let done = AtomicUsize::new(0);
    let num_units = axes.alphas_per_m.len() + 1;
    let pressure_l1: Vec<Vec<u64>> = axes
        .alphas_per_m
        .par_iter()
        .map(|&alpha_per_m| {
            let stage = format!("alpha = {alpha_per_m:.4} /m, every lambda_pre");
            watch.step(done.load(Ordering::Relaxed), num_units, &stage)?;
            let columns = count(data, alpha_per_m, SensorKind::Pressure, &axes.lambda_pres_pa);
            done.fetch_add(1, Ordering::Relaxed);
            Ok(columns)
        })
        .collect::<Result<_, CalibrationError>>()?;
    watch.step(num_units - 1, num_units, "every lambda_con")?;
    let proximity_l1 = count(data, 0.0, SensorKind::Proximity, &axes.lambda_cons_m);
    let evaluations = (axes.alphas_per_m.len() * axes.lambda_pres_pa.len() + axes.lambda_cons_m.len()) as u64;
    Ok(GridResult { axes, pressure_l1, proximity_l1, evaluations })
}

/// For each threshold, the channel-frames of sensors of `kind` that differ.
fn count(data: &FitData<'_>, alpha_per_m: f64, kind: SensorKind, thresholds: &[f64]) -> Vec<u64> {
    let num_channels = data.layout().num_channels();
    let channels = data.channels(kind);
    let mut l1 = vec![0; thresholds.len()];
    for take in data.takes() {
        let raw = tactile::raw_signals(data.layout(), &take.contact, alpha_per_m);
        for (raw, real) in raw.chunks_exact(num_channels).zip(take.real_active.chunks_exact(num_channels)) {
            for (l1, &threshold) in l1.iter_mut().zip(thresholds) {
                *l1 += channels.iter().filter(|&&c| is_active(kind, raw[c], threshold) != real[c]).count()
                    as u64;
            }
        }
    }
    l1
}

/// The objective at one theta, the long way: through the sensor model's own readings.
pub fn l1_of_readings(data: &FitData<'_>, theta: Theta) -> u64 {
    let model = SensorModel::plain("", theta);
    let l1_of_take = |take: &&crate::PairedTake| {
        let Readings { active, .. } = tactile::readings(data.layout(), &take.contact, &model.thetas());
        active.iter().zip(&take.real_active).filter(|(simulated, real)| simulated != real).count() as u64
    };
    data.takes().iter().map(l1_of_take).sum()
}
