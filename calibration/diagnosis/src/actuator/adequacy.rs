//! Which names account for what is there, and whether something is left.

use palpate_sim::actuator::{ActuatorEffect, actuator};
use palpate_sim::effects::Effect;

use crate::DiagnosisError;
use crate::engine::{Domain as _, Model, loss_by_unit, share_left};
use crate::fired::Fired;

use super::ActuatorDomain;
use super::domain::SIGNALS;

/// Losses of rows by signal, in variances, above which something is unexplained.
///
/// A misfit of the library's own, of which emulated servos of another make have some whatever is named, is above them too:
/// that something is left takes no name back.
const LIMITS: [f64; SIGNALS] = [0.37, 0.56, 1.0, 0.1];
/// What a model that misses nothing shows.
const COMPLETE: [f64; SIGNALS] = [0.31, 0.48, 0.16, 0.02];
/// Share of the excess that names may leave together, in the signals that one of them changes, and still be the right ones.
const MOST_LEFT: f64 = 0.42;
/// Loss, over [`LIMITS`], that names may leave which are [constants](ActuatorEffect::is_constant) all, whose form is beyond
/// doubt: friction of one direction is nearly a constant friction and an offset of the encoder. On tuning seeds (51, 52) right
/// ones left up to 0.98, that 1.6 and 1.7 where it is strong.
const MOST_LEFT_BY_CONSTANTS: f64 = 1.25;
/// Share of what was there before it that a name may leave beside those that came after it.
const MOST_LEFT_BY_ONE: f64 = 0.75;
/// Factor by which a name may raise the loss of a signal, from no less than a complete model has. A supply that is said
/// to sag shows it in its voltage: what fits the positions and contradicts the voltage stands in for something else.
const MOST_RAISED: f64 = 1.05;
/// Change of a prediction that counts as one, in standard deviations.
const NOTICEABLE: f64 = 0.05;

/// Signals in which `losses` show that something is left.
pub(super) fn left(losses: &[f64]) -> impl Iterator<Item = usize> + '_ {
    (0..SIGNALS).filter(|&signal| losses[signal] > LIMITS[signal])
}

/// Losses of a model by signal.
pub(super) fn losses(
    domain: &ActuatorDomain<'_>,
    model: &Model,
    takes: &[usize],
) -> Result<Vec<f64>, DiagnosisError> {
    loss_by_unit(domain, model, takes)
}

/// The last effect that stands in for something else, if any, and why; `steps` are models with one effect more each.
///
/// It does where it makes a signal worse, where it leaves most of what was there before it, and where all names together
/// leave too much in the signals that it changes: less if none of them is a model of something. What an effect leaves is
/// judged beside those that came after it: the first of two explains little while the second is missing.
pub(super) fn inadequate(
    domain: &ActuatorDomain<'_>,
    steps: &[Model],
    takes: &[usize],
) -> Result<Option<(usize, Fired)>, DiagnosisError> {
    let losses: Vec<Vec<f64>> =
        steps.iter().map(|step| losses(domain, step, takes)).collect::<Result<_, _>>()?;
    let (Some(last), Some(start), Some(now)) = (steps.last(), losses.first(), losses.last()) else {
        return Ok(None);
    };
    let is_constant = |effect: &Effect| actuator(&effect.id).is_some_and(ActuatorEffect::is_constant);
    let of_constants = last.effects.iter().all(is_constant);
    for (idx, before) in losses.iter().enumerate().take(last.effects.len()).rev() {
        let mut without = last.clone();
        without.effects.remove(idx);
        let changed = changed(domain, &without, last, takes)?;
        let left = |before: &[f64]| share_left(now, before, &COMPLETE, &changed);
        let most = |of: &dyn Fn(usize) -> f64| {
            (0..SIGNALS).filter(|signal| changed[*signal]).map(of).fold(0.0, f64::max)
        };
        let raised = most(&|signal| now[signal] / before[signal].max(COMPLETE[signal]));
        let by_constants = most(&|signal| now[signal] / LIMITS[signal]);
        let by_constants = if of_constants { by_constants } else { 0.0 };
        let why = Fired::above("signal_raised", raised, MOST_RAISED)
            .or_else(|| Fired::above("left_by_constants", by_constants, MOST_LEFT_BY_CONSTANTS))
            .or_else(|| Fired::above("left_by_one", left(before), MOST_LEFT_BY_ONE))
            .or_else(|| Fired::above("left_by_all", left(start), MOST_LEFT));
        if let Some(why) = why {
            return Ok(Some((idx, why)));
        }
    }
    Ok(None)
}

/// Signals that `a` and `b` predict differently.
fn changed(
    domain: &ActuatorDomain<'_>,
    a: &Model,
    b: &Model,
    takes: &[usize],
) -> Result<Vec<bool>, DiagnosisError> {
    let mut changed = vec![false; SIGNALS];
    for &take in takes {
        let (of_a, of_b) = (domain.predict(take, a)?, domain.predict(take, b)?);
        for (signal, (a, b)) in of_a.iter().zip(&of_b).enumerate() {
            let weights = domain.weights(take, signal, a);
            changed[signal] |= a
                .iter()
                .zip(b.iter())
                .zip(weights)
                .any(|((a, b), weight)| ((a - b) * weight).abs() > NOTICEABLE);
        }
    }
    Ok(changed)
}
