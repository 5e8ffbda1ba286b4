//! What a real robot may do: segments that would be too fast for it are slowed.

use palpate_robot_model::Station;

use crate::PlanError;
use crate::path::Segment;

/// Fraction of a limit that planned motions use: what follows them has something left to catch up with.
const USED_FRACTION: f64 = 0.9;

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
            if let Some(limits) = joint.limits {
                (lower, upper) = (lower.max(limits.lower), upper.min(limits.upper));
            }
            // Bounds that are no numbers leave no room either.
            if lower.is_nan() || upper.is_nan() || lower >= upper {
                return Err(fail(format!("its limits {lower}..{upper} leave no room: widen them")));
            }
            if let Some(limits) = &mut joint.limits {
                (limits.lower, limits.upper) = (lower, upper);
            } else if lower.is_finite() || upper.is_finite() {
                joint.limits = Some(palpate_robot_model::JointLimits {
                    lower,
                    upper,
                    velocity: self.velocity[dof],
                    effort: f64::INFINITY,
                });
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
