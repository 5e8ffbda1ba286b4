//! Names that are taken back for the company they are in.

use std::collections::BTreeSet;

use palpate_robot_model::Place;
use palpate_sim::effects::{self, Effect, Stage};

use crate::DiagnosisError;
use crate::engine::{Domain, Model, Naming, within};
use crate::tactile::TactileDomain;

/// Share of the evidence of a name below which another one of the same parts is taken for a remainder of it.
const LEAST_BESIDE: f64 = 0.2;

/// Takes back names beyond the first `known` that reach all that a stronger name of another effect reaches, each at a patch, a
/// joint or an object, with little evidence beside it: how skin and object meet is modelled roughly, and what a right name
/// leaves of that looks like one more small fault of the same finger. A fault that is there is found again once the first is in
/// the model.
pub(crate) fn withhold_remainders(
    domain: &TactileDomain<'_>,
    known: usize,
    naming: &mut Naming,
    fitted: &[usize],
) -> Result<(), DiagnosisError> {
    let is_placed =
        |effect: &Effect| matches!(effect.place, Place::Patch(_) | Place::Joint(_) | Place::Object(_));
    loop {
        let named = &naming.model.effects[known..];
        let evidence = &naming.evidence[known..];
        let is_remainder = |idx: usize| {
            let reach = domain.reach(&named[idx]);
            named.iter().zip(evidence).any(|(other, of_other)| {
                other.id != named[idx].id
                    && is_placed(other)
                    && evidence[idx] < LEAST_BESIDE * of_other
                    && within(&domain.reach(other), &reach)
            })
        };
        let remainder = (0..named.len()).filter(|&idx| is_placed(&named[idx])).find(|&idx| is_remainder(idx));
        let Some(remainder) = remainder else { return Ok(()) };
        naming.withhold_one(domain, known + remainder, fitted)?;
    }
}

/// Takes back names beyond those of `start` that are about one patch and do not stand, see [`num_standing`].
pub(crate) fn withhold_at_one_patch(
    domain: &TactileDomain<'_>,
    start: &Model,
    naming: &mut Naming,
    fitted: &[usize],
) -> Result<(), DiagnosisError> {
    let known = start.effects.len();
    let named = &naming.model.effects[known..];
    let patches: Vec<BTreeSet<usize>> = named.iter().map(|effect| domain.patches(effect)).collect();
    match num_standing(named, &patches) {
        0 => naming.withhold(start),
        standing => {
            while naming.model.effects.len() > known + standing {
                naming.withhold_one(domain, known + standing, fitted)?;
            }
        }
    }
    Ok(())
}

/// How many of the names stand, the weightiest first, of effects that reach these `patches`: all, unless they are two or more
/// that are all about how one patch is moved and loaded. Then the weightiest stands if it is of the patch itself: the others are
/// what the rough model of that patch leaves. A joint, or channels, that explain what is felt at one patch only with the help
/// of others there stand in for something else.
fn num_standing(named: &[Effect], patches: &[BTreeSet<usize>]) -> usize {
    let is_of_skin = |effect: &Effect| {
        effects::tactile(&effect.id).is_some_and(|kind| kind.stage() <= Stage::Contact)
            && !matches!(effect.place, Place::Stream(_) | Place::Object(_))
    };
    let [weightiest, _, ..] = named else { return named.len() };
    let shared = patches.iter().cloned().reduce(|shared, patches| &shared & &patches).unwrap_or_default();
    if shared.is_empty() || !named.iter().all(is_of_skin) {
        return named.len();
    }
    usize::from(matches!(weightiest.place, Place::Patch(_)))
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
        num_standing(named, &patches)
    }

    #[test]
    fn a_joint_that_needs_help_at_one_patch_is_something_else() {
        let crosstalk = patch("elastic_crosstalk");
        assert_eq!(standing(&[joint(), crosstalk.clone()], &[&[3, 4], &[4]]), 0);
        assert_eq!(standing(&[joint(), crosstalk.clone(), channel()], &[&[3, 4], &[4], &[4]]), 0);
        assert_eq!(standing(&[channel(), channel()], &[&[4], &[4]]), 0);
        assert_eq!(standing(&[joint(), crosstalk], &[&[3], &[4]]), 2, "of another finger");
    }

    #[test]
    fn the_weightiest_name_of_the_patch_itself_stands() {
        let names = [patch("preload"), patch("elastic_crosstalk"), channel()];
        assert_eq!(standing(&names, &[&[4], &[4], &[4]]), 1);
    }

    #[test]
    fn names_alone_or_of_electronics_and_streams_stand() {
        assert_eq!(standing(&[], &[]), 0);
        assert_eq!(standing(&[joint()], &[&[4]]), 1);
        assert_eq!(standing(&[joint(), latency()], &[&[3, 4], &[3, 4, 5]]), 2);
        let dead = named("dead_channel", Place::Channel("thumb_tip.1".to_owned()));
        assert_eq!(standing(&[joint(), dead], &[&[3, 4], &[4]]), 2);
    }
}
