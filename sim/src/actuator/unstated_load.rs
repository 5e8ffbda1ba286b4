//! A load that nobody weighed.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// What the joint carries where its logs do not say: a link of a hand, a tool. Its weight pulls hardest at some
/// angle, and it has an inertia.
pub(super) struct UnstatedLoad;

impl ActuatorEffect for UnstatedLoad {
    fn id(&self) -> &'static str {
        "unstated_load"
    }

    fn explain(&self, effect: &Effect) -> String {
        let [sine, cosine] = ["sine_nm", "cosine_nm"].map(|name| effect.parameter(name));
        // It hangs where the torque is nothing and the joint would come back.
        let hangs_deg = (-cosine).atan2(sine).to_degrees();
        let inertia = effect.parameter("inertia_kg_m2") * 1e3;
        format!(
            "The joint carries a load that hangs at {hangs_deg:.0} degrees, pulls with up to {:.1} mN m and has an \
             inertia of {inertia:.2} g m^2.",
            1e3 * sine.hypot(cosine)
        )
    }

    fn signature(&self) -> &'static str {
        "a static error that goes as a sine of the angle, and slower acceleration"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![
            parameter("sine_nm", [-5.0, 5.0], 0.006, 0.015),
            parameter("cosine_nm", [-5.0, 5.0], 0.006, 0.015),
            parameter("inertia_kg_m2", [0.0, 0.1], 0.0002, 0.0006),
        ]
    }

    fn could_be(&self, load_is_stated: bool) -> bool {
        !load_is_stated
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.unstated_nm[0] += effect.parameter("sine_nm");
        plant.unstated_nm[1] += effect.parameter("cosine_nm");
        plant.unstated_kg_m2 += effect.parameter("inertia_kg_m2");
    }
}
