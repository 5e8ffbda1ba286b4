//! Dry friction.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// A torque against the motion that does not depend on its speed, and holds the joint at rest.
pub(super) struct CoulombFriction;

impl ActuatorEffect for CoulombFriction {
    fn id(&self) -> &'static str {
        "coulomb_friction"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("coulomb_nm") * 1e3;
        format!("Dry friction of {size:.1} mN m acts against every motion.")
    }

    fn signature(&self) -> &'static str {
        "a free swing decays linearly and stops off centre; reversals have a flat"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("coulomb_nm", [0.0, 0.3], 0.003, 0.008)]
    }

    fn is_constant(&self) -> bool {
        true
    }

    fn is_friction(&self) -> bool {
        true
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.coulomb_nm += effect.parameter("coulomb_nm");
    }
}
