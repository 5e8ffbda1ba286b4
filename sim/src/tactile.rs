//! The paper's tactile model: from a contact trace and theta to raw and binary readings of every channel.

use palpate_robot_model::TactileLayout;

use crate::{SensorModel, replay::ContactTrace};

/// Simulated readings of every channel over a take, frame-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Readings {
    /// Number of frames.
    pub num_frames: usize,
    /// Number of channels.
    pub num_channels: usize,
    /// The continuous signal that is compared with the threshold, `[frame * num_channels + channel]`: signed distance
    /// in m for proximity channels, propagated pressure in Pa for pressure channels.
    pub raw: Vec<f64>,
    /// Whether the channel is active, same indexing.
    pub active: Vec<bool>,
}

/// Precomputed `exp(-alpha * |node - taxel|)` of one pressure patch: `[taxel * num_nodes + node]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Propagation {
    /// Weights, taxel-major.
    pub weights: Vec<f64>,
}

/// The weights of every patch of `layout` for one `alpha` (1/m); empty for proximity patches.
pub fn propagation(layout: &TactileLayout, alpha_per_m: f64) -> Vec<Propagation> {
    let _ = (layout, alpha_per_m);
    todo!()
}

/// The continuous signals of every channel, `[frame * num_channels + channel]`, as in [`Readings::raw`].
pub fn raw_signals(layout: &TactileLayout, trace: &ContactTrace, alpha_per_m: f64) -> Vec<f64> {
    let _ = (layout, trace, alpha_per_m);
    todo!()
}

/// Readings of `model` over a take.
pub fn readings(layout: &TactileLayout, trace: &ContactTrace, model: &SensorModel) -> Readings {
    let _ = (layout, trace, model);
    todo!()
}
