//! Models as they are deployed: fitted to whole logs, driven from their first measured position alone.
//!
//! Short windows tell effects apart, since what is missing shows there where it acts. What a simulator does with the
//! model is another matter: it drives it for seconds, so that small errors pile up. The last fit is therefore of what
//! is judged. Beside names go three constants that every servo has a little of and that are worth no name (the base
//! of the models M1 to M6 of Duclusaud and others, arXiv 2410.08650).

use std::ops::Range;

use palpate_sim::actuator::{ActuatorEffect, actuator};
use palpate_sim::effects::{Effect, Parameter};

use super::ActuatorDomain;
use super::domain::{POSITION_RAD, SUPPLY};
use crate::DiagnosisError;
use crate::engine::{BaseParameter, Domain, Model, Series};

/// Constants that are fitted along, unless an effect names them.
struct Trim {
    /// The effect that is the same.
    effect: &'static str,
    name: &'static str,
    bounds: [f64; 2],
    dose: f64,
}

/// In the order in which a deployed model has them after the parameters of the motor.
const TRIMS: [Trim; 3] = [
    Trim { effect: "coulomb_friction", name: "coulomb_nm", bounds: [0.0, 0.2], dose: 0.002 },
    Trim { effect: "viscous_friction", name: "viscous_nm_s_per_rad", bounds: [0.0, 0.2], dose: 0.002 },
    Trim { effect: "encoder_offset", name: "encoder_offset_rad", bounds: [-0.1, 0.1], dose: 0.002 },
];

/// Coulomb friction, N m, viscous friction, N m s / rad, and offset of the encoder, rad.
pub(super) type Trims = [f64; TRIMS.len()];

/// Whole logs as measurements: the position alone.
pub(super) struct OpenLoop<'d, 'a> {
    domain: &'d ActuatorDomain<'a>,
    base: Vec<BaseParameter>,
    /// Each log by itself.
    blocks: Vec<Range<usize>>,
}

impl<'d, 'a> OpenLoop<'d, 'a> {
    /// For models with the effects of `model`, with trims or without.
    pub(super) fn new(domain: &'d ActuatorDomain<'a>, model: &Model, with_trims: bool) -> Self {
        let candidates = domain.candidates();
        let is_none = |trim: &Trim| {
            let is_named = model.effects.iter().any(|effect| effect.id == trim.effect);
            !with_trims || is_named || candidates.iter().all(|effect| effect.id != trim.effect)
        };
        let trims = TRIMS.iter().map(|trim| BaseParameter {
            name: trim.name.to_owned(),
            lower: if is_none(trim) { 0.0 } else { trim.bounds[0] },
            upper: if is_none(trim) { 0.0 } else { trim.bounds[1] },
            dose: trim.dose,
        });
        let of_motor = domain.base().iter().zip(&model.base).enumerate().map(|(idx, (parameter, value))| {
            // A higher voltage moves as other constants of the motor do; readings of it have told what it is.
            let [lower, upper] = if idx == SUPPLY { [*value; 2] } else { [parameter.lower, parameter.upper] };
            BaseParameter { lower, upper, ..parameter.clone() }
        });
        let base = of_motor.chain(trims).collect();
        let blocks = (0..domain.num_takes()).map(|take| 0..domain.log(take).times_s.len()).collect();
        Self { domain, base, blocks }
    }

    /// `model`, which windows were fitted with, and trims to begin with.
    pub(super) fn start(model: &Model, trims: Trims) -> Model {
        let mut start = model.clone();
        start.base.extend(trims);
        start
    }
}

impl Domain for OpenLoop<'_, '_> {
    fn num_takes(&self) -> usize {
        self.domain.num_takes()
    }

    fn blocks(&self, take: usize) -> &[Range<usize>] {
        &self.blocks[take..=take]
    }

    fn observed(&self, take: usize, _signal: usize) -> &[f64] {
        &self.domain.log(take).positions_rad
    }

    fn base(&self) -> &[BaseParameter] {
        &self.base
    }

    fn candidates(&self) -> Vec<Effect> {
        Vec::new()
    }

    /// What readings tell best stays as they told it.
    fn parameters(&self, effect: &Effect) -> Vec<Parameter> {
        let is_read = actuator(&effect.id).is_some_and(ActuatorEffect::is_read);
        if is_read { Vec::new() } else { self.domain.parameters(effect) }
    }

    fn num_units(&self) -> usize {
        1
    }

    fn support(&self, _effect: &Effect, _parameter: &str) -> Vec<bool> {
        vec![true]
    }

    fn predict(&self, take: usize, model: &Model) -> Result<Vec<Series>, DiagnosisError> {
        Ok(vec![self.domain.open_loop(take, model)?.into()])
    }

    /// Nearly all errors are beyond four standard deviations of a measured position, where a loss is linear: what is
    /// fitted is the mean absolute error, which is judged.
    fn weights(&self, _take: usize, _signal: usize, prediction: &[f64]) -> Vec<f64> {
        vec![POSITION_RAD.recip(); prediction.len()]
    }
}
