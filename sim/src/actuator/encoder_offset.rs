//! An encoder whose zero is not where the load hangs.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// Positions and goals are measured from an angle at which gravity has a torque.
pub(super) struct EncoderOffset;

impl ActuatorEffect for EncoderOffset {
    fn id(&self) -> &'static str {
        "encoder_offset"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("offset_rad") * 1e3;
        format!("The encoder reads {size:+.1} mrad while the load hangs at rest.")
    }

    fn signature(&self) -> &'static str {
        "one side needs more torque than the other; nothing changes with speed"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("offset_rad", [-0.5, 0.5], 0.01, 0.03)]
    }

    fn is_constant(&self) -> bool {
        true
    }

    fn could_be(&self, load_is_stated: bool) -> bool {
        load_is_stated
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.encoder_offset_rad += effect.parameter("offset_rad");
    }
}
