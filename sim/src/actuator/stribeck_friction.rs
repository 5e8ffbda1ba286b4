//! Friction that is highest at rest.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// A torque against the motion that fades as the joint gets going.
pub(super) struct StribeckFriction;

impl ActuatorEffect for StribeckFriction {
    fn id(&self) -> &'static str {
        "stribeck_friction"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("stribeck_nm") * 1e3;
        format!("Friction is {size:.1} mN m higher at rest than in motion.")
    }

    fn signature(&self) -> &'static str {
        "slow motion sticks and slips, fast motion is free"
    }

    fn parameters(&self) -> Vec<Parameter> {
        // The fade speed alone is never evidence: no distance from neutral is large enough.
        let speed = Parameter {
            neutral: 0.3,
            ..parameter("stribeck_speed_rad_per_s", [0.05, 2.0], f64::INFINITY, 0.1)
        };
        vec![parameter("stribeck_nm", [0.0, 0.3], 0.004, 0.01), speed]
    }

    fn is_friction(&self) -> bool {
        true
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.stribeck_nm += effect.parameter("stribeck_nm");
        plant.stribeck_speed_rad_per_s = effect.parameter("stribeck_speed_rad_per_s");
    }
}
