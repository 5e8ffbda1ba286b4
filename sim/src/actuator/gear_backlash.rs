//! Play between rotor and joint.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// The joint moves freely within an angle before the rotor carries it.
pub(super) struct GearBacklash;

impl ActuatorEffect for GearBacklash {
    fn id(&self) -> &'static str {
        "gear_backlash"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("play_rad") * 1e3;
        format!("The gear has {size:.1} mrad of play.")
    }

    fn signature(&self) -> &'static str {
        "the load falls through the gap whenever its torque changes sign, whatever the speed"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("play_rad", [0.0, 0.3], 0.006, 0.02)]
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.play_rad += effect.parameter("play_rad");
    }
}
