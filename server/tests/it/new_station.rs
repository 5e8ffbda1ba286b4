//! A station of one's own: from a URDF over recordings to a calibrated model.

use std::{fmt::Write as _, fs, path::Path};

use serde_json::Value;

use crate::support::{arg, palpate, palpate_ok, palpate_refuses};

/// Its right finger mimics the left one, and its shapes are meshes.
const GRIPPER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../sim/robot_model/tests/gripper/gripper.urdf");
const BALL: &str =
    "id = \"ball\"\nlabel = \"Ball, r 20 mm\"\nshape = { kind = \"sphere\", radius_m = 0.02 }\n";
const NUM_TAKES: usize = 4;
const DURATION_S: f64 = 12.0;

/// How far the left finger is open, m: from 6 mm above the ball to 2 mm into it and back in 3 s, after a second of rest.
fn left_m(time_s: f64) -> f64 {
    let phase = (time_s - 1.0).max(0.0) / 3.0;
    0.026 - (1.0 - (2.0 * phase.fract() - 1.0).abs()) * 0.008
}

/// Takes of the gripper that closes on a ball between its fingers. The right finger, which follows, is in no file.
fn write_recordings(dir: &Path) {
    for take in 1..=NUM_TAKES {
        let take_dir = dir.join(format!("take-{take:02}"));
        fs::create_dir_all(&take_dir).unwrap();
        let take_toml = "object = \"ball\"\nobject_pose = { position_m = [0.0, 0.0, 0.105] }\nprimitive = \"close\"\n\
                         baseline_s = [0.0, 0.9]\n";
        fs::write(take_dir.join("take.toml"), take_toml).unwrap();
        let mut joints = "t,left [mm],roll [deg]\n".to_owned();
        for row in 0..(DURATION_S * 50.0) as usize {
            let time_s = row as f64 / 50.0;
            writeln!(joints, "{time_s},{},30", left_m(time_s) * 1e3).unwrap();
        }
        fs::write(take_dir.join("joints.csv"), joints).unwrap();
        let channels =
            ["left", "right"].iter().flat_map(|finger| (0..6).map(move |taxel| format!("{finger}.{taxel}")));
        let channels: Vec<String> = channels.collect();
        let mut gel = format!("t,{}\n", channels.join(","));
        for row in 0..(DURATION_S * 100.0) as usize {
            let time_s = row as f64 / 100.0;
            // The ball touches each pad in its middle, which is between the two rows; the sensors answer late.
            let is_felt = left_m(time_s - 0.05) < 0.0195;
            let reading = |idx: usize| if is_felt && matches!(idx % 6, 1 | 4) { 900 } else { 200 + idx };
            let readings: Vec<String> = (0..channels.len()).map(|idx| reading(idx).to_string()).collect();
            writeln!(gel, "{time_s},{}", readings.join(",")).unwrap();
        }
        fs::write(take_dir.join("gel.csv"), gel).unwrap();
    }
}

fn new_args<'a>(object: &'a str, rest: &[&'a str]) -> Vec<&'a str> {
    let common = [
        "station",
        "new",
        "--urdf",
        GRIPPER,
        "--stream",
        "gel",
        "--joint-rate-hz",
        "50",
        "--object",
        object,
        "--patch",
        "left=finger_left:2x3@20x12:-y",
        "--patch",
        "right=finger_right:2x3@20x12:+y",
    ];
    [&common[..], rest].concat()
}

#[test]
fn a_urdf_becomes_a_station_and_its_recordings_calibrate_it() {
    let dir = tempfile::tempdir().unwrap();
    let ball = dir.path().join("ball.toml");
    fs::write(&ball, BALL).unwrap();
    let (hand, recordings) = (dir.path().join("hand"), dir.path().join("recordings"));
    let made = palpate_ok(&new_args(arg(&ball), &["--out", arg(&hand), "--carrier", "roll"]));
    for expected in [
        "note: link \"finger_left\": 2 meshes are replaced by the box around each",
        "warning: link \"palm\": mesh \"package://gripper/palm.dae\" is left out",
        "station \"gripper\" is in",
        "3 joints, 2 patches, 12 channels, 1 object\n",
        "hand/station.toml --out SESSION",
    ] {
        assert!(made.contains(expected), "{expected}: {made}");
    }
    write_recordings(&recordings);
    let station = hand.join("station.toml");
    let explained =
        palpate_ok(&["import", "--csv", arg(&recordings), "--station", arg(&station), "--explain"]);
    assert!(
        explained.contains("joint \"right\" was not recorded; it follows \"left\": times 1, plus 0"),
        "{explained}"
    );
    let session = dir.path().join("session");
    palpate_ok(&["import", "--csv", arg(&recordings), "--station", arg(&station), "--out", arg(&session)]);
    let take = palpate_recording::Take::read(&session.join("take-01.mcap")).unwrap();
    // Joints come in the order of the URDF: roll, left, right.
    let first = &take.joints.positions[..3];
    assert!((first[0] - 30_f64.to_radians()).abs() < 1e-9, "{first:?}");
    assert_eq!((first[1], first[2]), (0.026, 0.026));

    let check: Value =
        serde_json::from_str(&palpate_ok(&["session", "check", arg(&session), "--json"])).unwrap();
    assert_eq!(check["ok"], true, "{check}");
    let json = palpate_ok(&[
        "calibrate",
        "--session",
        arg(&session),
        "--hold-out",
        "take-04",
        "--out",
        arg(&dir.path().join("model.toml")),
        "--json",
    ]);
    let report: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(report["channels"], 12);
    assert!(report["calibrated"]["l1"].as_u64() < report["nominal"]["l1"].as_u64(), "{report}");
}

/// A world in which the gripper touches the ball as its plan says.
const TRUTH: &str = r#"
format = 1
name = "Gripper"
station = "hand/station.toml"
plan = "hand/plans/every_patch.toml"
recorded = 2026-03-06T09:30:00Z
operator = "emulated"
world_seed = 1

[joints]
noise_rad = 0.0003
noise_m = 0.00001

[[stream]]
id = "gel"
latency_s = 0.02
jitter_s = 0.001
sensitivity_spread = 0.1
noise_raw = 4.0

[stream.elastomer]
spacing_m = 0.0026
thickness_m = 0.005
modulus_pa = 1.0e5
contact_ratio = 8.0
relaxing_ratio = 0.6
relaxing_s = 0.2
damping_s = 0.03
coupling_m = 0.002

[stream.front_end]
kind = "barometer"
depth_m = 0.004
raw_per_pa = 0.03
offset_raw = 400.0
low_pass_s = 0.012
"#;

#[test]
fn the_plan_of_a_new_station_is_recorded_by_an_emulated_one() {
    let dir = tempfile::tempdir().unwrap();
    let ball = dir.path().join("ball.toml");
    fs::write(&ball, BALL).unwrap();
    let (hand, truth) = (dir.path().join("hand"), dir.path().join("truth.toml"));
    let json = palpate_ok(&new_args(arg(&ball), &["--out", arg(&hand), "--carrier", "roll", "--json"]));
    let document: Value = serde_json::from_str(&json).unwrap();
    let plan = &document["plan"];
    assert_eq!(plan["file"], "plans/every_patch.toml", "{document}");
    assert_eq!(plan["objects"][0]["object"], "ball", "{plan}");
    let channels: Vec<&str> =
        plan["objects"][0]["channels"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
    for finger in ["left.", "right."] {
        assert!(channels.iter().any(|channel| channel.starts_with(finger)), "{plan}");
    }
    fs::write(&truth, TRUTH).unwrap();
    let session = dir.path().join("session");
    palpate_ok(&["emulate", "--truth", arg(&truth), "--out", arg(&session)]);
    let takes = fs::read_dir(&session).unwrap().filter(|entry| {
        entry.as_ref().is_ok_and(|entry| entry.path().extension().is_some_and(|ending| ending == "mcap"))
    });
    assert_eq!(takes.count() as u64, plan["takes"].as_u64().unwrap());
    let checked = palpate_ok(&["session", "check", arg(&session), "--json"]);
    let check: Value = serde_json::from_str(&checked).unwrap();
    assert_eq!(check["ok"], true, "{check}");
}

#[test]
fn explain_writes_nothing_and_json_says_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let text = palpate_ok(&["station", "new", "--urdf", GRIPPER, "--explain"]);
    for expected in [
        "right                    prismatic  0 to 0.04 m              palm -> finger_right; follows left, times 1, plus 0",
        "finger_left              tip          1       1  16.0 x 12.0 x 50.0",
        "warning: joint \"roll\" has no limits",
        "nothing was written",
    ] {
        let squeezed = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(squeezed(&text).contains(&squeezed(expected)), "{expected}: {text}");
    }
    let json = palpate_ok(&new_args("box_80x60x45mm", &["--explain", "--json"]));
    let document: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(document["station"], "gripper");
    assert_eq!(document["dir"], Value::Null);
    assert_eq!(document["patches"][1]["channels"][5], "right.5");
    assert_eq!(document["robot"]["joints"][2]["follows"]["joint"], "left");
    assert!(document["plan"]["takes"].as_u64().is_some_and(|takes| takes > 0), "{document}");
    assert_eq!(document["plan"]["objects"][0]["object"], "box_80x60x45mm");
    // Nothing moves the wrist, so that nothing on it can be brought to an object.
    let args = ["station", "new", "--urdf", GRIPPER, "--patch", "a=wrist:1x1@9x9", "--explain", "--json"];
    let document: Value = serde_json::from_str(&palpate_ok(&args)).unwrap();
    assert_eq!(document["plan"], Value::Null);
    let warnings = document["warnings"].to_string();
    assert!(warnings.contains("no joint moves it") && warnings.contains("no plan was written"), "{warnings}");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn several_streams_come_from_a_file() {
    let dir = tempfile::tempdir().unwrap();
    let (skin, hand) = (dir.path().join("skin.toml"), dir.path().join("hand"));
    let text = "[[stream]]\nid = \"gel\"\nraw_max = 1023\n\n[[stream]]\nid = \"fsr\"\nkind = \"proximity\"\nunit = \"mV\"\n\n\
                [[patch]]\nid = \"tip\"\nlink = \"finger_left\"\ntaxels = [3, 2]\nsize_mm = [20, 10]\noutward = \"-y\"\n\n\
                [[patch]]\nid = \"palm\"\nstream = \"fsr\"\nlink = \"palm\"\ntaxels = [1, 1]\nsize_mm = [10, 10]\n";
    fs::write(&skin, text).unwrap();
    let args = ["station", "new", "--urdf", GRIPPER, "--patches", arg(&skin), "--out", arg(&hand), "--json"];
    let document: Value = serde_json::from_str(&palpate_ok(&args)).unwrap();
    assert_eq!(document["patches"][1]["stream"], "fsr");
    assert!(hand.join("objects/sphere_50mm.toml").is_file(), "{document}");
    let error = palpate_refuses(&[&args[..6], &["--explain", "--raw-max", "9"]].concat());
    assert!(error.contains("--raw-max, but") && error.contains("say it there"), "{error}");
}

#[test]
fn what_cannot_be_made_is_refused_and_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("hand");
    let refused = |rest: &[&str]| {
        let common = ["station", "new", "--urdf", GRIPPER, "--out", arg(&out)];
        let error = palpate_refuses(&[&common[..], rest].concat());
        assert!(!out.exists(), "{rest:?}");
        error
    };
    let error = refused(&[]);
    assert!(
        error.contains("--patch tip=finger_left:4x3@20x15:+z") && error.contains("other links: \"wrist\""),
        "{error}"
    );
    let error = refused(&["--patch", "a=finger_lfet:1x1@9x9"]);
    assert!(
        error.contains("gripper.urdf has no link \"finger_lfet\"; nearest are \"finger_left\""),
        "{error}"
    );
    assert!(refused(&["--patch", "a"]).contains("expected NAME=LINK"));
    assert!(refused(&["--patch", "a=palm:1x1@9x9", "--id", "a b"]).contains("expected letters, digits"));
    assert!(refused(&["--patch", "a=palm:1x1@9x9", "--object", "moon"]).contains("shipped are"));
    assert!(
        refused(&["--patch", "a=palm:1x1@9x9", "--carrier", "wrist"]).contains("no moving joint \"wrist\"")
    );
    assert!(refused(&["--patches", "nowhere.toml"]).contains("nowhere.toml"));
    let error = palpate_refuses(&["station", "new", "--urdf", "nowhere.urdf", "--explain"]);
    assert!(error.contains("nowhere.urdf"), "{error}");
    let full = dir.path().join("full");
    fs::create_dir(&full).unwrap();
    fs::write(full.join("mine"), "x").unwrap();
    let error = palpate_refuses(&["station", "new", "--urdf", GRIPPER, "--out", arg(&full)]);
    assert!(error.contains("is not empty"), "{error}");
    assert_eq!(palpate(&["station", "new", "--urdf", GRIPPER]).status.code(), Some(2));
}
