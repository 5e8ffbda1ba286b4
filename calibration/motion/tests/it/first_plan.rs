//! Plans for stations that have none: they are read, planned, and touch what can be touched.

use std::path::Path;

use palpate_motion::{
    Experiment, FirstPlan, MotionLimits, Plan, Primitive, Primitives, coverage, experiment_plan, first_plan,
    plan_take, plan_text,
};
use palpate_recording::load_station;
use palpate_robot_model::Station;

use crate::{assets, station};

fn fixture(name: &str) -> Station {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures");
    load_station(&fixtures.join(name).join("station.toml")).unwrap()
}

fn shipped() -> Primitives {
    let read = |id: &str| {
        let text = std::fs::read_to_string(assets().join("primitives").join(format!("{id}.toml"))).unwrap();
        (id.to_owned(), Primitive::from_text(id, &text).unwrap())
    };
    ["tap", "press_hold"].map(read).into()
}

/// The plan of `station`, read back; each of its takes is planned as it stands, with the station's limits and without.
fn planned(station: &Station) -> (FirstPlan, Plan) {
    let first = first_plan(station, &shipped());
    let text = first.text.as_deref().unwrap_or_else(|| panic!("no plan: {:?}", first.warnings));
    let plan = Plan::from_text("every_patch.toml", text).unwrap();
    plan.check(station).unwrap();
    assert_eq!(plan.takes.len(), first.takes);
    for limits in [None, Some(MotionLimits::of(station))] {
        for take_idx in 0..plan.takes.len() {
            let motion = plan_take(station, &plan, &Primitives::new(), take_idx, limits.as_ref()).unwrap();
            assert!(motion.duration_s() <= plan.takes[take_idx].duration_s + 1e-6, "{take_idx}");
            assert!(plan.takes[take_idx].touch.len() <= 6);
        }
    }
    (first, plan)
}

#[test]
fn a_carried_hand_touches_every_patch_with_each_object() {
    let station = fixture("gripper-station");
    let (first, plan) = planned(&station);
    assert!(first.warnings.is_empty(), "{:?}", first.warnings);
    for object in station.objects.keys() {
        let of_object = Plan {
            takes: plan.takes.iter().filter(|take| take.object == *object).cloned().collect(),
            ..plan.clone()
        };
        for channel in coverage(&of_object, &station).unwrap() {
            let id = &station.layout.channels[channel.channel].id;
            assert!(!channel.patch_takes.is_empty(), "{id} is not touched with {object}");
        }
    }
    assert_eq!(first_plan(&station, &shipped()).text, first.text, "same station, same plan");
}

/// One slide and one joint: nothing brings a taxel to a chosen point, but the finger closes on what stands before it.
#[test]
fn a_hand_that_nothing_carries_closes_on_objects_and_the_rest_is_said() {
    let mut station = fixture("finger-station");
    // A mesh takes its time.
    station.objects.remove("wedge");
    let (first, plan) = planned(&station);
    let motion = plan_take(&station, &plan, &Primitives::new(), 0, None).unwrap();
    assert!(motion.spans.iter().any(|span| span.label.contains("by limb")), "{:?}", motion.spans);
    let touched: Vec<&str> = plan
        .takes
        .iter()
        .flat_map(|take| &take.touch)
        .map(|touch| touch.split('.').next().unwrap())
        .collect();
    for patch in &station.layout.patches {
        let named = format!("patch {:?}", patch.id);
        assert!(
            touched.contains(&patch.id.as_str()) || first.warnings.iter().any(|text| text.contains(&named)),
            "{} is neither touched nor said to be left out: {:?}",
            patch.id,
            first.warnings
        );
    }
}

#[test]
fn an_experiment_is_a_plan_of_its_own() {
    let station = station("xarm6_leap");
    let wanted = |primitive: &'static str, repetitions| Experiment {
        primitive,
        object: "sphere_50mm",
        repetitions,
        object_pose: None,
        touched: &[],
    };
    let plan = experiment_plan(&station, &shipped(), &wanted("slide", 3), "next").unwrap();
    let text = plan_text(&plan, &station, &["Why.".to_owned()]);
    let read = Plan::from_text("next.toml", &text).unwrap();
    assert!(text.starts_with("# Why.\n"), "{text}");
    assert_eq!(read.takes.len(), 2, "one to fit and one to judge");
    assert!(read.takes.iter().all(|take| take.primitive == "slide" && take.object == "sphere_50mm"));
    assert_eq!(read.primitives["slide"].repetitions, 3);
    assert_eq!(read.motion.away, plan.motion.away);
    plan_take(&station, &read, &Primitives::new(), 1, None).unwrap();
    let error = experiment_plan(&station, &shipped(), &wanted("wave", 1), "next").unwrap_err().to_string();
    assert!(error.contains("touched nothing in this session"), "{error}");
}
