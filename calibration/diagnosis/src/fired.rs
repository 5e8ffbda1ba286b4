//! Names that are withheld, and the rule that does it.

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

/// Which rules are in force.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InForce<'a> {
    without: &'a [String],
}

impl<'a> InForce<'a> {
    pub(crate) fn all_but(without: &'a [String]) -> Self {
        Self { without }
    }

    /// `fired`, if its rule is in force.
    pub(crate) fn keep(&self, fired: Option<Fired>) -> Option<Fired> {
        fired.filter(|fired| self.has(fired.rule))
    }

    pub(crate) fn has(&self, rule: &str) -> bool {
        !self.without.iter().any(|without| without == rule)
    }
}

pub(crate) const USUAL: &str = "usual";
pub(crate) const BY_TAKE: &str = "size_by_take";
pub(crate) const REMAINDER: &str = "remainder";
pub(crate) const ALIKE: &str = "alike";
pub(crate) const ONE_PLACE: &str = "one_place";
pub(crate) const WEAK_BESIDE_REST: &str = "weak_beside_rest";
pub(crate) const REPEATS_MORE: &str = "repeats_more";
pub(crate) const LEFT_AT_PATCH: &str = "left_at_patch";
pub(crate) const POSTURE: &str = "posture";
pub(crate) const GAP_GROWS: &str = "gap_grows";
