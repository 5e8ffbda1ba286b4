//! What holds for every effect of the library.

use std::collections::{BTreeMap, BTreeSet};

use palpate_robot_model::{Place, Station};
use palpate_sim::effects::{Effect, EffectKind, Parameter, Sensed, Stage, TACTILE};
use palpate_sim::{SensorModel, tactile};

use super::scene::{INDEX, PALM, SOFT, THETA, THUMB, Take, sense, station, take};

fn takes(station: &Station) -> Vec<Take> {
    [&INDEX, &THUMB, &PALM].map(|plan| take(station, plan, 4, 7)).into()
}

pub(crate) fn effect(
    kind: &dyn EffectKind,
    place: &Place,
    station: &Station,
    value: impl Fn(&Parameter) -> f64,
) -> Effect {
    let parameters = kind.parameters(place, station);
    Effect {
        id: kind.id().into(),
        place: place.clone(),
        parameters: parameters.iter().map(|parameter| (parameter.name.clone(), value(parameter))).collect(),
        interval: BTreeMap::new(),
        takes: Vec::new(),
    }
}

fn bits(sensed: &[Sensed]) -> Vec<u64> {
    let values = sensed.iter().flat_map(|sensed| sensed.load.iter().chain(&sensed.activation));
    values.map(|value| value.to_bits()).collect()
}

#[test]
fn every_effect_has_places_and_sensible_parameters() {
    let station = station("xarm6_leap.toml");
    let ids: BTreeSet<&str> = TACTILE.iter().map(|kind| kind.id()).collect();
    assert_eq!(ids.len(), TACTILE.len(), "ids are unique");
    let stages: Vec<Stage> = TACTILE.iter().map(|kind| kind.stage()).collect();
    assert!(stages.is_sorted(), "the registry is in the order of the chain: {stages:?}");
    for kind in TACTILE {
        let places = kind.places(&station);
        assert!(!places.is_empty(), "{}", kind.id());
        assert_eq!(
            places.iter().collect::<BTreeSet<_>>().len(),
            places.len(),
            "{}: a place twice",
            kind.id()
        );
        for place in &places {
            let parameters = kind.parameters(place, &station);
            assert!(!parameters.is_empty(), "{} at {place:?}", kind.id());
            for parameter in parameters {
                let dosed = parameter.neutral + parameter.dose;
                let range = parameter.lower..=parameter.upper;
                assert!(range.contains(&parameter.neutral) && range.contains(&dosed), "{parameter:?}");
                assert!(parameter.smallest > 0.0 && parameter.dose.abs() > 0.0, "{parameter:?}");
            }
            let sentence = effect(*kind, place, &station, |parameter| parameter.neutral + parameter.dose);
            let sentence = kind.explain(&sentence, &station);
            assert!(sentence.ends_with('.') && !sentence.contains("missing"), "{sentence}");
            assert!(sentence.starts_with(|first: char| first.is_uppercase()), "{sentence}");
        }
        assert!(!kind.signature().is_empty() && !kind.signature().ends_with('.'), "{}", kind.id());
    }
}

#[test]
fn neutral_parameters_leave_every_output_bit_identical() {
    let station = station("xarm6_leap.toml");
    let takes = takes(&station);
    for widths in [&[][..], &SOFT] {
        let plain = bits(&sense(&station, &takes, true, &[], widths, None));
        for kind in TACTILE {
            let places = kind.places(&station);
            for place in [places.first(), places.last()].into_iter().flatten() {
                let neutral = effect(*kind, place, &station, |parameter| parameter.neutral);
                let found = bits(&sense(&station, &takes, true, &[neutral], widths, None));
                assert!(found == plain, "{} at {place:?}", kind.id());
            }
        }
    }
}

#[test]
fn a_dose_shows_somewhere() {
    let station = station("xarm6_leap.toml");
    let takes = takes(&station);
    let plain = bits(&sense(&station, &takes, true, &[], &SOFT, None));
    for kind in TACTILE.iter().filter(|kind| kind.id() != "self_contact") {
        let shows = kind.places(&station).iter().any(|place| {
            let dosed = effect(*kind, place, &station, |parameter| parameter.neutral + parameter.dose);
            bits(&sense(&station, &takes, true, &[dosed], &SOFT, None)) != plain
        });
        assert!(shows, "{}", kind.id());
    }
}

#[test]
fn no_effects_are_the_papers_model() {
    let station = station("xarm6_leap.toml");
    let model = SensorModel::from_toml(
        "model.toml",
        &format!(
            "format = 1\nname = \"paper\"\n[theta]\nlambda_con_m = {}\nalpha_per_m = {}\nlambda_pre_pa = {}\n",
            THETA.lambda_con_m, THETA.alpha_per_m, THETA.lambda_pre_pa
        ),
    )
    .expect("valid");
    let response = palpate_sim::Response::default();
    let chain =
        palpate_sim::effects::Chain { theta: THETA, response: &response, effects: &[], soft_widths: &[] };
    for take in takes(&station) {
        let scene = take.scene(&station, &take.measured);
        let object = palpate_sim::geometry::SignedDistance::new(&take.object.shape).expect("valid");
        let trace = palpate_sim::replay::contact_trace(
            &station.robot,
            &station.layout,
            &object,
            &take.base_from_object,
            &take.measured,
        )
        .expect("valid");
        let paper = tactile::readings(&station.layout, &trace, &model);
        let active: Vec<bool> = chain
            .sense(&scene)
            .expect("valid")
            .activation
            .iter()
            .map(|&activation| activation == 1.0)
            .collect();
        assert!(paper.active.iter().filter(|&&active| active).count() > 20);
        assert!(active == paper.active);
    }
}

#[test]
fn order_in_the_list_does_not_matter() {
    let station = station("xarm6_leap.toml");
    let takes = &takes(&station)[..1];
    let dosed: Vec<Effect> = TACTILE
        .iter()
        .map(|kind| {
            let places = kind.places(&station);
            effect(*kind, &places[0], &station, |parameter| parameter.neutral + 0.5 * parameter.dose)
        })
        .collect();
    let plain = bits(&sense(&station, takes, true, &dosed, &SOFT, None));
    let reversed: Vec<Effect> = dosed.iter().rev().cloned().collect();
    assert!(bits(&sense(&station, takes, true, &reversed, &SOFT, None)) == plain);
    assert!(bits(&sense(&station, takes, true, &[], &SOFT, None)) != plain);
}
