//! What a model knows of sensors beyond theta.

use std::collections::BTreeMap;

use palpate_robot_model::SensorKind;
use serde::{Deserialize, Serialize};

use crate::replay::NEAR_M;
use crate::theta::Theta;

/// What a model knows of sensors beyond theta. The defaults are the paper's model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Response {
    /// A proximity sensor begins to read this far before `lambda_con` is reached, m: the travel over which its reading
    /// rises from nothing to its threshold.
    #[serde(default = "Response::default_band_m")]
    pub proximity_band_m: f64,
    /// How far, in m, a node of a proximity patch may be behind the nearest one and still add to what the patch reads:
    /// a pad reads the force on all of its area, so that a wide contact reads more than a point at the same depth. The
    /// patch's distance is then `-s ln sum_i exp(-d_i / s)` over its nodes (a soft minimum); at 0 that of the nearest.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub pad_softness_m: f64,
    /// By stream id, the load below which a channel switches off again, over the one at which it switches on; 1
    /// (no hysteresis) where absent.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub off_fractions: BTreeMap<String, f64>,
}

impl Default for Response {
    fn default() -> Self {
        Self { proximity_band_m: Self::default_band_m(), pad_softness_m: 0.0, off_fractions: BTreeMap::new() }
    }
}

impl Response {
    fn default_band_m() -> f64 {
        1e-3
    }

    pub(crate) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Signed distance at which proximity sensors begin to read, m; at most as far as replays know distances.
    pub fn reach_m(&self, theta: &Theta) -> f64 {
        (theta.lambda_con_m + self.proximity_band_m).min(NEAR_M)
    }

    /// The load at which channels of `kind` switch on: Pa, or m into the reach.
    pub fn on_load(&self, kind: SensorKind, theta: &Theta) -> f64 {
        match kind {
            // As far as the reach is from the threshold, and not the band itself, so that rounding is the same.
            SensorKind::Proximity => self.reach_m(theta) - theta.lambda_con_m,
            SensorKind::Pressure => theta.lambda_pre_pa,
        }
    }

    /// Of the stream called `stream`.
    pub fn off_fraction(&self, stream: &str) -> f64 {
        self.off_fractions.get(stream).copied().unwrap_or(1.0)
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}
