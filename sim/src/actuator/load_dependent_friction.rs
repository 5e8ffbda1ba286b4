//! Friction of a gear under load.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// A torque against the motion, proportional to the torque that the gear transmits.
pub(super) struct LoadDependentFriction;

impl ActuatorEffect for LoadDependentFriction {
    fn id(&self) -> &'static str {
        "load_dependent_friction"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("load_friction") * 100.0;
        format!("The gear loses {size:.0} % of the torque that it transmits.")
    }

    fn signature(&self) -> &'static str {
        "lifting costs more than the load, lowering holds by itself; without load it vanishes"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("load_friction", [0.0, 0.9], 0.03, 0.08)]
    }

    fn is_friction(&self) -> bool {
        true
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.load_friction += effect.parameter("load_friction");
    }
}
