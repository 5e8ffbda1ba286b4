//! Names that are taken back: for being usual, for not being of one size, or for being weak beside what is left.

use crate::DiagnosisError;
use crate::engine::{Contributions, Naming};
use crate::fired::{self, Fired, InForce};
use crate::reference::Reference;
use crate::tactile::TactileDomain;

/// Highest evidence of effects like it in reference sessions, over that of a name, at most: a name is twice as far beyond the
/// smallest size that matters as these are, in standard errors.
pub(crate) const MOST_USUAL: f64 = 0.25;
/// Less than any evidence that counts: keeps quotients finite, as reports need them.
const NO_EVIDENCE: f64 = 1e-3;
/// How far takes may disagree on the size of a right name: on the tuning stations by up to 0.6; a channel that is stuck, and is
/// said to flicker, is off by as much as it should be.
pub(crate) const MOST_BY_TAKE: f64 = 0.8;
/// Evidence that a name needs where more is left than may be, for each time as much as that. On the tuning stations
/// right first names beside which more is left have 120 and more; names that stand in for an effect of no library
/// have 67 and less, or 400 and more.
pub(crate) const EVIDENCE_BESIDE_REST: f64 = 80.0;

/// Takes back names of `naming`, beyond the first `known`, that are usual or not of one size.
///
/// Sizes are not asked where the names are a part of what was found (`is_part`), because what is missing beside them
/// differs from take to take, nor of events alone, which are few.
pub(crate) fn withhold(
    domain: &TactileDomain<'_>,
    known: usize,
    naming: &mut Naming,
    fitted: &[usize],
    is_part: bool,
    reference: &Reference,
    rules: InForce<'_>,
) -> Result<(), DiagnosisError> {
    withhold_usual(known, naming, reference, rules);
    if domain.num_raw_takes() > 0 && !is_part && rules.has(fired::BY_TAKE) {
        withhold_disagreeing(domain, known, naming, fitted, rules)?;
    }
    Ok(())
}

/// Takes back names beyond the first `known` that are too weak beside what is left, the weakest first, each time
/// fitting the others without it; says whether any was. See [`too_weak`].
pub(crate) fn withhold_weak(
    domain: &TactileDomain<'_>,
    known: usize,
    naming: &mut Naming,
    fitted: &[usize],
    overdispersion: f64,
    rules: InForce<'_>,
) -> Result<bool, DiagnosisError> {
    let count = naming.model.effects.len();
    while let Some((weakest, why)) = too_weak(&naming.evidence, known, overdispersion, rules) {
        naming.withhold_one(domain, weakest, fitted, why)?;
    }
    Ok(naming.model.effects.len() < count)
}

/// The weakest of the names beyond the first `known` with this `evidence`, if it is too weak where `overdispersion`
/// times as much is left as may be.
///
/// Standard errors hold for a model that is right but for noise. Where more is left, variances are as many times
/// larger (the dispersion of a quasi-likelihood), and an effect that is not there explains a part of it.
fn too_weak(
    evidence: &[f64],
    known: usize,
    overdispersion: f64,
    rules: InForce<'_>,
) -> Option<(usize, Fired)> {
    if overdispersion <= 1.0 {
        return None;
    }
    let of_names = evidence.iter().copied().enumerate().skip(known);
    let (weakest, evidence) = of_names.min_by(|(_, one), (_, other)| one.total_cmp(other))?;
    let measured = EVIDENCE_BESIDE_REST * overdispersion / evidence.max(NO_EVIDENCE);
    Some((weakest, rules.above(fired::WEAK_BESIDE_REST, measured, 1.0)?))
}

/// Takes back names beyond the first `known` that have not much more evidence than effects like them have in sessions in which
/// nothing is wrong. They are there, and usual: the others stay as they were fitted beside them.
fn withhold_usual(known: usize, naming: &mut Naming, reference: &Reference, rules: InForce<'_>) {
    for idx in (known..naming.model.effects.len()).rev() {
        let Some(usual) = reference.evidence_of(&naming.model.effects[idx]) else { continue };
        let measured = usual / naming.evidence[idx].max(NO_EVIDENCE);
        if let Some(why) = rules.above(fired::USUAL, measured, MOST_USUAL) {
            naming.set_aside(idx, why);
        }
    }
}

/// Takes back names beyond the first `known` on whose size the takes do not agree, the worst first.
fn withhold_disagreeing(
    domain: &TactileDomain<'_>,
    known: usize,
    naming: &mut Naming,
    fitted: &[usize],
    rules: InForce<'_>,
) -> Result<(), DiagnosisError> {
    while naming.model.effects.len() > known {
        let disagreements = Contributions::of(domain, &naming.model, fitted)?.disagreements()?;
        let of_names = disagreements.into_iter().enumerate().skip(known);
        let worst = of_names.max_by(|(_, one), (_, other)| one.total_cmp(other));
        let fired = worst.and_then(|(idx, of)| Some((idx, rules.above(fired::BY_TAKE, of, MOST_BY_TAKE)?)));
        let Some((worst, why)) = fired else { break };
        naming.withhold_one(domain, worst, fitted, why)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn a_name_needs_more_evidence_the_more_is_left() {
        let shipped = BTreeMap::new();
        let rules = InForce::scaled(&shipped);
        let weakest = |overdispersion| too_weak(&[3.0, 900.0, 200.0, 500.0], 1, overdispersion, rules);
        assert_eq!(weakest(0.9), None, "no more is left than may be");
        assert_eq!(weakest(2.0), None);
        let (idx, why) = weakest(3.0).unwrap();
        assert_eq!((idx, why.rule), (2, fired::WEAK_BESIDE_REST), "what the model had already is no name");
        assert!((why.measured - 3.0 * EVIDENCE_BESIDE_REST / 200.0).abs() < 1e-12, "{why:?}");
        assert_eq!(too_weak(&[3.0], 1, 9.0, rules), None, "no names");
        assert!(too_weak(&[f64::NAN], 0, 9.0, rules).is_none_or(|(_, why)| why.measured.is_finite()));
    }
}
