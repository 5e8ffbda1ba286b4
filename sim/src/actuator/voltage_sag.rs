//! A supply that gives way under load.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// The supply has an internal resistance, so its voltage falls with the current it gives.
pub(super) struct VoltageSag;

impl ActuatorEffect for VoltageSag {
    fn id(&self) -> &'static str {
        "voltage_sag"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("supply_resistance_ohm");
        format!("The supply sags by {size:.2} V per ampere.")
    }

    fn signature(&self) -> &'static str {
        "torque falls short at high duty only, and so does the measured voltage"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("supply_resistance_ohm", [0.0, 5.0], 0.08, 0.2)]
    }

    fn is_read(&self) -> bool {
        true
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.supply_resistance_ohm += effect.parameter("supply_resistance_ohm");
    }
}
