//! A torque that is always there.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// A torque on the joint that depends neither on its angle nor on its motion: a spring, a cable, a link that nobody
/// weighed.
pub(super) struct ConstantTorque;

impl ActuatorEffect for ConstantTorque {
    fn id(&self) -> &'static str {
        "constant_torque"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("torque_nm") * 1e3;
        format!("A torque of {size:+.1} mN m acts on the joint at all times.")
    }

    fn signature(&self) -> &'static str {
        "a static error that is the same at every angle, and smaller at a higher gain"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("torque_nm", [-5.0, 5.0], 0.006, 0.015)]
    }

    fn is_constant(&self) -> bool {
        true
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.constant_torque_nm += effect.parameter("torque_nm");
    }
}
