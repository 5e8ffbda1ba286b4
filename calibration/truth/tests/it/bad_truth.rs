//! Truth files that cannot be used: the error names the place and says what to do, and nothing is written.

use tempfile::TempDir;

use crate::{record, variant};

const TAKE: &str = r#"
[[take]]
object = "sphere_50mm"
primitive = "tap"
duration_s = 12.0
touch = ["palm_heel"]
"#;

/// The error that `edits` to a good truth bring about.
fn error(takes: &str, edits: &[(&str, &str)]) -> String {
    let dir = TempDir::new().unwrap();
    let truth = variant(&dir, "bad.toml", takes, edits);
    let error = record(&truth, &dir.path().join("out"), 1).unwrap_err();
    let left: Vec<_> =
        std::fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "something was left on disk beside the truth and its plan: {left:?}");
    error.to_string()
}

fn assert_says(message: &str, parts: &[&str]) {
    for part in parts {
        assert!(message.contains(part), "{message:?} does not say {part:?}");
    }
}

#[test]
fn unknown_field_is_named_with_its_line() {
    let message = error(TAKE, &[("format = 1", "format = 1\nformatt = 2")]);
    assert_says(&message, &["bad.toml", "line 3", "formatt"]);
}

#[test]
fn other_versions_are_refused() {
    assert_says(&error(TAKE, &[("format = 1", "format = 2")]), &["format", "is 2, expected 1"]);
}

#[test]
fn joints_are_checked_against_the_robot() {
    let message = error(TAKE, &[("joint2 = 0.0", "elbow = 0.0")]);
    assert_says(&message, &["motion.rest", "no moving joint \"elbow\""]);
    let message = error(TAKE, &[("joint2 = 0.0\n", "")]);
    assert_says(&message, &["motion.rest", "\"joint2\" is missing"]);
    let message = error(TAKE, &[("joint2 = 0.0", "joint2 = 3.0")]);
    assert_says(&message, &["\"joint2\"", "outside its limits"]);
}

#[test]
fn streams_patches_and_objects_are_checked_against_the_station() {
    let message = error(TAKE, &[("id = \"fsr\"", "id = \"fsrs\"")]);
    assert_says(&message, &["stream \"fsr\"", "add a [[stream]]"]);
    let message = error(TAKE, &[("patch = \"middle_tip\"", "patch = \"little_tip\"")]);
    assert_says(&message, &["mount_offset \"little_tip\"", "no such patch"]);
    let message = error(TAKE, &[("[object.sphere_50mm]", "[object.ball]")]);
    assert_says(&message, &["object \"ball\"", "no such object"]);
}

#[test]
fn takes_are_checked_before_anything_moves() {
    let message = error(&TAKE.replace("palm_heel", "palm_heal"), &[]);
    assert_says(&message, &["take 1", "no channel or patch \"palm_heal\""]);
    let message = error(&TAKE.replace("\"tap\"", "\"pat\""), &[]);
    assert_says(&message, &["pat.toml"]);
    let message = error(&TAKE.replace("12.0", "4.0"), &[]);
    assert_says(&message, &["take 1", "touches need", "duration_s is 4"]);
}

#[test]
fn numbers_out_of_range_are_named() {
    let message = error(TAKE, &[("latency_s = 0.14", "latency_s = -0.14")]);
    assert_says(&message, &["stream \"twintac\"", "latency_s = -0.14 must not be negative"]);
    let message = error(TAKE, &[("damping_s = 0.03", "damping_s = 0.0001")]);
    assert_says(&message, &["stream \"twintac\"", "elastomer", "raise damping_s"]);
    let message = error(TAKE, &[("recorded = 2026-03-02T09:30:00Z", "recorded = 2026-03-02")]);
    assert_says(&message, &["recorded", "needs date, time and offset"]);
}

#[test]
fn an_object_out_of_reach_says_what_to_move() {
    let message = error(TAKE, &[("position_m = [0.47, 0.0, 0.19]", "position_m = [2.0, 0.0, 0.19]")]);
    assert_says(&message, &["take 1", "palm_heel", "move the object"]);
}
