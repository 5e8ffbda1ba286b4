//! A skin that stays dented after a touch.

use palpate_robot_model::{Place, Station};

use super::{
    DynFrameEffect, Effect, EffectKind, Load, Parameter, Stage, TakeScene,
    force::{Force, LateForce, lag_forces},
    places,
};

/// The standard linear solid in its creep form (a spring in series with a Kelvin-Voigt element; Findley, Lai,
/// Onaran, "Creep and Relaxation of Nonlinear Viscoelastic Materials", 1976, section 5.4) under one-sided contact:
/// while it is pressed, the skin is where the object puts it; a share `fraction` of its compliance is strain that
/// creeps after the load with `time_constant_s`, and once the object retreats that share recovers as slowly. So
/// `F' = max(F, fraction * z)` of the force `F` that the skin bears, with `z' = (F - z) / time_constant_s`: onsets
/// stay, releases come late, later after longer holds.
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

    fn acts_on_forces(&self) -> bool {
        true
    }

    fn load(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Load) {
        let (fraction, time_constant_s) = (effect.parameter("fraction"), effect.parameter("time_constant_s"));
        if fraction <= 0.0 || time_constant_s <= 0.0 {
            return;
        }
        let of_channel = |channel| Force::usual(&scene.station.layout, channel);
        let felt = |force: f64, z| force.max(fraction * z);
        lag_forces(&effect.place, scene, state, time_constant_s, of_channel, felt);
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, _on_loads: &[f64]) -> Option<DynFrameEffect> {
        let (fraction, time_constant_s) = (effect.parameter("fraction"), effect.parameter("time_constant_s"));
        (fraction > 0.0 && time_constant_s > 0.0).then(|| {
            let of_channel = |channel| Force::usual(&station.layout, channel);
            let felt = move |force: f64, z| force.max(fraction * z);
            LateForce::boxed(&effect.place, station, time_constant_s, of_channel, felt)
        })
    }
}
