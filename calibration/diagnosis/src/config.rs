//! What a diagnosis is asked to do, and what it asks of names.

use std::collections::BTreeMap;

use palpate_calibration::HoldOut;

use crate::reference::Reference;

/// Candidates fitted in a round.
pub(crate) const NUM_FITS: usize = 8;
/// Share of the loss that a named effect removes at least.
pub(crate) const LEAST_SHARE: f64 = 0.002;
/// Evidence that a name must have in the end, beside all others. Of those that had 20 to 25 on the stations of the blind bench
/// four were right, weak all of them, and two stood for effects of no library; of those with less none was right.
pub(crate) const KEPT_EVIDENCE: f64 = 25.0;

/// What to do.
#[derive(Clone, Debug)]
pub struct DiagnosisConfig {
    /// Confirm takes: opened once, for the report.
    pub hold_out: HoldOut,
    /// Most effects to name.
    pub max_effects: usize,
    /// Effects to leave out of the library, by id.
    pub without: Vec<String>,
    /// Factors of the limits of some of [`crate::rules::RULES`], by id; a rule with an infinite one withholds
    /// nothing. For benches that ask what each is good for.
    pub rule_scales: BTreeMap<String, f64>,
    /// Other such factors, to say what would be named with each; what is searched is searched once.
    pub ablation: Vec<BTreeMap<String, f64>>,
    /// What sessions of the station leave in which nothing is wrong; the shipped limits apply without it.
    pub reference: Option<Reference>,
    /// Resamples behind intervals.
    pub bootstrap_resamples: usize,
    /// Seed of resampling.
    pub seed: u64,
}

impl Default for DiagnosisConfig {
    fn default() -> Self {
        Self {
            hold_out: HoldOut::Auto,
            max_effects: 8,
            without: Vec::new(),
            rule_scales: BTreeMap::new(),
            ablation: Vec::new(),
            reference: None,
            bootstrap_resamples: 1000,
            seed: 0,
        }
    }
}
