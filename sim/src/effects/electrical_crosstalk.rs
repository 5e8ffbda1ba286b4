//! Channels that leak into those next to them on the cable.

use palpate_robot_model::{Place, Station};

use super::{
    DynFrameEffect, Effect, EffectKind, Frame, FrameEffect, Load, Parameter, Stage, TakeScene, places,
};

/// Every channel reads `leak` of each neighbour's load besides its own.
pub(super) struct ElectricalCrosstalk;

impl EffectKind for ElectricalCrosstalk {
    fn id(&self) -> &'static str {
        "electrical_crosstalk"
    }

    fn stage(&self) -> Stage {
        Stage::Electronics
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "Channels of the {} leak {:.1} % of their reading into their neighbours on the cable.",
            places::name(&effect.place, station),
            effect.parameter("leak") * 1e2
        )
    }

    fn signature(&self) -> &'static str {
        "channels that nothing touches follow those next to them by number, however far apart on the skin"
    }

    fn mixes_channels(&self) -> bool {
        true
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("leak", 0.0..=0.8, 0.0, 0.03, 0.08)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_streams(station)
    }

    fn load(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Load) {
        let leak = effect.parameter("leak");
        if leak == 0.0 {
            return;
        }
        let layout = &scene.station.layout;
        let pairs = effect.wiring_neighbours(layout);
        let own = state.values.clone();
        let silent: Vec<bool> = (0..own.len()).map(|channel| state.is_silent(channel)).collect();
        for [channel, other] in pairs.into_iter().filter(|[_, other]| !silent[*other]) {
            let loads = state.of_channel_mut(channel).iter_mut().zip(own[other].iter());
            loads.for_each(|(load, other)| *load += leak * other);
        }
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, on_loads: &[f64]) -> Option<DynFrameEffect> {
        let leak = effect.parameter("leak");
        let pairs = effect.wiring_neighbours(&station.layout);
        let num_channels = on_loads.len();
        (leak != 0.0).then(|| Box::new(Leaks { leak, pairs, num_channels }) as DynFrameEffect)
    }
}

/// Its memory is where the loads are kept that all had before any leaked.
#[derive(Debug)]
struct Leaks {
    leak: f64,
    pairs: Vec<[usize; 2]>,
    num_channels: usize,
}

impl FrameEffect for Leaks {
    fn memory_len(&self) -> usize {
        self.num_channels
    }

    fn step(&self, _frame: &Frame<'_>, memory: &mut [f64], loads: &mut [f64]) {
        memory.copy_from_slice(loads);
        for &[channel, other] in &self.pairs {
            loads[channel] += self.leak * memory[other];
        }
    }
}
