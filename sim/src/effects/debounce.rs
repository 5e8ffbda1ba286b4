//! A firmware that waits before it reports a touch.

use palpate_robot_model::{Place, Station};

use super::{Effect, EffectKind, Parameter, Stage, Switching, TakeScene, places};

/// A touch is reported once it has lasted `min_on_s`, and shorter ones never.
pub(super) struct Debounce;

impl EffectKind for Debounce {
    fn id(&self) -> &'static str {
        "debounce"
    }

    fn stage(&self) -> Stage {
        Stage::Electronics
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "The {} reports a touch only once it has lasted {:.0} ms.",
            places::name(&effect.place, station),
            effect.parameter("min_on_s") * 1e3
        )
    }

    fn signature(&self) -> &'static str {
        "onsets late by the same time at every load, releases on time, taps shorter than that vanish"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("min_on_s", 0.0..=0.6, 0.0, 0.02, 0.06)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_streams(station)
    }

    fn switching(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Switching) {
        for channel in places::channels_of(&effect.place, &scene.station.layout) {
            state.min_on_s[channel] += effect.parameter("min_on_s");
        }
    }
}
