//! Films of trials: takes of a session, with the object where it was.

use std::path::Path;

use palpate_calibration::PairedTake;
use palpate_recording::{Session, SpanKind, Take, check_session};
use palpate_robot_model::ObjectPath;
use palpate_sim::{SensorModel, tactile::readings};

use super::palpate_train;
use super::policies::printed;

/// Trials of the script on objects that the station does not know, filmed into `dir`.
fn film(dir: &Path, objects: &str, more: &[&str]) -> Session {
    let dir = dir.to_str().expect("a path");
    let trials = ["--protocol", "wide", "--trials", "2", "--seed", "4", "--objects", objects];
    printed(&[&["evaluate", "--policy", "script", "--json", "--films", dir][..], &trials, more].concat());
    Session::open(Path::new(dir)).expect("a session")
}

fn takes(session: &Session) -> Vec<Take> {
    session.accepted_takes().expect("takes")
}

#[test]
fn a_film_is_a_session_whose_objects_are_felt_where_they_were() {
    let folder = tempfile::tempdir().expect("a folder");
    let session = film(&folder.path().join("films"), "ring,cube", &[]);
    let report = check_session(&session).expect("a report");
    let of_streams: Vec<_> = report
        .problems
        .iter()
        .filter(|problem| !report.coverage.iter().any(|channel| channel.channel == problem.place))
        .collect();
    assert!(report.ok && of_streams.is_empty(), "{of_streams:?}");
    let takes = takes(&session);
    for object in ["ring", "cube"] {
        assert!(takes.iter().any(|take| take.meta.object == object), "{object}");
    }
    // Touches that a replay finds, and those that differ from what the grasp world felt: with the object where it was, and with
    // the object where it began.
    let (mut num_felt, mut num_wrong, mut num_wrong_still) = (0, 0, 0);
    for take in &takes {
        assert_eq!(take.commands.times_s.len() + 1, take.num_frames(), "{}", take.id);
        assert!(!take.has_raw() && take.spans.iter().any(|span| span.kind == SpanKind::Baseline));
        let verdict = take.spans.iter().find(|span| span.kind == SpanKind::Note).expect("a verdict");
        let expected = if take.id.contains("_won_") { "won: success" } else { "lost: " };
        assert!(verdict.label.starts_with(expected), "{}: {}", take.id, verdict.label);
        let ObjectPath::Moving(path) = take.object_path() else { panic!("{} has no poses", take.id) };
        assert_eq!((path.len(), path[0]), (take.num_frames(), take.meta.base_from_object));
        // The grasp world felt with the station's nominal model, which a replay of the film has as well. It also felt the table.
        let model = SensorModel::from_toml("nominal", &take.station.nominal_model_toml).expect("a model");
        let layout = &take.station.layout;
        let paired = PairedTake::from_take(take).expect("it can be replayed");
        let replayed = readings(layout, &paired.contact, &model.thetas()).active;
        let mut still = take.clone();
        still.object_poses = palpate_recording::PoseLog::default();
        let stands = PairedTake::from_take(&still).expect("it can be replayed");
        let stands = readings(layout, &stands.contact, &model.thetas()).active;
        for ((&was, &is), &stood) in paired.real_active.iter().zip(&replayed).zip(&stands) {
            assert!(was || !is, "{}: a replay feels what the grasp world did not", take.id);
            num_felt += usize::from(is);
            num_wrong += usize::from(was != is);
            num_wrong_still += usize::from(was != stood);
        }
    }
    assert!(num_felt > 100 && 10 * num_wrong < num_felt, "{num_wrong} wrong beside {num_felt}");
    assert!(num_wrong_still > num_felt, "{num_wrong_still} wrong beside {num_felt}");
}

#[test]
fn films_keep_raw_readings_where_there_are_some_and_have_the_same_bytes_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let truth = ["--truth", "assets/truth/demo.toml", "--threads", "1"];
    let session = film(&folder.path().join("films"), "cube", &truth);
    let report = check_session(&session).expect("a report");
    assert!(report.ok, "{:?}", report.problems);
    for take in takes(&session) {
        assert!(take.has_raw());
        for (config, log) in take.station.streams.iter().zip(&take.streams) {
            let inside = |raw: &&f32| (config.raw_min..=config.raw_max).contains(&f64::from(**raw));
            assert_eq!(log.raw.iter().filter(inside).count(), log.raw.len(), "{}", config.stream);
        }
    }
    let again =
        film(&folder.path().join("again"), "cube", &["--truth", "assets/truth/demo.toml", "--threads", "2"]);
    for entry in &session.file.takes {
        let bytes = |session: &Session| std::fs::read(session.take_path(entry)).expect("a take");
        assert!(bytes(&session) == bytes(&again), "{}", entry.file);
    }
    // What is there is not written over.
    let output = palpate_train(&[
        "evaluate",
        "--policy",
        "script",
        "--protocol",
        "wide",
        "--trials",
        "1",
        "--films",
        session.dir.to_str().expect("a path"),
    ]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("is there already; choose another folder"), "{said}");
}
