//! Names that are withheld, and the rule that does it.

use std::collections::BTreeMap;

use palpate_sim::effects::Effect;

/// Why a name was withheld.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fired {
    /// Id of the rule.
    pub rule: &'static str,
    /// What it measured.
    pub measured: f64,
    /// What it allows.
    pub limit: f64,
}

impl Fired {
    /// The rule `rule`, if it allows `limit` and `measured` is above that.
    pub(crate) fn above(rule: &'static str, measured: f64, limit: f64) -> Option<Self> {
        (measured > limit).then_some(Self { rule, measured, limit })
    }
}

/// A name that was withheld.
#[derive(Clone, Debug, PartialEq)]
pub struct Withheld {
    /// The effect as it was fitted when it was withheld.
    pub effect: Effect,
    /// Why.
    pub why: Fired,
}

/// The rules in force, and by how much their limits are other than shipped.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InForce<'a> {
    scales: &'a BTreeMap<String, f64>,
}

impl<'a> InForce<'a> {
    /// As in [`crate::DiagnosisConfig::rule_scales`].
    pub(crate) fn scaled(scales: &'a BTreeMap<String, f64>) -> Self {
        Self { scales }
    }

    pub(crate) fn has(&self, rule: &str) -> bool {
        self.scales.get(rule).is_none_or(|scale| scale.is_finite())
    }

    /// The rule `rule`, if it is in force, allows `shipped` as it is shipped, and `measured` is above what it allows.
    pub(crate) fn above(&self, rule: &'static str, measured: f64, shipped: f64) -> Option<Fired> {
        let limit = shipped * self.scales.get(rule).copied().filter(|scale| scale.is_finite()).unwrap_or(1.0);
        Fired::above(rule, measured, limit).filter(|_| self.has(rule))
    }
}

pub(crate) const USUAL: &str = "usual";
pub(crate) const BY_TAKE: &str = "size_by_take";
pub(crate) const WEAK_BESIDE_REST: &str = "weak_beside_rest";
pub(crate) const REPEATS_MORE: &str = "repeats_more";
pub(crate) const GAP_GROWS: &str = "gap_grows";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rule_that_is_scaled_allows_more_and_one_that_is_off_all() {
        let scales = BTreeMap::from([(REPEATS_MORE.to_owned(), 1.4), (BY_TAKE.to_owned(), f64::INFINITY)]);
        let rules = InForce::scaled(&scales);
        assert_eq!(rules.above(REPEATS_MORE, 0.4, 0.3), None);
        assert_eq!(rules.above(REPEATS_MORE, 0.5, 0.3).map(|fired| fired.limit), Some(1.4 * 0.3));
        assert_eq!(rules.above(BY_TAKE, 1e9, 0.8), None);
        assert_eq!(rules.above(GAP_GROWS, 1.1, 1.0).map(|fired| fired.limit), Some(1.0));
        assert!(!rules.has(BY_TAKE) && rules.has(GAP_GROWS));
    }
}
