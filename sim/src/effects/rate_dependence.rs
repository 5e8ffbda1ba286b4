//! A skin that pushes back harder the faster it is pressed.

use std::sync::Arc;

use palpate_robot_model::{Place, Station};

use super::{Contact, Effect, EffectKind, Parameter, Stage, TakeScene, places};
use crate::replay::{NEAR_M, PatchTrace};

/// A damper beside the spring of the penalty force (Kelvin-Voigt): the pressure of a touched node is
/// `stiffness * max(0, depth + damping_s * d(depth)/dt)`; a proximity patch reads the distance that it would have
/// `damping_s` later at its present speed.
pub(super) struct RateDependence;

impl EffectKind for RateDependence {
    fn id(&self) -> &'static str {
        "rate_dependence"
    }

    fn stage(&self) -> Stage {
        Stage::Contact
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "The skin of the {} pushes back against speed: it answers {:.0} ms ahead of how deep it is pressed.",
            places::name(&effect.place, station),
            effect.parameter("damping_s") * 1e3
        )
    }

    fn signature(&self) -> &'static str {
        "onsets and releases early, in proportion to the speed of the touch; nothing while it holds still"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("damping_s", 0.0..=0.3, 0.0, 0.012, 0.03)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_streams(station)
    }

    fn contact(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Contact<'_>) {
        let damping_s = effect.parameter("damping_s");
        if damping_s <= 0.0 {
            return;
        }
        let times_s = scene.frame_times_s;
        for patch in places::patches_of(&effect.place, &scene.station.layout) {
            match Arc::make_mut(&mut state.trace.to_mut().patches[patch]) {
                PatchTrace::Proximity { min_distance_m, .. } => approach(min_distance_m, times_s, damping_s),
                PatchTrace::Pressure { offsets, entries } => press(offsets, entries, times_s, damping_s),
            }
        }
    }

    fn looks_ahead(&self) -> bool {
        true
    }
}

/// The frames around `frame` from which its rate is taken, those within the take that `counts` accepts.
fn around(frame: usize, num_frames: usize, counts: impl Fn(usize) -> bool) -> (usize, usize) {
    let before = frame.checked_sub(1).filter(|&before| counts(before)).unwrap_or(frame);
    let after = Some(frame + 1).filter(|&after| after < num_frames && counts(after)).unwrap_or(frame);
    (before, after)
}

fn rate(change: f64, times_s: &[f64], (before, after): (usize, usize)) -> f64 {
    let gap_s = times_s[after] - times_s[before];
    if gap_s > 0.0 { change / gap_s } else { 0.0 }
}

/// Far frames hold bounds instead of distances, so they and the step to them have no rate.
fn approach(distances_m: &mut [f64], times_s: &[f64], damping_s: f64) {
    let still = distances_m.to_vec();
    for (frame, distance_m) in distances_m.iter_mut().enumerate().filter(|(frame, _)| still[*frame] < NEAR_M)
    {
        let sides = around(frame, still.len(), |other| still[other] < NEAR_M);
        *distance_m += damping_s * rate(still[sides.1] - still[sides.0], times_s, sides);
    }
}

fn press(offsets: &[u32], entries: &mut [(u32, f64)], times_s: &[f64], damping_s: f64) {
    let still = entries.to_vec();
    let num_frames = offsets.len() - 1;
    let pressure_pa = |frame: usize, node: u32| {
        let touched = &still[PatchTrace::entry_range(offsets, frame)];
        touched.binary_search_by_key(&node, |entry| entry.0).map_or(0.0, |found| touched[found].1)
    };
    for frame in 0..num_frames {
        let sides = around(frame, num_frames, |_| true);
        for (node, pressure) in &mut entries[PatchTrace::entry_range(offsets, frame)] {
            let change_pa = pressure_pa(sides.1, *node) - pressure_pa(sides.0, *node);
            *pressure = (*pressure + damping_s * rate(change_pa, times_s, sides)).max(0.0);
        }
    }
}
