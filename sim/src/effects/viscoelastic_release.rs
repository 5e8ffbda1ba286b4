//! A skin that stays dented after a touch.

use palpate_robot_model::{Place, Station};

use super::{
    DynFrameEffect, Effect, EffectKind, Frame, FrameEffect, Load, Parameter, Stage, TakeScene,
    low_pass::{FrameLag, Lag},
    places,
};

/// The standard linear solid in its creep form (a spring in series with a Kelvin-Voigt element; Findley, Lai, Onaran,
/// "Creep and Relaxation of Nonlinear Viscoelastic Materials", 1976, section 5.4) under one-sided contact: while it is
/// pressed, the skin is where the object puts it; a share `fraction` of its compliance is strain that creeps after the
/// load with `time_constant_s`, and once the object retreats that share recovers as slowly. So
/// `load' = max(load, fraction * z)` with `z' = (load - z) / time_constant_s`: onsets stay, releases come late, later
/// after longer holds.
pub(super) struct ViscoelasticRelease;

impl EffectKind for ViscoelasticRelease {
    fn id(&self) -> &'static str {
        "viscoelastic_release"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "The {} stays dented after a touch: {:.0} % of the dent recovers with a time constant of {:.0} ms.",
            places::name(&effect.place, station),
            effect.parameter("fraction") * 1e2,
            effect.parameter("time_constant_s") * 1e3
        )
    }

    fn signature(&self) -> &'static str {
        "releases late by time, more after long and firm touches; onsets on time"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![
            Parameter::new("fraction", 0.0..=1.0, 0.0, 0.1, 0.3),
            // Without a fraction it does nothing.
            Parameter::new("time_constant_s", 0.02..=5.0, 0.3, 10.0, 0.1),
        ]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_streams(station)
    }

    fn load(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Load) {
        let (fraction, time_constant_s) = (effect.parameter("fraction"), effect.parameter("time_constant_s"));
        if fraction <= 0.0 || time_constant_s <= 0.0 {
            return;
        }
        let lag = Lag::new(scene.frame_times_s, time_constant_s);
        for channel in state.pressed_at(&effect.place, &scene.station.layout) {
            let strain = lag.of(state.of_channel(channel));
            let loads = state.of_channel_mut(channel).iter_mut().zip(strain.iter());
            loads.for_each(|(load, z)| *load = load.max(fraction * z));
        }
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, _on_loads: &[f64]) -> Option<DynFrameEffect> {
        let (fraction, time_constant_s) = (effect.parameter("fraction"), effect.parameter("time_constant_s"));
        let channels = places::channels_of(&effect.place, &station.layout);
        (fraction > 0.0 && time_constant_s > 0.0).then(|| {
            let strain = FrameLag { channels, time_constant_s };
            Box::new(Creep { fraction, strain }) as DynFrameEffect
        })
    }
}

#[derive(Debug)]
struct Creep {
    fraction: f64,
    strain: FrameLag,
}

impl FrameEffect for Creep {
    fn memory_len(&self) -> usize {
        self.strain.memory_len()
    }

    fn step(&self, frame: &Frame<'_>, memory: &mut [f64], loads: &mut [f64]) {
        self.strain.step(frame, memory, loads, |load, z| *load = load.max(self.fraction * z));
    }
}
