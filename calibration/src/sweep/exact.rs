//! Exact in both thresholds, searched in alpha only.

use std::sync::atomic::{AtomicUsize, Ordering};

use palpate_robot_model::SensorKind;
use rayon::prelude::*;

use super::{BestThreshold, FitData, Ranked, Watch};
use crate::CalibrationError;

/// Rounds of refinement about the best alpha; each narrows its bracket to a third.
pub(crate) const REFINEMENT_ROUNDS: usize = 3;

/// What the exact search found.
#[derive(Clone, Debug, PartialEq)]
pub struct ExactResult {
    /// Best `lambda_con`, m, with the L1 of the proximity channels; `None` without any approach to the object.
    pub lambda_con_m: Option<BestThreshold>,
    /// Proximity scores, for the curve.
    pub proximity: Ranked,
    /// Every alpha tried, ascending.
    pub tried: Vec<TriedAlpha>,
    /// Steps of the objective that were compared.
    pub evaluations: u64,
}

/// One alpha and its best `lambda_pre`.
#[derive(Clone, Debug, PartialEq)]
pub struct TriedAlpha {
    /// 1/m.
    pub alpha_per_m: f64,
    /// Best `lambda_pre`, Pa, with the L1 of the pressure channels; `None` where no pressure is left.
    pub lambda_pre_pa: Option<BestThreshold>,
    /// Pressures, for the heat map.
    pub pressure: Ranked,
}

impl ExactResult {
    /// The objective at the optimum: both parts.
    pub fn l1(&self) -> u64 {
        let proximity = self.lambda_con_m.map_or(self.proximity.num_real_active(), |best| best.l1);
        let without_pressure = self.tried.first().map_or(0, |alpha| alpha.pressure.num_real_active());
        proximity + self.best_alpha().map_or(without_pressure, |(_, best)| best.l1)
    }

    /// The best alpha and its `lambda_pre`; the smallest such alpha, where several are as good.
    pub fn best_alpha(&self) -> Option<(f64, BestThreshold)> {
        best_of(&self.tried)
            .and_then(|best| Some((self.tried[best].alpha_per_m, self.tried[best].lambda_pre_pa?)))
    }
}

/// Tries every alpha of `alphas_per_m` (ascending), then refines about the best; each with its best threshold over all
/// admissible real numbers. The result has the same bits for any number of threads.
pub fn exact(
    data: &FitData<'_>,
    alphas_per_m: &[f64],
    refinement_rounds: usize,
    watch: Watch<'_>,
) -> Result<ExactResult, CalibrationError> {
    let [start, end] = watch.span;
    let proximity = data.proximity();
    // The score is minus the distance. An interval of scores (closed below) mirrors to one of distances (closed
    // above), as `distance < lambda_con` wants it.
    let lambda_con_m = proximity.best().map(|best| BestThreshold { threshold: -best.threshold, ..best });
    watch.step(0, 1, "distances sorted")?;

    let mut tried = Vec::new();
    if !data.channels(SensorKind::Pressure).is_empty() {
        let middle = start
            + (end - start) * alphas_per_m.len() as f64
                / (alphas_per_m.len() + 4 * refinement_rounds).max(1) as f64;
        tried = try_alphas(data, alphas_per_m, watch.within([start, middle]))?;
        for round in 0..refinement_rounds {
            let between = |round: usize| middle + (end - middle) * round as f64 / refinement_rounds as f64;
            let more = between_neighbours(&tried);
            tried.extend(try_alphas(data, &more, watch.within([between(round), between(round + 1)]))?);
            tried.sort_by(|a, b| a.alpha_per_m.total_cmp(&b.alpha_per_m));
        }
    }
    let pressure_evaluations = tried.iter().filter_map(|alpha| alpha.lambda_pre_pa);
    let evaluations = pressure_evaluations.chain(lambda_con_m).map(|best| best.evaluations).sum();
    Ok(ExactResult { lambda_con_m, proximity, tried, evaluations })
}

fn try_alphas(
    data: &FitData<'_>,
    alphas_per_m: &[f64],
    watch: Watch<'_>,
) -> Result<Vec<TriedAlpha>, CalibrationError> {
    let done = AtomicUsize::new(0);
    alphas_per_m
        .par_iter()
        .map(|&alpha_per_m| {
            watch.step(
                done.load(Ordering::Relaxed),
                alphas_per_m.len(),
                &format!("best threshold for alpha = {alpha_per_m:.4} /m"),
            )?;
            let pressure = data.pressure(alpha_per_m);
            let lambda_pre_pa = pressure.best();
            done.fetch_add(1, Ordering::Relaxed);
            Ok(TriedAlpha { alpha_per_m, lambda_pre_pa, pressure })
        })
        .collect()
}

fn best_of(tried: &[TriedAlpha]) -> Option<usize> {
    let l1 = |idx: usize| tried[idx].lambda_pre_pa.map(|best| best.l1);
    (0..tried.len()).filter(|&idx| l1(idx).is_some()).min_by_key(|&idx| l1(idx))
}

/// Two alphas on either side of the best one, dividing the way to its neighbours into thirds (of the logarithm, except
/// next to zero).
fn between_neighbours(tried: &[TriedAlpha]) -> Vec<f64> {
    let Some(best) = best_of(tried) else { return Vec::new() };
    let neighbours = &tried[best.saturating_sub(1)..(best + 2).min(tried.len())];
    let mut more = Vec::new();
    for two in neighbours.windows(2) {
        let (low, high) = (two[0].alpha_per_m, two[1].alpha_per_m);
        for third in [1.0 / 3.0, 2.0 / 3.0] {
            let alpha = if low > 0.0 { low * (high / low).powf(third) } else { high * third };
            if low < alpha && alpha < high {
                more.push(alpha);
            }
        }
    }
    more
}
