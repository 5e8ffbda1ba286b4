//! A firmware that switches off at another threshold than it should.

use palpate_robot_model::{Place, Station};

use super::{Effect, EffectKind, Parameter, Stage, Switching, TakeScene, places};

/// A channel that is on switches off below `off_fraction` of the load that switches it on. A station says what the
/// fraction should be.
pub(super) struct ThresholdHysteresis;

impl EffectKind for ThresholdHysteresis {
    fn id(&self) -> &'static str {
        "threshold_hysteresis"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "The {} switches off at {:.0} % of the load that switches it on.",
            places::name(&effect.place, station),
            effect.parameter("off_fraction") * 1e2
        )
    }

    fn signature(&self) -> &'static str {
        "releases late or early by load, the same after slow and fast releases; onsets on time"
    }

    fn parameters(&self, place: &Place, station: &Station) -> Vec<Parameter> {
        let known = places::streams_of(place, &station.layout).next();
        let neutral = known.map_or(1.0, |stream| station.streams[stream].off_fraction());
        vec![Parameter::new(
            "off_fraction",
            0.02..=1.0,
            neutral,
            0.12,
            if neutral > 0.5 { -0.25 } else { 0.25 },
        )]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_streams(station)
    }

    fn switching(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Switching) {
        for channel in places::channels_of(&effect.place, &scene.station.layout) {
            state.off_fractions[channel] = effect.parameter("off_fraction");
        }
    }
}
