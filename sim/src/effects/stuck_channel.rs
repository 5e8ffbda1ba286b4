//! A channel that always reads a touch.

use palpate_robot_model::{Place, Station};

use super::{
    DynFrameEffect, Effect, EffectKind, Load, Parameter, Stage, Switching, TakeScene, frame::Factors, places,
};

/// The channel is active all the time. Its reading stands still, and the reference that a recording takes at rest with it:
/// above the reference there is nothing.
pub(super) struct StuckChannel;

impl EffectKind for StuckChannel {
    fn id(&self) -> &'static str {
        "stuck_channel"
    }

    fn stage(&self) -> Stage {
        Stage::Electronics
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        let likely = places::likely(effect.parameter("presence"));
        format!("{} is stuck: it is on all the time{likely}.", places::title(&effect.place, station))
    }

    fn signature(&self) -> &'static str {
        "one channel is on without any touch and through every touch, and its reading never moves"
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
            let idle = &mut state.idle_activation[channel];
            *idle = idle.max(effect.parameter("presence"));
        }
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, _on_loads: &[f64]) -> Option<DynFrameEffect> {
        Some(Box::new(Factors::left_by_presence(effect, &station.layout)))
    }
}
