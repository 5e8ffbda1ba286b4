//! The bar that evidence must reach: what the whole pipeline finds in sessions that miss nothing.

use palpate_recording::Take;
use palpate_reports::Bar;
use palpate_sim::SensorModel;
use palpate_sim::job::{Cancel, Progress};
use serde::{Deserialize, Serialize};

use crate::DiagnosisError;
use crate::config::{DiagnosisConfig, KEPT_EVIDENCE, LEAST_SHARE, NUM_FITS};
use crate::engine::{self, NamingConfig};
use crate::prepare::{Prepared, check, prepare};

/// A station's null bar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NullBar {
    /// Least evidence for a name.
    pub evidence: f64,
    /// Highest evidence in each null session, ascending.
    pub maxima: Vec<f64>,
}

impl NullBar {
    /// The bar where a station has none of its own: tuned on sessions of an emulated station in which nothing is hidden.
    pub const DEFAULT_EVIDENCE: f64 = 12.0;

    /// How sessions are searched that miss nothing: by the shipped bar.
    pub(crate) fn naming(max_effects: usize) -> NamingConfig {
        NamingConfig {
            max_effects,
            bar: Self::DEFAULT_EVIDENCE,
            kept_bar: KEPT_EVIDENCE,
            least_share: LEAST_SHARE,
            num_fits: NUM_FITS,
            without: Vec::new(),
        }
    }

    /// Probability of evidence this strong if nothing is missing, from the null sessions; `None` without any. The
    /// normal distribution would not do in their place: standard errors leave out that the model is only roughly right,
    /// so that it gives probabilities many orders of magnitude too small.
    pub fn p_value(&self, evidence: f64) -> Option<f64> {
        let as_strong = self.maxima.iter().filter(|maximum| **maximum >= evidence).count();
        (!self.maxima.is_empty()).then(|| (1 + as_strong) as f64 / (1 + self.maxima.len()) as f64)
    }

    pub(crate) fn to_report(&self) -> Bar {
        Bar { evidence: self.evidence, null_sessions: self.maxima.len(), null_maxima: self.maxima.clone() }
    }
}

/// Share of null sessions that stay below the bar.
const BELOW_BAR: f64 = 0.95;

/// Finds the bar of the station of `takes`: simulates `sessions` sessions with the motions of `takes` from the
/// calibrated model, with noise and nothing missing, and searches each of them for effects.
///
/// Simulated sessions agree with the model in everything but noise, real ones do not: so the bar is never below
/// [`NullBar::DEFAULT_EVIDENCE`], which was tuned on sessions of a world of another make.
pub fn null_bar(
    config: &DiagnosisConfig,
    takes: &[Take],
    nominal: &SensorModel,
    sessions: usize,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<NullBar, DiagnosisError> {
    let station = check(config, takes)?;
    let Prepared { domain, start, fitted, .. } = prepare(config, station, takes, nominal, cancel)?;
    let naming = NamingConfig { without: config.without.clone(), ..NullBar::naming(0) };
    let mut maxima = Vec::with_capacity(sessions);
    for session in 0..sessions {
        progress.report(
            session as f64 / sessions as f64,
            &format!("searching null session {} of {sessions}", session + 1),
        );
        let simulated = domain.simulated(&start, config.seed.wrapping_add(session as u64))?;
        let model = engine::refit(&simulated, &start, &fitted, 2)?;
        let watch = |_: f64, _: &str| match cancel.is_cancelled() {
            true => Err(DiagnosisError::Cancelled),
            false => Ok(()),
        };
        maxima.push(engine::strongest(&simulated, &model, &fitted, &naming, &watch)?);
    }
    maxima.sort_unstable_by(f64::total_cmp);
    let position = (BELOW_BAR * maxima.len() as f64).ceil() as usize;
    let of_null = maxima.get(position.saturating_sub(1)).copied().unwrap_or(0.0);
    progress.report(1.0, "done");
    Ok(NullBar { evidence: of_null.max(NullBar::DEFAULT_EVIDENCE), maxima })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_probability_comes_from_null_sessions_or_not_at_all() {
        let bar = NullBar { evidence: 12.0, maxima: vec![2.0, 5.0, 11.0] };
        assert_eq!(bar.p_value(5.0), Some(0.75));
        assert_eq!(bar.p_value(1200.0), Some(0.25), "three sessions tell no smaller one");
        assert_eq!(NullBar { maxima: Vec::new(), ..bar }.p_value(1200.0), None);
    }
}
