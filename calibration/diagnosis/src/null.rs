//! The bar that evidence must reach: what the whole pipeline finds in sessions that miss nothing.

use palpate_recording::Take;
use palpate_sim::SensorModel;
use palpate_sim::job::{Cancel, Progress};
use palpate_wire::api::Bar;
use serde::{Deserialize, Serialize};

use crate::DiagnosisError;
use crate::engine::{self, NamingConfig};
use crate::job::{DiagnosisConfig, KEPT_EVIDENCE, LEAST_SHARE, NUM_FITS, Prepared, check, prepare};
use crate::tactile::adequacy::Adequacy;

/// A station's null bar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NullBar {
    /// Least evidence for a name.
    pub evidence: f64,
    /// Highest evidence in each null session, ascending.
    pub maxima: Vec<f64>,
    /// What adequacy statistics may be without anything being left.
    #[serde(skip, default = "NullBar::default_adequacy")]
    pub adequacy: Adequacy,
}

impl NullBar {
    /// The bar where a station has none of its own: tuned on sessions of an emulated station in which nothing is hidden.
    pub const DEFAULT_EVIDENCE: f64 = 12.0;

    /// Limits of the adequacy statistics, tuned likewise.
    pub const DEFAULT_ADEQUACY: Adequacy =
        Adequacy { repeating: 0.5, at_patch: 0.85, common_mode: 1.5, loss: 0.61, switching: 0.03 };

    fn default_adequacy() -> Adequacy {
        Self::DEFAULT_ADEQUACY
    }

    /// Probability of evidence this strong if nothing is missing, from the null sessions.
    pub fn p_value(&self, evidence: f64) -> f64 {
        let as_strong = self.maxima.iter().filter(|maximum| **maximum >= evidence).count();
        (1 + as_strong) as f64 / (1 + self.maxima.len()) as f64
    }

    /// The same from the normal distribution and the number of candidates, where there are no null sessions: an upper
    /// bound (Bonferroni).
    pub fn default_p_value(evidence: f64) -> f64 {
        const CANDIDATES: f64 = 500.0;
        let z = evidence.max(0.0).sqrt();
        // Mills' ratio bounds the normal tail.
        let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
        (2.0 * CANDIDATES * density / z.max(1.0)).min(1.0)
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
    let naming = NamingConfig {
        max_effects: 0,
        bar: NullBar::DEFAULT_EVIDENCE,
        kept_bar: KEPT_EVIDENCE,
        least_share: LEAST_SHARE,
        num_fits: NUM_FITS,
        without: config.without.clone(),
    };
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
    Ok(NullBar {
        evidence: of_null.max(NullBar::DEFAULT_EVIDENCE),
        maxima,
        adequacy: NullBar::DEFAULT_ADEQUACY,
    })
}
