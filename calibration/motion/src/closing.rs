//! Touches by limbs alone, for hands that nothing carries to the object: a finger closes on it.
//!
//! A carrier of at least three joints brings a taxel to any point of a surface, which [`crate::contact`] solves for. A
//! gripper on a wrist, or a hand on a table, cannot do that. Here a limb starts from a posture near rest and moves along one
//! straight line of its joint positions until the patch meets the object, wherever that is.

use nalgebra::{Isometry3, Point3, Unit, Vector3};
use palpate_robot_model::{JointKind, Robot, ik};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::contact::{AMPLE_CLEARANCE_M, LEAST_CLEARANCE_M, OWN_OVERLAP_M, Postures, bell, limb_dofs};
use crate::primitive::{Actuator, Primitive};
use crate::scene::Scene;
use crate::touch::{Strokes, WAYPOINTS};

/// Fewer moving joints than this bring a taxel to a point of a surface only by luck.
const FEWEST_CARRIERS: usize = 3;
const MOST_TRIALS: usize = 800;
const ENOUGH_FOUND: usize = 6;
/// How far a taxel travels on the line at most, m: to the object, and away from it.
const LONGEST_WAY_M: f64 = 0.12;
/// How far the surface may be from facing the skin where they meet, rad: more is an edge.
const FACING_TOLERANCE_RAD: f64 = 0.35;
/// The taxel that is touched may be so much farther from the deepest point than the nearest taxel is.
const NEAREST_SHARE: f64 = 1.25;
/// Other skin that moves with the limb, as that of the opposite finger, may go in by so much more than the touch, m.
const COMPANION_DEPTH_M: f64 = 0.0005;
/// Steps along the line are at least this long, m of the taxel's way.
const STEP_M: f64 = 0.001;

/// A finger that closes on the object.
#[derive(Clone, Debug)]
pub(crate) struct Closing {
    /// The touching link.
    pub(crate) link: usize,
    /// The taxels that may be said to be touched, by index in their patch.
    pub(crate) taxels: Vec<usize>,
    /// Joint positions away from the object, on the line.
    pub(crate) apart: Vec<f64>,
    /// Whether the joint that closes most arrives from above its final position.
    pub(crate) from_above: bool,
    pub(crate) strokes: Strokes,
    score: f64,
}

/// Whether the station's carriers can bring a taxel to an object by themselves.
pub(crate) fn is_carried(scene: &Scene<'_>) -> bool {
    let carriers = scene.station.carrier_dofs.iter().copied();
    ik::leaders(&scene.station.robot, carriers).len() >= FEWEST_CARRIERS
}

/// Ways in which the limb of `channel` closes on the object with its taxel, best first; empty if none was found.
pub(crate) fn find_closings(
    scene: &Scene<'_>,
    channel: usize,
    primitive: &Primitive,
    postures: &Postures<'_>,
    rng: &mut ChaCha8Rng,
) -> Vec<Closing> {
    let channel = &scene.station.layout.channels[channel];
    let mut found: Vec<Closing> = Vec::new();
    for _ in 0..MOST_TRIALS {
        let closing = try_closing(scene, channel.patch, Some(channel.taxel), primitive, postures, rng);
        found.extend(closing.filter(|closing| closing.taxels.contains(&channel.taxel)));
        if found.len() >= ENOUGH_FOUND {
            break;
        }
    }
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    found
}

/// A way in which the limb of the patch at `patch_idx` closes on the object from a posture that is drawn; the taxel at
/// `taxel` is the one that is led towards it, the middle of the patch if that is `None`.
pub(crate) fn try_closing(
    scene: &Scene<'_>,
    patch_idx: usize,
    taxel: Option<usize>,
    primitive: &Primitive,
    postures: &Postures<'_>,
    rng: &mut ChaCha8Rng,
) -> Option<Closing> {
    let robot = &scene.station.robot;
    let patch = &scene.station.layout.patches[patch_idx];
    let limb = limb_dofs(scene, patch.link);
    if limb.is_empty() {
        return None;
    }
    let mut positions = postures.away.to_vec();
    let carriers_move = !is_carried(scene);
    for ((dof, position), joint) in positions.iter_mut().enumerate().zip(robot.dofs()) {
        if joint.mimic.is_some() {
            continue;
        }
        let is_carrier = scene.station.carrier_dofs.contains(&dof);
        let spread = match (is_carrier, limb.contains(&dof)) {
            (true, _) if !carriers_move => 0.0,
            (true, _) => 0.2,
            (false, true) => 0.4,
            (false, false) => 0.0,
        };
        if is_carrier || limb.contains(&dof) {
            *position = postures.rest[dof];
        }
        let (lower, upper) = ik::range(robot, dof);
        let span = if upper.is_finite() && lower.is_finite() { upper - lower } else { 1.0 };
        *position = (*position + spread * span * bell(rng)).clamp(lower, upper);
    }
    robot.follow(&mut positions);
    let mut frames = Vec::new();
    robot.forward_kinematics(&positions, &mut frames);
    let middle = patch.taxels_in_link.len() / 2;
    let taxel = taxel.unwrap_or(middle);
    let pos = frames[patch.link] * patch.taxels_in_link[taxel];
    let outward = frames[patch.link].rotation * patch.taxel_normals_in_link[taxel].into_inner();
    let direction = closing_direction(robot, &frames, patch.link, &limb, &pos, &outward, rng)?;
    let mut line = Line { scene, patch: patch_idx, start: positions, direction, frames };

    let (least, most) = line.range();
    let touch = line.first_touch(least, most)?;
    let hover = line.back_to(primitive.clearance_m, touch, least)?;
    let bottom = line.on_to(-primitive.depth_m, touch, most)?;
    // As far away as the limb opens, if it does not open as far as is wanted.
    let apart = line.back_to(postures.retreat_m, hover, least).unwrap_or(least);

    line.distance_m(touch);
    let (deepest, facing) = scene.deepest_node(patch_idx, &line.frames[patch.link])?;
    if facing > FACING_TOLERANCE_RAD {
        return None;
    }
    let away_m = |pos: &Point3<f64>| (pos - deepest.pos_in_link).norm();
    let nearest_m = patch.taxels_in_link.iter().map(away_m).fold(f64::INFINITY, f64::min);
    let is_touched = |pos: &Point3<f64>| away_m(pos) <= NEAREST_SHARE * nearest_m + STEP_M;
    let taxels = patch.taxels_in_link.iter().enumerate().filter(|(_, pos)| is_touched(pos));
    let taxels: Vec<usize> = taxels.map(|(taxel, _)| taxel).collect();

    let others_m = line.room_m(bottom, primitive.depth_m)?;
    let strokes = Strokes {
        actuator: Actuator::Limb,
        press: (0..WAYPOINTS)
            .map(|step| line.at(hover + (bottom - hover) * step as f64 / (WAYPOINTS - 1) as f64))
            .collect(),
        traverse: Vec::new(),
        traverse_length: 0.0,
    };
    let leading = line.direction.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    let travel: f64 = line.at(hover).iter().zip(postures.rest).map(|(a, b)| (a - b).powi(2)).sum();
    let score = others_m.min(AMPLE_CLEARANCE_M) * 60.0 - 2.0 * facing - 0.35 * travel.sqrt();
    Some(Closing {
        link: patch.link,
        taxels,
        apart: line.at(apart),
        from_above: leading < 0.0,
        strokes,
        score,
    })
}

/// Changes of the limb's joints that move `pos` along `outward`, a metre for a metre to first order: each joint moves as
/// far as it helps, times a weight that is drawn. `None` where no joint moves it that way.
fn closing_direction(
    robot: &Robot,
    frames: &[Isometry3<f64>],
    link: usize,
    limb: &[usize],
    pos: &Point3<f64>,
    outward: &Vector3<f64>,
    rng: &mut ChaCha8Rng,
) -> Option<Vec<f64>> {
    let chain = ik::chain_dofs(robot, link);
    let led = robot.led();
    let joints: Vec<_> = robot.dofs().collect();
    let helps = |dof: usize| {
        let joint = joints[dof];
        let base_from_joint = frames[joint.parent_link] * joint.parent_from_joint;
        let axis: Unit<Vector3<f64>> = base_from_joint.rotation * joint.axis_in_joint;
        match joint.kind {
            JointKind::Revolute => {
                axis.cross(&(pos - Point3::from(base_from_joint.translation.vector))).dot(outward)
            }
            JointKind::Prismatic => axis.dot(outward),
            JointKind::Fixed => 0.0,
        }
    };
    let mut direction = vec![0.0; robot.num_dofs()];
    let mut gained = 0.0;
    for &dof in limb {
        let own = if chain.contains(&dof) { helps(dof) } else { 0.0 };
        let followers = led.iter().filter(|led| led.leader == dof && chain.contains(&led.dof));
        let gain = own + followers.map(|led| led.multiplier * helps(led.dof)).sum::<f64>();
        let weight: f64 = rng.random();
        direction[dof] = weight * gain;
        gained += weight * gain * gain;
    }
    if gained < 1e-9 {
        return None;
    }
    direction.iter_mut().for_each(|change| *change /= gained);
    Some(direction)
}

/// A straight line of joint positions, by the way in m that the taxel goes along it, to first order.
struct Line<'a> {
    scene: &'a Scene<'a>,
    patch: usize,
    start: Vec<f64>,
    direction: Vec<f64>,
    /// Scratch: the links' poses at the last place that was looked at.
    frames: Vec<Isometry3<f64>>,
}

impl Line<'_> {
    fn at(&self, way_m: f64) -> Vec<f64> {
        let mut positions: Vec<f64> =
            self.start.iter().zip(&self.direction).map(|(start, change)| start + change * way_m).collect();
        self.scene.station.robot.follow(&mut positions);
        positions
    }

    /// How far the patch is from the object there, m.
    fn distance_m(&mut self, way_m: f64) -> f64 {
        let positions = self.at(way_m);
        self.scene.station.robot.forward_kinematics(&positions, &mut self.frames);
        let link = self.scene.station.layout.patches[self.patch].link;
        self.scene.patch_distance_m(self.patch, &self.frames[link])
    }

    /// From where to where joints stay within their limits.
    fn range(&self) -> (f64, f64) {
        let robot = &self.scene.station.robot;
        let (mut least, mut most) = (-LONGEST_WAY_M, LONGEST_WAY_M);
        for (dof, (start, change)) in self.start.iter().zip(&self.direction).enumerate() {
            if *change == 0.0 {
                continue;
            }
            let (lower, upper) = ik::range(robot, dof);
            let [one, other] = [lower, upper].map(|end| (end - start) / change);
            (least, most) = (least.max(one.min(other)), most.min(one.max(other)));
        }
        (least.min(0.0), most.max(0.0))
    }

    /// Where the patch first meets the object on the way from `least` to `most`.
    fn first_touch(&mut self, least: f64, most: f64) -> Option<f64> {
        let mut clear = least;
        let mut distance_m = self.distance_m(clear);
        if distance_m <= 0.0 {
            return None;
        }
        while clear < most {
            // Half of what is left: points of the patch may go farther than the taxel.
            let next = (clear + (0.5 * distance_m).max(STEP_M)).min(most);
            distance_m = self.distance_m(next);
            if distance_m <= 0.0 {
                return Some(self.crossing(0.0, clear, next));
            }
            clear = next;
        }
        None
    }

    /// The last place before `from`, not before `least`, where the patch is `distance_m` from the object.
    fn back_to(&mut self, distance_m: f64, from: f64, least: f64) -> Option<f64> {
        let mut near = from;
        while near > least {
            let next = (near - STEP_M).max(least);
            if self.distance_m(next) >= distance_m {
                return Some(self.crossing(distance_m, next, near));
            }
            near = next;
        }
        None
    }

    /// The first place after `from`, not after `most`, where the patch is `distance_m` from the object, which is negative.
    fn on_to(&mut self, distance_m: f64, from: f64, most: f64) -> Option<f64> {
        let mut clear = from;
        while clear < most {
            let next = (clear + 0.5 * STEP_M).min(most);
            if self.distance_m(next) <= distance_m {
                return Some(self.crossing(distance_m, clear, next));
            }
            clear = next;
        }
        None
    }

    /// Where the patch is `distance_m` from the object, between `far` and `near`.
    fn crossing(&mut self, distance_m: f64, mut far: f64, mut near: f64) -> f64 {
        for _ in 0..40 {
            let middle = 0.5 * (far + near);
            if self.distance_m(middle) > distance_m {
                far = middle;
            } else {
                near = middle;
            }
        }
        0.5 * (far + near)
    }

    /// How much room everything else has when the limb is at `bottom`, m; `None` where something is in the way. Links that
    /// move with the limb may touch too, as the opposite finger of a gripper does: with skin no deeper than this one.
    fn room_m(&mut self, bottom: f64, depth_m: f64) -> Option<f64> {
        self.distance_m(bottom);
        let scene = self.scene;
        let (robot, layout) = (&scene.station.robot, &scene.station.layout);
        let own_root = scene.rigid_root[layout.patches[self.patch].link];
        let mut moving: Vec<usize> =
            (0..robot.num_dofs()).filter(|&dof| self.direction[dof] != 0.0).collect();
        let followers: Vec<usize> =
            robot.led().iter().filter(|led| moving.contains(&led.leader)).map(|led| led.dof).collect();
        moving.extend(followers);
        let moves: Vec<bool> = (0..robot.links.len())
            .map(|link| ik::chain_dofs(robot, link).iter().any(|dof| moving.contains(dof)))
            .collect();
        let others_m = scene.least_m(&self.frames, |link| !moves[link] && scene.rigid_root[link] != 0);
        let with_it_m = scene.least_m(&self.frames, |link| moves[link]);
        let companions = layout
            .patches
            .iter()
            .enumerate()
            .filter(|(_, patch)| moves[patch.link] && scene.rigid_root[patch.link] != own_root);
        let companions_m = companions
            .map(|(idx, patch)| scene.patch_distance_m(idx, &self.frames[patch.link]))
            .fold(f64::INFINITY, f64::min);
        let clear = others_m >= LEAST_CLEARANCE_M
            && with_it_m >= -OWN_OVERLAP_M
            && companions_m >= -(depth_m + COMPANION_DEPTH_M);
        clear.then_some(others_m)
    }
}
