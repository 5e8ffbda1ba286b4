//! A load that is heavier or lighter than stated.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// The torque of gravity differs from that of the stated mass and length.
pub(super) struct GravityLoad;

impl ActuatorEffect for GravityLoad {
    fn id(&self) -> &'static str {
        "gravity_load"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("gravity") * 100.0;
        let how = if size < 0.0 { "less hard" } else { "harder" };
        format!("Gravity pulls {:.0} % {how} than the stated load accounts for.", size.abs())
    }

    fn signature(&self) -> &'static str {
        "a static error that grows with the sine of the angle; a free swing is faster"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("gravity", [-0.8, 3.0], 0.04, 0.1)]
    }

    fn is_constant(&self) -> bool {
        true
    }

    fn could_be(&self, load_is_stated: bool) -> bool {
        load_is_stated
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.gravity_factor += effect.parameter("gravity");
    }
}
