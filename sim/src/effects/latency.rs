//! A stream that arrives late.

use palpate_robot_model::{Place, Station};

use super::{Effect, EffectKind, Parameter, Stage, TakeScene, Transport, places};

/// Every reading of a stream shows the world as it was `delay_s` earlier.
pub(super) struct Latency;

impl EffectKind for Latency {
    fn id(&self) -> &'static str {
        "latency"
    }

    fn stage(&self) -> Stage {
        Stage::Transport
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        let stream = places::name(&effect.place, station);
        format!("The {stream} arrives {:.0} ms late.", effect.parameter("delay_s") * 1e3)
    }

    fn signature(&self) -> &'static str {
        "onsets and releases shift by the same time, at every speed"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("delay_s", 0.0..=0.5, 0.0, 0.015, 0.04)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_streams(station)
    }

    fn transport(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Transport) {
        let delay_s = effect.parameter("delay_s");
        for stream in places::streams_of(&effect.place, &scene.station.layout) {
            for time_s in &mut state.device_times_s[stream] {
                *time_s -= delay_s;
            }
        }
    }
}
