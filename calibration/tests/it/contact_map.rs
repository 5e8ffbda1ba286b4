//! Contact maps of made-up takes: channels of unequal sensitivity that follow contact late, with noise.

use std::path::Path;
use std::sync::Arc;

use nalgebra::Isometry3;
use palpate_calibration::contact_map::{
    ContactMap, LAGS_S, LiveMap, MapConfig, MapFit, MapTake, fit,
    judge::{Comparison, MAP, THRESHOLDS, compare, rows},
};
use palpate_recording::{JointLog, PoseLog, StreamLog, Take, TakeMeta};
use palpate_robot_model::Station;
use palpate_sim::SensorModel;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const NUM_FRAMES: usize = 400;
const FRAME_S: f64 = 0.05;
const REST_RAW: f32 = 500.0;

fn station() -> Station {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/stations");
    let read = |path: &str| std::fs::read(folder.join(path)).map_err(|err| err.to_string());
    Station::read("probe_bench.toml", read).expect("a shipped station")
}

fn nominal(station: &Station) -> SensorModel {
    SensorModel::from_toml("nominal", &station.nominal_model_toml).expect("a shipped model")
}

/// A take of `station`, and which channels are in contact at each frame.
fn take(station: &Station, number: u64) -> (Take, Vec<bool>) {
    let num_channels = station.layout.num_channels();
    let times_s: Vec<f64> = (0..NUM_FRAMES).map(|frame| frame as f64 * FRAME_S).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(number);
    let mut contacts = vec![false; NUM_FRAMES * num_channels];
    let mut streams = Vec::new();
    for (stream, config) in station.layout.streams.iter().zip(&station.streams) {
        let width = stream.channels.len();
        let mut raw = vec![REST_RAW; NUM_FRAMES * width];
        for column in 0..width {
            // From a third of what switches the firmware on to three times as much, the same in every take.
            let gain = 3.0_f64.powf(2.0 * column as f64 / (width - 1) as f64 - 1.0);
            let (mut load, mut depth, mut left) = (0.0, 0.0, 0);
            for frame in 0..NUM_FRAMES {
                if left == 0 {
                    depth = if depth > 0.0 { 0.0 } else { rng.random_range(1.0..1.5) };
                    left = rng.random_range(10..30);
                }
                left -= 1;
                contacts[frame * num_channels + stream.channels.start + column] = depth > 0.0;
                load += 0.6 * (depth - load);
                let noise = rng.random_range(-0.03..0.03);
                raw[frame * width + column] += (config.on_threshold * (gain * load + noise)) as f32;
            }
        }
        let active = raw.iter().map(|raw| f64::from(raw - REST_RAW) > config.on_threshold).collect();
        streams.push(StreamLog {
            times_s: times_s.clone(),
            raw,
            active,
            reference: vec![REST_RAW; width],
            ..StreamLog::default()
        });
    }
    let take = Take {
        id: format!("take-{number:02}"),
        meta: TakeMeta {
            object: "sphere_50mm".to_owned(),
            base_from_object: Isometry3::identity(),
            primitive: "tap".to_owned(),
            fixture_trusted: true,
            operator: String::new(),
            software: String::new(),
            surroundings: Vec::new(),
        },
        start_unix_ns: 0,
        joints: JointLog { positions: vec![0.0; NUM_FRAMES * station.robot.num_dofs()], times_s },
        commands: JointLog::default(),
        object_poses: PoseLog::default(),
        streams,
        spans: Vec::new(),
        station: station.clone(),
    };
    (take, contacts)
}

/// Takes that a map may see, with their contacts.
fn takes(station: &Station, numbers: impl IntoIterator<Item = u64>) -> (Vec<MapTake>, Vec<Vec<bool>>) {
    let map_take = |number| {
        let (take, contacts) = take(station, number);
        (MapTake::from_take(&take, &LAGS_S).expect("raw readings"), contacts)
    };
    numbers.into_iter().map(map_take).unzip()
}

fn learn(station: &Station, takes: &[MapTake], contacts: &[Vec<bool>]) -> MapFit {
    let takes: Vec<&MapTake> = takes.iter().collect();
    let contacts: Vec<&[bool]> = contacts.iter().map(Vec::as_slice).collect();
    fit(&MapConfig::default(), station, &nominal(station), &takes, &contacts).expect("something to learn")
}

#[test]
fn a_map_agrees_better_than_thresholds_on_takes_it_has_not_seen() {
    let station = station();
    let (fitted, contacts) = takes(&station, 1..4);
    let map = learn(&station, &fitted, &contacts).map;
    let (unseen, contacts) = takes(&station, 11..14);
    let compare = |hardware: &str, of: &dyn Fn(&MapTake) -> Vec<bool>| Comparison {
        hardware: hardware.to_owned(),
        simulation: "made up".to_owned(),
        takes: unseen
            .iter()
            .zip(&contacts)
            .map(|(take, c)| compare(&station.layout, take, &of(take), c))
            .collect(),
    };
    let thresholds = compare(THRESHOLDS, &|take| take.thresholded.clone());
    let mapped = compare(MAP, &|take| map.contacts(take).expect("the same station"));
    let rows = rows(&station.layout, &[thresholds, mapped], 200, 0);
    let [low, _] = rows[0].map_less_this_95.as_ref().and_then(|change| change.f1).expect("three takes");
    assert!(low > 0.1, "{rows:?}");
    assert!(rows[1].metrics.f1 > Some(0.95), "{:?}", rows[1].metrics);
    assert!(rows[1].by_stream.values().all(|stream| stream.f1 > Some(0.9)), "{:?}", rows[1].by_stream);
}

#[test]
fn same_seed_gives_the_same_bits_for_any_number_of_threads() {
    let station = station();
    let (fitted, contacts) = takes(&station, 1..3);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| learn(&station, &fitted, &contacts).map)
    };
    let one = with(1);
    assert_eq!(with(3).to_toml(), one.to_toml());
    let again = ContactMap::from_toml("map.toml", &one.to_toml()).expect("what was written");
    assert_eq!(again, one, "the file keeps every bit");
    let (other, contacts) = takes(&station, [1, 5]);
    assert_ne!(learn(&station, &other, &contacts).map.streams, one.streams, "takes are what it learns from");
}

#[test]
fn reading_by_reading_it_says_what_it_says_of_the_take() {
    let station = station();
    let (fitted, contacts) = takes(&station, 1..3);
    let map = learn(&station, &fitted, &contacts).map;
    let (take, _) = take(&station, 11);
    let of_take = map.contacts(&MapTake::from_take(&take, &LAGS_S).expect("raw readings")).expect("a take");
    let mut live = LiveMap::new(Arc::new(map), &station).expect("the same station");
    let num_channels = station.layout.num_channels();
    for trial in 0..2 {
        live.restart();
        for frame in 0..NUM_FRAMES {
            let readings: Vec<f64> = take
                .streams
                .iter()
                .flat_map(|log| {
                    let width = log.reference.len();
                    log.raw[frame * width..(frame + 1) * width].iter().map(|raw| f64::from(raw - REST_RAW))
                })
                .collect();
            let mut active = vec![false; num_channels];
            live.read(take.joints.times_s[frame], &readings, &mut active);
            assert_eq!(
                active,
                of_take[frame * num_channels..(frame + 1) * num_channels],
                "trial {trial}, frame {frame}"
            );
        }
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let station = station();
    let (fitted, contacts) = takes(&station, 1..3);
    let map = learn(&station, &fitted, &contacts).map;
    let says = |result: Result<(), palpate_calibration::CalibrationError>| {
        result.expect_err("must be refused").to_string()
    };

    let mut other = station.clone();
    other.id = "elsewhere".to_owned();
    assert!(says(map.check(&other)).contains("was learned on station \"probe-bench\""));
    let mut other = station.clone();
    other.layout.channels[3].id = "cap.x".to_owned();
    assert!(says(map.check(&other)).contains("has channel \"cap.3\" of stream \"gel\""));

    let (mut binary, _) = take(&station, 1);
    binary.streams.iter_mut().for_each(|log| log.raw.clear());
    let said = says(MapTake::from_take(&binary, &LAGS_S).map(drop));
    assert!(said.contains("take \"take-01\" holds no raw readings"), "{said}");

    let takes: Vec<&MapTake> = fitted.iter().collect();
    let nothing = vec![false; contacts[0].len()];
    let untouched = [&nothing[..], &nothing[..]];
    let config = MapConfig::default();
    let said = says(fit(&config, &station, &nominal(&station), &takes, &untouched).map(drop));
    assert!(said.contains("nothing touches it in the fitted takes"), "{said}");

    let file = map.to_toml();
    for (from, to, expected) in [
        ("format = 1", "format = 2", "format 2, expected 1"),
        ("hidden = 8", "hidden = 9", "weights, expected"),
        ("inputs = 10", "inputs = 11", "11 inputs"),
        ("lags_s = [0.0", "lags_s = [0.06", "go up from 0"),
        ("name = ", "game = ", "no contact map that palpate wrote"),
    ] {
        assert!(file.contains(from), "{from:?} is in the file");
        let said = says(ContactMap::from_toml("map.toml", &file.replacen(from, to, 1)).map(drop));
        assert!(said.contains("map.toml") && said.contains(expected), "{said}");
    }
}
