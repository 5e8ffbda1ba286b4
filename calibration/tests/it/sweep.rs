//! The exact search against any grid and against counting, on arbitrary small sessions.

use std::sync::Arc;

use palpate_calibration::{
    PairedTake,
    sweep::{FitData, GridAxes, Watch, exact, grid, l1_of_readings},
};
use palpate_robot_model::TactileLayout;
use palpate_sim::{
    Theta,
    job::{Cancel, NoProgress},
    replay::{ContactTrace, Gaps, NEAR_M, PatchTrace},
};
use proptest::{collection::vec, prelude::*};

use crate::synthetic::{self, Size};

const SIZE: Size =
    Size { pads: 1, taxels_per_pad: 3, nodes_per_side: 2, patches: 2, takes: 2, frames_per_take: 0 };
const NUM_CHANNELS: usize = 5;

/// What one frame holds: pressures of the four nodes, distances of the two patches, real activations.
type Frame = ([f64; 4], [f64; 2], [bool; NUM_CHANNELS]);

fn frame() -> impl Strategy<Value = Frame> {
    // Many zeros and ties, as in a session, and anything else.
    let pressure =
        || prop_oneof![3 => Just(0.0), 1 => (1..4_u8).prop_map(|k| 100.0 * f64::from(k)), 1 => 1e-3..1e4_f64];
    let distance =
        || prop_oneof![1 => Just(NEAR_M + 0.01), 1 => Just(0.0), 1 => Just(1e-3), 1 => -5e-3..NEAR_M];
    let real = prop_oneof![1 => Just([false; NUM_CHANNELS]), 1 => Just([true; NUM_CHANNELS]), 4 => any::<[bool; NUM_CHANNELS]>()];
    ([pressure(), pressure(), pressure(), pressure()], [distance(), distance()], real)
}

fn session() -> impl Strategy<Value = Vec<Vec<Frame>>> {
    vec(vec(frame(), 0..25), 1..4)
}

fn take((take_idx, frames): (usize, &Vec<Frame>)) -> PairedTake {
    let (mut offsets, mut entries) = (vec![0], Vec::new());
    for (pressures, ..) in frames {
        let touched = pressures.iter().enumerate().filter(|&(_, &pressure_pa)| pressure_pa > 0.0);
        entries.extend(touched.map(|(node, &pressure_pa)| (node as u32, pressure_pa)));
        offsets.push(entries.len() as u32);
    }
    let distances = |patch: usize| {
        let min_distance_m = frames.iter().map(|(_, distances, _)| distances[patch]).collect();
        Arc::new(PatchTrace::Proximity { min_distance_m, gaps: Gaps::default() })
    };
    PairedTake {
        id: format!("take-{take_idx}"),
        object: "ball".to_owned(),
        frame_times_s: (0..frames.len()).map(|frame| frame as f64 * 0.1).collect(),
        contact: ContactTrace {
            num_frames: frames.len(),
            patches: vec![Arc::new(PatchTrace::Pressure { offsets, entries }), distances(0), distances(1)],
        },
        real_active: frames.iter().flat_map(|(.., real)| *real).collect(),
    }
}

fn paired(session: &[Vec<Frame>]) -> (TactileLayout, Vec<PairedTake>) {
    (synthetic::layout(SIZE), session.iter().enumerate().map(take).collect())
}

fn ascending(mut axis: Vec<f64>) -> Vec<f64> {
    axis.sort_by(f64::total_cmp);
    axis
}

fn axes() -> impl Strategy<Value = GridAxes> {
    // Thresholds also fall on the very values that the signals take.
    let lambda_con = prop_oneof![Just(0.0), Just(1e-3), -6e-3..NEAR_M];
    let lambda_pre = prop_oneof![Just(0.0), Just(100.0), Just(300.0), 0.0..2e4_f64];
    let alpha = prop_oneof![Just(0.0), 1.0..3000.0_f64];
    (vec(alpha, 1..5), vec(lambda_con, 1..8), vec(lambda_pre, 1..8)).prop_map(|(alphas, cons, pres)| {
        GridAxes {
            alphas_per_m: ascending(alphas),
            lambda_cons_m: ascending(cons),
            lambda_pres_pa: ascending(pres),
        }
    })
}

proptest! {
    #[test]
    fn exact_is_never_worse_than_any_grid(session in session(), axes in axes()) {
        let (layout, takes) = paired(&session);
        let data = FitData::new(&layout, &takes);
        let cancel = Cancel::default();
        let watch = Watch { progress: &NoProgress, cancel: &cancel, span: [0.0, 1.0] };
        let grid = grid(&data, axes.clone(), watch).expect("not cancelled");
        for refinement_rounds in [0, 2] {
            let exact = exact(&data, &axes.alphas_per_m, refinement_rounds, watch).expect("not cancelled");
            prop_assert!(exact.l1() <= grid.l1(), "exact {} grid {}", exact.l1(), grid.l1());
        }
    }

    #[test]
    fn both_objectives_equal_counting_at_every_point_of_the_grid(session in session(), axes in axes()) {
        let (layout, takes) = paired(&session);
        let data = FitData::new(&layout, &takes);
        let cancel = Cancel::default();
        let watch = Watch { progress: &NoProgress, cancel: &cancel, span: [0.0, 1.0] };
        let grid = grid(&data, axes.clone(), watch).expect("not cancelled");
        let proximity = data.proximity();
        for (i, &alpha_per_m) in axes.alphas_per_m.iter().enumerate() {
            let pressure = data.pressure(alpha_per_m);
            for (j, &lambda_pre_pa) in axes.lambda_pres_pa.iter().enumerate() {
                for (k, &lambda_con_m) in axes.lambda_cons_m.iter().enumerate() {
                    let counted = l1_of_readings(&data, Theta { lambda_con_m, alpha_per_m, lambda_pre_pa });
                    prop_assert_eq!(counted, grid.pressure_l1[i][j] + grid.proximity_l1[k]);
                    prop_assert_eq!(counted, pressure.l1_at(lambda_pre_pa) + proximity.l1_at(-lambda_con_m));
                }
            }
        }
    }

    #[test]
    fn objective_at_the_optimum_is_what_the_sensor_model_gives(session in session(), axes in axes()) {
        let (layout, takes) = paired(&session);
        let data = FitData::new(&layout, &takes);
        let cancel = Cancel::default();
        let watch = Watch { progress: &NoProgress, cancel: &cancel, span: [0.0, 1.0] };
        let found = exact(&data, &axes.alphas_per_m, 1, watch).expect("not cancelled");
        let (alpha_per_m, lambda_pre_pa) = found.best_alpha().map_or((0.0, 0.0), |(alpha, best)| (alpha, best.threshold));
        let lambda_con_m = found.lambda_con_m.map_or(0.0, |best| best.threshold);
        prop_assert!(lambda_con_m <= NEAR_M && lambda_pre_pa >= 0.0 && lambda_pre_pa.is_finite());
        prop_assert_eq!(l1_of_readings(&data, Theta { lambda_con_m, alpha_per_m, lambda_pre_pa }), found.l1());
    }
}
