//! Names that are taken back: for not being of one size, or for the company they are in.

use std::collections::BTreeSet;

use palpate_robot_model::Place;
use palpate_sim::effects::{self, Effect, Stage};

use crate::DiagnosisError;
use crate::engine::{Contributions, Domain, Model, Naming, within};
use crate::fired::{self, Fired, InForce};
use crate::reference::Reference;
use crate::tactile::{TactileDomain, is_local};

/// Highest evidence of effects like it in reference sessions, over that of a name, at most: a name is twice as far beyond the
/// smallest size that matters as these are, in standard errors.
pub(crate) const MOST_USUAL: f64 = 0.25;
/// Less than any evidence that counts: keeps quotients finite, as reports need them.
const NO_EVIDENCE: f64 = 1e-3;
/// Evidence of a name, over that of another one of the same parts, beyond which the other is taken for a remainder of
/// it.
pub(crate) const MOST_BESIDE: f64 = 5.0;
/// How far takes may disagree on the size of a right name: on the tuning stations by up to 0.6; a channel that is stuck, and is
/// said to flicker, is off by as much as it should be.
pub(crate) const MOST_BY_TAKE: f64 = 0.8;
/// Evidence that a name needs where more is left than may be, for each time as much as that. On the tuning stations
/// right first names beside which more is left have 120 and more; names that stand in for an effect of no library
/// have 67 and less, or 400 and more.
pub(crate) const EVIDENCE_BESIDE_REST: f64 = 80.0;
/// Cosine between what two names add to the readings from which they do nearly the same: of right ones at most 0.11, of a bent
/// joint and a stiffer layer in place of a preload 0.7.
pub(crate) const ALIKE: f64 = 0.3;
/// Faults of so many kinds at one patch are one of another kind.
const MANY_KINDS: usize = 3;

/// Takes back names of `naming`, beyond those of `start`, that cannot be the names of what is missing. Sizes tell nothing where
/// the names are a part of what was found (`is_part`), since what is missing beside them differs from take to take, nor where
/// there are events alone, which are few.
pub(crate) fn withhold(
    domain: &TactileDomain<'_>,
    start: &Model,
    naming: &mut Naming,
    fitted: &[usize],
    is_part: bool,
    reference: &Reference,
    rules: InForce<'_>,
) -> Result<(), DiagnosisError> {
    let known = start.effects.len();
    let has_readings = domain.num_raw_takes() > 0;
    withhold_usual(known, naming, reference, rules);
    if has_readings && !is_part && rules.has(fired::BY_TAKE) {
        withhold_disagreeing(domain, known, naming, fitted, rules)?;
    }
    if rules.has(fired::REMAINDER) {
        withhold_remainders(domain, known, naming, fitted, rules)?;
    }
    if has_readings && rules.has(fired::ALIKE) {
        withhold_alike(domain, known, naming, fitted, rules)?;
    }
    withhold_at_one_place(domain, start, naming, fitted, rules)
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

/// Takes back names beyond the first `known` that reach all that a stronger name of another effect reaches, each at a patch, a
/// joint or an object, with little evidence beside it: how skin and object meet is modelled roughly, and what a right name
/// leaves of that looks like one more small fault of the same finger. A fault that is there is found again once the first is in
/// the model.
fn withhold_remainders(
    domain: &TactileDomain<'_>,
    known: usize,
    naming: &mut Naming,
    fitted: &[usize],
    rules: InForce<'_>,
) -> Result<(), DiagnosisError> {
    let is_placed =
        |effect: &Effect| matches!(effect.place, Place::Patch(_) | Place::Joint(_) | Place::Object(_));
    loop {
        let named = &naming.model.effects[known..];
        let evidence = &naming.evidence[known..];
        let beside_stronger = |idx: usize| {
            let reach = domain.reach(&named[idx]);
            named.iter().zip(evidence).find_map(|(other, of_other)| {
                let measured = of_other / evidence[idx].max(NO_EVIDENCE);
                let why = rules.above(fired::REMAINDER, measured, MOST_BESIDE)?;
                let is_of_same =
                    other.id != named[idx].id && is_placed(other) && within(&domain.reach(other), &reach);
                is_of_same.then_some(why)
            })
        };
        let mut placed = (0..named.len()).filter(|&idx| is_placed(&named[idx]));
        let remainder = placed.find_map(|idx| Some((idx, beside_stronger(idx)?)));
        let Some((remainder, why)) = remainder else { return Ok(()) };
        naming.withhold_one(domain, known + remainder, fitted, why)?;
    }
}

/// Takes back pairs of names beyond the first `known` that do nearly the same, neither of them a remainder of the other: what
/// takes one effect with a part of another to explain it is a third one. Streams are often late and smoothed as well.
fn withhold_alike(
    domain: &TactileDomain<'_>,
    known: usize,
    naming: &mut Naming,
    fitted: &[usize],
    rules: InForce<'_>,
) -> Result<(), DiagnosisError> {
    loop {
        let contributions = Contributions::of(domain, &naming.model, fitted)?;
        let is_placed = |idx: &usize| !matches!(naming.model.effects[*idx].place, Place::Stream(_));
        let placed: Vec<usize> = (known..naming.model.effects.len()).filter(is_placed).collect();
        let pairs =
            placed.iter().enumerate().flat_map(|(at, &two)| placed[..at].iter().map(move |&one| (one, two)));
        let mut alike = pairs.filter_map(|(one, two)| {
            let cosine = contributions.likeness(one, two).abs();
            rules.above(fired::ALIKE, cosine, ALIKE).map(|why| (one, two, why))
        });
        let Some((one, two, why)) = alike.next() else { break };
        naming.withhold_one(domain, two, fitted, why)?;
        naming.withhold_one(domain, one, fitted, why)?;
    }
    Ok(())
}

/// Takes back names beyond those of `start` that are about one patch or one finger and do not stand, see [`num_standing`].
fn withhold_at_one_place(
    domain: &TactileDomain<'_>,
    start: &Model,
    naming: &mut Naming,
    fitted: &[usize],
    rules: InForce<'_>,
) -> Result<(), DiagnosisError> {
    let known = start.effects.len();
    let named = &naming.model.effects[known..];
    let patches: Vec<BTreeSet<usize>> = named.iter().map(|effect| domain.patches(effect)).collect();
    let (standing, count) = (num_standing(named, &patches, &domain.limbs()), named.len());
    let Some(why) = rules.above(fired::ONE_PLACE, (count - standing) as f64, 0.0) else { return Ok(()) };
    match standing {
        0 => naming.withhold(start, why),
        standing => {
            while naming.model.effects.len() > known + standing {
                naming.withhold_one(domain, known + standing, fitted, why)?;
            }
        }
    }
    Ok(())
}

/// How many of the names stand, the weightiest first, of effects that reach these `patches`; `limbs` says of every patch on
/// which finger it is. All, unless they all act at one patch or on one finger. If they are about how that patch is moved and
/// loaded, the weightiest stands if it is of the patch itself: the others are what the rough model of that patch leaves. A
/// joint, or channels, that explain what is felt at one patch only with the help of others there stand in for something
/// else, and so do faults of many kinds, and pads of one finger that feel more or less than they should, each to its own
/// degree.
fn num_standing(named: &[Effect], patches: &[BTreeSet<usize>], limbs: &[usize]) -> usize {
    let is_of_skin =
        |effect: &Effect| effects::tactile(&effect.id).is_some_and(|kind| kind.stage() <= Stage::Contact);
    let [weightiest, _, ..] = named else { return named.len() };
    if !named.iter().all(is_local) {
        return named.len();
    }
    let all_of_skin = named.iter().all(is_of_skin);
    let shared = patches.iter().cloned().reduce(|shared, patches| &shared & &patches).unwrap_or_default();
    if shared.is_empty() {
        let touched: BTreeSet<usize> = patches.iter().flatten().map(|&patch| limbs[patch]).collect();
        let has_channel = named.iter().any(|effect| matches!(effect.place, Place::Channel(_)));
        return if touched.len() == 1 && all_of_skin && has_channel { 0 } else { named.len() };
    }
    if all_of_skin {
        return usize::from(matches!(weightiest.place, Place::Patch(_)));
    }
    let kinds: BTreeSet<&str> = named.iter().map(|effect| effect.id.as_str()).collect();
    if kinds.len() < MANY_KINDS { named.len() } else { 0 }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    fn named(id: &str, place: Place) -> Effect {
        let (parameters, interval) = (BTreeMap::new(), BTreeMap::new());
        Effect { id: id.to_owned(), place, parameters, interval, takes: Vec::new() }
    }

    fn joint() -> Effect {
        named("joint_offset", Place::Joint("thumb_ip".to_owned()))
    }

    fn patch(id: &str) -> Effect {
        named(id, Place::Patch("thumb_tip".to_owned()))
    }

    fn channel() -> Effect {
        named("sensitivity_spread", Place::Channel("thumb_tip.1".to_owned()))
    }

    fn latency() -> Effect {
        named("latency", Place::Stream("film".to_owned()))
    }

    fn standing(named: &[Effect], patches: &[&[usize]]) -> usize {
        let patches: Vec<BTreeSet<usize>> =
            patches.iter().map(|patches| patches.iter().copied().collect()).collect();
        // Fingers of two patches each.
        num_standing(named, &patches, &[0, 0, 1, 2, 2, 3, 3])
    }

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

    #[test]
    fn a_joint_that_needs_help_at_one_patch_is_something_else() {
        let crosstalk = patch("elastic_crosstalk");
        assert_eq!(standing(&[joint(), crosstalk.clone()], &[&[3, 4], &[4]]), 0);
        assert_eq!(standing(&[joint(), crosstalk.clone(), channel()], &[&[3, 4], &[4], &[4]]), 0);
        assert_eq!(standing(&[channel(), channel()], &[&[4], &[4]]), 0);
        assert_eq!(standing(&[joint(), crosstalk], &[&[1], &[4]]), 2, "of another finger");
    }

    #[test]
    fn faults_of_three_kinds_at_one_patch_are_something_else() {
        let dead = named("dead_channel", Place::Channel("thumb_tip.1".to_owned()));
        let names = [joint(), patch("sensor_mount_offset"), dead];
        assert_eq!(standing(&names, &[&[3, 4], &[4], &[4]]), 0);
        assert_eq!(standing(&names, &[&[1], &[4], &[4]]), 3, "of another finger");
    }

    #[test]
    fn the_weightiest_name_of_the_patch_itself_stands() {
        let names = [patch("preload"), patch("elastic_crosstalk"), channel()];
        assert_eq!(standing(&names, &[&[4], &[4], &[4]]), 1);
    }

    #[test]
    fn pads_of_one_finger_that_are_off_each_by_its_own_are_something_else() {
        assert_eq!(standing(&[channel(), channel()], &[&[3], &[4]]), 0);
        assert_eq!(standing(&[joint(), channel()], &[&[4], &[3]]), 0);
        assert_eq!(standing(&[channel(), channel()], &[&[1], &[4]]), 2, "of two fingers");
        assert_eq!(standing(&[joint(), patch("preload")], &[&[4], &[3]]), 2, "no pad is off");
        assert_eq!(standing(&[channel(), channel(), latency()], &[&[3], &[4], &[4]]), 3, "beside a stream");
    }

    #[test]
    fn names_alone_or_of_electronics_and_streams_stand() {
        assert_eq!(standing(&[], &[]), 0);
        assert_eq!(standing(&[joint()], &[&[4]]), 1);
        assert_eq!(standing(&[joint(), latency()], &[&[3, 4], &[3, 4, 5]]), 2);
        let dead = named("dead_channel", Place::Channel("thumb_tip.1".to_owned()));
        assert_eq!(standing(&[joint(), dead.clone()], &[&[3, 4], &[4]]), 2);
        assert_eq!(standing(&[joint(), dead.clone(), dead.clone()], &[&[3, 4], &[4], &[4]]), 3);
        assert_eq!(
            standing(&[dead.clone(), dead.clone(), dead], &[&[4], &[4], &[4]]),
            3,
            "a cable that broke"
        );
    }
}
