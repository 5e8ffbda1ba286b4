//! A controller that damps.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// The firmware subtracts a share of the speed from the duty: the derivative gain of its controller.
pub(super) struct DerivativeGain;

impl ActuatorEffect for DerivativeGain {
    fn id(&self) -> &'static str {
        "derivative_gain"
    }

    fn explain(&self, effect: &Effect) -> String {
        let time = effect.parameter("derivative_s") * 1e3;
        format!("The controller damps: its derivative gain is {time:.0} ms times its position gain.")
    }

    fn signature(&self) -> &'static str {
        "the PWM falls with the speed, and more at a higher gain; with the torque off nothing damps"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("derivative_s", [0.0, 0.5], 0.002, 0.006)]
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.derivative_s += effect.parameter("derivative_s");
    }
}
