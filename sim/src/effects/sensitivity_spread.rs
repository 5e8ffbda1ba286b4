//! Channels that are more or less sensitive than the model of their stream.

use palpate_robot_model::{Place, Station};

use super::{DynFrameEffect, Effect, EffectKind, Load, Parameter, Stage, TakeScene, frame::Factors, places};

/// The load of each channel counts `gain` times.
pub(super) struct SensitivitySpread;

impl EffectKind for SensitivitySpread {
    fn id(&self) -> &'static str {
        "sensitivity_spread"
    }

    fn stage(&self) -> Stage {
        Stage::Contact
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        let place = places::name(&effect.place, station);
        if let Some(gain) = effect.parameters.get(GAIN) {
            return format!("The {place} is {gain:.2} times as sensitive as the model has it.");
        }
        let gains = effect.parameters.iter().map(|(name, gain)| (name.trim_start_matches("gain_"), *gain));
        let furthest = gains.max_by(|a, b| a.1.ln().abs().total_cmp(&b.1.ln().abs()));
        let (channel, gain) = furthest.unwrap_or(("", 1.0));
        format!("Channels of the {place} differ in sensitivity, channel {channel} the most: {gain:.2} times.")
    }

    fn signature(&self) -> &'static str {
        "onsets early and releases late on some channels, the other way round on others, at every speed"
    }

    fn parameters(&self, place: &Place, station: &Station) -> Vec<Parameter> {
        let gain = |name: &str| Parameter::new(name, 0.2..=5.0, 1.0, 0.08, 0.15);
        match place {
            Place::Channel(_) => vec![gain(GAIN)],
            _ => {
                let channels = places::channels_of(place, &station.layout).into_iter();
                channels.map(|channel| gain(&gain_of(&station.layout.channels[channel].id))).collect()
            }
        }
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_streams(station).into_iter().chain(places::all_channels(station)).collect()
    }

    fn load(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Load) {
        let layout = &scene.station.layout;
        for channel in state.pressed_at(&effect.place, layout) {
            state.scale(channel, gain_at(effect, &layout.channels[channel].id));
        }
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, _on_loads: &[f64]) -> Option<DynFrameEffect> {
        let channels = places::channels_of(&effect.place, &station.layout).into_iter();
        let gain = |channel: usize| (channel, gain_at(effect, &station.layout.channels[channel].id));
        Some(Box::new(Factors(channels.map(gain).collect())))
    }
}

/// Of the channel called `channel`, at its place.
fn gain_at(effect: &Effect, channel: &str) -> f64 {
    match &effect.place {
        Place::Channel(_) => effect.parameter(GAIN),
        _ => effect.parameter(&gain_of(channel)),
    }
}

/// Parameter of a single channel.
const GAIN: &str = "gain";

/// Parameter of the channel called `channel`, for a whole stream.
fn gain_of(channel: &str) -> String {
    format!("gain_{channel}")
}
