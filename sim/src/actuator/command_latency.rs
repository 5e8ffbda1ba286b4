//! Goals that take effect late.

use super::{ActuatorEffect, Plant, parameter};
use crate::effects::{Effect, Parameter};

/// Every goal takes effect a fixed time after it was sent.
pub(super) struct CommandLatency;

impl ActuatorEffect for CommandLatency {
    fn id(&self) -> &'static str {
        "command_latency"
    }

    fn explain(&self, effect: &Effect) -> String {
        let size = effect.parameter("latency_s") * 1e3;
        format!("Commands take effect {size:.0} ms late.")
    }

    fn signature(&self) -> &'static str {
        "the lag is the same time at every speed and gain"
    }

    fn parameters(&self) -> Vec<Parameter> {
        vec![parameter("latency_s", [0.0, 0.3], 0.004, 0.01)]
    }

    fn apply(&self, effect: &Effect, plant: &mut Plant) {
        plant.latency_s += effect.parameter("latency_s");
    }
}
