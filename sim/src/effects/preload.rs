//! A patch that feels nothing until it is pressed some way in.

use std::sync::Arc;

use palpate_robot_model::{Place, Station};

use super::{Contact, Effect, EffectKind, Parameter, Stage, TakeScene, places};
use crate::replay::PatchTrace;

/// Nothing registers on the patch before it is `depth_m` deep: a stiff cover, a gap under it. To first order this is
/// also a mount offset along the normal and a threshold of the patch's own.
pub(super) struct Preload;

impl EffectKind for Preload {
    fn id(&self) -> &'static str {
        "preload"
    }

    fn stage(&self) -> Stage {
        Stage::Contact
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "{} feels nothing until it is pressed {:.2} mm in.",
            places::title(&effect.place, station),
            effect.parameter("depth_m") * 1e3
        )
    }

    fn signature(&self) -> &'static str {
        "one patch switches on late and off early by the same depth, from every direction; light touches are missed"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("depth_m", 0.0..=0.002, 0.0, 2.5e-4, 4e-4)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_patches(station)
    }

    fn contact(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Contact<'_>) {
        let depth_m = effect.parameter("depth_m");
        if depth_m <= 0.0 {
            return;
        }
        let layout = &scene.station.layout;
        for patch in places::patches_of(&effect.place, layout) {
            match Arc::make_mut(&mut state.trace.to_mut().patches[patch]) {
                PatchTrace::Proximity { min_distance_m, .. } => {
                    for distance_m in min_distance_m {
                        *distance_m += depth_m;
                    }
                }
                PatchTrace::Pressure { entries, .. } => {
                    let lost_pa = depth_m * layout.patches[patch].stiffness_pa_per_m;
                    for (_, pressure_pa) in entries {
                        *pressure_pa = (*pressure_pa - lost_pa).max(0.0);
                    }
                }
            }
        }
    }
}
