//! The motion of one touch: in, along, out, for a primitive at a posture.

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use palpate_robot_model::ik::{self, Goal};

use crate::contact::{Contact, limb_dofs};
use crate::path::{PEAK_OVER_MEAN, Segment};
use crate::primitive::{Actuator, Motion, Primitive, Speed};
use crate::scene::Scene;

/// Waypoints of a press.
pub(crate) const WAYPOINTS: usize = 9;
/// Other links stay this far away during a touch, m.
const LEAST_CLEARANCE_M: f64 = 0.0005;

/// The parts that the repetitions of a touch are put together from.
#[derive(Clone, Debug)]
pub(crate) struct Strokes {
    /// What presses.
    pub(crate) actuator: Actuator,
    /// From clearance to depth.
    pub(crate) press: Vec<Vec<f64>>,
    /// At depth, from the middle to one end, to the other, and back to the middle; empty for a press.
    pub(crate) traverse: Vec<Vec<f64>>,
    /// Length of the traverse, m or rad.
    pub(crate) traverse_length: f64,
}

impl Strokes {
    /// Plans `primitive` at `contact`; `None` where joints or other links are in the way.
    pub(crate) fn plan(
        scene: &Scene<'_>,
        contact: &Contact,
        primitive: &Primitive,
        actuator: Actuator,
    ) -> Option<Self> {
        let limb = limb_dofs(scene, contact.link);
        let pressing = match actuator {
            Actuator::Carrier => &scene.station.carrier_dofs,
            Actuator::Limb => &limb,
        };
        if pressing.is_empty() {
            return None;
        }
        let oriented = actuator == Actuator::Carrier;
        let mut follower =
            Follower { scene, contact, positions: contact.positions.clone(), frames: Vec::new() };
        // The deepest point of the patch goes to `depth_m`, which need not be the taxel itself.
        let bottom_m = follower.level(&contact.base_from_link, -primitive.depth_m);
        let mut press = Vec::with_capacity(WAYPOINTS);
        for step in 0..WAYPOINTS {
            let fraction = step as f64 / (WAYPOINTS - 1) as f64;
            let height_m = bottom_m + (primitive.clearance_m - bottom_m) * fraction;
            let pose = lifted(&contact.base_from_link, contact, height_m);
            press.push(follower.follow(pressing, &pose, oriented)?);
        }
        press.reverse();
        let mut traverse = Vec::new();
        let mut traverse_length = 0.0;
        if primitive.motion != Motion::Press {
            for shrink in [1.0, 0.7, 0.45] {
                let reach = primitive.reach * shrink;
                if let Some(waypoints) = traverse_at(scene, contact, primitive, reach, press.last()?) {
                    traverse = waypoints;
                    traverse_length = 4.0 * reach;
                    break;
                }
            }
            if traverse.is_empty() {
                return None;
            }
        }
        Some(Self { actuator, press, traverse, traverse_length })
    }

    /// One repetition at `speed`, from clearance to clearance.
    pub(crate) fn repetition(&self, primitive: &Primitive, speed: &Speed) -> Vec<Segment> {
        let distance_m = primitive.clearance_m + primitive.depth_m;
        let press = Segment { duration_s: distance_m / speed.press_m_per_s, waypoints: self.press.clone() };
        let bottom = press.end().to_vec();
        let release = press.reversed();
        let mut segments = vec![press, Segment::still(&bottom, primitive.dwell_s)];
        if !self.traverse.is_empty() {
            segments.push(Segment {
                duration_s: self.traverse_length / speed.traverse_per_s,
                waypoints: self.traverse.clone(),
            });
            segments.push(Segment::still(&bottom, primitive.dwell_s));
        }
        segments.push(release);
        segments
    }

    /// Positions at clearance.
    pub(crate) fn hover(&self) -> &[f64] {
        &self.press[0]
    }
}

/// Follows poses of the touching link from one solution to the next.
struct Follower<'a> {
    scene: &'a Scene<'a>,
    contact: &'a Contact,
    positions: Vec<f64>,
    frames: Vec<Isometry3<f64>>,
}

impl Follower<'_> {
    /// Joint positions for `pose`, if it can be reached with the other links clear of the object.
    fn follow(&mut self, dofs: &[usize], pose: &Isometry3<f64>, oriented: bool) -> Option<Vec<f64>> {
        let link = self.contact.link;
        let goal = Goal { link, pos_in_link: &self.contact.taxel_in_link, base_from_link: pose, oriented };
        let reached =
            ik::solve(&self.scene.station.robot, dofs, &goal, &mut self.positions, &mut self.frames);
        let clear = self.scene.clearance(&self.frames, Some(link)).others_m > LEAST_CLEARANCE_M;
        (reached && clear).then(|| self.positions.clone())
    }

    /// Height along the contact's normal at which the patch, posed at `pose` and lifted, is `distance_m` from the
    /// object. The distance grows with height at most as fast, so the secant steps do not overshoot much.
    fn level(&self, pose: &Isometry3<f64>, distance_m: f64) -> f64 {
        let mut height_m = distance_m;
        for _ in 0..12 {
            let at = self.scene.patch_distance_m(self.contact.patch, &lifted(pose, self.contact, height_m));
            height_m += (distance_m - at).clamp(-0.004, 0.004);
        }
        height_m
    }
}

fn lifted(pose: &Isometry3<f64>, contact: &Contact, height_m: f64) -> Isometry3<f64> {
    Translation3::from(contact.normal.into_inner() * height_m) * pose
}

/// The way at depth from `bottom` to +reach, -reach and back.
fn traverse_at(
    scene: &Scene<'_>,
    contact: &Contact,
    primitive: &Primitive,
    reach: f64,
    bottom: &[f64],
) -> Option<Vec<Vec<f64>>> {
    let mut follower = Follower { scene, contact, positions: bottom.to_vec(), frames: Vec::new() };
    let carriers = &scene.station.carrier_dofs;
    let mut robot_frames = Vec::new();
    scene.station.robot.forward_kinematics(bottom, &mut robot_frames);
    // A pressing limb may have turned the link a little: the traverse keeps the orientation it found.
    let rotation = robot_frames[contact.link].rotation;
    let base = contact.base_from_link;
    let taxel = base * contact.taxel_in_link;
    let steps = 24;
    let mut waypoints = Vec::with_capacity(steps + 1);
    for step in 0..=steps {
        let phase = std::f64::consts::TAU * step as f64 / steps as f64;
        let amount = reach * phase.sin();
        let pose = match primitive.motion {
            Motion::Press => base,
            Motion::Slide => Translation3::from(contact.long_axis * amount) * base,
            Motion::Roll => {
                let turn = UnitQuaternion::new(contact.long_axis * amount);
                Isometry3::from_parts(
                    Translation3::from(taxel - turn * rotation * contact.taxel_in_link),
                    turn * rotation,
                )
            }
        };
        let height_m = follower.level(&pose, -primitive.depth_m);
        waypoints.push(follower.follow(carriers, &lifted(&pose, contact, height_m), true)?);
    }
    // Starts and ends exactly where pressing ends.
    waypoints[0] = bottom.to_vec();
    waypoints[steps] = bottom.to_vec();
    Some(waypoints)
}

/// How long the joints need from one position to another when each may use `fraction` of its speed limit, s.
pub(crate) fn travel_s(scene: &Scene<'_>, from: &[f64], to: &[f64], fraction: f64) -> f64 {
    scene
        .station
        .robot
        .dofs()
        .zip(from.iter().zip(to))
        .map(|(joint, (from, to))| {
            // A robot file that gives no speed gives zero, by URDF's default.
            let given = joint.limits.map(|limits| limits.velocity).filter(|&velocity| velocity > 0.0);
            let limit = given.unwrap_or(1.0) * fraction;
            PEAK_OVER_MEAN * (to - from).abs() / limit.max(1e-6)
        })
        .fold(0.25, f64::max)
}
