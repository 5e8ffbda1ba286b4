//! A driver that gives no more than so much current.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// The driver limits the current of the motor, and with it the torque, whatever the duty.
pub(super) struct CurrentLimit;

impl ActuatorEffect for CurrentLimit {
    fn id(&self) -> &'static str {
        "current_limit"
    }

    fn explain(&self, effect: &Effect) -> String {
        let limit_a = 1.0 / effect.parameter("inverse_limit_per_a").max(f64::MIN_POSITIVE);
        format!("The driver gives no more than {limit_a:.2} A.")
    }

    fn signature(&self) -> &'static str {
        "torque stops rising while the duty still does; a stalled joint pushes equally hard at any gain"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("inverse_limit_per_a", [0.0, 10.0], 0.3, 0.8)]
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.inverse_current_limit_per_a += effect.parameter("inverse_limit_per_a");
    }
}
