//! A position gain that is not the stated one.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// The firmware multiplies the position error by another gain than its register states.
pub(super) struct GainError;

impl ActuatorEffect for GainError {
    fn id(&self) -> &'static str {
        "gain_error"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("gain") * 100.0;
        format!("The position gain is {size:+.0} % off its register.")
    }

    fn signature(&self) -> &'static str {
        "the PWM that the firmware reports is off by the same factor everywhere below saturation"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("gain", [-0.8, 3.0], 0.04, 0.1)]
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.gain_factor += effect.parameter("gain");
    }
}
