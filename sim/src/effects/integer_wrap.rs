//! A channel whose reading wraps around when it falls below its reference.

use palpate_robot_model::{Place, Station};

use super::{Effect, EffectKind, Parameter, Stage, Switching, TakeScene, places};

/// A signed difference is stored unsigned: below its reference the reading is huge. At rest noise puts it below half of
/// the time, so that the quiet channel flickers on; under load it reads what it should.
pub(super) struct IntegerWrap;

impl EffectKind for IntegerWrap {
    fn id(&self) -> &'static str {
        "integer_wrap"
    }

    fn stage(&self) -> Stage {
        Stage::Electronics
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        let likely = places::likely(effect.parameter("presence"));
        format!(
            "{} wraps around below its reference and flickers on at rest{likely}.",
            places::title(&effect.place, station)
        )
    }

    fn signature(&self) -> &'static str {
        "one channel flickers on at rest, frame by frame, and reads right under load"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        Parameter::presence()
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_channels(station)
    }

    fn switching(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Switching) {
        for channel in places::channels_of(&effect.place, &scene.station.layout) {
            let idle = &mut state.idle_activation[channel];
            *idle = idle.max(BELOW_SHARE * effect.parameter("presence"));
        }
    }
}

/// How often the noise of a reading at rest is below its mean.
const BELOW_SHARE: f64 = 0.5;
