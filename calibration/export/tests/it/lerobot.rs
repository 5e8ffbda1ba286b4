//! What a data set holds.

use std::{collections::BTreeSet, fs, path::Path};

use palpate_export::lerobot::{Action, LerobotConfig};
use parquet::{
    file::reader::{FileReader as _, SerializedFileReader},
    record::{Field, Row},
};
use serde_json::json;

use crate::support::{TAP, TakeSpec, field, json_of, numbers, record, rows, session, text, write};

const DATA: &str = "data/chunk-000/file-000.parquet";
const EPISODES: &str = "meta/episodes/chunk-000/file-000.parquet";

/// Columns that LeRobot demands, and ours.
fn names(row: &Row) -> BTreeSet<&str> {
    row.get_column_iter().map(|(name, _)| name.as_str()).collect()
}

fn f32s(values: &[f64]) -> Vec<f64> {
    values.iter().map(|&value| f64::from(value as f32)).collect()
}

#[test]
fn frames_hold_what_was_newest_and_nothing_later() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (dir.path().join("s"), dir.path().join("out"));
    session(&source, &[(&TAP, true)]);
    let report = write(&[source], &out, LerobotConfig { fps: Some(50), action: None }).unwrap();
    // From 30 ms, where the gel begins, to 2000 ms.
    assert_eq!((report.episodes, report.frames, report.fps), (1, 99, 50));
    let frames = rows(&out.join(DATA));
    assert_eq!(frames.len(), 99);
    for (idx, row) in frames.iter().enumerate() {
        let now_ms = 30 + 20 * idx as u64;
        let joint_ms = (now_ms / 100 * 100) as f64;
        let state = f32s(&[joint_ms * 1e-4, -0.5]);
        assert_eq!(numbers(row, "observation.state"), state, "frame {idx}");
        // Commands come every 50 ms from 450 ms on.
        let action = if now_ms < 450 { state } else { f32s(&[(now_ms / 50 * 50) as f64, 7.0]) };
        assert_eq!(numbers(row, "action"), action, "frame {idx}");
        let (gel_ms, film_ms) = ((now_ms / 10 * 10) as f64, (now_ms / 25 * 25) as f64);
        let raw = [gel_ms, 1000.0 + gel_ms, 2000.0 + gel_ms, film_ms, 1000.0 + film_ms];
        assert_eq!(numbers(row, "observation.tactile.raw"), raw, "frame {idx}");
        let touched = |ms: f64, channel: u64| f64::from(u8::from(ms as u64 / 500 == channel));
        let active = [
            touched(gel_ms, 0),
            touched(gel_ms, 1),
            touched(gel_ms, 2),
            touched(film_ms, 0),
            touched(film_ms, 1),
        ];
        assert_eq!(numbers(row, "observation.tactile.active"), active, "frame {idx}");
        assert_eq!(numbers(row, "timestamp"), f32s(&[idx as f64 / 50.0]));
        assert_eq!(numbers(row, "frame_index"), [idx as f64]);
    }
}

#[test]
fn tables_agree_with_each_other() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (dir.path().join("s"), dir.path().join("out"));
    let roll = TakeSpec { object: "wedge", primitive: "press_hold", duration_ms: 700, ..TAP };
    session(&source, &[(&TAP, true), (&roll, true), (&TAP, false), (&TAP, true)]);
    let report = write(&[source], &out, LerobotConfig::default()).unwrap();
    assert_eq!(report.fps, 10, "the rate of the joint log");
    assert_eq!(report.left_out.len(), 1);
    assert!(report.left_out[0].file.ends_with("s/take-03.mcap"), "{:?}", report.left_out);
    let info = json_of(&out.join("meta/info.json"));
    let frames = rows(&out.join(DATA));
    let features = info["features"].as_object().unwrap();
    assert_eq!(names(&frames[0]), features.keys().map(String::as_str).collect());
    assert_eq!(info["codebase_version"], "v3.0");
    assert_eq!(info["total_frames"], frames.len());
    assert_eq!(info["total_episodes"], 3);
    assert_eq!(info["splits"]["train"], "0:3");
    for (name, feature) in features {
        let width = feature["shape"][0].as_u64().unwrap() as usize;
        assert!(frames.iter().all(|row| numbers(row, name).len() == width), "{name}");
        if width > 1 {
            assert_eq!(feature["names"].as_array().unwrap().len(), width, "{name}");
        }
    }
    assert_eq!(features["observation.state"]["names"], json!(["slide", "curl"]));
    assert_eq!(features["observation.tactile.raw"]["names"][2], "tip.2");

    let tasks = rows(&out.join("meta/tasks.parquet"));
    assert_eq!(tasks.len(), 2);
    assert_eq!(info["total_tasks"], 2);
    assert_eq!(field(&tasks[0], "task"), &Field::Str("tap: Ball, r 20 mm".to_owned()));
    let Field::Str(task) = field(&tasks[1], "task") else { panic!("a task is no text") };
    assert!(task.starts_with("press hold: "), "{task}");

    let episodes = rows(&out.join(EPISODES));
    assert_eq!(episodes.len(), 3);
    let mut next = 0.0;
    for (idx, episode) in episodes.iter().enumerate() {
        assert_eq!(numbers(episode, "dataset_from_index"), [next]);
        let length = numbers(episode, "length")[0];
        assert_eq!(numbers(episode, "dataset_to_index"), [next + length]);
        for index in 0..length as usize {
            let row = &frames[next as usize + index];
            assert_eq!(numbers(row, "index"), [next + index as f64]);
            assert_eq!(numbers(row, "episode_index"), [idx as f64]);
            assert_eq!(numbers(row, "task_index"), [if idx == 1 { 1.0 } else { 0.0 }]);
        }
        next += length;
        // Takes do not say how they ended.
        assert_eq!(field(episode, "success"), &Field::Null);
        assert_eq!(field(episode, "failure_mode"), &Field::Null);
    }
    assert_eq!(next as usize, frames.len());
    assert_eq!(field(&episodes[2], "source_file"), &Field::Str("take-04.mcap".to_owned()));
    assert_eq!(field(&episodes[2], "source_folder"), &Field::Str("s".to_owned()));

    let about = json_of(&out.join("meta/palpate.json"));
    assert_eq!(about["episodes"][1]["source"]["file"], "take-02.mcap");
    assert_eq!(about["episodes"][0]["source"]["sha256"].as_str().unwrap().len(), 64);
    assert_eq!(about["episodes"][0]["first_frame_s"], 0.03);
    assert!(about["truth"].as_str().unwrap().contains("MCAP"));
    assert!(fs::read_to_string(out.join("README.md")).unwrap().contains("MCAP"));
}

#[test]
fn statistics_are_those_of_the_frames() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (dir.path().join("s"), dir.path().join("out"));
    session(&source, &[(&TAP, true), (&TakeSpec { duration_ms: 900, ..TAP }, true)]);
    write(&[source], &out, LerobotConfig { fps: Some(20), action: None }).unwrap();
    let frames = rows(&out.join(DATA));
    let episodes = rows(&out.join(EPISODES));
    let all = json_of(&out.join("meta/stats.json"));
    assert_eq!(
        all.as_object().unwrap().keys().map(String::as_str).collect::<BTreeSet<_>>(),
        names(&frames[0])
    );
    for name in names(&frames[0]) {
        let check = |rows: &[&Row], found: &dyn Fn(&str) -> Vec<f64>| {
            assert_eq!(found("count"), [rows.len() as f64], "{name}");
            for dimension in 0..numbers(rows[0], name).len() {
                let values: Vec<f64> = rows.iter().map(|row| numbers(row, name)[dimension]).collect();
                let mean = values.iter().sum::<f64>() / values.len() as f64;
                let variance =
                    values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64;
                let close = |key: &str, expected: f64| {
                    let value = found(key)[dimension];
                    let close = (value - expected).abs() <= 1e-9 * (1.0 + expected.abs());
                    assert!(close, "{name}, {key}: {value}, expected {expected}");
                };
                close("min", values.iter().copied().fold(f64::INFINITY, f64::min));
                close("max", values.iter().copied().fold(f64::NEG_INFINITY, f64::max));
                close("mean", mean);
                close("std", variance.sqrt());
                let at_most = |limit: f64| values.iter().filter(|&&value| value <= limit).count();
                assert!(2 * at_most(found("q50")[dimension]) >= values.len(), "{name}: q50");
                assert!(found("q01")[dimension] <= found("q99")[dimension], "{name}");
            }
        };
        let of_all = |key: &str| -> Vec<f64> { serde_json::from_value(all[name][key].clone()).unwrap() };
        check(&frames.iter().collect::<Vec<_>>(), &of_all);
        for (idx, episode) in episodes.iter().enumerate() {
            let own: Vec<&Row> =
                frames.iter().filter(|row| numbers(row, "episode_index") == [idx as f64]).collect();
            check(&own, &|key| numbers(episode, &format!("stats/{name}/{key}")));
        }
    }
}

#[test]
fn pandas_takes_the_task_as_index() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (dir.path().join("s"), dir.path().join("out"));
    session(&source, &[(&TAP, true)]);
    write(&[source], &out, LerobotConfig::default()).unwrap();
    let file = fs::File::open(out.join("meta/tasks.parquet")).unwrap();
    let reader = SerializedFileReader::new(file).unwrap();
    let metadata = reader.metadata().file_metadata().key_value_metadata().unwrap();
    let pandas = metadata.iter().find(|entry| entry.key == "pandas").unwrap();
    let pandas: serde_json::Value = serde_json::from_str(pandas.value.as_ref().unwrap()).unwrap();
    assert_eq!(pandas["index_columns"], json!(["task"]));
}

#[test]
fn recordings_without_commands_have_the_action_that_was_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("s");
    session(&source, &[(&TakeSpec { commands_from_ms: None, ..TAP }, true)]);
    let out = dir.path().join("none");
    let report = write(std::slice::from_ref(&source), &out, LerobotConfig::default()).unwrap();
    assert_eq!(report.action, Action::None);
    assert!(!names(&rows(&out.join(DATA))[0]).contains("action"));
    assert_eq!(json_of(&out.join("meta/info.json"))["features"]["action"], json!(null));

    let out = dir.path().join("next");
    let config = LerobotConfig { fps: Some(10), action: Some(Action::NextState) };
    write(&[source], &out, config).unwrap();
    let frames = rows(&out.join(DATA));
    for pair in frames.windows(2) {
        assert_eq!(numbers(&pair[0], "action"), numbers(&pair[1], "observation.state"));
    }
    let last = frames.last().unwrap();
    assert_eq!(numbers(last, "action"), numbers(last, "observation.state"));
}

#[test]
fn where_the_object_is_is_written_where_it_moves_in_some_take() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (dir.path().join("s"), dir.path().join("out"));
    session(&source, &[(&TakeSpec { moves: true, ..TAP }, true), (&TAP, true)]);
    let report = write(&[source], &out, LerobotConfig { fps: Some(50), action: None }).unwrap();
    let feature = report.features.last().unwrap();
    assert_eq!((feature.name.as_str(), feature.size), ("observation.environment_state", 7));
    let info = json_of(&out.join("meta/info.json"));
    let about = &info["features"]["observation.environment_state"];
    assert_eq!(about["names"], json!(["x", "y", "z", "qw", "qx", "qy", "qz"]));
    assert_eq!((&about["dtype"], &about["shape"]), (&json!("float32"), &json!([7])));
    let unit = &json_of(&out.join("meta/palpate.json"))["units"]["observation.environment_state"];
    assert!(unit.as_str().unwrap().contains("in m"), "{unit}");
    let frames = rows(&out.join(DATA));
    assert_eq!(frames.len(), 2 * 99);
    for (idx, row) in frames[..99].iter().enumerate() {
        // As the newest pose says; before the first, as that one.
        let newest_ms = u64::max((30 + 20 * idx as u64) / 20 * 20, 100);
        let pose = f32s(&[newest_ms as f64 * 1e-5, 0.25, -0.5, 1.0, 0.0, 0.0, 0.0]);
        assert_eq!(numbers(row, "observation.environment_state"), pose, "frame {idx}");
    }
    // It stands still in the second take, at the pose that the take has.
    for row in &frames[99..] {
        assert_eq!(numbers(row, "observation.environment_state"), [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    }
    let stats = json_of(&out.join("meta/stats.json"));
    assert!(stats["observation.environment_state"]["mean"].is_array(), "{stats}");
}

#[test]
fn takes_of_events_only_have_no_readings() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (dir.path().join("s"), dir.path().join("out"));
    session(&source, &[(&TakeSpec { with_raw: false, ..TAP }, true)]);
    let report = write(&[source], &out, LerobotConfig::default()).unwrap();
    let features: Vec<&str> = report.features.iter().map(|feature| feature.name.as_str()).collect();
    assert_eq!(features, ["observation.state", "action", "observation.tactile.active"]);
    assert!(!names(&rows(&out.join(DATA))[0]).contains("observation.tactile.raw"));
}

#[test]
fn trials_say_whether_they_were_a_success_and_how_they_failed() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (dir.path().join("rollout"), dir.path().join("out"));
    fs::create_dir(&source).unwrap();
    let ends = [
        Some(json!({ "suggested": "success", "truth": null })),
        // Whoever sees the object knows better.
        Some(json!({ "suggested": "success", "truth": { "verdict": "SL" } })),
        Some(json!({ "suggested": "void", "truth": null })),
        None,
        Some(json!({ "suggested": "EG", "truth": { "verdict": null } })),
    ];
    for (trial, outcome) in ends.into_iter().enumerate() {
        fs::write(source.join(format!("trial-{trial:04}.jsonl")), text(&record(outcome))).unwrap();
    }
    // Not a record.
    fs::write(source.join("outcomes.jsonl"), "x").unwrap();
    let report = write(&[source], &out, LerobotConfig::default()).unwrap();
    assert_eq!((report.episodes, report.successes, report.failures, report.fps), (3, 1, 2, 20));
    let reasons: Vec<&str> = report.left_out.iter().map(|unusable| unusable.reason.as_str()).collect();
    assert_eq!(reasons, ["the trial is void", "the trial has no outcome: it was cut off"]);
    assert_eq!(report.tasks, ["grasp and lift: cube"]);
    let episodes = rows(&out.join(EPISODES));
    let text = |text: &str| Field::Str(text.to_owned());
    let expected = [
        (Field::Bool(true), Field::Null),
        (Field::Bool(false), text("slip")),
        (Field::Bool(false), text("empty_grasp")),
    ];
    for (episode, (success, failure_mode)) in episodes.iter().zip(expected) {
        assert_eq!(field(episode, "success"), &success);
        assert_eq!(field(episode, "failure_mode"), &failure_mode);
    }
    let frames = rows(&out.join(DATA));
    assert_eq!(numbers(&frames[5], "observation.tactile.active"), [0.0, 0.0, 1.0]);
    assert_eq!(numbers(&frames[5], "observation.tactile.raw"), [0.0, 1.0, 5.0]);
    // Before there was torque: where joints were told to be as the trial began.
    assert_eq!(numbers(&frames[3], "action"), [0.5, 0.25]);
    assert_eq!(numbers(&frames[4], "action"), [104.0, 2.0]);
    let about = json_of(&out.join("meta/palpate.json"));
    assert_eq!(about["episodes"][1]["outcome"]["judged_by"], "operator of the emulated station");
}

#[test]
fn nothing_is_left_beside_the_data_set() {
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (dir.path().join("s"), dir.path().join("sub/out"));
    session(&source, &[(&TAP, true)]);
    write(&[source], &out, LerobotConfig::default()).unwrap();
    let entries =
        |dir: &Path| fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name()).collect::<Vec<_>>();
    assert_eq!(entries(&dir.path().join("sub")), ["out"]);
}
