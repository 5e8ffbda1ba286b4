//! What a real robot may do: segments that would be too fast for it are slowed.

use palpate_robot_model::{JointLimits, JointSafety, Station, WorkspaceBox};

use nalgebra::Point3;

use crate::path::Segment;
use crate::{PlanError, TakeMotion};

/// Fraction of a limit that planned motions use: what follows them has something left to catch up with.
const USED_FRACTION: f64 = 0.9;
/// How often along a motion skin and links are looked for outside the workspace, s: they move by millimetres in between.
const WORKSPACE_PERIOD_S: f64 = 0.02;

/// Limits of every degree of freedom, in the station's order.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionLimits {
    /// Lowest position, rad or m.
    pub lower: Vec<f64>,
    /// Highest position, rad or m.
    pub upper: Vec<f64>,
    /// Largest speed, rad/s or m/s.
    pub velocity: Vec<f64>,
    /// Largest acceleration, rad/s² or m/s².
    pub acceleration: Vec<f64>,
}

impl MotionLimits {
    /// Those of the station's safety section.
    pub fn of(station: &Station) -> Self {
        let joints = &station.safety.joints;
        let each = |limit: fn(&JointSafety) -> f64| joints.iter().map(limit).collect();
        Self {
            lower: each(|joint| joint.lower),
            upper: each(|joint| joint.upper),
            velocity: each(|joint| joint.velocity),
            acceleration: each(|joint| joint.acceleration),
        }
    }

    /// These speeds and accelerations, and the positions that the station's robot allows.
    pub fn new(station: &Station, velocity: Vec<f64>, acceleration: Vec<f64>) -> Self {
        let range = |joint: &palpate_robot_model::Joint| {
            joint.limits.map_or((f64::NEG_INFINITY, f64::INFINITY), |limits| (limits.lower, limits.upper))
        };
        let (lower, upper) = station.robot.dofs().map(range).unzip();
        Self { lower, upper, velocity, acceleration }
    }

    /// The station with its robot's limits narrowed to these; or which joint is left without room.
    pub(crate) fn narrow(&self, station: &Station, file: &str) -> Result<Station, PlanError> {
        let num_dofs = station.robot.num_dofs();
        let counts = [&self.lower, &self.upper, &self.velocity, &self.acceleration].map(Vec::len);
        if let Some(count) = counts.iter().find(|&&count| count != num_dofs) {
            let problem = format!("are for {count} joints, the station has {num_dofs}");
            return Err(PlanError::new(file, "motion limits", problem));
        }
        let mut station = station.clone();
        for joint in &mut station.robot.joints {
            let Some(dof) = joint.dof else { continue };
            let fail = |problem: String| PlanError::new(file, format!("joint {:?}", joint.name), problem);
            for (what, value) in [("velocity", self.velocity[dof]), ("acceleration", self.acceleration[dof])]
            {
                if !(value.is_finite() && value > 0.0) {
                    return Err(fail(format!("its {what} limit {value} must be a positive number")));
                }
            }
            let (mut lower, mut upper) = (self.lower[dof], self.upper[dof]);
            if lower.is_nan() || upper.is_nan() {
                return Err(fail(format!("its limits {lower}..{upper} must be numbers")));
            }
            if let Some(limits) = joint.limits {
                (lower, upper) = (lower.max(limits.lower), upper.min(limits.upper));
            }
            if lower >= upper {
                return Err(fail(format!("its limits {lower}..{upper} leave no room: widen them")));
            }
            if let Some(limits) = &mut joint.limits {
                (limits.lower, limits.upper) = (lower, upper);
            } else if lower.is_finite() || upper.is_finite() {
                joint.limits =
                    Some(JointLimits { lower, upper, velocity: self.velocity[dof], effort: f64::INFINITY });
            }
        }
        Ok(station)
    }

    /// The segment, or the same way in more time where a joint would be too fast or gain speed too fast.
    pub(crate) fn slowed(&self, mut segment: Segment) -> Segment {
        let needed_s = segment.peaks().into_iter().enumerate().map(|(dof, peak)| {
            let by_speed_s = peak.velocity / (USED_FRACTION * self.velocity[dof]);
            let by_gain_s = (peak.acceleration / (USED_FRACTION * self.acceleration[dof])).sqrt();
            by_speed_s.max(by_gain_s)
        });
        segment.duration_s = needed_s.fold(segment.duration_s, f64::max);
        segment
    }
}

/// Why `motion` leaves the station's workspace, if it does: which patch or link, where and when.
pub(crate) fn outside(station: &Station, motion: &TakeMotion) -> Option<String> {
    let WorkspaceBox { min_m, max_m } = station.safety.workspace?;
    let mut positions = motion.start().to_vec();
    let mut frames = Vec::new();
    let steps = (motion.duration_s() / WORKSPACE_PERIOD_S).ceil() as usize;
    let is_out = |pos: &Point3<f64>| (0..3).any(|axis| !(min_m[axis]..=max_m[axis]).contains(&pos[axis]));
    // What never moves, as the foot of an arm, has its place.
    let mut standing = Vec::new();
    station.robot.forward_kinematics(motion.start(), &mut standing);
    (0..=steps).find_map(|step| {
        let time_s = step as f64 * WORKSPACE_PERIOD_S;
        motion.at(time_s, &mut positions);
        station.robot.forward_kinematics(&positions, &mut frames);
        let patches = station.layout.patches.iter().find_map(|patch| {
            let mut nodes = patch.nodes.iter().map(|node| frames[patch.link] * node.pos_in_link);
            Some((patch.id.as_str(), nodes.find(is_out)?))
        });
        let links = || {
            let moved = station.robot.links.iter().enumerate().filter(|(link, _)| frames[*link] != standing[*link]);
            moved.into_iter().find_map(|(link, shapes)| {
                let mut corners = shapes.collisions.iter().flat_map(|shape| shape.bounds(&frames[link]));
                Some((shapes.name.as_str(), corners.find(is_out)?))
            })
        };
        patches.or_else(links).map(|(what, pos)| {
            format!(
                "{what:?} would be at [{:.3}, {:.3}, {:.3}] m after {time_s:.1} s, outside safety.workspace of the \
                 station: move the object, or widen the workspace",
                pos.x, pos.y, pos.z
            )
        })
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::path::JointPath;

    proptest! {
        /// Whatever the way, a slowed segment keeps below the limits, and one that was slow enough is left alone.
        #[test]
        fn slowed_segments_keep_their_limits(
            waypoints in prop::collection::vec(prop::collection::vec(-2.0..2.0_f64, 3), 1..7),
            duration_s in 0.05..2.0_f64,
            velocity in prop::collection::vec(0.05..5.0_f64, 3),
            acceleration in prop::collection::vec(0.1..60.0_f64, 3),
        ) {
            let open = vec![f64::INFINITY; 3];
            let lower = open.iter().map(|bound| -bound).collect();
            let limits = MotionLimits { lower, upper: open, velocity, acceleration };
            let segment = limits.slowed(Segment { duration_s, waypoints });
            prop_assert!(segment.duration_s >= duration_s);
            prop_assert_eq!(&limits.slowed(segment.clone()), &segment);
            let mut path = JointPath::default();
            path.push(segment);
            // Differences over a short time are means of what lies between: none can be above the largest.
            let steps = 2000;
            let dt_s = path.duration_s() / f64::from(steps);
            let mut last = [vec![0.0; 3], vec![0.0; 3]];
            let mut now = vec![0.0; 3];
            let mut fastest = 0.0_f64;
            for step in -2..steps + 3 {
                path.at(f64::from(step) * dt_s, &mut now);
                for dof in 0..3 {
                    let [before, last] = [last[0][dof], last[1][dof]];
                    let used_velocity = (now[dof] - last).abs() / dt_s / limits.velocity[dof];
                    let used_gain =
                        (now[dof] - 2.0 * last + before).abs() / dt_s.powi(2) / limits.acceleration[dof];
                    if step > 0 {
                        prop_assert!(used_velocity < 0.902, "velocity {used_velocity} of its limit");
                        prop_assert!(used_gain < 0.902, "acceleration {used_gain} of its limit");
                        fastest = fastest.max(used_velocity).max(used_gain);
                    }
                }
                last.rotate_left(1);
                last[1].clone_from(&now);
            }
            // Not slower than needed either.
            prop_assert!(path.duration_s() <= duration_s || fastest > 0.85, "uses only {fastest} of its limits");
        }
    }
}
