//! A stream whose clock runs at another speed than the joints'.

use palpate_robot_model::{Place, Station};

use super::{Effect, EffectKind, Parameter, Stage, TakeScene, Transport, places};

/// Readings show the world as it was, later by `skew` every second since the take started.
pub(super) struct ClockSkew;

impl EffectKind for ClockSkew {
    fn id(&self) -> &'static str {
        "clock_skew"
    }

    fn stage(&self) -> Stage {
        Stage::Transport
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        let skew = effect.parameter("skew");
        let (falls, behind) = if skew < 0.0 { ("gets", "ahead") } else { ("falls", "behind") };
        format!(
            "The {} {falls} {:.2} ms further {behind} every second of a take.",
            places::name(&effect.place, station),
            skew.abs() * 1e3
        )
    }

    fn signature(&self) -> &'static str {
        "onsets and releases shift by a time that grows from the start of each take"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("skew", -0.02..=0.02, 0.0, 4e-4, 1e-3)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_streams(station)
    }

    fn transport(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Transport) {
        let start_s = scene.frame_times_s.first().copied().unwrap_or(0.0);
        let skew = effect.parameter("skew");
        if skew == 0.0 {
            return;
        }
        for stream in places::streams_of(&effect.place, &scene.station.layout) {
            for time_s in &mut state.device_times_s[stream] {
                *time_s -= skew * (*time_s - start_s).max(0.0);
            }
        }
    }
}
