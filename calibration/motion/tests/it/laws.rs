//! Laws of every planned motion.

use std::collections::BTreeMap;

use palpate_motion::{MotionLimits, Plan, Primitives, TakeMotion, plan_approach, plan_take};
use palpate_recording::SpanKind;
use palpate_robot_model::{Station, WorkspaceBox};
use proptest::prelude::*;

use crate::{limits, plan, station};

/// What a control loop that runs at 100 Hz sees.
const DT_S: f64 = 0.01;

/// Checks a motion against everything that holds for all of them.
fn check(
    station: &Station,
    plan: &Plan,
    take_idx: usize,
    motion: &TakeMotion,
    limits: Option<&MotionLimits>,
) {
    let at = format!("{} take {}", plan.id, take_idx + 1);
    let take = &plan.takes[take_idx];
    let robot = &station.robot;
    let duration_s = motion.duration_s();
    assert!(duration_s >= take.duration_s - 1e-9, "{at}: {duration_s} s");
    if limits.is_none() {
        assert!((duration_s - take.duration_s).abs() < 1e-6, "{at}: {duration_s} s");
    }
    check_spans(&at, robot.num_dofs(), plan, motion);

    let rest = plan.rest(station);
    assert_eq!(motion.start(), rest, "{at}: starts elsewhere");
    let scene = plan.scene(station, &take.object).unwrap();
    let (mut before, mut last, mut now) = (rest.clone(), rest.clone(), rest.clone());
    let mut frames = Vec::new();
    // Some more steps at either end: a motion that did not start and end at rest would show as a jump.
    let steps = (duration_s / DT_S).ceil() as i64 + 3;
    for step in -3..steps {
        let time_s = step as f64 * DT_S;
        motion.at(time_s, &mut now);
        for (dof, joint) in robot.dofs().enumerate() {
            let urdf = joint.limits.expect("every joint has limits");
            let name = &joint.name;
            let velocity = (now[dof] - last[dof]) / DT_S;
            let acceleration = (now[dof] - 2.0 * last[dof] + before[dof]) / (DT_S * DT_S);
            assert!((urdf.lower..=urdf.upper).contains(&now[dof]), "{at} at {time_s} s: {name} {}", now[dof]);
            assert!(velocity.abs() <= urdf.velocity, "{at} at {time_s} s: {name} moves at {velocity}");
            if let Some(limits) = limits {
                let (lower, upper) = (limits.lower[dof], limits.upper[dof]);
                assert!((lower..=upper).contains(&now[dof]), "{at} at {time_s} s: {name} at {}", now[dof]);
                let most = 0.905 * limits.velocity[dof];
                assert!(velocity.abs() <= most, "{at} at {time_s} s: {name} moves at {velocity}");
                let most = 0.905 * limits.acceleration[dof];
                assert!(acceleration.abs() <= most, "{at} at {time_s} s: {name} gains {acceleration}");
            }
        }
        if step % 4 == 0 {
            robot.forward_kinematics(&now, &mut frames);
            let touching = motion.spans.iter().any(|span| {
                span.kind == SpanKind::Repetition && (span.start_s..=span.end_s).contains(&time_s)
            });
            // A touching link enters by the depth of the press, and by as much as its collision shape is coarser than
            // its patch.
            let least_m = if touching { -0.0095 } else { 0.0 };
            let nearest_m = scene.clearance_m(&frames);
            assert!(nearest_m > least_m, "{at} at {time_s} s: {nearest_m} m");
        }
        before.clone_from(&last);
        last.clone_from(&now);
    }
    assert_eq!(now, rest, "{at}: ends elsewhere");
}

/// Spans lie one after another within the take; the baseline is still; repetitions come back to where they began and
/// take as long as those that they repeat.
fn check_spans(at: &str, num_dofs: usize, plan: &Plan, motion: &TakeMotion) {
    let position = |time_s: f64| {
        let mut positions = vec![0.0; num_dofs];
        motion.at(time_s, &mut positions);
        positions
    };
    let mut end_s = 0.0;
    let mut lengths_s: BTreeMap<&str, f64> = BTreeMap::new();
    for (span_idx, span) in motion.spans.iter().enumerate() {
        assert!(span.start_s >= end_s - 1e-9 && span.end_s > span.start_s, "{at}: span {span_idx}");
        end_s = span.end_s;
        let baseline = span.kind == SpanKind::Baseline;
        assert_eq!(baseline, span_idx == 0, "{at}: the baseline comes first, and once");
        let [from, to] = [span.start_s, span.end_s].map(position);
        let apart = from.iter().zip(&to).map(|(from, to)| (from - to).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-9, "{at}: {:?} ends {apart} from where it began", span.label);
        let middle = position(0.5 * (span.start_s + span.end_s));
        assert_eq!(middle == from, baseline, "{at}: {:?} moves, the baseline does not", span.label);
        if !baseline {
            let length_s = lengths_s.entry(&span.label).or_insert(span.end_s - span.start_s);
            assert!((*length_s - (span.end_s - span.start_s)).abs() < 1e-9, "{at}: {:?}", span.label);
        }
    }
    assert!(end_s <= motion.duration_s() + 1e-9, "{at}: spans end after the take");
    let times: Vec<f64> = motion.activities.iter().map(|(from_s, _)| *from_s).collect();
    assert!(times[0] == 0.0 && times.is_sorted() && times[times.len() - 1] <= motion.duration_s(), "{at}");
    assert!(motion.spans[0].end_s < plan.motion.baseline_s, "{at}: the baseline ends before anything moves");
}

fn planned(station: &Station, plan: &Plan, take_idx: usize, limits: Option<&MotionLimits>) -> TakeMotion {
    let motion = plan_take(station, plan, &Primitives::new(), take_idx, limits);
    motion.unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn takes_without_limits_last_as_long_as_the_plan_says_and_touch_nothing_else() {
    for (station_name, plan_name, takes) in
        [("xarm6_leap", "nine_takes", [0, 1, 3]), ("probe_bench", "probe_bench", [0, 1, 3])]
    {
        let (station, plan) = (station(station_name), plan(plan_name));
        for take_idx in takes {
            let motion = planned(&station, &plan, take_idx, None);
            check(&station, &plan, take_idx, &motion, None);
        }
    }
}

/// As in a station's safety section: what the shipped sessions are recorded with on a real hand and arm.
#[test]
fn takes_keep_the_limits_of_a_real_hand_and_arm() {
    for (station_name, plan_name) in
        [("xarm6_leap", "nine_takes"), ("xarm6_leap", "quick_check"), ("probe_bench", "probe_bench")]
    {
        let (station, plan) = (station(station_name), plan(plan_name));
        let limits = MotionLimits::of(&station);
        let mut lasts_s = 0.0;
        for take_idx in 0..plan.takes.len() {
            let motion = planned(&station, &plan, take_idx, Some(&limits));
            check(&station, &plan, take_idx, &motion, Some(&limits));
            lasts_s += motion.duration_s();
        }
        // A plan whose times nearly hold on a real station says truly how long a session takes.
        let planned_s: f64 = plan.takes.iter().map(|take| take.duration_s).sum();
        assert!(lasts_s < 1.25 * planned_s, "{plan_name}: {lasts_s} s instead of {planned_s} s");
    }
}

#[test]
fn the_same_plan_gives_the_same_motion_to_the_bit() {
    let (station, plan) = (station("xarm6_leap"), plan("quick_check"));
    let limits = limits(&station, [0.6, 5.0], [3.0, 40.0]);
    let [one, other] = [(); 2].map(|()| planned(&station, &plan, 1, Some(&limits)));
    assert_eq!(one.spans, other.spans);
    assert_eq!(one.touches, other.touches);
    let (mut here, mut there) = (one.start().to_vec(), one.start().to_vec());
    for step in 0..(one.duration_s() / DT_S) as usize {
        one.at(step as f64 * DT_S, &mut here);
        other.at(step as f64 * DT_S, &mut there);
        assert_eq!(here, there);
    }
}

#[test]
fn narrower_positions_are_kept_or_the_joint_is_named() {
    let (station, plan) = (station("xarm6_leap"), plan("quick_check"));
    let mut limits = limits(&station, [0.6, 5.0], [3.0, 40.0]);
    let wide = planned(&station, &plan, 0, Some(&limits));
    let dof = station.robot.dofs().position(|joint| joint.name == "joint6").unwrap();
    let reach = |motion: &TakeMotion| {
        let mut now = motion.start().to_vec();
        let steps = (motion.duration_s() / DT_S) as usize;
        (0..steps).fold(0.0_f64, |most, step| {
            motion.at(step as f64 * DT_S, &mut now);
            most.max(now[dof].abs())
        })
    };
    let bound = 0.6 * reach(&wide);
    assert!(bound > 0.05, "the joint is used: {bound}");
    (limits.lower[dof], limits.upper[dof]) = (-bound, bound);
    let narrow = planned(&station, &plan, 0, Some(&limits));
    check(&station, &plan, 0, &narrow, Some(&limits));

    (limits.lower[dof], limits.upper[dof]) = (0.1, 0.2);
    let error = plan_take(&station, &plan, &Primitives::new(), 0, Some(&limits)).unwrap_err().to_string();
    assert!(
        error.contains("motion.rest") && error.contains("joint6") && error.contains("0.1..0.2"),
        "{error}"
    );
    (limits.lower[dof], limits.upper[dof]) = (f64::NAN, 0.2);
    let error = plan_take(&station, &plan, &Primitives::new(), 0, Some(&limits)).unwrap_err().to_string();
    assert!(error.contains("joint6") && error.contains("must be numbers"), "{error}");
    limits.acceleration[dof] = 0.0;
    let error = plan_take(&station, &plan, &Primitives::new(), 0, Some(&limits)).unwrap_err().to_string();
    assert!(error.contains("joint6") && error.contains("acceleration limit 0 must be"), "{error}");
    limits.velocity.pop();
    let error = plan_take(&station, &plan, &Primitives::new(), 0, Some(&limits)).unwrap_err().to_string();
    assert!(error.contains("motion limits") && error.contains("the station has"), "{error}");
}

#[test]
fn a_motion_that_leaves_the_workspace_says_what_does_and_when() {
    let (mut station, plan) = (station("xarm6_leap"), plan("quick_check"));
    let limits = MotionLimits::of(&station);
    station.safety.workspace = Some(WorkspaceBox { min_m: [-1.0, -1.0, 0.0], max_m: [1.0, 1.0, 1.5] });
    let motion = planned(&station, &plan, 0, Some(&limits));
    check(&station, &plan, 0, &motion, Some(&limits));
    // The hand rests above this and comes down to touch the sphere's top at 0.24 m.
    station.safety.workspace = Some(WorkspaceBox { min_m: [-1.0, -1.0, 0.27], max_m: [1.0, 1.0, 1.5] });
    let error = plan_take(&station, &plan, &Primitives::new(), 0, Some(&limits)).unwrap_err().to_string();
    assert!(error.contains("take 1") && error.contains("outside safety.workspace"), "{error}");
    // The skin stays below the arm's shoulder and elbow, which do not fit.
    station.safety.workspace = Some(WorkspaceBox { min_m: [-1.0, -1.0, 0.0], max_m: [1.0, 1.0, 0.5] });
    let error = plan_take(&station, &plan, &Primitives::new(), 0, Some(&limits)).unwrap_err().to_string();
    let names_a_link = station.robot.links.iter().any(|link| error.contains(&format!("{:?}", link.name)));
    assert!(names_a_link && error.contains("outside safety.workspace"), "{error}");
}

/// From wherever a take was left, the way back to its start is clear of the object, or it is said that somebody has to
/// move the robot.
#[test]
fn ways_to_the_start_are_clear_of_the_object() {
    let (station, plan) = (station("xarm6_leap"), plan("quick_check"));
    let limits = MotionLimits::of(&station);
    let scene = plan.scene(&station, &plan.takes[0].object).unwrap();
    let motion = planned(&station, &plan, 0, Some(&limits));
    let mut from = motion.start().to_vec();
    let (mut found, mut refused) = (0, 0);
    // As it was left, and pushed into the object by somebody.
    let moments = (0..motion.duration_s() as usize * 2).map(|half| 0.5 * half as f64);
    for (left_s, pushed_rad) in moments.flat_map(|left_s| [(left_s, 0.0), (left_s, 0.3)]) {
        motion.at(left_s, &mut from);
        from[1] += pushed_rad;
        let way = match plan_approach(&station, &plan, &Primitives::new(), 0, &from, Some(&limits)) {
            Ok(way) => way,
            Err(error) => {
                let mut frames = Vec::new();
                station.robot.forward_kinematics(&from, &mut frames);
                assert!(scene.clearance_m(&frames) < 0.0 && pushed_rad > 0.0, "refused at {left_s} s");
                assert!(error.to_string().contains("take 1: found no way to the start"), "{error}");
                refused += 1;
                continue;
            }
        };
        found += 1;
        assert_eq!(way.start(), from);
        let (mut before, mut last, mut now) = (from.clone(), from.clone(), from.clone());
        let mut frames = Vec::new();
        let mut cleared_m = f64::NEG_INFINITY;
        for step in -3..(way.duration_s() / DT_S).ceil() as i64 + 3 {
            way.at(step as f64 * DT_S, &mut now);
            for dof in 0..now.len() {
                let velocity = (now[dof] - last[dof]) / DT_S;
                let acceleration = (now[dof] - 2.0 * last[dof] + before[dof]) / (DT_S * DT_S);
                assert!(velocity.abs() <= 0.905 * limits.velocity[dof], "left at {left_s} s: {velocity}");
                assert!(acceleration.abs() <= 0.905 * limits.acceleration[dof], "{left_s} s: {acceleration}");
            }
            station.robot.forward_kinematics(&now, &mut frames);
            let clearance_m = scene.clearance_m(&frames);
            assert!(clearance_m > cleared_m.min(0.0) - 1e-5, "left at {left_s} s: through the object");
            // What touched when the take was left gets away, and comes no closer again.
            cleared_m = cleared_m.max(clearance_m);
            before.clone_from(&last);
            last.clone_from(&now);
        }
        assert_eq!(now, motion.start());
    }
    assert!(found > 20 && refused > 0, "{found} found, {refused} refused");

    from[0] = f64::NAN;
    let error = plan_approach(&station, &plan, &Primitives::new(), 0, &from, None).unwrap_err().to_string();
    assert!(error.contains("joint \"joint1\" is at NaN"), "{error}");
    let error = plan_approach(&station, &plan, &Primitives::new(), 0, &from[1..], None).unwrap_err();
    assert!(error.to_string().contains("positions to start from, expected"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

    #[test]
    fn any_limits_are_kept(
        take_idx in 0..3_usize,
        carriers in prop::array::uniform2(0.0..1.0_f64),
        limbs in prop::array::uniform2(0.0..1.0_f64),
    ) {
        let (station, plan) = (station("xarm6_leap"), plan("quick_check"));
        // From a crawl to faster than the plan asks for, evenly on a logarithmic scale.
        let spread = |lower: f64, upper: f64, fraction: f64| lower * (upper / lower).powf(fraction);
        let carriers = [spread(0.1, 3.0, carriers[0]), spread(0.2, 20.0, carriers[1])];
        let limbs = [spread(0.2, 6.0, limbs[0]), spread(0.5, 80.0, limbs[1])];
        let limits = limits(&station, carriers, limbs);
        let motion = planned(&station, &plan, take_idx, Some(&limits));
        check(&station, &plan, take_idx, &motion, Some(&limits));
    }
}
