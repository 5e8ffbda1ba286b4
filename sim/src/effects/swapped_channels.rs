//! Two channels that are plugged in the wrong way round.

use std::sync::Arc;

use palpate_robot_model::{Place, Station, TactileLayout};

use super::{
    DynFrameEffect, Effect, EffectKind, Frame, FrameEffect, Load, Parameter, Stage, TakeScene, places,
};

/// Each of two channels reads what the other should.
pub(super) struct SwappedChannels;

impl EffectKind for SwappedChannels {
    fn id(&self) -> &'static str {
        "swapped_channels"
    }

    fn stage(&self) -> Stage {
        Stage::Electronics
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        let likely = places::likely(effect.parameter("presence"));
        format!("{} are swapped{likely}.", places::title(&effect.place, station))
    }

    fn signature(&self) -> &'static str {
        "each of two channels answers when the other is touched; counts unchanged"
    }

    fn mixes_channels(&self) -> bool {
        true
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        Parameter::presence()
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        let channels = &station.layout.channels;
        let id = |channel: usize| channels[channel].id.clone();
        let pairs = (0..channels.len())
            .flat_map(|first| (first + 1..channels.len()).map(move |second| (first, second)));
        let likely = pairs.filter(|&(first, second)| can_swap(first, second, &station.layout));
        likely.map(|(first, second)| Place::Channels(vec![id(first), id(second)])).collect()
    }

    fn load(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Load) {
        let presence = effect.parameter("presence");
        let channels = places::channels_of(&effect.place, &scene.station.layout);
        let [first, second] = channels[..] else { return };
        if presence == 0.0 || (state.is_silent(first) && state.is_silent(second)) {
            return;
        }
        let (ones, others) = (Arc::clone(state.of_channel(first)), Arc::clone(state.of_channel(second)));
        let swapped = |own: &[f64], other: &[f64]| -> Arc<[f64]> {
            own.iter().zip(other).map(|(&own, &other)| mix(presence, own, other)).collect()
        };
        state.values[first] = swapped(&ones, &others);
        state.values[second] = swapped(&others, &ones);
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, _on_loads: &[f64]) -> Option<DynFrameEffect> {
        let presence = effect.parameter("presence");
        let channels = places::channels_of(&effect.place, &station.layout);
        let &[first, second] = &channels[..] else { return None };
        (presence != 0.0).then(|| Box::new(Swap { presence, first, second }) as DynFrameEffect)
    }
}

fn mix(presence: f64, own: f64, other: f64) -> f64 {
    (1.0 - presence) * own + presence * other
}

#[derive(Debug)]
struct Swap {
    presence: f64,
    first: usize,
    second: usize,
}

impl FrameEffect for Swap {
    fn step(&self, _frame: &Frame<'_>, _memory: &mut [f64], loads: &mut [f64]) {
        let (one, other) = (loads[self.first], loads[self.second]);
        loads[self.first] = mix(self.presence, one, other);
        loads[self.second] = mix(self.presence, other, one);
    }
}

/// Whether the two could be confused at a connector: taxels of one patch, or patches of one taxel each on one board.
fn can_swap(first: usize, second: usize, layout: &TactileLayout) -> bool {
    let (one, other) = (&layout.channels[first], &layout.channels[second]);
    let alone = |patch: usize| layout.patches[patch].channels.len() == 1;
    one.patch == other.patch || (one.stream == other.stream && alone(one.patch) && alone(other.patch))
}
