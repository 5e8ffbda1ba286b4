//! Fits: one candidate beside a linearised model, and a whole model.

use palpate_sim::effects::{Effect, Parameter};

use super::linear::{Assessment, Linear, Residual, predict};
use super::screen::{responses, stepped};
use super::{Domain, Model};
use crate::DiagnosisError;

/// A candidate, fitted.
pub(crate) struct Fitted {
    pub(crate) effect: Effect,
    pub(crate) parameters: Vec<Parameter>,
    /// At the fitted parameters.
    pub(crate) assessment: Assessment,
    /// Loss that it removes on each take when fitted to the others.
    pub(crate) held_out_gains: Vec<f64>,
}

/// Steps of Gauss and Newton for a candidate.
const STEPS: usize = 3;

/// Where else a fit starts, as multiples of the screened estimate.
const STARTS: [f64; 2] = [2.0, 4.0];

/// `effect` at a multiple of its distance from its neutral parameters, as far as their bounds allow.
fn scaled(effect: &Effect, parameters: &[Parameter], scale: f64) -> Effect {
    let steps: Vec<f64> = parameters
        .iter()
        .map(|parameter| (scale - 1.0) * (effect.parameter(&parameter.name) - parameter.neutral))
        .collect();
    stepped(effect, parameters, &steps)
}

/// Fits `start` with the parameters of `linear`'s model projected out.
pub(crate) fn fit<D: Domain>(
    linear: &Linear<'_, D>,
    start: &Effect,
    parameters: &[Parameter],
) -> Result<Fitted, DiagnosisError> {
    let left_by = |effect: &Effect| -> Result<Residual, DiagnosisError> {
        let predicted = predict(linear.domain, &linear.with(effect.clone()), &linear.takes)?;
        Ok(linear.residual_of(&predicted))
    };
    // A dose response flattens out: where an effect is large, its estimate from a small dose falls short.
    let mut effect = start.clone();
    let mut residual = left_by(&effect)?;
    for scale in STARTS {
        let farther = scaled(start, parameters, scale);
        let left = left_by(&farther)?;
        if left.square() < residual.square() {
            (effect, residual) = (farther, left);
        }
    }
    let mut assessment = linear.assess(&responses(linear, &effect, parameters)?, &residual);
    for _ in 0..STEPS {
        let mut better = None;
        for scale in [1.0, 0.4, 0.1] {
            let steps: Vec<f64> = assessment.step.iter().map(|step| step * scale).collect();
            let tried = stepped(&effect, parameters, &steps);
            let left = left_by(&tried)?;
            if left.square() < residual.square() {
                better = Some((tried, left));
                break;
            }
        }
        let Some((tried, left)) = better else { break };
        let gained = residual.square() - left.square();
        (effect, residual) = (tried, left);
        assessment = linear.assess(&responses(linear, &effect, parameters)?, &residual);
        if gained < 0.5 {
            break;
        }
    }
    let by_take = |residual: &Residual| -> Vec<f64> {
        let square = |rows: &[usize]| residual.values[rows[0]..rows[1]].iter().map(|r| r * r).sum();
        linear.starts.windows(2).map(square).collect()
    };
    let (before, after) = (by_take(&linear.residual), by_take(&residual));
    let held_out_gains = before
        .iter()
        .zip(&after)
        .zip(&assessment.held_out_gains)
        .map(|((before, after), of_step)| before - after + of_step)
        .collect();
    Ok(Fitted { effect, parameters: parameters.to_vec(), assessment, held_out_gains })
}

/// Fits every parameter of `model`, its own and those of its effects, to `takes`.
///
/// Never returns a model with a higher loss. Parameters stay within their bounds.
pub(crate) fn refit<D: Domain>(
    domain: &D,
    model: &Model,
    takes: &[usize],
    steps: usize,
) -> Result<Model, DiagnosisError> {
    let mut linear = Linear::without_nuisances(domain, model, takes)?;
    for _ in 0..steps {
        let columns = linear.nuisance_columns()?;
        let step = linear.assess(&columns, &linear.residual).step;
        let mut better = None;
        for scale in [1.0, 0.5, 0.2, 0.05] {
            let tried = moved(domain, &linear.model, step.as_slice(), scale);
            let tried = Linear::without_nuisances(domain, &tried, takes)?;
            if tried.loss < linear.loss {
                better = Some(tried);
                break;
            }
        }
        let Some(tried) = better else { break };
        let gained = linear.loss - tried.loss;
        linear = tried;
        if gained < 1e-3 * linear.loss.max(1.0) {
            break;
        }
    }
    Ok(linear.model)
}

fn moved<D: Domain>(domain: &D, model: &Model, step: &[f64], scale: f64) -> Model {
    let mut moved = model.clone();
    let (of_base, mut of_effects) = step.split_at(model.base.len());
    for ((value, step), parameter) in moved.base.iter_mut().zip(of_base).zip(domain.base()) {
        *value = (*value + scale * step).clamp(parameter.lower, parameter.upper);
    }
    for effect in &mut moved.effects {
        let parameters = domain.parameters(effect);
        let (own, rest) = of_effects.split_at(parameters.len());
        let steps: Vec<f64> = own.iter().map(|step| step * scale).collect();
        *effect = stepped(effect, &parameters, &steps);
        of_effects = rest;
    }
    moved
}
