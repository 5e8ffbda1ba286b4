use serde_json::{Value, json};

use super::*;

fn head() -> Value {
    json!({ "kind": "trial", "trial": {
        "trial": 3, "object": "cube", "policy": "p", "start": { "seed": 5, "trial": 3, "start_cm": null, "object_pose": null },
        "station": "s", "files": [], "control_rate_hz": 20.0, "joints": ["a", "b"], "channels": ["x", "y", "z"],
        "begins_at": [0.0, 0.5],
    } })
}

fn step(time_s: f64, active: &[usize]) -> Value {
    json!({ "kind": "step", "number": 1, "at_s": 0.0, "time_s": time_s, "positions": [0.0, 0.0], "active": active,
        "wanted": [null, 1.0] })
}

fn frame(at_s: f64, let_through: &[f64]) -> Value {
    json!({ "kind": "frame", "at_s": at_s, "let_through": let_through, "active": [1], "phase": "armed" })
}

fn text(lines: &[Value]) -> String {
    lines.iter().map(|line| format!("{line}\n")).collect()
}

fn parsed(text: &str) -> anyhow::Result<Recorded> {
    parse(Path::new("trial-0003.jsonl"), text)
}

#[test]
fn steps_that_were_left_out_keep_what_was_felt() {
    let lines = [head(), step(0.0, &[]), step(0.05, &[1]), step(0.2, &[0, 2])];
    let record = parsed(&text(&lines)).expect("a record");
    let (none, middle, outer) = ([false; 3], [false, true, false], [true, false, true]);
    assert_eq!(record.active_by_step(), [none, middle, middle, middle, outer].concat());
    assert_eq!(record.outcome, None);
}

#[test]
fn commands_are_the_newest_by_the_end_of_a_step_and_end_with_torque() {
    let lines = [
        head(),
        frame(-0.02, &[0.1, 0.5]),
        step(0.0, &[]),
        frame(0.06, &[0.2, 0.5]),
        step(0.05, &[]),
        frame(0.08, &[0.3, 0.5]),
        step(0.1, &[]),
        frame(0.16, &[]),
        step(0.15, &[]),
    ];
    let record = parsed(&text(&lines)).expect("a record");
    assert_eq!(record.commands_by_step(), [[0.1, 0.5], [0.3, 0.5], [0.3, 0.5]]);
}

#[test]
fn a_record_that_was_cut_off_is_read_up_to_there() {
    let whole = text(&[head(), step(0.0, &[2])]);
    let cut = format!("{whole}{}", &step(0.05, &[1]).to_string()[..30]);
    let record = parsed(&cut).expect("a record");
    assert_eq!((record.steps.len(), record.outcome), (1, None));
}

#[test]
fn outcomes_are_those_of_robot_and_operator() {
    let outcome = |truth: Value| json!({ "kind": "outcome", "outcome": { "suggested": "success", "truth": truth, "steps": 4 } });
    for (truth, expected) in [
        (Value::Null, None),
        (json!({ "verdict": "SL", "lift_m": 0.1 }), Some(TrialVerdict::Slip)),
        (json!({ "problem": "it is gone" }), None),
    ] {
        let record = parsed(&text(&[head(), outcome(truth)])).expect("a record").outcome.expect("an outcome");
        assert_eq!(record.suggested, TrialVerdict::Success);
        assert_eq!(record.truth.and_then(|truth| truth.verdict), expected);
    }
}

#[test]
fn what_is_wrong_with_a_record_is_named_with_its_line() {
    let mut other_rate = head();
    other_rate["trial"]["control_rate_hz"] = json!(0.0);
    for (lines, expected) in [
        (vec![], "it is empty"),
        (vec![step(0.0, &[])], "line 1 is none of the kind \"trial\""),
        (vec![other_rate], "line 1: control_rate_hz is 0, expected a positive number"),
        (vec![head(), head()], "line 2 begins another trial"),
        (vec![head(), step(0.0, &[3])], "line 2: active names channel 3, expected less than 3"),
        (vec![head(), step(0.1, &[]), step(0.1, &[])], "line 3: time_s is 0.1, expected more"),
        (vec![head(), frame(0.0, &[1.0])], "line 2: let_through has 1 numbers, expected one per joint, 2"),
        (vec![head(), json!({ "kind": "dance" })], "line 2: unknown variant `dance`"),
    ] {
        let said = parsed(&text(&lines)).map_or_else(|err| format!("{err:#}"), |_| "it was read".to_owned());
        assert!(said.contains(expected), "{said}");
    }
}
