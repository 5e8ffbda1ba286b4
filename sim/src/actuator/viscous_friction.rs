//! Friction that grows with speed.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// A torque against the motion, proportional to its speed, beside the one of the back-EMF.
pub(super) struct ViscousFriction;

impl ActuatorEffect for ViscousFriction {
    fn id(&self) -> &'static str {
        "viscous_friction"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("viscous_nm_s_per_rad");
        format!("Friction grows with speed: {size:.4} N m at 1 rad/s.")
    }

    fn signature(&self) -> &'static str {
        "a free swing decays exponentially; unlike the back-EMF it is there with the torque off"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("viscous_nm_s_per_rad", [0.0, 0.2], 0.001, 0.004)]
    }

    fn is_constant(&self) -> bool {
        true
    }

    fn is_friction(&self) -> bool {
        true
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.viscous_nm_s_per_rad += effect.parameter("viscous_nm_s_per_rad");
    }
}
