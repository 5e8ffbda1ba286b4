//! What is wrong with the poses of a moving object.

use palpate_reports::{Severity, wording::counted};

use crate::{Take, plausible};

/// A gap is longer than this many usual distances of two poses.
const GAP_PERIODS: f64 = 3.0;
/// Less than this is no motion that a gap could hide, m: a tracker's noise.
const LEAST_MOTION_M: f64 = 0.001;
/// The same of a turn, rad.
const LEAST_TURN_RAD: f64 = 0.02;
/// No object that is touched is faster, m/s: a fall from a metre's height ends with half of it.
const MAX_SPEED_M_S: f64 = 10.0;

/// Problems of `take`'s poses; none of an object that stands still.
pub(crate) fn problems(take: &Take) -> Vec<(Severity, String)> {
    let log = &take.object_poses;
    let (times_s, poses) = (&log.times_s, &log.poses);
    let (Some(first), Some(&first_s), Some(&last_s)) = (poses.first(), times_s.first(), times_s.last())
    else {
        return Vec::new();
    };
    let mut problems = Vec::new();
    let mut warn = |problem: String| problems.push((Severity::Warning, problem));

    let begins = &take.meta.base_from_object;
    let apart_m = (begins.translation.vector - first.translation.vector).norm();
    let turned_rad = begins.rotation.angle_to(&first.rotation);
    if apart_m > LEAST_MOTION_M || turned_rad > LEAST_TURN_RAD {
        warn(format!(
            "the first pose is {:.1} mm and {turned_rad:.2} rad from the pose that the take gives for its start; programs that \
             do not read poses over time take the object to stand there",
            1e3 * apart_m
        ));
    }

    let steps_s: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut sorted_s = steps_s.clone();
    sorted_s.sort_by(f64::total_cmp);
    let usual_s = sorted_s.get(sorted_s.len() / 2).copied().unwrap_or(0.0);
    let moved = |idx: usize| {
        let (from, to) = (&poses[idx], &poses[idx + 1]);
        let moved_m = (to.translation.vector - from.translation.vector).norm();
        (moved_m, from.rotation.angle_to(&to.rotation))
    };
    let hides_motion = |idx: usize| {
        let (moved_m, turned_rad) = moved(idx);
        moved_m > LEAST_MOTION_M || turned_rad > LEAST_TURN_RAD
    };
    let gaps: Vec<f64> = steps_s
        .iter()
        .enumerate()
        .filter(|&(idx, &step_s)| step_s > GAP_PERIODS * usual_s && hides_motion(idx))
        .map(|(_, &step_s)| step_s)
        .collect();
    if !gaps.is_empty() {
        warn(format!(
            "{} in which the object moved, the longest {:.3} s; it is taken to move evenly from one pose to the next, so \
             look whether the tracker lost it",
            counted(gaps.len() as u64, "gap"),
            gaps.iter().copied().fold(0.0, f64::max)
        ));
    }
    // That times increase is looked at elsewhere.
    let forward = steps_s.iter().enumerate().filter(|(_, step_s)| **step_s > 0.0);
    let fastest_m_s = forward.map(|(idx, step_s)| moved(idx).0 / step_s).fold(0.0, f64::max);
    if fastest_m_s > MAX_SPEED_M_S {
        warn(format!(
            "the object jumps: from one pose to the next it moves at {fastest_m_s:.0} m/s, more than {MAX_SPEED_M_S:.0} m/s; \
             look whether the tracker took another thing for it"
        ));
    }

    // One pose says that it stands still.
    if let (Some(&start_s), Some(&end_s)) = (take.joints.times_s.first(), take.joints.times_s.last())
        && poses.len() > 1
    {
        let uncovered_s = f64::max(first_s - start_s, end_s - last_s);
        if uncovered_s > f64::max(GAP_PERIODS * usual_s, 0.1) {
            warn(format!(
                "poses are there from {first_s:.3} s to {last_s:.3} s, joints from {start_s:.3} s to {end_s:.3} s; before the \
                 first pose and after the last the object is taken to stand still"
            ));
        }
    }

    let robot = &take.station.robot;
    let far = poses.iter().enumerate().find_map(|(idx, pose)| {
        let problem = plausible::out_of_reach(robot, pose)?;
        Some(format!("message {} at {:.3} s: {problem}", idx + 1, times_s[idx]))
    });
    problems.extend(far.map(|problem| (Severity::Error, problem)));
    problems
}
