//! A skin that goes on giving way under a load.

use palpate_robot_model::{Place, Station};

use super::{
    DynFrameEffect, Effect, EffectKind, Load, Parameter, Stage, TakeScene,
    force::{Force, LateForce, lag_forces},
    places,
};

/// Quasi-linear viscoelasticity (Y. C. Fung, "Biomechanics: Mechanical Properties of Living Tissues", 1993, section
/// 7.6) with one term of a Prony series: what follows late is the force that the skin bears, `F = load^exponent`,
/// and `F' = (1 - fraction) F + fraction z` is felt, with `z' = (F - z) / time_constant_s`. Readings jump to most
/// of a force and creep to the rest; once it is gone, the same share goes as slowly.
pub(super) struct Creep;

impl EffectKind for Creep {
    fn id(&self) -> &'static str {
        "creep"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "The {} creeps: {:.0} % of a load is felt late, with a time constant of {:.1} s, and goes as slowly.",
            places::name(&effect.place, station),
            effect.parameter("fraction") * 1e2,
            effect.parameter("time_constant_s")
        )
    }

    fn signature(&self) -> &'static str {
        "readings creep up while a load holds still, and back once it is gone; fitted along, never named"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![
            Parameter::new("fraction", 0.0..=0.9, 0.0, 0.1, 0.2),
            // Without a fraction it does nothing.
            Parameter::new("time_constant_s", 0.1..=30.0, 1.0, 60.0, 0.3),
            Parameter::new("exponent", 0.3..=3.0, 1.0, 10.0, 0.2),
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
        let bears = Force::with(effect.parameter("exponent"));
        let felt = |force, late| blend(force, late, fraction);
        lag_forces(&effect.place, scene, state, time_constant_s, |_| bears, felt);
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, _on_loads: &[f64]) -> Option<DynFrameEffect> {
        let (fraction, time_constant_s) = (effect.parameter("fraction"), effect.parameter("time_constant_s"));
        (fraction > 0.0 && time_constant_s > 0.0).then(|| {
            let bears = Force::with(effect.parameter("exponent"));
            let felt = move |force, late| blend(force, late, fraction);
            LateForce::boxed(&effect.place, station, time_constant_s, |_| bears, felt)
        })
    }
}

/// `force` where a `fraction` of it comes `late`.
fn blend(force: f64, late: f64, fraction: f64) -> f64 {
    force + fraction * (late - force)
}
