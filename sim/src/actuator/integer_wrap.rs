//! A signed reading that is stored unsigned.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// Negative PWM readings show up 65,536 too high, as when sixteen signed bits are read as unsigned.
pub(super) struct IntegerWrap;

impl ActuatorEffect for IntegerWrap {
    fn id(&self) -> &'static str {
        "integer_wrap"
    }

    fn explain(&self, effect: &Effect) -> String {
        let share = effect.parameter("wrapped");
        format!(
            "Negative PWM is stored unsigned: readings below zero are 65536 too high ({:.0} % of them).",
            share * 100.0
        )
    }

    fn signature(&self) -> &'static str {
        "readings beyond the signed range wherever the predicted PWM is negative, and nowhere else"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("wrapped", [0.0, 1.0], 0.1, 1.0)]
    }

    fn is_read(&self) -> bool {
        true
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.wrap += effect.parameter("wrapped");
    }
}
