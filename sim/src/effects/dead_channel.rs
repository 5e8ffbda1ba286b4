//! A channel that never reads anything.

use palpate_robot_model::{Place, Station};

use super::{
    DynFrameEffect, Effect, EffectKind, Load, Parameter, Stage, Switching, TakeScene, frame::Factors, places,
};

/// The channel reads nothing, whatever touches it.
pub(super) struct DeadChannel;

impl EffectKind for DeadChannel {
    fn id(&self) -> &'static str {
        "dead_channel"
    }

    fn stage(&self) -> Stage {
        Stage::Electronics
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        let likely = places::likely(effect.parameter("presence"));
        format!("{} is dead{likely}.", places::title(&effect.place, station))
    }

    fn signature(&self) -> &'static str {
        "one channel misses every touch, firm ones too"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        Parameter::presence()
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_channels(station)
    }

    fn load(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Load) {
        for channel in state.pressed_at(&effect.place, &scene.station.layout) {
            state.scale(channel, 1.0 - effect.parameter("presence"));
        }
    }

    fn switching(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Switching) {
        for channel in places::channels_of(&effect.place, &scene.station.layout) {
            state.passed_shares[channel] *= 1.0 - effect.parameter("presence");
        }
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, _on_loads: &[f64]) -> Option<DynFrameEffect> {
        Some(Box::new(Factors::left_by_presence(effect, &station.layout)))
    }
}
