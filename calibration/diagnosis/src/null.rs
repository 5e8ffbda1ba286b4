//! The bar that evidence must reach: what the whole pipeline finds in sessions that miss nothing.

use palpate_wire::api::Bar;
use serde::{Deserialize, Serialize};

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
    pub const DEFAULT_EVIDENCE: f64 = 16.0;

    /// Limits of the adequacy statistics, tuned likewise.
    pub const DEFAULT_ADEQUACY: Adequacy = Adequacy { repeating: 0.35, common_mode: 2.0 };

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
