//! A channel that always reads a touch.

use palpate_robot_model::{Place, Station};

use super::{
    DynFrameEffect, Effect, EffectKind, Frame, FrameEffect, Load, Parameter, Stage, Switching, TakeScene,
    places,
};

/// The channel is active all the time, and its reading stands still: at `level` times the load that switches it on,
/// above the reference that was taken at rest. Where it was stuck by then, the reference stands with it, and the level
/// is 0.
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

    fn uses_on_loads(&self) -> bool {
        true
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        let mut parameters = Parameter::presence();
        // Unless it is stuck it stands nowhere.
        parameters.push(Parameter::new(LEVEL, LOWEST..=HIGHEST, 0.0, 2.0 * HIGHEST, 0.5));
        parameters
    }

    fn parameters_since(&self) -> &'static [(&'static str, f64)] {
        &[(LEVEL, 0.0)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_channels(station)
    }

    fn load(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Load) {
        let presence = effect.parameter("presence");
        let level = presence * effect.parameter(LEVEL);
        for channel in state.pressed_at(&effect.place, &scene.station.layout) {
            state.scale(channel, 1.0 - presence);
        }
        if level != 0.0 {
            for channel in state.needed_at(&effect.place, &scene.station.layout) {
                let added = level * state.on_loads[channel];
                state.of_channel_mut(channel).iter_mut().for_each(|load| *load += added);
            }
        }
    }

    fn switching(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Switching) {
        for channel in places::channels_of(&effect.place, &scene.station.layout) {
            let idle = &mut state.idle_activation[channel];
            *idle = idle.max(effect.parameter("presence"));
        }
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, on_loads: &[f64]) -> Option<DynFrameEffect> {
        let presence = effect.parameter("presence");
        let level = presence * effect.parameter(LEVEL);
        let channels = places::channels_of(&effect.place, &station.layout).into_iter();
        let channels = channels.map(|channel| (channel, level * on_loads[channel])).collect();
        Some(Box::new(Stuck { left: 1.0 - presence, channels }))
    }
}

/// The parameter that says where it stands.
const LEVEL: &str = "level";
/// Lowest level: a reference that is a little too high.
const LOWEST: f64 = -1.0;
/// Highest level: a converter ends some tens of thresholds above its reference.
const HIGHEST: f64 = 50.0;

#[derive(Debug)]
struct Stuck {
    /// Share of the load that gets through.
    left: f64,
    /// Channels, each with the load that it has besides.
    channels: Vec<(usize, f64)>,
}

impl FrameEffect for Stuck {
    fn step(&self, _frame: &Frame<'_>, _memory: &mut [f64], loads: &mut [f64]) {
        for &(channel, added) in &self.channels {
            loads[channel] *= self.left;
            if added != 0.0 {
                loads[channel] += added;
            }
        }
    }
}
