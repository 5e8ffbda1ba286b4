//! Sessions made up without robot or object: pads that are pressed and patches that are approached, in any size.
//!
//! "Reality" is the same geometry with other thresholds, a spread of sensitivity between channels, latency and slow
//! release, so that no theta explains all of it.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use palpate_calibration::PairedTake;
use palpate_robot_model::{Channel, Patch, SensorKind, Stream, SurfaceNode, TactileLayout, TaxelAxes};
use palpate_sim::replay::{ContactTrace, Gaps, NEAR_M, PatchTrace};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// How large a made-up session is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Size {
    pub(crate) pads: usize,
    pub(crate) taxels_per_pad: usize,
    pub(crate) nodes_per_side: usize,
    pub(crate) patches: usize,
    pub(crate) takes: usize,
    pub(crate) frames_per_take: usize,
}

impl Size {
    /// 5,670 frames, 784 nodes, 44 channels: as large as the paper's session.
    pub(crate) const PAPER: Self =
        Self { pads: 4, taxels_per_pad: 8, nodes_per_side: 14, patches: 12, takes: 9, frames_per_take: 630 };
}

const PAD_SIDE_M: f64 = 0.02;
const STIFFNESS_PA_PER_M: f64 = 2e6;
const FRAME_S: f64 = 0.1;

pub(crate) fn layout(size: Size) -> TactileLayout {
    let mut layout = TactileLayout {
        name: "made up".to_owned(),
        streams: Vec::new(),
        patches: Vec::new(),
        channels: Vec::new(),
    };
    let num_pad_channels = size.pads * size.taxels_per_pad;
    for (stream, (id, kind, channels)) in [
        ("pad", SensorKind::Pressure, 0..num_pad_channels),
        ("patch", SensorKind::Proximity, num_pad_channels..num_pad_channels + size.patches),
    ]
    .into_iter()
    .enumerate()
    {
        let label = format!("{id} <&> \"{id}\"");
        let raw_unit = "counts".to_owned();
        let axes = TaxelAxes::One;
        layout.streams.push(Stream {
            id: id.to_owned(),
            label,
            kind,
            rate_hz: 40.0,
            channels,
            raw_unit,
            axes,
        });
        let num_patches = [size.pads, size.patches][stream];
        for patch in 0..num_patches {
            let (taxels, nodes) = match kind {
                SensorKind::Pressure => (ring(size.taxels_per_pad), square(size.nodes_per_side)),
                SensorKind::Proximity => (vec![Point3::origin()], square(1)),
            };
            push_patch(&mut layout, stream, format!("{id}{patch}"), taxels, nodes);
        }
    }
    layout
}

fn push_patch(
    layout: &mut TactileLayout,
    stream: usize,
    id: String,
    taxels: Vec<Point3<f64>>,
    nodes: Vec<Point3<f64>>,
) {
    let first = layout.channels.len();
    let patch = layout.patches.len();
    for taxel in 0..taxels.len() {
        let id = if taxels.len() > 1 { format!("{id}.{taxel}") } else { id.clone() };
        layout.channels.push(Channel { id, stream, patch, taxel });
    }
    layout.patches.push(Patch {
        label: id.clone(),
        group: id.clone(),
        id,
        stream,
        link: 0,
        link_from_patch: Isometry3::identity(),
        nodes: nodes
            .into_iter()
            .map(|pos_in_link| SurfaceNode { pos_in_link, normal_in_link: Vector3::z_axis() })
            .collect(),
        taxel_normals_in_link: vec![Vector3::z_axis(); taxels.len()],
        map_positions: taxels.iter().map(|taxel| [taxel.x, taxel.y]).collect(),
        channels: first..first + taxels.len(),
        taxels_in_link: taxels,
        stiffness_pa_per_m: STIFFNESS_PA_PER_M,
    });
}

fn square(per_side: usize) -> Vec<Point3<f64>> {
    let at = |i: usize| PAD_SIDE_M * ((i as f64 + 0.5) / per_side as f64 - 0.5);
    (0..per_side * per_side).map(|i| Point3::new(at(i % per_side), at(i / per_side), 0.0)).collect()
}

fn ring(num_taxels: usize) -> Vec<Point3<f64>> {
    let at = |i: usize| (TAU * i as f64 / num_taxels as f64).sin_cos();
    (0..num_taxels).map(at).map(|(sin, cos)| Point3::new(7e-3 * cos, 7e-3 * sin, -1e-3)).collect()
}

/// Takes of `size`, the same for the same seed. Objects alternate.
pub(crate) fn takes(size: Size, layout: &TactileLayout, seed: u64) -> Vec<PairedTake> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let gains: Vec<f64> = (0..layout.num_channels()).map(|_| rng.random_range(0.7..1.4)).collect();
    (0..size.takes)
        .map(|take_idx| {
            let mut real = vec![false; size.frames_per_take * layout.num_channels()];
            let patches = layout.patches.iter().map(|patch| {
                let presses = presses(&mut rng, size.frames_per_take);
                match layout.streams[patch.stream].kind {
                    SensorKind::Pressure => {
                        pressed_pad(patch, &presses, &gains, layout.num_channels(), &mut real)
                    }
                    SensorKind::Proximity => {
                        approached_patch(patch, &presses, &gains, layout.num_channels(), &mut real)
                    }
                }
            });
            let contact =
                ContactTrace { num_frames: size.frames_per_take, patches: patches.map(Arc::new).collect() };
            PairedTake {
                id: format!("take-{:02}", take_idx + 1),
                object: ["ball", "can"][take_idx % 2].to_owned(),
                frame_times_s: (0..size.frames_per_take).map(|frame| frame as f64 * FRAME_S).collect(),
                contact,
                real_active: real,
            }
        })
        .collect()
}

/// Height of the object over the undeformed skin, m, negative when pressed in, and where it presses.
struct Press {
    height_m: f64,
    at: Point3<f64>,
}

fn presses(rng: &mut ChaCha8Rng, num_frames: usize) -> Vec<Press> {
    let mut frames = Vec::with_capacity(num_frames);
    while frames.len() < num_frames {
        let at = Point3::new(rng.random_range(-8e-3..8e-3), rng.random_range(-8e-3..8e-3), 0.0);
        let depth_m: f64 = rng.random_range(0.3e-3..2.5e-3);
        let speed_m_per_frame = rng.random_range(1e-3..8e-3);
        let (rest, hold) = (rng.random_range(10..40), rng.random_range(3..25));
        let steps = (0.06 / speed_m_per_frame) as usize;
        let height = |step: usize| (speed_m_per_frame * step as f64 - depth_m).max(-depth_m);
        let heights = std::iter::repeat_n(0.08, rest)
            .chain((0..steps).rev().map(height))
            .chain(std::iter::repeat_n(-depth_m, hold))
            .chain((0..steps).map(height));
        frames.extend(heights.map(|height_m| Press { height_m, at }));
    }
    frames.truncate(num_frames);
    frames
}

fn pressed_pad(
    patch: &Patch,
    presses: &[Press],
    gains: &[f64],
    num_channels: usize,
    real: &mut [bool],
) -> PatchTrace {
    let (mut offsets, mut entries) = (vec![0], Vec::new());
    for press in presses {
        for (node_idx, node) in patch.nodes.iter().enumerate() {
            let rise_m = (node.pos_in_link - press.at).norm_squared() / (2.0 * 0.025);
            let depth_m = -press.height_m - rise_m;
            if depth_m > 0.0 {
                entries.push((node_idx as u32, STIFFNESS_PA_PER_M * depth_m));
            }
        }
        offsets.push(entries.len() as u32);
    }
    for (taxel, channel) in patch.taxels_in_link.iter().zip(patch.channels.clone()) {
        let feels = |frame: usize| {
            let felt =
                entries[PatchTrace::entry_range(&offsets, frame)].iter().map(|&(node, pressure_pa)| {
                    (-280.0 * (patch.nodes[node as usize].pos_in_link - taxel).norm()).exp() * pressure_pa
                });
            gains[channel] * felt.sum::<f64>() > 900.0
        };
        lagging(presses.len(), feels, |frame| real[frame * num_channels + channel] = true);
    }
    PatchTrace::Pressure { offsets, entries }
}

fn approached_patch(
    patch: &Patch,
    presses: &[Press],
    gains: &[f64],
    num_channels: usize,
    real: &mut [bool],
) -> PatchTrace {
    let min_distance_m: Vec<f64> = presses
        .iter()
        .map(|press| if press.height_m > NEAR_M { NEAR_M + 0.01 } else { press.height_m })
        .collect();
    for channel in patch.channels.clone() {
        let feels = |frame: usize| min_distance_m[frame] < 1.0e-3 * gains[channel];
        lagging(presses.len(), feels, |frame| real[frame * num_channels + channel] = true);
    }
    PatchTrace::Proximity { min_distance_m, gaps: Gaps::default() }
}

/// Late by one frame, and two frames longer.
fn lagging(num_frames: usize, feels: impl Fn(usize) -> bool, mut set: impl FnMut(usize)) {
    for frame in (1..num_frames).filter(|&frame| (1..=3).any(|lag| frame >= lag && feels(frame - lag))) {
        set(frame);
    }
}
