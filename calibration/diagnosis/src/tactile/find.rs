//! Where simulated and real events disagree.

use std::collections::{BTreeMap, BTreeSet};

use palpate_reports::{Cell, ChannelResidual};
use palpate_robot_model::Station;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::judge::{Judged, frame_lengths_s};
use super::{Observed, moves};

/// Frames this near to the start or end of a contact belong to its onset or release, s.
const EDGE_S: f64 = 0.3;
/// Share of the excess that the reported cells hold.
const REPORTED: f64 = 0.8;
/// Draws behind a p-value.
const FLIPS: usize = 999;
/// Joints that a cell names at most.
const JOINTS: usize = 3;

/// Names of the phases of a contact, in order.
pub(crate) const PHASES: [&str; 4] = ["onset", "sustained", "release", "no_contact"];

/// A group of channels of one stream, in one phase.
type Key = (usize, String, usize);

#[derive(Default)]
struct Sum {
    excess_s: f64,
    channels: BTreeMap<usize, f64>,
    takes: BTreeSet<String>,
    /// Signed mismatch by part of a take, and its absolute value.
    parts: Vec<f64>,
    /// Speed of each joint, weighted by mismatch.
    speeds: Vec<f64>,
}

/// The smallest set of cells that holds 80 % of the mismatch, largest first; and the phase of each frame decides which
/// cell it is in. Cells of one group of patches are one: a finger, the palm.
pub(crate) fn cells(station: &Station, takes: &[&Observed<'_>], judged: &[Judged], seed: u64) -> Vec<Cell> {
    let layout = &station.layout;
    let num_channels = layout.num_channels();
    let num_dofs = station.robot.num_dofs();
    let mut sums: BTreeMap<Key, Sum> = BTreeMap::new();
    let mut total_s = 0.0;
    for (observed, judged) in takes.iter().zip(judged) {
        let real = &observed.active;
        let phases = phases(real, num_channels, &observed.take.joints.times_s);
        let lengths_s = frame_lengths_s(&observed.take.joints.times_s);
        let speeds = speeds(observed, num_dofs);
        for (frames, _) in &observed.repetitions {
            let mut of_part: BTreeMap<Key, f64> = BTreeMap::new();
            for frame in frames.clone() {
                for (idx, channel) in layout.channels.iter().enumerate() {
                    let at = frame * num_channels + idx;
                    if real[at] == judged.active[at] {
                        continue;
                    }
                    let group = layout.patches[channel.patch].group.clone();
                    let key = (channel.stream, group, phases[at]);
                    let signed = if real[at] { lengths_s[frame] } else { -lengths_s[frame] };
                    *of_part.entry(key.clone()).or_default() += signed;
                    let sum = sums.entry(key).or_default();
                    sum.excess_s += lengths_s[frame];
                    total_s += lengths_s[frame];
                    *sum.channels.entry(idx).or_default() += lengths_s[frame];
                    sum.takes.insert(observed.take.id.clone());
                    sum.speeds.resize(num_dofs, 0.0);
                    for (sum, speed) in sum.speeds.iter_mut().zip(&speeds[frame * num_dofs..]) {
                        *sum += speed * lengths_s[frame];
                    }
                }
            }
            for (key, signed) in of_part {
                sums.entry(key).or_default().parts.push(signed);
            }
        }
    }
    let mut sums: Vec<(Key, Sum)> = sums.into_iter().collect();
    sums.sort_by(|(_, a), (_, b)| b.excess_s.total_cmp(&a.excess_s));
    let moves = moves(station);
    let names: Vec<&str> = station.robot.dofs().map(|joint| joint.name.as_str()).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut reported_s = 0.0;
    let mut cells = Vec::new();
    for ((stream, _, phase), sum) in sums {
        if total_s <= 0.0 || reported_s >= REPORTED * total_s {
            break;
        }
        reported_s += sum.excess_s;
        let mut channels: Vec<(usize, f64)> = sum.channels.into_iter().collect();
        channels.sort_by(|(a_idx, a), (b_idx, b)| b.total_cmp(a).then(a_idx.cmp(b_idx)));
        let reached = |dof: usize| channels.iter().any(|&(channel, _)| moves[dof][channel]);
        let mut joints: Vec<usize> =
            (0..num_dofs).filter(|&dof| sum.speeds[dof] > 0.0 && reached(dof)).collect();
        joints.sort_by(|&a, &b| sum.speeds[b].total_cmp(&sum.speeds[a]));
        let (effect_size, p_value) = sign_test(&sum.parts, &mut rng);
        cells.push(Cell {
            stream: Some(layout.streams[stream].id.clone()),
            channels: channels.iter().map(|&(channel, _)| layout.channels[channel].id.clone()).collect(),
            joints: joints.iter().take(JOINTS).map(|&dof| names[dof].to_owned()).collect(),
            phase: PHASES[phase].to_owned(),
            takes: sum.takes.into_iter().collect(),
            excess: sum.excess_s / total_s,
            effect_size,
            p_value,
        });
    }
    cells
}

/// Mean over standard deviation, and how often the mean is as far from zero when the signs of whole parts are drawn.
fn sign_test(parts: &[f64], rng: &mut ChaCha8Rng) -> (f64, f64) {
    let count = parts.len() as f64;
    let mean = parts.iter().sum::<f64>() / count.max(1.0);
    let variance = parts.iter().map(|part| (part - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
    let size = if variance > 0.0 { mean / variance.sqrt() } else { 0.0 };
    let as_far = (0..FLIPS)
        .filter(|_| {
            let flipped: f64 =
                parts.iter().map(|part| if rng.random::<bool>() { *part } else { -part }).sum();
            flipped.abs() / count.max(1.0) >= mean.abs() - 1e-12
        })
        .count();
    (size, (1 + as_far) as f64 / (1 + FLIPS) as f64)
}

/// Phase of each channel and frame, as an index into [`PHASES`], from the real events.
pub(crate) fn phases(real: &[bool], num_channels: usize, times_s: &[f64]) -> Vec<usize> {
    let num_frames = times_s.len();
    let mut phases = vec![3; real.len()];
    for channel in 0..num_channels {
        let at = |frame: usize| real[frame * num_channels + channel];
        for frame in 0..num_frames {
            if at(frame) {
                phases[frame * num_channels + channel] = 1;
            }
        }
        for frame in 1..num_frames {
            if at(frame) == at(frame - 1) {
                continue;
            }
            let phase = if at(frame) { 0 } else { 2 };
            let edge_s = times_s[frame];
            let first = times_s.partition_point(|&time_s| time_s < edge_s - EDGE_S);
            let last = times_s.partition_point(|&time_s| time_s <= edge_s + EDGE_S);
            for near in first..last {
                // Where an onset and a release are both near, the frame belongs to the one on its side.
                let slot = &mut phases[near * num_channels + channel];
                if *slot == 1 || *slot == 3 || near >= frame {
                    *slot = phase;
                }
            }
        }
    }
    phases
}

/// Absolute speed of every joint at every frame, `[frame * num_dofs + dof]`.
fn speeds(observed: &Observed<'_>, num_dofs: usize) -> Vec<f64> {
    let times_s = &observed.take.joints.times_s;
    let positions = &observed.take.joints.positions;
    let mut speeds = vec![0.0; positions.len()];
    for frame in 1..times_s.len() {
        for dof in 0..num_dofs {
            let change = positions[frame * num_dofs + dof] - positions[(frame - 1) * num_dofs + dof];
            speeds[frame * num_dofs + dof] = (change / (times_s[frame] - times_s[frame - 1])).abs();
        }
    }
    speeds
}

/// Mismatch of every channel by phase, seconds a second of the take, before and after.
pub(crate) fn residual_map(
    station: &Station,
    takes: &[&Observed<'_>],
    calibrated: &[Judged],
    diagnosed: &[Judged],
) -> Vec<ChannelResidual> {
    let layout = &station.layout;
    let num_channels = layout.num_channels();
    let mut map = vec![[[0.0; 4]; 2]; num_channels];
    let mut duration_s = 0.0;
    for (idx, observed) in takes.iter().enumerate() {
        let real = &observed.active;
        let times_s = &observed.take.joints.times_s;
        let phases = phases(real, num_channels, times_s);
        let lengths_s = frame_lengths_s(times_s);
        duration_s += lengths_s.iter().sum::<f64>();
        for (model, judged) in [&calibrated[idx], &diagnosed[idx]].into_iter().enumerate() {
            for (at, (real, simulated)) in real.iter().zip(&judged.active).enumerate() {
                if real != simulated {
                    map[at % num_channels][model][phases[at]] += lengths_s[at / num_channels];
                }
            }
        }
    }
    let named = |of_model: &[f64; 4]| -> BTreeMap<String, f64> {
        let phases = PHASES.iter().zip(of_model);
        phases.map(|(phase, sum)| ((*phase).to_owned(), sum / duration_s.max(f64::MIN_POSITIVE))).collect()
    };
    layout
        .channels
        .iter()
        .zip(&map)
        .map(|(channel, [calibrated, diagnosed])| ChannelResidual {
            channel: channel.id.clone(),
            calibrated: named(calibrated),
            diagnosed: named(diagnosed),
        })
        .collect()
}
