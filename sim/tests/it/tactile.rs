//! The tactile model: propagation and thresholds.

use palpate_robot_model::SensorKind;
use palpate_sim::replay::PatchTrace;
use palpate_sim::tactile::{propagation, raw_signals, readings, thresholds};
use proptest::prelude::*;

use crate::probe::{ball, base_from_object, layout, model, path, replay, robot};

/// The slide goes this much deeper while swing and twist stay.
fn press(depths_m: &[f64], swing: f64, twist: f64) -> Vec<f64> {
    depths_m.iter().flat_map(|depth| [0.0 - depth, swing, twist]).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// The formula of the paper, written out.
    #[test]
    fn raw_signals_are_the_sums_of_the_paper(alpha in 0.0..2000.0_f64) {
        let layout = layout(&robot());
        let trace = replay(&ball(), &base_from_object(), &path(101));
        let raw = raw_signals(&layout, &trace, alpha);
        prop_assert_eq!(raw.len(), 101 * layout.num_channels());
        let mut active_sums = 0;
        for frame in 0..101 {
            for (idx, channel) in layout.channels.iter().enumerate() {
                let found = raw[frame * layout.num_channels() + idx];
                let patch = &layout.patches[channel.patch];
                let expected = match &*trace.patches[channel.patch] {
                    PatchTrace::Proximity { min_distance_m, .. } => min_distance_m[frame],
                    PatchTrace::Pressure { offsets, entries } => {
                        let taxel = patch.taxels_in_link[channel.taxel];
                        entries[PatchTrace::entry_range(offsets, frame)]
                            .iter()
                            .map(|&(node, f)| (-alpha * (patch.nodes[node as usize].pos_in_link - taxel).norm()).exp() * f)
                            .sum()
                    }
                };
                active_sums += usize::from(expected > 1000.0);
                prop_assert!((found - expected).abs() <= 1e-12 * expected.abs(), "{}: {} against {}", channel.id, found, expected);
            }
        }
        prop_assert!(active_sums > 20);
    }

    /// The sled moves the pads straight towards the ball's lower half space: every node gets nearer or stays out.
    #[test]
    fn deeper_press_never_lowers_propagated_pressure(
        swing in -0.2..0.2_f64, twist in -3.0..3.0_f64, alpha in 0.0..2000.0_f64
    ) {
        let layout = layout(&robot());
        let depths: Vec<f64> = (0..40).map(|i| 0.0005 * f64::from(i)).collect();
        let raw = raw_signals(&layout, &replay(&ball(), &base_from_object(), &press(&depths, swing, twist)), alpha);
        let num_channels = layout.num_channels();
        for (idx, channel) in layout.channels.iter().enumerate() {
            if layout.streams[channel.stream].kind == SensorKind::Pressure {
                for frame in 1..depths.len() {
                    let (before, now) = (raw[(frame - 1) * num_channels + idx], raw[frame * num_channels + idx]);
                    prop_assert!(now >= before, "{} falls from {} to {}", channel.id, before, now);
                }
            }
        }
        prop_assert!(raw.iter().any(|&pressure_pa| pressure_pa > 1000.0), "the press must reach the ball");
    }

    #[test]
    fn larger_alpha_never_raises_a_pressure(alpha in 0.0..1500.0_f64, more in 0.0..1500.0_f64) {
        let layout = layout(&robot());
        let trace = replay(&ball(), &base_from_object(), &path(61));
        let (low, high) = (raw_signals(&layout, &trace, alpha), raw_signals(&layout, &trace, alpha + more));
        for (a, b) in low.iter().zip(&high) {
            prop_assert!(b <= a, "{} rises to {}", a, b);
        }
    }

    #[test]
    fn larger_lambda_con_never_deactivates(lambda in -0.005..0.04_f64, more in 0.0..0.009_f64) {
        let layout = layout(&robot());
        let trace = replay(&ball(), &base_from_object(), &path(61));
        let tight = readings(&layout, &trace, &model(lambda, 100.0, 500.0).thetas());
        let wide = readings(&layout, &trace, &model(lambda + more, 100.0, 500.0).thetas());
        for (was, is) in tight.active.iter().zip(&wide.active) {
            prop_assert!(!was || *is);
        }
    }

    #[test]
    fn larger_lambda_pre_never_activates(lambda in 0.0..20000.0_f64, more in 0.0..20000.0_f64) {
        let layout = layout(&robot());
        let trace = replay(&ball(), &base_from_object(), &path(61));
        let low = readings(&layout, &trace, &model(0.002, 100.0, lambda).thetas());
        let high = readings(&layout, &trace, &model(0.002, 100.0, lambda + more).thetas());
        for (was, is) in low.active.iter().zip(&high.active) {
            prop_assert!(*was || !is);
        }
    }
}

#[test]
fn very_large_alpha_isolates_taxels() {
    let layout = layout(&robot());
    let trace = replay(&ball(), &base_from_object(), &path(101));
    let raw = raw_signals(&layout, &trace, 1e7);
    let mut touched = 0;
    for (idx, channel) in layout.channels.iter().enumerate() {
        let patch = &layout.patches[channel.patch];
        let PatchTrace::Pressure { offsets, entries } = &*trace.patches[channel.patch] else { continue };
        for frame in 0..trace.num_frames {
            // Every taxel of the probe sits on a node: only that node's own pressure is left.
            let own = entries[PatchTrace::entry_range(offsets, frame)]
                .iter()
                .find(|(node, _)| {
                    patch.nodes[*node as usize].pos_in_link == patch.taxels_in_link[channel.taxel]
                })
                .map_or(0.0, |&(_, pressure_pa)| pressure_pa);
            assert_eq!(raw[frame * layout.num_channels() + idx], own, "{}", channel.id);
            touched += usize::from(own > 0.0);
        }
    }
    assert!(touched > 20);
}

#[test]
fn alpha_zero_makes_the_taxels_of_a_patch_equal() {
    let layout = layout(&robot());
    let raw = raw_signals(&layout, &replay(&ball(), &base_from_object(), &path(101)), 0.0);
    for frame in raw.chunks(layout.num_channels()) {
        for patch in &layout.patches {
            let taxels = &frame[patch.channels.clone()];
            assert!(taxels.iter().all(|taxel| taxel == &taxels[0]), "{}: {taxels:?}", patch.id);
        }
    }
}

#[test]
fn readings_compare_raw_signals_with_thresholds() {
    let layout = layout(&robot());
    let model = model(0.003, 150.0, 2000.0);
    let readings = readings(&layout, &replay(&ball(), &base_from_object(), &path(101)), &model.thetas());
    assert_eq!((readings.num_frames, readings.num_channels), (101, layout.num_channels()));
    let thresholds = thresholds(&layout, &model.thetas());
    assert_eq!(thresholds[..12], [2000.0; 12]);
    assert_eq!(thresholds[12..], [0.003; 2]);
    for frame in 0..readings.num_frames {
        let (raw, active) = (readings.raw_frame(frame), readings.active_frame(frame));
        for channel in 0..readings.num_channels {
            let expected = if channel < 12 { raw[channel] > 2000.0 } else { raw[channel] < 0.003 };
            assert_eq!(active[channel], expected);
        }
    }
    assert!(readings.active.iter().any(|active| *active) && !readings.active.iter().all(|active| *active));
}

#[test]
fn weights_are_one_at_the_taxel_and_empty_for_proximity() {
    let layout = layout(&robot());
    let propagation = propagation(&layout, &[250.0; 4]);
    assert_eq!(propagation[0].weights.len(), 15 * 4);
    assert_eq!(propagation[0].weights[4 * 4 + 1], 1.0, "taxel 1 of the pad sits on node 4");
    let apart = propagation[0].weights[4];
    assert!((apart - (-250.0 * 0.004_f64).exp()).abs() < 1e-12, "node 1 is 4 mm from taxel 0: {apart}");
    assert!(propagation[2].weights.is_empty());
}
