//! Measures the searches against each other, and writes what a peer in another language needs to take part.

use std::{fs, io, path::Path, sync::Arc};

use palpate_robot_model::{SensorKind, TactileLayout};
use palpate_sim::{
    job::{Cancel, NoProgress},
    replay::PatchTrace,
};
use serde::Serialize;

use crate::{
    CalibrationError, PairedTake,
    sweep::{FitData, GridAxes, Watch, alpha_axis, exact, grid},
};

/// What to measure.
#[derive(Clone, Copy, Debug)]
pub struct SweepBenchConfig {
    /// Values of alpha, for both methods.
    pub num_alphas: usize,
    /// Values of each lambda on the grid.
    pub num_lambdas: usize,
    /// Each method runs this often; the fastest run counts, as the one that was disturbed least.
    pub repeats: usize,
}

impl Default for SweepBenchConfig {
    fn default() -> Self {
        Self { num_alphas: 20, num_lambdas: 20, repeats: 10 }
    }
}

/// The result of [`sweep`]: `palpate bench sweep --json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SweepBenchReport {
    /// Joint frames.
    pub frames: usize,
    /// Channels.
    pub channels: usize,
    /// Surface nodes of the pressure patches.
    pub pressure_nodes: usize,
    /// Nodes under pressure, summed over frames: the multiplications an alpha needs are these times taxels per patch.
    pub node_pressures: usize,
    /// Pressures above zero at alpha = 0: what is sorted for each alpha.
    pub sorted_pressures: u64,
    /// Distances within reach: sorted once.
    pub sorted_distances: u64,
    /// Threads.
    pub threads: usize,
    /// Values of alpha.
    pub alphas: usize,
    /// Points of the grid.
    pub grid_points: usize,
    /// Exact search over the same alphas as the grid, without refinement, s.
    pub exact_seconds: f64,
    /// Steps of the objective that the exact search compared.
    pub exact_evaluations: u64,
    /// Its objective.
    pub exact_l1: u64,
    /// Exact search with refinement of alpha, as a calibration runs it, s.
    pub exact_refined_seconds: f64,
    /// Its objective.
    pub exact_refined_l1: u64,
    /// Our own grid, s.
    pub grid_seconds: f64,
    /// Its objective.
    pub grid_l1: u64,
}

/// Times the exact search and the grid on all of `takes`.
pub fn sweep(
    config: SweepBenchConfig,
    layout: &TactileLayout,
    takes: &[PairedTake],
    clock_s: &dyn Fn() -> f64,
) -> Result<SweepBenchReport, CalibrationError> {
    for take in takes {
        take.check(layout)?;
    }
    let data = FitData::new(layout, takes);
    let alphas = alpha_axis(layout, config.num_alphas);
    let axes = GridAxes::from_data(&data, alphas.clone(), config.num_lambdas);
    let cancel = Cancel::default();
    let watch = Watch { progress: &NoProgress, cancel: &cancel, span: [0.0, 1.0] };
    let repeats = config.repeats;

    let (exact_seconds, plain) = fastest(repeats, clock_s, || exact(&data, &alphas, 0, watch))?;
    let rounds = crate::sweep::REFINEMENT_ROUNDS;
    let (exact_refined_seconds, refined) =
        fastest(repeats, clock_s, || exact(&data, &alphas, rounds, watch))?;
    let (grid_seconds, grid) = fastest(repeats, clock_s, || grid(&data, axes.clone(), watch))?;

    let pressure_patches = || patches(layout, SensorKind::Pressure);
    let node_pressures = |trace: &Arc<PatchTrace>| match &**trace {
        PatchTrace::Pressure { entries, .. } => entries.len(),
        PatchTrace::Proximity { .. } => 0,
    };
    Ok(SweepBenchReport {
        frames: takes.iter().map(PairedTake::num_frames).sum(),
        channels: layout.num_channels(),
        pressure_nodes: pressure_patches().map(|(_, patch)| patch.nodes.len()).sum(),
        node_pressures: takes.iter().flat_map(|take| &take.contact.patches).map(node_pressures).sum(),
        sorted_pressures: data.pressure(0.0).num_above_floor(),
        sorted_distances: plain.proximity.num_above_floor(),
        threads: rayon::current_num_threads(),
        alphas: alphas.len(),
        grid_points: alphas.len() * config.num_lambdas * config.num_lambdas,
        exact_seconds,
        exact_evaluations: plain.evaluations,
        exact_l1: plain.l1(),
        exact_refined_seconds,
        exact_refined_l1: refined.l1(),
        grid_seconds,
        grid_l1: grid.l1(),
    })
}

fn fastest<T>(
    repeats: usize,
    clock_s: &dyn Fn() -> f64,
    run: impl Fn() -> Result<T, CalibrationError>,
) -> Result<(f64, T), CalibrationError> {
    let timed = || {
        let start_s = clock_s();
        let result = run()?;
        Ok((clock_s() - start_s, result))
    };
    let mut best: (f64, T) = timed()?;
    for _ in 1..repeats {
        let again = timed()?;
        if again.0 < best.0 {
            best = again;
        }
    }
    Ok(best)
}

fn patches(
    layout: &TactileLayout,
    kind: SensorKind,
) -> impl Iterator<Item = (usize, &palpate_robot_model::Patch)> {
    layout.patches.iter().enumerate().filter(move |(_, patch)| layout.streams[patch.stream].kind == kind)
}

/// Writes the precomputed signals of `takes` as NumPy arrays into `dir`, for `tests/peers/numpy_grid.py`.
///
/// All takes are joined, frame by frame. Per pressure patch `k`: `pressures_k.npy` (frames x nodes, Pa, dense),
/// `node_distances_k.npy` (taxels x nodes, m), `real_pressure_k.npy` (frames x taxels, bool). For the proximity channels:
/// `distances.npy` (frames x channels, m), `real_proximity.npy` (bool). The grid's axes: `alphas.npy`,
/// `lambda_cons.npy`, `lambda_pres.npy`.
pub fn write_peer_inputs(
    config: SweepBenchConfig,
    layout: &TactileLayout,
    takes: &[PairedTake],
    dir: &Path,
) -> io::Result<()> {
    fs::create_dir_all(dir)?;
    let num_channels = layout.num_channels();
    let num_frames: usize = takes.iter().map(PairedTake::num_frames).sum();
    let real = |channels: std::ops::Range<usize>| -> Vec<u8> {
        let frames = takes.iter().flat_map(|take| take.real_active.chunks_exact(num_channels));
        frames.flat_map(|frame| frame[channels.clone()].iter().map(|&active| u8::from(active))).collect()
    };
    for (k, (patch_idx, patch)) in patches(layout, SensorKind::Pressure).enumerate() {
        let num_nodes = patch.nodes.len();
        let mut pressures = vec![0.0; num_frames * num_nodes];
        let mut rows = pressures.chunks_exact_mut(num_nodes.max(1));
        for take in takes {
            let PatchTrace::Pressure { offsets, entries } = &*take.contact.patches[patch_idx] else {
                continue;
            };
            for (frame, row) in (0..take.num_frames()).zip(&mut rows) {
                for &(node, pressure_pa) in &entries[PatchTrace::entry_range(offsets, frame)] {
                    row[node as usize] = pressure_pa;
                }
            }
        }
        let distances: Vec<f64> = patch
            .taxels_in_link
            .iter()
            .flat_map(|taxel| patch.nodes.iter().map(move |node| (node.pos_in_link - taxel).norm()))
            .collect();
        let num_taxels = patch.taxels_in_link.len();
        write_npy(
            &dir.join(format!("pressures_{k}.npy")),
            "<f8",
            &[num_frames, num_nodes],
            &bytes(&pressures),
        )?;
        write_npy(
            &dir.join(format!("node_distances_{k}.npy")),
            "<f8",
            &[num_taxels, num_nodes],
            &bytes(&distances),
        )?;
        let real = real(patch.channels.clone());
        write_npy(&dir.join(format!("real_pressure_{k}.npy")), "|b1", &[num_frames, num_taxels], &real)?;
    }

    let proximity: Vec<_> = patches(layout, SensorKind::Proximity)
        .flat_map(|(patch_idx, patch)| patch.channels.clone().map(move |channel| (patch_idx, channel)))
        .collect();
    let mut distances = Vec::with_capacity(num_frames * proximity.len());
    let mut real_proximity = Vec::with_capacity(num_frames * proximity.len());
    for take in takes {
        for frame in 0..take.num_frames() {
            for &(patch_idx, channel) in &proximity {
                let PatchTrace::Proximity { min_distance_m, .. } = &*take.contact.patches[patch_idx] else {
                    continue;
                };
                distances.push(min_distance_m[frame]);
                real_proximity.push(u8::from(take.real_active[frame * num_channels + channel]));
            }
        }
    }
    let shape = [num_frames, proximity.len()];
    write_npy(&dir.join("distances.npy"), "<f8", &shape, &bytes(&distances))?;
    write_npy(&dir.join("real_proximity.npy"), "|b1", &shape, &real_proximity)?;

    let data = FitData::new(layout, takes);
    let axes = GridAxes::from_data(&data, alpha_axis(layout, config.num_alphas), config.num_lambdas);
    for (name, axis) in [
        ("alphas", axes.alphas_per_m),
        ("lambda_cons", axes.lambda_cons_m),
        ("lambda_pres", axes.lambda_pres_pa),
    ] {
        write_npy(&dir.join(format!("{name}.npy")), "<f8", &[axis.len()], &bytes(&axis))?;
    }
    Ok(())
}

fn bytes(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// Version 1.0 of NumPy's own format: magic, length of the header, header as a Python literal, C-ordered data.
fn write_npy(path: &Path, dtype: &str, shape: &[usize], data: &[u8]) -> io::Result<()> {
    let shape: String = shape.iter().map(|len| format!("{len},")).collect();
    let mut header = format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({shape}), }}");
    // Magic, version and length take 10 bytes; data start at a multiple of 64.
    let padding = 63 - (10 + header.len()) % 64;
    header.extend(std::iter::repeat_n(' ', padding));
    header.push('\n');
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((header.len() as u16).to_le_bytes());
    file.extend(header.as_bytes());
    file.extend(data);
    fs::write(path, file)
}
