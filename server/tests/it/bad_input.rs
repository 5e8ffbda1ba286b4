//! Bad input to the command: exit code 2, one line that names the place, and nothing on disk changed.

use std::{fs, path::Path};

use palpate_server::assets;

use crate::support::{Data, STATION, arg, palpate_refuses, tree, write_recording};

/// Runs `palpate` and checks that it refuses, naming `words`, without touching anything below `dir`.
#[track_caller]
fn refuses(dir: &Path, args: &[&str], words: &[&str]) {
    let before = tree(dir);
    let error = palpate_refuses(args);
    for word in words {
        assert!(error.contains(word), "{word:?} is missing in {error:?}");
    }
    assert!(tree(dir) == before, "{args:?} changed something on disk");
}

/// An import whose `file` of the second take was edited.
#[track_caller]
fn refuses_import(file: &str, edit: impl Fn(&str) -> String, words: &[&str]) {
    let data = Data::empty();
    let csv = data.csv();
    write_recording(data.csv());
    let path = data.csv().join("take-02").join(file);
    fs::write(&path, edit(&fs::read_to_string(&path).unwrap())).unwrap();
    let out = data.path("session");
    let args = ["import", "--csv", arg(csv), "--out", arg(&out), "--station", STATION];
    refuses(&data.path("."), &args, &[&[file], words].concat());
}

fn with_line(text: &str, line: usize, row: &str) -> String {
    let mut lines: Vec<&str> = text.lines().collect();
    lines[line - 1] = row;
    lines.join("\n")
}

#[test]
fn ragged_row() {
    refuses_import("gel.csv", |text| with_line(text, 7, "0.025,1,2"), &["line 7"]);
}

#[test]
fn time_that_does_not_increase() {
    refuses_import("joints.csv", |text| with_line(text, 5, "0.08,0,0,0.1"), &["line 5"]);
}

#[test]
fn reading_that_is_no_number() {
    refuses_import("joints.csv", |text| with_line(text, 9, "0.28,0,NaN,0.1"), &["line 9"]);
    refuses_import("film.csv", |text| with_line(text, 4, "0.04,inf,300,300,300,300,300"), &["line 4"]);
    refuses_import("film.csv", |text| with_line(text, 4, "0.04,abc,300,300,300,300,300"), &["line 4"]);
}

#[test]
fn wrong_channel_count() {
    let narrower = |text: &str| -> String {
        text.lines().map(|line| format!("{}\n", line.rsplit_once(',').unwrap().0)).collect()
    };
    refuses_import("film.csv", narrower, &["6", "5"]);
    refuses_import("joints.csv", narrower, &["3", "2"]);
}

#[test]
fn empty_file() {
    refuses_import("joints.csv", |_| String::new(), &[]);
    refuses_import("take.toml", |_| "object = \"sphere_50mm\"".to_owned(), &["object_pose"]);
}

#[test]
fn station_that_does_not_match_the_recording() {
    let data = Data::empty();
    let csv = data.csv();
    write_recording(data.csv());
    let out = data.path("session");
    // This one has other streams and joints.
    let args = ["import", "--csv", arg(csv), "--out", arg(&out), "--station", "xarm6-leap"];
    refuses(&data.path("."), &args, &["take-01"]);
    let args = ["import", "--csv", arg(csv), "--out", arg(&out), "--station", "nowhere"];
    refuses(&data.path("."), &args, &["nowhere", STATION]);
    let missing = data.path("missing.toml");
    let args = ["import", "--csv", arg(csv), "--out", arg(&out), "--station", arg(&missing)];
    refuses(&data.path("."), &args, &["missing.toml"]);
}

/// An import with a station one of whose files was edited.
#[track_caller]
fn refuses_station(file: &str, edit: impl Fn(&str) -> String, words: &[&str]) {
    let data = Data::empty();
    let csv = data.csv();
    write_recording(data.csv());
    let unpacked = assets::unpack().unwrap();
    let path = unpacked.path().join(file);
    let text = fs::read_to_string(&path).unwrap();
    let edited = edit(&text);
    assert_ne!(text, edited);
    fs::write(&path, edited).unwrap();
    let out = data.path("session");
    let station = unpacked.path().join("stations/probe_bench.toml");
    let args = ["import", "--csv", arg(csv), "--out", arg(&out), "--station", arg(&station)];
    refuses(&data.path("."), &args, words);
}

#[test]
fn urdf_with_a_missing_link() {
    let edit = |text: &str| text.replace("<child link=\"carriage_y\"/>", "<child link=\"carriage_w\"/>");
    refuses_station("robots/probe_bench.urdf", edit, &["probe_bench.urdf", "carriage_w"]);
}

#[test]
fn layout_that_names_an_unknown_link() {
    let edit = |text: &str| text.replacen("link = \"ram\"", "link = \"rammer\"", 1);
    refuses_station("layouts/probe_pad_15.toml", edit, &["probe_pad_15.toml", "rammer"]);
}

#[test]
fn station_that_names_an_unknown_stream_or_file() {
    let edit = |text: &str| text.replacen("stream = \"film\"", "stream = \"foil\"", 1);
    refuses_station("stations/probe_bench.toml", edit, &["probe_bench.toml", "foil"]);
    let edit = |text: &str| text.replace("wedge_80mm.toml", "wedge_90mm.toml");
    refuses_station("stations/probe_bench.toml", edit, &["probe_bench.toml", "wedge_90mm.toml"]);
}

#[test]
fn truncated_take() {
    let data = Data::with_session();
    let session_dir = data.session();
    let file = data.truncate_take();
    let model = write_model(&data);
    let (take, out) = (data.session().join(&file), data.path("out.mcap"));
    let args = ["replay", "--take", arg(&take), "--model", arg(&model), "--out", arg(&out)];
    refuses(&data.path("."), &args, &[&file]);
    let report = data.path("report");
    let args = ["calibrate", "--session", arg(session_dir), "--report", arg(&report), "--json"];
    refuses(&data.path("."), &args, &[&file]);
}

#[test]
fn session_without_takes() {
    let data = Data::with_session();
    let session_dir = data.session();
    data.edit_session(|text| text[..text.find("[[take]]").unwrap()].to_owned());
    for command in [&["session", "check"][..], &["calibrate", "--session"]] {
        let args = [command, &[arg(session_dir)]].concat();
        refuses(&data.path("."), &args, &["session.toml", "no takes"]);
    }
    let empty = data.path("empty");
    fs::create_dir(&empty).unwrap();
    refuses(&data.path("."), &["session", "check", arg(&empty)], &["session.toml"]);
    let out = data.path("imported");
    let args = ["import", "--csv", arg(&empty), "--out", arg(&out), "--station", STATION];
    refuses(&data.path("."), &args, &["empty"]);
}

#[test]
fn session_of_another_station() {
    let data = Data::with_session();
    let session_dir = data.session();
    data.edit_session(|text| text.replace(STATION, "xarm6-leap"));
    for command in ["calibrate", "diagnose"] {
        let args = [command, "--session", arg(session_dir)];
        refuses(&data.path("."), &args, &["take-01.mcap", STATION, "xarm6-leap"]);
    }
}

#[test]
fn arguments_that_name_nothing() {
    let data = Data::with_session();
    let here = data.path(".");
    let session = data.session();
    let args = ["calibrate", "--session", arg(session), "--hold-out", "take-01,take-55"];
    refuses(&here, &args, &["take-55", "take-04"]);
    let everything =
        ["calibrate", "--session", arg(session), "--hold-out", "take-01,take-02,take-03,take-04"];
    refuses(&here, &everything, &["hold"]);
    let nowhere = data.path("nowhere/model.toml");
    let args = ["calibrate", "--session", arg(session), "--out", arg(&nowhere)];
    refuses(&here, &args, &["nowhere"]);
    let args = ["emulate", "--truth", "nowhere.toml", "--out", arg(&nowhere)];
    refuses(&here, &args, &["nowhere.toml"]);
}

#[test]
fn diagnosis_of_nothing() {
    let data = Data::with_session();
    let here = data.path(".");
    let session = data.session();
    let refuses = |args: &[&str], words: &[&str]| {
        let args = [&["diagnose", "--session", arg(session)], args].concat();
        refuses(&here, &args, words);
    };
    refuses(&["--hold-out", "take-01,take-55"], &["take-55", "take-04"]);
    refuses(&["--hold-out", "take-01,take-02,take-03,take-04"], &["held out"]);
    refuses(&["--without", "latency,gremlins"], &["gremlins", "joint_offset"]);
    refuses(&["--max-effects", "0"], &["at least 1"]);
    refuses(&["--null-bar", "3"], &["3 null sessions"]);
    refuses(&["--out", arg(&data.path("nowhere/model.toml"))], &["nowhere"]);
    refuses(&["--model", arg(&data.path("nowhere.toml"))], &["nowhere.toml"]);
    let model = write_model(&data);
    let text = fs::read_to_string(&model).unwrap();
    fs::write(&model, text.replace("alpha_per_m = 80.0", "alpha_per_m = nan")).unwrap();
    refuses(&["--model", arg(&model)], &["model.toml", "alpha_per_m"]);
    let nowhere = data.path("nowhere");
    crate::support::palpate_refuses(&["diagnose", "--session", arg(&nowhere)]);
}

#[test]
fn model_of_another_station_is_no_start() {
    let data = Data::with_session();
    let model = write_model(&data);
    let text = fs::read_to_string(&model).unwrap();
    let effect = "\n[[effect]]\nid = \"latency\"\nwhere = { stream = \"twintac\" }\n\
        parameters = { delay_s = 0.05 }\n";
    fs::write(&model, text.replace("format = 1", "format = 2") + effect).unwrap();
    let session = data.session();
    let args = ["diagnose", "--session", arg(session), "--model", arg(&model)];
    refuses(&data.path("."), &args, &["twintac"]);
}

#[test]
fn existing_session_is_never_overwritten() {
    let data = Data::with_session();
    let session_dir = data.session();
    let csv = data.csv();
    let args = ["import", "--csv", arg(csv), "--out", arg(session_dir), "--station", STATION];
    refuses(&data.path("."), &args, &["taps", "already"]);
}

#[test]
fn model_that_makes_no_sense() {
    let data = Data::with_session();
    let take = data.session().join("take-01.mcap");
    let out = data.path("out.mcap");
    let model = write_model(&data);
    let text = fs::read_to_string(&model).unwrap();
    for (from, to) in
        [("alpha_per_m = 80.0", "alpha_per_m = -1.0"), ("lambda_con_m", "lambda_kon_m"), ("0.001", "nan")]
    {
        fs::write(&model, text.replace(from, to)).unwrap();
        let args = ["replay", "--take", arg(&take), "--model", arg(&model), "--out", arg(&out)];
        refuses(&data.path("."), &args, &["model.toml"]);
    }
}

fn write_model(data: &Data) -> std::path::PathBuf {
    let path = data.path("model.toml");
    let text = "format = 1\nname = \"Soft\"\n[theta]\nlambda_con_m = 0.001\nalpha_per_m = 80.0\n\
        lambda_pre_pa = 500.0\n";
    fs::write(&path, text).unwrap();
    path
}
