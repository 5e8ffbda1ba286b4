//! A stream that arrives late.

use palpate_robot_model::{Place, Station};

use super::{Effect, EffectKind, Parameter, Stage, TakeScene, Transport};

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
        let stream = super::stream_label(&effect.place, station);
        format!("The {stream} stream arrives {:.0} ms late.", effect.parameter("delay_s") * 1e3)
    }

    fn signature(&self) -> &'static str {
        "onsets and releases shift by the same time, at every speed"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter {
            name: "delay_s".to_owned(),
            lower: 0.0,
            upper: 0.5,
            neutral: 0.0,
            smallest: 0.015,
            dose: 0.04,
        }]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        station.layout.streams.iter().map(|stream| Place::Stream(stream.id.clone())).collect()
    }

    fn transport(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Transport) {
        for stream in super::streams_of(&effect.place, &scene.station.layout) {
            for time_s in &mut state.device_times_s[stream] {
                *time_s -= effect.parameter("delay_s");
            }
        }
    }
}
