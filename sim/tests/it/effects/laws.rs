//! What holds for every effect of the library.

use std::collections::{BTreeMap, BTreeSet};

use palpate_robot_model::{Place, Station, Tare};
use palpate_sim::effects::{Effect, EffectKind, Parameter, Sensed, Stage, TACTILE, TakeScene};
use palpate_sim::geometry::SignedDistance;
use palpate_sim::replay::contact_trace;
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

/// A reference that is taken anew takes away what a reading had gained until then, and changes nothing before.
#[test]
fn a_drift_begins_again_with_each_tare() {
    let station = station("xarm6_leap.toml");
    let take = take(&station, &INDEX, 4, 7);
    let place = Place::Stream("twintac".to_owned());
    let kind = TACTILE.iter().find(|kind| kind.id() == "baseline_drift").expect("it is there");
    let rate_per_s = 0.01;
    let effects = [effect(*kind, &place, &station, |_| rate_per_s)];
    let scene = take.scene(&station, &take.clean);
    let model = SensorModel { effects: effects.to_vec(), ..SensorModel::plain("drifting", THETA) };
    let of = |tares: &[Tare]| model.sense(&TakeScene { tares, ..scene }).expect("it fits").load;
    let (start_s, end_s) = (take.times_s[0], take.times_s[take.times_s.len() - 1]);
    let tare = Tare { from_s: 0.5 * (start_s + end_s), taken_s: 0.6 * end_s + 0.4 * start_s };
    let (once, anew) = (of(&[]), of(&[tare]));
    let num_channels = station.layout.num_channels();
    let channel =
        station.layout.streams[station.layout.stream_index("twintac").expect("it has one")].channels.start;
    let mut later = 0;
    for (frame, &time_s) in take.times_s.iter().enumerate() {
        let cell = frame * num_channels + channel;
        if time_s < tare.from_s {
            assert_eq!(once[cell], anew[cell], "{time_s} s");
        } else {
            let lost = (once[cell] - anew[cell]) / THETA.lambda_pre_pa;
            let expected = rate_per_s * (tare.taken_s - start_s);
            assert!((lost - expected).abs() < 1e-9, "{time_s} s: {lost}, expected {expected}");
            later += 1;
        }
    }
    assert!(later > 10, "{later} frames");
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
    let chain = palpate_sim::effects::Chain::new(THETA, &response, &[], &[]);
    for take in takes(&station) {
        let scene = take.scene(&station, &take.measured);
        let object = SignedDistance::new(&take.object.shape).expect("valid");
        let trace =
            contact_trace(&station.robot, &station.layout, &object, &take.base_from_object, &take.measured)
                .expect("valid");
        let paper = tactile::readings(&station.layout, &trace, &model.thetas());
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

#[test]
fn a_model_with_effects_reads_what_its_chain_senses() {
    let station = station("xarm6_leap.toml");
    let plain = SensorModel::plain("plain", THETA);
    let takes = takes(&station);
    let delay = |delay_s: f64| {
        let late = tactile_effect("latency", &Place::Stream("fsr".into()), &station, delay_s);
        SensorModel { effects: vec![late], ..plain.clone() }
    };
    let mut late_frames = 0;
    for take in &takes {
        let scene = take.scene(&station, &take.measured);
        let object = SignedDistance::new(&take.object.shape).expect("valid");
        let pose = &take.base_from_object;
        let contact =
            contact_trace(&station.robot, &station.layout, &object, pose, &take.measured).expect("valid");
        let paper = tactile::readings(&station.layout, &contact, &plain.thetas());
        assert!(plain.readings(&scene, &contact).expect("fits") == paper);
        let on_time = delay(0.0).readings(&scene, &contact).expect("fits");
        assert!(on_time.active == paper.active);
        let reach_m = plain.response.reach_m(&THETA);
        for (idx, (raw, paper_raw)) in on_time.raw.iter().zip(&paper.raw).enumerate() {
            let stream = station.layout.channels[idx % paper.num_channels].stream;
            let expected =
                if station.layout.streams[stream].id == "fsr" { paper_raw.min(reach_m) } else { *paper_raw };
            assert!((raw - expected).abs() < 1e-12, "{raw} against {expected}");
        }
        let late = delay(0.25).readings(&scene, &contact).expect("fits");
        late_frames += late.active.iter().zip(&paper.active).filter(|(late, paper)| late != paper).count();
    }
    assert!(late_frames > 10, "{late_frames}");
}

#[test]
fn a_model_of_another_station_is_refused_before_it_senses() {
    let bench = station("probe_bench.toml");
    let leap = station("xarm6_leap.toml");
    let late = tactile_effect("latency", &Place::Stream("fsr".into()), &leap, 0.1);
    let model = SensorModel { effects: vec![late], ..SensorModel::plain("leap", THETA) };
    let take = &takes(&leap)[0];
    let refused = model.sense(&take.scene(&bench, &take.measured)).expect_err("has no FSRs").to_string();
    assert!(
        refused.contains("effect 1 (latency, stream \"fsr\")") && refused.contains("gel, film"),
        "{refused}"
    );
}

/// An effect with one value for all its parameters.
fn tactile_effect(id: &str, place: &Place, station: &Station, value: f64) -> Effect {
    effect(palpate_sim::effects::tactile(id).expect("in the library"), place, station, |_| value)
}
