//! A reading that drifts away from its reference.

use palpate_robot_model::{Place, Station, Tare};

use super::{
    DynFrameEffect, Effect, EffectKind, Frame, FrameEffect, Load, Parameter, Stage, TakeScene, places,
};

/// The reading gains `rate_per_s` of the load that switches the channel on, every second since the take started, when
/// the firmware took its reference, or since a reference was taken anew ([`TakeScene::tares`]).
pub(super) struct BaselineDrift;

impl EffectKind for BaselineDrift {
    fn id(&self) -> &'static str {
        "baseline_drift"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "The baseline of the {} drifts by {:+.2} % of its threshold a second.",
            places::name(&effect.place, station),
            effect.parameter("rate_per_s") * 1e2
        )
    }

    fn signature(&self) -> &'static str {
        "grows with time since the start of a take, with and without contact"
    }

    fn uses_on_loads(&self) -> bool {
        true
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("rate_per_s", -0.2..=0.2, 0.0, 0.002, 0.005)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_streams(station).into_iter().chain(places::all_channels(station)).collect()
    }

    fn load(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Load) {
        let rate_per_s = effect.parameter("rate_per_s");
        if rate_per_s == 0.0 {
            return;
        }
        let start_s = scene.frame_times_s.first().copied().unwrap_or(0.0);
        let elapsed = |&time_s: &f64| match Tare::newest(scene.tares, time_s) {
            Some(tare) => time_s - tare.taken_s,
            None => time_s - start_s,
        };
        let elapsed_s: Vec<f64> = scene.frame_times_s.iter().map(elapsed).collect();
        for channel in state.needed_at(&effect.place, &scene.station.layout) {
            let load_per_s = rate_per_s * state.on_loads[channel];
            let loads = state.of_channel_mut(channel).iter_mut().zip(&elapsed_s);
            loads.for_each(|(load, elapsed_s)| *load += load_per_s * elapsed_s);
        }
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, on_loads: &[f64]) -> Option<DynFrameEffect> {
        let rate_per_s = effect.parameter("rate_per_s");
        let channels = places::channels_of(&effect.place, &station.layout).into_iter();
        let drift = |channel: usize| (channel, rate_per_s * on_loads[channel]);
        (rate_per_s != 0.0).then(|| Box::new(Drift(channels.map(drift).collect())) as DynFrameEffect)
    }
}

/// Load a second, by channel.
#[derive(Debug)]
struct Drift(Vec<(usize, f64)>);

impl FrameEffect for Drift {
    fn step(&self, frame: &Frame<'_>, _memory: &mut [f64], loads: &mut [f64]) {
        for &(channel, load_per_s) in &self.0 {
            loads[channel] += load_per_s * (frame.time_s - frame.start_s);
        }
    }
}
