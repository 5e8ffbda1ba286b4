//! Joint motion of the arm: tracks from rest to rest, targets that are followed, velocities.

use nalgebra::Isometry3;

use super::kinematics::ArmModel;

/// The vendor's limits of every joint.
pub(crate) const MOST_RAD_PER_SEC: f64 = std::f64::consts::PI;
pub(crate) const MOST_RAD_PER_SEC2: f64 = 20.0;
/// Waypoints of a straight line are at most this far apart.
const LINE_STEP_M: f64 = 0.004;
const LINE_STEP_RAD: f64 = 0.02;

/// What was queued, to be planned when its turn comes.
#[derive(Clone, Debug)]
pub(crate) enum Move {
    /// All joints together; speed and acceleration are those of the one with the longest way, rad/s and rad/s2.
    Joints { target_rad: Vec<f64>, speed: f64, acc: f64 },
    /// The flange on a straight line, m/s and m/s2.
    Line { base_from_flange: Isometry3<f64>, speed: f64, acc: f64 },
    /// Standing still, s.
    Sleep(f64),
}

/// A way along waypoints that are evenly spaced, with bounded speed and acceleration.
#[derive(Clone, Debug)]
pub(crate) struct Track {
    waypoints: Vec<Vec<f64>>,
    /// In the unit of its speed.
    length: f64,
    speed: f64,
    acc: f64,
    done: f64,
    rate: f64,
}

impl Track {
    /// The way of `planned` from `from_rad`; `None` if no joints bring the flange along it. No joint gets faster than
    /// `most_rad_per_sec`.
    pub(crate) fn plan(
        planned: &Move,
        model: &ArmModel,
        from_rad: &[f64],
        most_rad_per_sec: f64,
    ) -> Option<Self> {
        let (waypoints, length, speed, acc) = match planned {
            Move::Sleep(seconds) => return Some(Self::still(from_rad, *seconds)),
            Move::Joints { target_rad, speed, acc } => {
                let ways = target_rad.iter().zip(from_rad).map(|(to, from)| (to - from).abs());
                (vec![from_rad.to_vec(), target_rad.clone()], ways.fold(0.0, f64::max), *speed, *acc)
            }
            Move::Line { base_from_flange, speed, acc } => {
                let start = model.base_from_flange(from_rad);
                let way_m = (base_from_flange.translation.vector - start.translation.vector).norm();
                let turn_rad = start.rotation.angle_to(&base_from_flange.rotation);
                let steps =
                    (way_m / LINE_STEP_M).max(turn_rad / LINE_STEP_RAD).ceil().clamp(1.0, 2000.0) as usize;
                let mut waypoints = vec![from_rad.to_vec()];
                for step in 1..=steps {
                    let part = step as f64 / steps as f64;
                    let translation =
                        start.translation.vector.lerp(&base_from_flange.translation.vector, part);
                    // Half a turn has no shortest way; the end is as good as any.
                    let rotation = start
                        .rotation
                        .try_slerp(&base_from_flange.rotation, part, 1e-9)
                        .unwrap_or(base_from_flange.rotation);
                    let pose = Isometry3::from_parts(translation.into(), rotation);
                    let joints_rad = model.joints_rad(&pose, waypoints.last()?)?;
                    waypoints.push(joints_rad);
                }
                // A pure turn is as long as the turn is, at a tenth of a metre.
                (waypoints, way_m.max(0.1 * turn_rad), *speed, *acc)
            }
        };
        if length < 1e-9 {
            return Some(Self::still(from_rad, 0.0));
        }
        let spacing = length / (waypoints.len() - 1) as f64;
        let steepest = waypoints
            .windows(2)
            .flat_map(|pair| pair[0].iter().zip(&pair[1]).map(|(a, b)| (b - a).abs() / spacing))
            .fold(1e-9, f64::max);
        let bounded = |value: f64, most: f64| if value > 0.0 { value.min(most) } else { most };
        Some(Self {
            waypoints,
            length,
            speed: bounded(speed, most_rad_per_sec / steepest),
            acc: bounded(acc, MOST_RAD_PER_SEC2 / steepest),
            done: 0.0,
            rate: 0.0,
        })
    }

    fn still(at_rad: &[f64], seconds: f64) -> Self {
        let length = if seconds.is_finite() { seconds.clamp(0.0, 3600.0) } else { 0.0 };
        let waypoints = vec![at_rad.to_vec(), at_rad.to_vec()];
        Self { waypoints, length, speed: 1.0, acc: f64::INFINITY, done: 0.0, rate: 0.0 }
    }

    /// Goes on for `dt_s`, or slows down if `paused`, and gives where the joints are.
    pub(crate) fn step(&mut self, dt_s: f64, paused: bool) -> Vec<f64> {
        let left = self.length - self.done;
        let wanted = if paused { 0.0 } else { self.speed.min((2.0 * self.acc * left).sqrt()) };
        let most_change = self.acc * dt_s;
        self.rate += (wanted - self.rate).clamp(-most_change, most_change);
        self.done += self.rate * dt_s;
        if !paused && self.length - self.done < (self.acc * dt_s * dt_s).min(self.speed * dt_s) {
            self.done = self.length;
        }
        let last = self.waypoints.len() - 1;
        let at = if self.length > 0.0 { self.done / self.length * last as f64 } else { last as f64 };
        let from = (at as usize).min(last - 1);
        let part = (at - from as f64).clamp(0.0, 1.0);
        let pair = self.waypoints[from].iter().zip(&self.waypoints[from + 1]);
        pair.map(|(a, b)| a + (b - a) * part).collect()
    }

    pub(crate) fn is_done(&self) -> bool {
        self.done >= self.length
    }
}

/// One joint's step towards `target_rad`, as fast as its limits allow; position and velocity afterwards.
pub(crate) fn chase(
    (angle_rad, rad_per_sec): (f64, f64),
    target_rad: f64,
    most_rad_per_sec: f64,
    dt_s: f64,
) -> (f64, f64) {
    let distance = target_rad - angle_rad;
    let braking = (2.0 * MOST_RAD_PER_SEC2 * distance.abs()).sqrt();
    let wanted = most_rad_per_sec.min(braking).min(distance.abs() / dt_s).copysign(distance);
    ramp((angle_rad, rad_per_sec), wanted, dt_s)
}

/// One joint's step towards a velocity.
pub(crate) fn ramp((angle_rad, rad_per_sec): (f64, f64), wanted_rad_per_sec: f64, dt_s: f64) -> (f64, f64) {
    let most_change = MOST_RAD_PER_SEC2 * dt_s;
    let velocity = rad_per_sec + (wanted_rad_per_sec - rad_per_sec).clamp(-most_change, most_change);
    (angle_rad + velocity * dt_s, velocity)
}
