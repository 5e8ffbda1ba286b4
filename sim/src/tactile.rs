//! The paper's tactile model: from a contact trace and theta to raw and binary readings of every channel.

use std::sync::Arc;

use palpate_robot_model::{Patch, SensorKind, TactileLayout};

use crate::parallel::for_each_chunk;
use crate::replay::{ContactTrace, PatchTrace};
use crate::theta::Thetas;

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

/// Precomputed `exp(-alpha * |node - taxel|)` of one pressure patch: `[node * num_taxels + taxel]`, so that one
/// touched node adds to its taxels from consecutive weights.
#[derive(Clone, Debug, PartialEq)]
pub struct Propagation {
    /// Weights, node-major.
    pub weights: Vec<f64>,
}

/// The weights of every patch of `layout`, each with its alpha (1/m); empty for proximity patches.
pub fn propagation(layout: &TactileLayout, alphas_per_m: &[f64]) -> Vec<Propagation> {
    let patches = layout.patches.iter().zip(alphas_per_m);
    patches.map(|(patch, &alpha_per_m)| patch_propagation(layout, patch, alpha_per_m)).collect()
}

/// [`propagation`] of one patch.
pub(crate) fn patch_propagation(layout: &TactileLayout, patch: &Patch, alpha_per_m: f64) -> Propagation {
    let weights = match layout.streams[patch.stream].kind {
        SensorKind::Proximity => Vec::new(),
        SensorKind::Pressure => patch
            .nodes
            .iter()
            .flat_map(|node| {
                let weight = move |taxel: &nalgebra::Point3<f64>| {
                    (-alpha_per_m * (node.pos_in_link - taxel).norm()).exp()
                };
                patch.taxels_in_link.iter().map(weight)
            })
            .collect(),
    };
    Propagation { weights }
}

/// The continuous signals of every channel, `[frame * num_channels + channel]`, as in [`Readings::raw`].
///
/// Propagated pressure of taxel i: `sum_j exp(-alpha * |p_j - t_i|) f_j` over the touched nodes j (paper, "Contact
/// Modeling"). Nodes are summed in ascending order, so the bits do not depend on the number of threads.
///
/// # Panics
/// If `trace` was made with another layout: a caller's bug.
pub fn raw_signals(layout: &TactileLayout, trace: &ContactTrace, alpha_per_m: f64) -> Vec<f64> {
    propagated(layout, trace, &vec![alpha_per_m; layout.patches.len()])
}

/// [`raw_signals`] with a decay for each patch, 1/m.
fn propagated(layout: &TactileLayout, trace: &ContactTrace, alphas_per_m: &[f64]) -> Vec<f64> {
    let num_channels = layout.num_channels();
    assert_eq!(trace.patches.len(), layout.patches.len(), "one trace per patch of the layout");
    let mut raw = vec![0.0; trace.num_frames * num_channels];
    if raw.is_empty() {
        return raw;
    }
    let propagation = propagation(layout, alphas_per_m);
    for_each_chunk(&mut raw, CHUNK_FRAMES * num_channels, |chunk, raw| {
        for (i, frame_raw) in raw.chunks_exact_mut(num_channels).enumerate() {
            let frame = chunk * CHUNK_FRAMES + i;
            for (patch_idx, patch) in layout.patches.iter().enumerate() {
                let taxels = &mut frame_raw[patch.channels.clone()];
                match &*trace.patches[patch_idx] {
                    PatchTrace::Proximity { min_distance_m, .. } => taxels.fill(min_distance_m[frame]),
                    PatchTrace::Pressure { offsets, entries } => {
                        let touched = &entries[PatchTrace::entry_range(offsets, frame)];
                        propagate(&propagation[patch_idx].weights, touched, taxels);
                    }
                }
            }
        }
    });
    raw
}

/// [`raw_signals`] of the taxels of a pressure patch over `num_frames` frames, each; `None` where nothing presses in any.
pub(crate) fn propagate_patch(
    layout: &TactileLayout,
    patch: &Patch,
    trace: &PatchTrace,
    alpha_per_m: f64,
    num_frames: usize,
) -> Vec<Option<Arc<[f64]>>> {
    let num_taxels = patch.channels.len();
    let PatchTrace::Pressure { offsets, entries } = trace else { return vec![None; num_taxels] };
    if entries.is_empty() {
        return vec![None; num_taxels];
    }
    let mut raw = vec![0.0; num_taxels * num_frames];
    let weights = patch_propagation(layout, patch, alpha_per_m).weights;
    let mut taxels = vec![0.0; num_taxels];
    for frame in 0..num_frames {
        let touched = &entries[PatchTrace::entry_range(offsets, frame)];
        if touched.is_empty() {
            continue;
        }
        taxels.fill(0.0);
        propagate(&weights, touched, &mut taxels);
        for (taxel, pressure_pa) in taxels.iter().enumerate() {
            raw[taxel * num_frames + frame] = *pressure_pa;
        }
    }
    let pressed = |of_taxel: &[f64]| of_taxel.iter().any(|pressure_pa| *pressure_pa != 0.0);
    let of_taxels = raw.chunks_exact(num_frames.max(1));
    of_taxels.map(|of_taxel| pressed(of_taxel).then(|| of_taxel.into())).collect()
}

/// Frames per unit of parallel work.
const CHUNK_FRAMES: usize = 128;

/// Propagated pressure of the taxels of one patch in one frame, `taxels` being zero before: `weights` as in
/// [`Propagation`], `touched` the frame's `(node, pressure)` entries. [`raw_signals`] is made of these sums, bit for bit.
pub fn propagate(weights: &[f64], touched: &[(u32, f64)], taxels: &mut [f64]) {
    // With a length known at compile time the sums stay in registers; any other length takes the loop below.
    if let Ok(taxels) = <&mut [f64; 8]>::try_from(&mut *taxels) {
        let mut sums = [0.0; 8];
        for &(node, pressure_pa) in touched {
            let node_weights = &weights[node as usize * 8..][..8];
            for (sum, weight) in sums.iter_mut().zip(node_weights) {
                *sum += weight * pressure_pa;
            }
        }
        *taxels = sums;
        return;
    }
    let num_taxels = taxels.len();
    for &(node, pressure_pa) in touched {
        let node_weights = &weights[node as usize * num_taxels..][..num_taxels];
        for (sum, weight) in taxels.iter_mut().zip(node_weights) {
            *sum += weight * pressure_pa;
        }
    }
}

/// The value that each channel's raw signal is compared with: `lambda_con` (m) for proximity channels, `lambda_pre`
/// (Pa) for pressure channels.
pub fn thresholds(layout: &TactileLayout, thetas: &Thetas<'_>) -> Vec<f64> {
    let of_streams = thetas.by_stream(layout);
    let threshold = |channel: &palpate_robot_model::Channel| match layout.streams[channel.stream].kind {
        SensorKind::Proximity => of_streams[channel.stream].lambda_con_m,
        SensorKind::Pressure => of_streams[channel.stream].lambda_pre_pa,
    };
    layout.channels.iter().map(threshold).collect()
}

/// Whether a channel of `kind` is active: a proximity sensor nearer than its threshold, a pressure sensor above it.
pub fn is_active(kind: SensorKind, raw: f64, threshold: f64) -> bool {
    match kind {
        SensorKind::Proximity => raw < threshold,
        SensorKind::Pressure => raw > threshold,
    }
}

/// Readings over a take of the model that has `thetas` and nothing else.
///
/// `lambda_con` must not be beyond [`crate::replay::NEAR_M`], which [`crate::SensorModel::from_toml`] makes sure of.
pub fn readings(layout: &TactileLayout, trace: &ContactTrace, thetas: &Thetas<'_>) -> Readings {
    let num_channels = layout.num_channels();
    let raw = propagated(layout, trace, &thetas.alphas_per_m(layout));
    let thresholds = thresholds(layout, thetas);
    let mut active = Vec::with_capacity(raw.len());
    for frame_raw in raw.chunks_exact(num_channels.max(1)) {
        let channels = layout.channels.iter().zip(frame_raw).zip(&thresholds);
        active.extend(channels.map(|((channel, &raw), &threshold)| {
            is_active(layout.streams[channel.stream].kind, raw, threshold)
        }));
    }
    Readings { num_frames: trace.num_frames, num_channels, raw, active }
}

impl Readings {
    /// Raw signals of one frame, one per channel.
    pub fn raw_frame(&self, frame: usize) -> &[f64] {
        &self.raw[frame * self.num_channels..(frame + 1) * self.num_channels]
    }

    /// Activations of one frame, one per channel.
    pub fn active_frame(&self, frame: usize) -> &[bool] {
        &self.active[frame * self.num_channels..(frame + 1) * self.num_channels]
    }
}
