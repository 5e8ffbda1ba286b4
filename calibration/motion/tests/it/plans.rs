//! Plan files: what the shipped ones hold, and what is refused.

use palpate_motion::{Plan, Primitive, Primitives, coverage, plan_take};
use palpate_robot_model::Station;

use crate::{assets, plan, station};

fn text(path: &str) -> String {
    std::fs::read_to_string(assets().join(path)).unwrap()
}

#[test]
fn shipped_plans_fit_their_stations() {
    for (station_name, plans) in [
        ("xarm6_leap", &["nine_takes", "quick_check", "three_takes", "blind_tune"][..]),
        ("xarm6_leap_b", &["blind_report"]),
        ("xarm6_leap_d", &["blind_report_d"]),
        ("probe_bench", &["probe_bench"]),
    ] {
        let station = station(station_name);
        for name in plans {
            let plan = plan(name);
            plan.check(&station).unwrap();
            assert_eq!(plan.id, *name);
            assert!(plan.needs().is_empty() && !plan.label.is_empty(), "{name}");
        }
    }
}

/// Stations name these: their texts alone must do, wherever they are read.
#[test]
fn plans_of_stations_need_no_other_file_and_tell_operators_what_to_do() {
    for name in ["nine_takes", "quick_check"] {
        let plan = Plan::from_text(name, &text(&format!("plans/{name}.toml"))).unwrap();
        assert_eq!(plan.needs(), [""; 0], "{name}");
        for (take_idx, take) in plan.takes.iter().enumerate() {
            assert!(!take.instruction.is_empty(), "{name} take {}", take_idx + 1);
        }
    }
    let station = station("xarm6_leap");
    let own: Vec<String> = Plan::of_station(&station).unwrap().into_iter().map(|plan| plan.id).collect();
    assert_eq!(own, ["nine_takes", "quick_check"]);
    // What is written out in the plan is what the folder has.
    let plan = plan("nine_takes");
    for (id, own) in &plan.primitives {
        let shared = Primitive::from_text(id, &text(&format!("primitives/{id}.toml"))).unwrap();
        assert!(own.same_motion(&shared), "{id} differs from primitives/{id}.toml");
    }
}

#[test]
fn nine_takes_mean_to_touch_every_patch_in_both_halves() {
    let (station, plan) = (station("xarm6_leap"), plan("nine_takes"));
    let coverage = coverage(&plan, &station).unwrap();
    assert_eq!(coverage.len(), station.layout.num_channels());
    for (channel, covered) in coverage.iter().enumerate() {
        let id = &station.layout.channels[channel].id;
        assert_eq!(covered.channel, channel);
        let half = plan.takes.len() / 2;
        assert!(covered.patch_takes.iter().any(|&take| take < half), "{id}: {covered:?}");
        assert!(covered.patch_takes.iter().any(|&take| take >= half), "{id}: {covered:?}");
    }
    let named = |id: &str| {
        let channel = station.layout.channels.iter().position(|channel| channel.id == id).unwrap();
        coverage[channel].takes.clone()
    };
    assert_eq!(named("palm_heel"), [0, 5]);
    assert_eq!(named("ring_tip.6"), [2, 2, 7], "twice in one take");
    assert_eq!(named("index_tip.0"), [0; 0], "its neighbours alone");
}

#[test]
fn missing_primitives_come_from_a_library_or_are_named() {
    let station = station("xarm6_leap");
    let own = text("plans/quick_check.toml");
    let bare = own.replace("[primitive.quick_tap", "[primitive.other");
    let plan = Plan::from_text("bare.toml", &bare).unwrap();
    assert_eq!(plan.needs(), ["quick_tap"]);
    let error = plan_take(&station, &plan, &Primitives::new(), 0, None).unwrap_err().to_string();
    assert!(
        error.contains("bare.toml: primitive \"quick_tap\"") && error.contains("primitives ="),
        "{error}"
    );
    let library = Plan::from_text("whole.toml", &own).unwrap().primitives;
    let motion = plan_take(&station, &plan, &library, 0, None).unwrap();
    let touched: Vec<&str> =
        motion.touches.iter().map(|&channel| station.layout.channels[channel].id.as_str()).collect();
    assert_eq!(touched, ["palm_middle", "index_tip.4"]);
}

#[test]
fn primitives_are_found_from_the_plan() {
    let text = text("plans/three_takes.toml");
    let mut plan = Plan::from_text("plans/three_takes.toml", &text).unwrap();
    assert_eq!(plan.needs(), ["slide", "tap"]);
    let mut asked = Vec::new();
    plan.complete(|path| {
        asked.push(path.to_owned());
        std::fs::read_to_string(assets().join("plans").join(path)).map_err(|error| error.to_string())
    })
    .unwrap();
    assert_eq!(asked, ["../primitives/slide.toml", "../primitives/tap.toml"]);
    assert_eq!(plan.needs(), [""; 0]);
}

/// What is said about the quick check with `from` replaced by `to`.
fn refusal(station: &Station, from: &str, to: &str) -> String {
    let text = text("plans/quick_check.toml");
    assert!(text.contains(from), "the plan has no {from:?}");
    let plan = Plan::from_text("check.toml", &text.replacen(from, to, 1));
    let refused = plan.and_then(|plan| plan_take(station, &plan, &Primitives::new(), 0, None));
    refused.err().map(|error| error.to_string()).unwrap_or_default()
}

#[test]
fn every_fault_names_file_place_and_what_to_do() {
    let station = station("xarm6_leap");
    for (from, to, expected) in [
        ("format = 1", "format = 2", "check.toml: format: is 2, expected 1"),
        ("label =", "lable =", "check.toml: line 4: unknown field `lable`"),
        ("joint2 = 0.0", "elbow = 0.0", "check.toml: motion.rest: the station has no moving joint \"elbow\""),
        ("joint2 = 0.0\n", "", "check.toml: motion.rest: joint \"joint2\" is missing"),
        ("joint2 = 0.0", "joint2 = 3.0", "motion.rest: joint \"joint2\": 3 is outside its limits"),
        ("joint2 = 0.0", "joint2 = nan", "motion.rest: joint \"joint2\": NaN must be finite"),
        ("speed_fraction = 0.65", "speed_fraction = 1.5", "motion: speed_fraction = 1.5 must be at most 1"),
        ("baseline_s = 1.5", "baseline_s = 0.0", "motion: baseline_s = 0 must be a positive number"),
        ("[object.sphere_50mm]", "[object.ball]", "object \"ball\": the station has no such object"),
        (
            "object = \"sphere_50mm\"",
            "object = \"cup\"",
            "take 1: object \"cup\" has no pose: add [object.cup]",
        ),
        ("\"palm_middle\"", "\"palm_mid\"", "take 1: touch: the layout has no channel or patch \"palm_mid\""),
        ("[\"palm_middle\", \"index_tip.4\"]", "[]", "take 1: touch is empty: name channels or patches"),
        ("duration_s = 14.0", "duration_s = 1.0", "take 1: duration_s = 1 must be longer than"),
        ("duration_s = 14.0", "duration_s = 3.0", "take 1: 2 touches need"),
        ("depth_m = 0.0022", "depth_m = -1.0", "primitive \"quick_tap\": primitive: depth_m = -1 must be"),
        (
            "press_m_per_s = 0.045",
            "press_m_per_s = 0.0",
            "quick_tap\": speed \"fast\": press_m_per_s = 0 must",
        ),
        ("repetitions = 1", "repetitions = 0", "must each have at least one"),
        ("position_m = [0.47, 0.0, 0.19]", "position_m = [2.0, 0.0, 0.19]", "take 1: found no way to touch"),
    ] {
        let message = refusal(&station, from, to);
        assert!(message.contains(expected), "{to:?}: {message:?} does not say {expected:?}");
    }
    let plan = plan("quick_check");
    let error = plan_take(&station, &plan, &Primitives::new(), 3, None).unwrap_err().to_string();
    assert!(error.contains("take 4: the plan has 3 takes"), "{error}");
    let error = Plan::read(&assets().join("plans/none.toml")).unwrap_err().to_string();
    assert!(error.contains("none.toml: file: failed to read it"), "{error}");
    let error = Primitive::from_text("tap.toml", "label = \"x\"").unwrap_err().to_string();
    assert!(error.starts_with("tap.toml: line 1: missing field"), "{error}");
}
