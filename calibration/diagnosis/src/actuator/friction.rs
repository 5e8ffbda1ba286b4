//! Friction of a kind that logs do not tell.
//!
//! Friction is easy to see and hard to tell apart: at one gain and under one load, what grows with the load, with the
//! speed or with neither brakes nearly alike.

use palpate_sim::actuator::{ActuatorEffect, actuator};
use palpate_sim::effects::Effect;

use super::experiment::Rivals;
use super::{ActuatorDomain, FIT_STEPS, loss};
use crate::DiagnosisError;
use crate::engine::{Domain as _, Model, RIVAL_SHARE, refit};

/// A kind of friction that explains what is there as well as the one that is named.
pub(super) struct FrictionRival {
    /// Id of the effect that is named.
    pub(super) of: String,
    /// The other one, fitted in its place.
    pub(super) effect: Effect,
    /// The model with it, everything else fitted anew.
    pub(super) model: Model,
}

/// Whether `effect` is a friction.
pub(super) fn is_friction(effect: &Effect) -> bool {
    actuator(&effect.id).is_some_and(ActuatorEffect::is_friction)
}

/// Kinds of friction that explain `takes` as well as those that `model` names, each in the place of one of them, with
/// no more parameters: a curve that fades may fade at no speed that was seen, and is then a constant.
///
/// Unlike the rivals of a round, they are fitted beside all that was named since.
pub(super) fn rivals(
    domain: &ActuatorDomain<'_>,
    model: &Model,
    takes: &[usize],
    without: &[String],
) -> Result<Vec<FrictionRival>, DiagnosisError> {
    let is_named = |id: &str| model.effects.iter().any(|named| named.id == id);
    let num_parameters = |effect: &Effect| domain.parameters(effect).len();
    let mut rivals = Vec::new();
    for (idx, named) in model.effects.iter().enumerate().filter(|(_, effect)| is_friction(effect)) {
        let others = kinds(domain, without)
            .filter(|other| !is_named(&other.id) && num_parameters(other) <= num_parameters(named));
        let with = loss(domain, model, takes)?;
        let mut bare = model.clone();
        bare.effects.remove(idx);
        let bare = loss(domain, &refit(domain, &bare, takes, FIT_STEPS)?, takes)?;
        for other in others {
            let mut rival = model.clone();
            rival.effects[idx] = dosed(domain, other);
            let rival = refit(domain, &rival, takes, FIT_STEPS)?;
            if bare - loss(domain, &rival, takes)? > RIVAL_SHARE * (bare - with) {
                let effect = rival.effects[idx].clone();
                rivals.push(FrictionRival { of: named.id.clone(), effect, model: rival });
            }
        }
    }
    Ok(rivals)
}

/// Dry friction, N m, and viscous friction, N m s / rad, that explain the windows of `takes` best beside `model`, which
/// names none.
pub(super) fn of_no_name(
    domain: &ActuatorDomain<'_>,
    model: &Model,
    takes: &[usize],
) -> Result<[f64; 2], DiagnosisError> {
    let mut with = model.clone();
    let kinds = ["coulomb_friction", "viscous_friction"];
    let both = domain.candidates().into_iter().filter(|effect| kinds.contains(&effect.id.as_str()));
    with.effects.extend(both.map(|effect| dosed(domain, effect)));
    let with = refit(domain, &with, takes, FIT_STEPS)?;
    Ok(kinds.map(|kind| {
        let effect = with.effects.iter().find(|effect| effect.id == kind);
        effect.and_then(|effect| effect.parameters.values().next().copied()).unwrap_or(0.0)
    }))
}

/// The two kinds of friction of one parameter that explain `takes` best beside `model`, which names none.
pub(super) fn likeliest(
    domain: &ActuatorDomain<'_>,
    model: &Model,
    takes: &[usize],
    without: &[String],
) -> Result<Option<Rivals>, DiagnosisError> {
    let mut fits = Vec::new();
    for effect in kinds(domain, without).filter(|effect| domain.parameters(effect).len() == 1) {
        let mut with = model.clone();
        with.effects.push(dosed(domain, effect));
        let with = refit(domain, &with, takes, FIT_STEPS)?;
        fits.push((loss(domain, &with, takes)?, with));
    }
    fits.sort_by(|a, b| a.0.total_cmp(&b.0));
    let id = |model: &Model| model.effects.last().map_or_else(String::new, |effect| effect.id.clone());
    let mut best = fits.into_iter().map(|(_, model)| model);
    Ok(best.next().zip(best.next()).map(|(a, b)| Rivals { ids: [id(&a), id(&b)], models: [a, b] }))
}

/// Kinds of friction, but for those that are left out of the library.
fn kinds(domain: &ActuatorDomain<'_>, without: &[String]) -> impl Iterator<Item = Effect> {
    domain.candidates().into_iter().filter(|effect| is_friction(effect) && !without.contains(&effect.id))
}

/// `effect` with a dose of its first parameter, from which a fit can begin.
fn dosed(domain: &ActuatorDomain<'_>, mut effect: Effect) -> Effect {
    if let Some(parameter) = domain.parameters(&effect).into_iter().next() {
        effect.parameters.insert(parameter.name, parameter.neutral + parameter.dose);
    }
    effect
}
