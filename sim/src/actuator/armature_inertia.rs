//! Inertia of rotor and gear.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// The rotor, geared up, adds to the inertia of the load.
pub(super) struct ArmatureInertia;

impl ActuatorEffect for ArmatureInertia {
    fn id(&self) -> &'static str {
        "armature_inertia"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("inertia_kg_m2") * 1e3;
        format!("Rotor and gear add {size:.2} g m² of inertia.")
    }

    fn signature(&self) -> &'static str {
        "accelerations are smaller, static errors are the same; a free swing is slower"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("inertia_kg_m2", [0.0, 0.05], 0.0002, 0.0006)]
    }

    fn is_constant(&self) -> bool {
        true
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.armature_kg_m2 += effect.parameter("inertia_kg_m2");
    }
}
