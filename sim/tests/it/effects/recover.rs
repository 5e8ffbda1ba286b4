//! Every effect is injected and found again, with the noise of encoders on the joints, at three strengths; and its
//! nearest rival at its best explains less.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use nalgebra::{DMatrix, DVector};
use palpate_robot_model::{Place, SensorKind, Station};
use palpate_sim::Response;
use palpate_sim::effects::{Chain, Effect, Geometry, Parameter, Sensed, Stage, tactile};

use super::scene::{INDEX, PALM, SOFT, THETA, THUMB, Take, response, sense, station, take, touching_fingers};

struct Bench {
    station: Station,
    takes: Vec<Take>,
    /// Of the takes as measured, without effects.
    geometries: Vec<Geometry>,
}

static BENCH: LazyLock<Bench> = LazyLock::new(|| {
    let station = station("xarm6_leap.toml");
    let mut takes: Vec<Take> = [(&INDEX, 24), (&PALM, 18), (&THUMB, 20)]
        .iter()
        .enumerate()
        .map(|(idx, (plan, presses))| take(&station, plan, *presses, 20 + idx as u64))
        .collect();
    takes.push(touching_fingers(&station, 40));
    let response = response(&station);
    let chain = Chain::new(THETA, &response, &[], &SOFT);
    let geometry = |take: &Take| chain.geometry(&take.scene(&station, &take.measured)).expect("a valid take");
    let geometries: Vec<Geometry> = takes.iter().map(geometry).collect();
    Bench { station, takes, geometries }
});

fn stream(id: &str) -> Place {
    Place::Stream(id.into())
}

fn patch(id: &str) -> Place {
    Place::Patch(id.into())
}

fn channel(id: &str) -> Place {
    Place::Channel(id.into())
}

fn joint(id: &str) -> Place {
    Place::Joint(id.into())
}

fn object(id: &str) -> Place {
    Place::Object(id.into())
}

/// An effect with some of its parameters, the others neutral.
fn effect(id: &str, place: &Place, values: &[(&str, f64)]) -> Effect {
    let kind = tactile(id).expect("in the library");
    let station = &BENCH.station;
    assert!(kind.places(station).contains(place), "{id} at {place:?}");
    let mut parameters: BTreeMap<String, f64> = kind
        .parameters(place, station)
        .into_iter()
        .map(|parameter| (parameter.name, parameter.neutral))
        .collect();
    for (name, value) in values {
        assert!(parameters.insert((*name).to_owned(), *value).is_some(), "{id} has no {name}");
    }
    Effect { id: id.into(), place: place.clone(), parameters, interval: BTreeMap::new(), takes: Vec::new() }
}

/// Weight of loads beside events.
const LOADS: f64 = 2.0;

/// What a fit compares: events, and loads in about decades of their threshold.
fn seen(sensed: &[Sensed], load_weight: f64) -> Vec<f64> {
    let layout = &BENCH.station.layout;
    let on_loads = layout.channels.iter().map(|channel| match layout.streams[channel.stream].kind {
        SensorKind::Pressure => THETA.lambda_pre_pa,
        SensorKind::Proximity => Response::default().proximity_band_m,
    });
    let on_loads: Vec<f64> = on_loads.collect();
    let of_take = |sensed: &Sensed| {
        let loads = sensed
            .load
            .iter()
            .zip(on_loads.iter().cycle())
            .map(|(load, on)| load_weight * (load / (4.0 * on)).asinh());
        sensed.activation.iter().copied().chain(loads).collect::<Vec<f64>>()
    };
    sensed.iter().flat_map(of_take).collect()
}

fn squares(seen: &[f64], measured: &[f64]) -> f64 {
    seen.iter().zip(measured).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// The takes in which an effect shows; in all others any fit of it or a rival stays as it is.
struct Shown {
    takes: Vec<Take>,
    geometries: Vec<Geometry>,
}

impl Shown {
    fn new(effect: &Effect) -> Self {
        let station = &BENCH.station;
        let hard = |take: &Take, effects: &[Effect]| {
            sense(station, std::slice::from_ref(take), false, effects, &[], None)
        };
        let (takes, geometries) = BENCH
            .takes
            .iter()
            .zip(&BENCH.geometries)
            .filter(|(take, _)| hard(take, std::slice::from_ref(effect)) != hard(take, &[]))
            .map(|(take, geometry)| (take.clone(), geometry.clone()))
            .unzip();
        Self { takes, geometries }
    }

    fn seen(&self, effects: &[Effect], load_weight: f64, cached: bool) -> Vec<f64> {
        let cache = cached.then_some(&self.geometries[..]);
        seen(&sense(&BENCH.station, &self.takes, true, effects, &SOFT, cache), load_weight)
    }
}

/// An effect being fitted.
struct Fit<'a> {
    shown: &'a Shown,
    parameters: Vec<Parameter>,
    measured: &'a [f64],
    load_weight: f64,
    cached: bool,
}

impl Fit<'_> {
    fn seen(&self, effect: &Effect) -> Vec<f64> {
        self.shown.seen(std::slice::from_ref(effect), self.load_weight, self.cached)
    }

    fn cost(&self, effect: &Effect) -> f64 {
        squares(&self.seen(effect), self.measured)
    }

    fn moved(&self, effect: &Effect, steps: &[f64]) -> Effect {
        let mut moved = effect.clone();
        for (parameter, step) in self.parameters.iter().zip(steps) {
            let value = moved.parameters.get_mut(&parameter.name).expect("its own");
            *value = (*value + step).clamp(parameter.lower, parameter.upper);
        }
        moved
    }

    /// One parameter after the other over its likely range, then closer and closer.
    fn scan(&self, best: &mut Effect, least: &mut f64) {
        for (idx, parameter) in self.parameters.iter().enumerate() {
            let mut step = (0.8 * parameter.dose.abs()).min(0.25 * (parameter.upper - parameter.lower));
            let mut reach = 8;
            for _ in 0..4 {
                let center = best.clone();
                for offset in (-reach..=reach).filter(|&offset| offset != 0) {
                    let mut steps = vec![0.0; self.parameters.len()];
                    steps[idx] = f64::from(offset) * step;
                    let tried = self.moved(&center, &steps);
                    let found = self.cost(&tried);
                    if found < *least {
                        (*best, *least) = (tried, found);
                    }
                }
                (step, reach) = (step / 3.0, 2);
            }
        }
    }

    /// All parameters together: Levenberg-Marquardt with steps of a third of a dose.
    fn descend(&self, best: &mut Effect, least: &mut f64) {
        let scales: Vec<f64> = self.parameters.iter().map(|parameter| parameter.dose.abs() / 3.0).collect();
        let count = scales.len();
        let mut damping = 1e-2;
        for _ in 0..12 {
            let here = self.seen(best);
            let residual =
                DVector::from_iterator(here.len(), self.measured.iter().zip(&here).map(|(a, b)| a - b));
            let mut slopes = DMatrix::zeros(here.len(), count);
            for (column, scale) in scales.iter().enumerate() {
                let mut steps = vec![0.0; count];
                steps[column] = *scale;
                let (up, down) = (
                    self.moved(best, &steps),
                    self.moved(best, &steps.iter().map(|s| -s).collect::<Vec<_>>()),
                );
                let name = &self.parameters[column].name;
                let apart = (up.parameters[name] - down.parameters[name]) / scale;
                let (up, down) = (self.seen(&up), self.seen(&down));
                let slope = up.iter().zip(&down).map(|(up, down)| (up - down) / apart);
                slopes.set_column(column, &DVector::from_iterator(here.len(), slope));
            }
            let normal = slopes.transpose() * &slopes;
            let gradient = slopes.transpose() * residual;
            let damped = &normal
                + DMatrix::from_diagonal(&normal.diagonal()) * damping
                + DMatrix::identity(count, count) * 1e-9;
            let Some(step) = damped.lu().solve(&gradient) else { return };
            let steps: Vec<f64> = step.iter().zip(&scales).map(|(step, scale)| step * scale).collect();
            let tried = self.moved(best, &steps);
            let found = self.cost(&tried);
            if found < *least {
                (*best, *least) = (tried, found);
                damping = (damping / 3.0_f64).max(1e-3);
            } else if damping > 10.0 {
                return;
            } else {
                damping *= 10.0;
            }
        }
    }
}

/// The best `id` at `place` for `measured`, all its parameters free within their bounds.
fn fit(shown: &Shown, id: &str, place: &Place, measured: &[f64], load_weight: f64) -> (Effect, f64) {
    let kind = tactile(id).expect("in the library");
    let cached = kind.stage() != Stage::Kinematics;
    let parameters = kind.parameters(place, &BENCH.station);
    let fit = Fit { shown, parameters, measured, load_weight, cached };
    let mut best = effect(id, place, &[]);
    let mut least = fit.cost(&best);
    fit.scan(&mut best, &mut least);
    if fit.parameters.len() > 1 {
        fit.descend(&mut best, &mut least);
    }
    (best, least)
}

/// Injects `id` at `place` with each of `strengths`, fits it, and fits its `rivals`.
fn recovers(
    id: &str,
    place: &Place,
    strengths: &[&[(&str, f64)]],
    tolerances: &[(&str, f64)],
    rivals: &[(&str, Place)],
) {
    recovers_from(LOADS, id, place, strengths, tolerances, rivals);
}

fn recovers_from(
    load_weight: f64,
    id: &str,
    place: &Place,
    strengths: &[&[(&str, f64)]],
    tolerances: &[(&str, f64)],
    rivals: &[(&str, Place)],
) {
    for values in strengths {
        let truth = effect(id, place, values);
        let shown = Shown::new(&truth);
        let effects = std::slice::from_ref(&truth);
        let measured = seen(&sense(&BENCH.station, &shown.takes, false, effects, &[], None), load_weight);
        let gap = squares(&shown.seen(&[], load_weight, true), &measured);
        let (found, left) = fit(&shown, id, place, &measured, load_weight);
        println!("{id} {values:?}: found {:?}, cost {gap:.2} -> {left:.2}", found.parameters);
        for (rival, rival_place) in rivals {
            let (best, rival_left) = fit(&shown, rival, rival_place, &measured, load_weight);
            println!("    rival {rival} {:?}: {rival_left:.2}", best.parameters);
            assert!(
                rival_left > left,
                "{id} {values:?} explains {}, {rival} {:?} explains {}",
                gap - left,
                best.parameters,
                gap - rival_left
            );
        }
        for (name, tolerance) in tolerances {
            let (injected, estimate) = (truth.parameters[*name], found.parameters[*name]);
            assert!(
                (estimate - injected).abs() <= *tolerance,
                "{id}: {name} was {injected}, found {estimate}, which is off by more than {tolerance}"
            );
        }
    }
}

#[test]
fn joint_offset() {
    let place = joint("index_mcp_forward");
    let strengths: [&[_]; 3] = [&[("offset_rad", 0.006)], &[("offset_rad", -0.012)], &[("offset_rad", 0.03)]];
    recovers(
        "joint_offset",
        &place,
        &strengths,
        &[("offset_rad", 0.001)],
        &[("joint_backlash", place.clone())],
    );
}

#[test]
fn joint_backlash() {
    let place = joint("index_mcp_forward");
    let strengths: [&[_]; 3] = [&[("width_rad", 0.009)], &[("width_rad", 0.018)], &[("width_rad", 0.04)]];
    let rivals =
        [("joint_offset", place.clone()), ("latency", stream("twintac")), ("preload", patch("index_tip"))];
    recovers("joint_backlash", &place, &strengths, &[("width_rad", 0.002)], &rivals);
}

#[test]
fn object_pose_offset() {
    let strengths: [&[_]; 3] = [
        &[("translation_x_m", 5e-4)],
        &[("translation_x_m", -4e-4), ("translation_y_m", 4e-4), ("translation_z_m", 8e-4)],
        &[("translation_x_m", 1e-3), ("translation_y_m", -2e-3), ("translation_z_m", -1e-3)],
    ];
    let tolerances = [("translation_x_m", 2e-4), ("translation_y_m", 1e-4), ("translation_z_m", 1e-4)];
    let place = object("sphere_50mm");
    recovers("object_pose_offset", &place, &strengths, &tolerances, &[("object_scale", place.clone())]);
}

#[test]
fn object_turn() {
    let place = object("cylinder_25x100mm");
    let strengths: [&[_]; 3] = [
        &[("rotation_x_rad", 0.02)],
        &[("rotation_y_rad", -0.05)],
        &[("rotation_x_rad", 0.1), ("translation_y_m", 5e-4)],
    ];
    let tolerances = [("rotation_x_rad", 0.01), ("rotation_y_rad", 0.02), ("translation_y_m", 4e-4)];
    recovers("object_pose_offset", &place, &strengths, &tolerances, &[("object_scale", place.clone())]);
}

#[test]
fn object_scale() {
    let place = object("sphere_50mm");
    let strengths: [&[_]; 3] = [&[("factor", 1.015)], &[("factor", 0.97)], &[("factor", 1.06)]];
    recovers(
        "object_scale",
        &place,
        &strengths,
        &[("factor", 0.002)],
        &[("joint_offset", joint("index_mcp_forward"))],
    );
}

#[test]
fn sensor_mount_offset() {
    let place = patch("index_tip");
    let strengths: [&[_]; 3] = [
        &[("translation_x_m", 8e-4)],
        &[("translation_x_m", -6e-4), ("translation_y_m", 1.2e-3)],
        &[("translation_y_m", -2e-3), ("rotation_rad", 0.15)],
    ];
    let tolerances = [("translation_x_m", 1.5e-4), ("translation_y_m", 2.5e-4), ("rotation_rad", 0.04)];
    recovers("sensor_mount_offset", &place, &strengths, &tolerances, &[("joint_offset", joint("index_dip"))]);
}

#[test]
fn self_contact() {
    let strengths: [&[_]; 3] = [&[("presence", 0.6)], &[("presence", 0.8)], &[("presence", 1.0)]];
    let place = Place::Groups(vec!["index".into(), "thumb".into()]);
    recovers(
        "self_contact",
        &place,
        &strengths,
        &[("presence", 0.1)],
        &[("motion_artifact", stream("twintac"))],
    );
}

#[test]
fn rate_dependence() {
    let place = stream("twintac");
    let strengths: [&[_]; 3] = [&[("damping_s", 0.03)], &[("damping_s", 0.06)], &[("damping_s", 0.15)]];
    recovers("rate_dependence", &place, &strengths, &[("damping_s", 0.01)], &[("clock_skew", place.clone())]);
}

#[test]
fn rate_dependence_of_proximity() {
    let place = stream("fsr");
    let strengths: [&[_]; 3] = [&[("damping_s", 0.03)], &[("damping_s", 0.06)], &[("damping_s", 0.15)]];
    recovers("rate_dependence", &place, &strengths, &[("damping_s", 0.01)], &[("clock_skew", place.clone())]);
}

#[test]
fn preload() {
    let strengths: [&[_]; 3] = [&[("depth_m", 4e-4)], &[("depth_m", 8e-4)], &[("depth_m", 1.6e-3)]];
    let rivals = [("joint_offset", joint("index_pip")), ("low_pass", stream("twintac"))];
    recovers("preload", &patch("index_tip"), &strengths, &[("depth_m", 1e-4)], &rivals);
    let rivals = [("low_pass", stream("fsr"))];
    recovers("preload", &patch("palm_middle"), &strengths, &[("depth_m", 1e-4)], &rivals);
}

#[test]
fn elastic_crosstalk() {
    let strengths: [&[_]; 3] =
        [&[("decay_factor", 0.75)], &[("decay_factor", 1.4)], &[("decay_factor", 0.4)]];
    let rivals = [("preload", patch("index_tip")), ("electrical_crosstalk", stream("twintac"))];
    recovers("elastic_crosstalk", &patch("index_tip"), &strengths, &[("decay_factor", 0.06)], &rivals);
}

#[test]
fn sensitivity_spread() {
    let strengths: [&[_]; 3] = [&[("gain", 1.2)], &[("gain", 0.7)], &[("gain", 2.0)]];
    let rivals = [("preload", patch("index_tip")), ("baseline_drift", channel("index_tip.4"))];
    recovers("sensitivity_spread", &channel("index_tip.4"), &strengths, &[("gain", 0.06)], &rivals);
}

#[test]
fn creep() {
    let strengths: [&[_]; 3] = [
        &[("fraction", 0.15), ("time_constant_s", 0.5)],
        &[("fraction", 0.25), ("time_constant_s", 2.0)],
        &[("fraction", 0.4), ("time_constant_s", 5.0), ("exponent", 1.5)],
    ];
    let rivals = [("low_pass", stream("twintac")), ("viscoelastic_release", stream("twintac"))];
    recovers("creep", &stream("twintac"), &strengths, &[("fraction", 0.06)], &rivals);
}

#[test]
fn viscoelastic_release() {
    let strengths: [&[_]; 3] = [
        &[("fraction", 0.2), ("time_constant_s", 0.4)],
        &[("fraction", 0.4), ("time_constant_s", 0.2)],
        &[("fraction", 0.6), ("time_constant_s", 0.8)],
    ];
    let rivals = [("low_pass", stream("twintac")), ("threshold_hysteresis", stream("twintac"))];
    let tolerances = [("fraction", 0.06), ("time_constant_s", 0.1)];
    recovers("viscoelastic_release", &stream("twintac"), &strengths, &tolerances, &rivals);
}

#[test]
fn low_pass() {
    let strengths: [&[_]; 3] =
        [&[("time_constant_s", 0.03)], &[("time_constant_s", 0.08)], &[("time_constant_s", 0.25)]];
    let rivals = [("latency", stream("twintac")), ("viscoelastic_release", stream("twintac"))];
    recovers("low_pass", &stream("twintac"), &strengths, &[("time_constant_s", 0.012)], &rivals);
}

#[test]
fn baseline_drift() {
    let strengths: [&[_]; 3] = [&[("rate_per_s", 0.004)], &[("rate_per_s", -0.008)], &[("rate_per_s", 0.02)]];
    let rivals = [("motion_artifact", stream("twintac")), ("clock_skew", stream("twintac"))];
    recovers("baseline_drift", &stream("twintac"), &strengths, &[("rate_per_s", 0.0015)], &rivals);
}

#[test]
fn motion_artifact() {
    let strengths: [&[_]; 3] =
        [&[("load_s_per_rad", 0.4)], &[("load_s_per_rad", 1.0)], &[("load_s_per_rad", 2.5)]];
    let rivals = [("baseline_drift", stream("twintac"))];
    recovers("motion_artifact", &stream("twintac"), &strengths, &[("load_s_per_rad", 0.1)], &rivals);
}

#[test]
fn threshold_hysteresis() {
    let strengths: [&[_]; 3] =
        [&[("off_fraction", 0.55)], &[("off_fraction", 0.4)], &[("off_fraction", 0.2)]];
    let rivals = [("viscoelastic_release", stream("twintac")), ("latency", stream("twintac"))];
    recovers("threshold_hysteresis", &stream("twintac"), &strengths, &[("off_fraction", 0.1)], &rivals);
}

#[test]
fn electrical_crosstalk() {
    let strengths: [&[_]; 3] = [&[("leak", 0.06)], &[("leak", 0.12)], &[("leak", 0.3)]];
    let rivals = [("elastic_crosstalk", patch("index_tip"))];
    recovers("electrical_crosstalk", &stream("twintac"), &strengths, &[("leak", 0.02)], &rivals);
}

const PRESENCES: [&[(&str, f64)]; 3] = [&[("presence", 0.6)], &[("presence", 0.8)], &[("presence", 1.0)]];

#[test]
fn swapped_channels() {
    let place = Place::Channels(vec!["index_tip.1".into(), "index_tip.5".into()]);
    let rivals = [("dead_channel", channel("index_tip.5")), ("sensor_mount_offset", patch("index_tip"))];
    recovers("swapped_channels", &place, &PRESENCES, &[("presence", 0.1)], &rivals);
}

#[test]
fn dead_channel() {
    let rivals = [("preload", patch("index_tip")), ("sensitivity_spread", channel("index_tip.5"))];
    recovers("dead_channel", &channel("index_tip.4"), &PRESENCES, &[("presence", 0.1)], &rivals);
}

#[test]
fn stuck_channel() {
    let rivals = [("baseline_drift", channel("palm_ring")), ("integer_wrap", channel("palm_ring"))];
    let strengths: [&[_]; 3] = [
        &[("presence", 0.7), ("level", 0.0)],
        &[("presence", 0.9), ("level", 4.0)],
        &[("presence", 1.0), ("level", 2.0)],
    ];
    let tolerances = [("presence", 0.1), ("level", 0.2)];
    recovers("stuck_channel", &channel("palm_ring"), &strengths, &tolerances, &rivals);
}

#[test]
fn integer_wrap() {
    let rivals = [("stuck_channel", channel("thumb_tip.2")), ("baseline_drift", channel("thumb_tip.2"))];
    recovers("integer_wrap", &channel("thumb_tip.2"), &PRESENCES, &[("presence", 0.15)], &rivals);
}

#[test]
fn debounce() {
    let strengths: [&[_]; 3] = [&[("min_on_s", 0.05)], &[("min_on_s", 0.12)], &[("min_on_s", 0.3)]];
    let rivals = [("latency", stream("twintac")), ("low_pass", stream("twintac"))];
    recovers("debounce", &stream("twintac"), &strengths, &[("min_on_s", 0.03)], &rivals);
}

#[test]
fn latency() {
    let strengths: [&[_]; 3] = [&[("delay_s", 0.05)], &[("delay_s", 0.1)], &[("delay_s", 0.2)]];
    let rivals = [("low_pass", stream("fsr")), ("clock_skew", stream("fsr"))];
    recovers("latency", &stream("fsr"), &strengths, &[("delay_s", 0.006)], &rivals);
}

#[test]
fn clock_skew() {
    let strengths: [&[_]; 3] = [&[("skew", 0.001)], &[("skew", -0.002)], &[("skew", 0.006)]];
    recovers("clock_skew", &stream("fsr"), &strengths, &[("skew", 2e-4)], &[("latency", stream("fsr"))]);
}

#[test]
fn sample_hold() {
    let strengths: [&[_]; 3] = [
        &[("frozen_fraction", 0.3), ("span_s", 0.5)],
        &[("frozen_fraction", 0.5), ("span_s", 1.0)],
        &[("frozen_fraction", 0.6), ("span_s", 0.8)],
    ];
    let tolerances = [("frozen_fraction", 0.15), ("span_s", 0.2)];
    // The mean over all phases is right for events; loads that are either here or there have no use for their mean.
    let rivals = [("latency", stream("twintac")), ("low_pass", stream("twintac"))];
    recovers_from(0.0, "sample_hold", &stream("twintac"), &strengths, &tolerances, &rivals);
}
