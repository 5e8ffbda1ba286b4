//! Calibration end to end, on made-up sessions.

use palpate_sim::{SensorModel, Theta};

mod contact_map;
mod job;
mod peer_inputs;
mod report;
mod sweep;
mod synthetic;

/// A few channels, for tests.
pub(crate) const SMALL: synthetic::Size = synthetic::Size {
    pads: 2,
    taxels_per_pad: 3,
    nodes_per_side: 5,
    patches: 3,
    takes: 6,
    frames_per_take: 120,
};

/// A model that touches too early.
pub(crate) fn nominal() -> SensorModel {
    let theta = Theta { lambda_con_m: 8e-3, alpha_per_m: 40.0, lambda_pre_pa: 20.0 };
    SensorModel::plain("nominal", theta)
}
