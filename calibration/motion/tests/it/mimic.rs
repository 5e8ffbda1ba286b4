//! Joints that follow others move with them, in every motion that is planned.

use std::path::Path;

use palpate_motion::{MotionLimits, Plan, Primitives, plan_approach, plan_take};
use palpate_recording::load_station;
use palpate_robot_model::Station;
use proptest::prelude::*;

const DT_S: f64 = 0.01;
/// The follower in the station's order, the one that it follows, and how.
const FOLLOWER: usize = 3;
const LEADER: usize = 4;
const MULTIPLIER: f64 = 0.8;
const OFFSET_M: f64 = 0.004;

fn gripper() -> (Station, Plan) {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/gripper-station");
    (load_station(&dir.join("station.toml")).unwrap(), Plan::read(&dir.join("plan.toml")).unwrap())
}

/// Where the left finger may be so that both are within their limits.
fn common_range(limits: &MotionLimits) -> [f64; 2] {
    let of_follower =
        [limits.lower[FOLLOWER], limits.upper[FOLLOWER]].map(|end| (end - OFFSET_M) / MULTIPLIER);
    [f64::max(limits.lower[LEADER], of_follower[0]), f64::min(limits.upper[LEADER], of_follower[1])]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, ..ProptestConfig::default() })]

    #[test]
    fn a_joint_that_follows_is_where_it_follows_to(
        seed in 0..1000_u64,
        take_idx in 0..2_usize,
        rest in 0.0..1.0_f64,
        velocity in 0.05..0.2_f64,
        narrowed in 0.0..0.4_f64,
    ) {
        let (station, mut plan) = gripper();
        plan.seed = seed;
        let num_dofs = station.robot.num_dofs();
        let mut limits = MotionLimits::new(&station, vec![velocity; num_dofs], vec![2.0; num_dofs]);
        // The follower leaves its leader less room than its own limits do.
        limits.upper[FOLLOWER] -= 0.01 * narrowed;
        let [lower, upper] = common_range(&limits);
        plan.motion.rest.insert("left".to_owned(), lower + (0.2 + 0.6 * rest) * (upper - lower));
        let motion = plan_take(&station, &plan, &Primitives::new(), take_idx, Some(&limits));
        let motion = motion.map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert_eq!(motion.touches.len(), 4);
        let mut now = motion.start().to_vec();
        let mut last = now.clone();
        let mut most_moved = 0.0_f64;
        for step in 0..(motion.duration_s() / DT_S) as usize {
            motion.at(step as f64 * DT_S, &mut now);
            let expected = MULTIPLIER * now[LEADER] + OFFSET_M;
            prop_assert!((now[FOLLOWER] - expected).abs() < 1e-12, "{} at {expected}", now[FOLLOWER]);
            for dof in 0..num_dofs {
                let within = limits.lower[dof] - 1e-9..=limits.upper[dof] + 1e-9;
                prop_assert!(within.contains(&now[dof]), "joint {dof} at {}", now[dof]);
                let speed = (now[dof] - last[dof]).abs() / DT_S;
                prop_assert!(speed <= 0.905 * velocity, "joint {dof} at {speed} m/s");
            }
            most_moved = most_moved.max((now[LEADER] - motion.start()[LEADER]).abs());
            last.clone_from(&now);
        }
        prop_assert!(most_moved > 0.004, "a finger presses too: {most_moved} m");
    }
}

#[test]
fn the_limb_of_a_finger_that_follows_is_the_one_that_it_follows() {
    let (station, plan) = gripper();
    // Stages and fingers take turns.
    let pressed_by_limb = |finger: &str, take_idx: usize| {
        let motion = plan_take(&station, &plan, &Primitives::new(), take_idx, None).unwrap();
        let spans = motion.spans.iter().filter(|span| span.label.contains(&format!(" {finger}.")));
        let mut by_limb = spans.filter(|span| span.label.contains("by limb")).peekable();
        assert!(by_limb.peek().is_some(), "no press of the {finger} finger by itself: {:?}", motion.spans);
        let mut positions = motion.start().to_vec();
        for span in by_limb {
            let mut range = |dof: usize| {
                let times_s =
                    (0..50).map(|step| span.start_s + f64::from(step) / 49.0 * (span.end_s - span.start_s));
                let at = times_s.map(|time_s| {
                    motion.at(time_s, &mut positions);
                    positions[dof]
                });
                let at: Vec<f64> = at.collect();
                at.iter().copied().fold(f64::NEG_INFINITY, f64::max)
                    - at.iter().copied().fold(f64::INFINITY, f64::min)
            };
            assert!(range(LEADER) > 0.005 && range(FOLLOWER) > 0.004, "{}", span.label);
            assert!((0..3).all(|stage| range(stage) < 1e-12), "the stages stand still: {}", span.label);
        }
    };
    pressed_by_limb("left", 1);
    pressed_by_limb("right", 0);
}

#[test]
fn a_plan_that_says_otherwise_is_refused() {
    let (station, plan) = gripper();
    let error = |change: &dyn Fn(&mut Plan)| {
        let mut plan = plan.clone();
        change(&mut plan);
        plan_take(&station, &plan, &Primitives::new(), 0, None).unwrap_err().to_string()
    };
    let rest = |name: &'static str, at_m: f64| {
        move |plan: &mut Plan| {
            plan.motion.rest.insert(name.to_owned(), at_m);
        }
    };
    let elsewhere = error(&rest("right", 0.02));
    assert!(
        elsewhere.contains("motion.rest: joint \"right\" follows \"left\" to 0.016, expected no other position than that, not 0.02"),
        "{elsewhere}"
    );
    let outside = error(&rest("left", 0.035));
    assert!(
        outside.contains("joint \"right\" follows \"left\" to 0.032")
            && outside.contains("outside its limits"),
        "{outside}"
    );
    let missing = error(&|plan| {
        plan.motion.rest.remove("left");
    });
    assert!(missing.contains("joint \"left\" is missing"), "{missing}");
    // Said rightly it is taken.
    let mut said = plan.clone();
    said.motion.rest.insert("right".to_owned(), 0.016);
    assert!(plan_take(&station, &said, &Primitives::new(), 0, None).is_ok());
}

#[test]
fn the_way_to_the_start_begins_where_the_robot_is() {
    let (station, plan) = gripper();
    // A little play in the gear.
    let from = [0.05, 0.05, 0.3, 0.0129, 0.011];
    let way = plan_approach(&station, &plan, &Primitives::new(), 0, &from, None).unwrap();
    assert_eq!(way.start(), from);
    let mut end = from.to_vec();
    way.at(way.duration_s(), &mut end);
    assert_eq!(end, plan.rest(&station));
    assert!((end[FOLLOWER] - (MULTIPLIER * end[LEADER] + OFFSET_M)).abs() < 1e-12);
}
