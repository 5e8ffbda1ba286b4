//! Finds postures in which one taxel touches the object and nothing else does.

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use palpate_robot_model::JointKind;
use palpate_robot_model::ik::{self, Goal};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::scene::{Scene, tangents};

/// Other links stay this far from the object while one touches, m.
pub(crate) const LEAST_CLEARANCE_M: f64 = 0.0005;
/// More clearance than this makes no posture better, m.
pub(crate) const AMPLE_CLEARANCE_M: f64 = 0.016;
/// How far the touching link's own collision shape may seem to be inside: it is coarser than its patches.
pub(crate) const OWN_OVERLAP_M: f64 = 0.006;
/// Normals at a touch are opposed within this, rad.
pub(crate) const NORMAL_TOLERANCE_RAD: f64 = 0.12;
const FEWEST_TRIALS: usize = 120;
const MOST_TRIALS: usize = 3000;
const ENOUGH_FOUND: usize = 8;

/// A posture in which a taxel touches the object's surface.
#[derive(Clone, Debug)]
pub(crate) struct Contact {
    pub(crate) patch: usize,
    pub(crate) link: usize,
    /// The taxel in its link.
    pub(crate) taxel_in_link: Point3<f64>,
    /// Pose of the link with the taxel on the surface.
    pub(crate) base_from_link: Isometry3<f64>,
    /// Outward normal of the object where it is touched, in the base frame.
    pub(crate) normal: Unit<Vector3<f64>>,
    /// The patch's longest direction along the surface, in the base frame.
    pub(crate) long_axis: Vector3<f64>,
    /// Joint positions at the touch.
    pub(crate) positions: Vec<f64>,
    score: f64,
}

/// What the search starts from.
pub(crate) struct Postures<'a> {
    /// Where takes start.
    pub(crate) rest: &'a [f64],
    /// Positions of limbs that do not touch.
    pub(crate) away: &'a [f64],
    /// Largest change of orientation from the one at rest, rad.
    pub(crate) tilt_rad: f64,
    /// How far the taxel must be able to retreat along the normal, m.
    pub(crate) retreat_m: f64,
    /// How deep it will press, m.
    pub(crate) depth_m: f64,
}

/// Degrees of freedom of the touching limb: those that move the link and do not carry the hand. In the place of one
/// that follows another is that other, which may be on another limb.
pub(crate) fn limb_dofs(scene: &Scene<'_>, link: usize) -> Vec<usize> {
    let robot = &scene.station.robot;
    let mut dofs = ik::leaders(robot, ik::chain_dofs(robot, link));
    dofs.retain(|dof| !scene.station.carrier_dofs.contains(dof));
    dofs
}

/// Postures in which `channel`'s taxel touches, best first; empty if none was found.
pub(crate) fn find_contacts(
    scene: &Scene<'_>,
    channel: usize,
    postures: &Postures<'_>,
    rng: &mut ChaCha8Rng,
) -> Vec<Contact> {
    let mut found: Vec<Contact> = Vec::new();
    for trial in 0..MOST_TRIALS {
        if trial >= FEWEST_TRIALS && found.len() >= ENOUGH_FOUND {
            break;
        }
        found.extend(try_contact(scene, channel, postures, rng));
    }
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    found.truncate(2 * ENOUGH_FOUND);
    found
}

pub(crate) fn try_contact(
    scene: &Scene<'_>,
    channel: usize,
    postures: &Postures<'_>,
    rng: &mut ChaCha8Rng,
) -> Option<Contact> {
    let robot = &scene.station.robot;
    let carriers = &scene.station.carrier_dofs;
    let patch_idx = scene.station.layout.channels[channel].patch;
    let patch = &scene.station.layout.patches[patch_idx];
    let taxel = scene.station.layout.channels[channel].taxel;
    let taxel_in_link = patch.taxels_in_link[taxel];
    let normal_in_link = patch.taxel_normals_in_link[taxel];
    let turns =
        carriers.iter().any(|&dof| robot.dofs().nth(dof).is_some_and(|j| j.kind == JointKind::Revolute));

    // The hand's posture: the touching limb anywhere about its rest position, the others out of the way.
    let mut positions = postures.away.to_vec();
    for &dof in carriers {
        positions[dof] = postures.rest[dof];
    }
    let limb = limb_dofs(scene, patch.link);
    for ((dof, position), joint) in positions.iter_mut().enumerate().zip(robot.dofs()) {
        if carriers.contains(&dof) || joint.mimic.is_some() {
            continue;
        }
        let (lower, upper) = ik::range(robot, dof);
        let span = if upper.is_finite() && lower.is_finite() { upper - lower } else { 1.0 };
        let (middle, spread) = if limb.contains(&dof) { (postures.rest[dof], 0.4) } else { (*position, 0.1) };
        *position = (middle + spread * span * bell(rng)).clamp(lower, upper);
    }
    robot.follow(&mut positions);
    let mut frames = Vec::new();
    robot.forward_kinematics(&positions, &mut frames);

    // The orientation: that at rest, tilted at random, then turned so that the surface is met squarely.
    let tilt = if turns { postures.tilt_rad } else { 0.0 };
    let wobble = UnitQuaternion::new(Vector3::new(bell(rng), bell(rng), bell(rng)) * tilt * 0.6);
    let tilted = wobble * frames[patch.link].rotation;
    let wanted = tilted * normal_in_link;
    let (surface_pos, normal) = scene
        .surface
        .iter()
        .map(|point| (point, -point.1.dot(&wanted) + 0.05 * rng.random::<f64>()))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(point, _)| *point)?;
    let square = UnitQuaternion::rotation_between(&wanted, &-normal.into_inner())?;
    let rotation = if turns { square * tilted } else { tilted };
    let pose_at = |clearance_m: f64| {
        let taxel_pos = surface_pos + normal.into_inner() * clearance_m;
        Isometry3::from_parts(Translation3::from(taxel_pos - rotation * taxel_in_link), rotation)
    };

    let goal_pose = pose_at(0.0);
    let goal =
        Goal { link: patch.link, pos_in_link: &taxel_in_link, base_from_link: &goal_pose, oriented: true };
    if !ik::solve(robot, carriers, &goal, &mut positions, &mut frames) {
        return None;
    }
    let opposed = (frames[patch.link].rotation * normal_in_link).angle(&-normal.into_inner());
    let clearance = scene.clearance(&frames, Some(patch.link));
    let others_m = clearance.others_m - postures.depth_m;
    if opposed > NORMAL_TOLERANCE_RAD || others_m < LEAST_CLEARANCE_M || clearance.own_m < -OWN_OVERLAP_M {
        return None;
    }
    let base_from_link = frames[patch.link];
    // The taxel must be what touches first: nothing of its patch may be much nearer.
    let patch_m = scene.patch_distance_m(patch_idx, &base_from_link);
    if patch_m < -0.0012 {
        return None;
    }
    let mut retreat = positions.clone();
    let retreat_pose = pose_at(postures.retreat_m);
    let goal = Goal { base_from_link: &retreat_pose, ..goal };
    if !ik::solve(robot, carriers, &goal, &mut retreat, &mut frames) {
        return None;
    }
    let retreated = scene.clearance(&frames, None);
    if retreated.others_m.min(retreated.own_m) < 0.5 * postures.retreat_m.min(0.03) {
        return None;
    }
    let travel: f64 = carriers.iter().map(|&dof| (positions[dof] - postures.rest[dof]).powi(2)).sum();
    let score = others_m.min(AMPLE_CLEARANCE_M) * 60.0 - 0.35 * travel.sqrt();
    let nodes = patch.nodes.iter().map(|node| base_from_link * node.pos_in_link);
    let long_axis = longest_direction(nodes, &normal);
    let link = patch.link;
    Some(Contact {
        patch: patch_idx,
        link,
        taxel_in_link,
        base_from_link,
        normal,
        long_axis,
        positions,
        score,
    })
}

/// The direction at right angles to `normal` in which `points` extend farthest.
fn longest_direction(points: impl Iterator<Item = Point3<f64>>, normal: &Unit<Vector3<f64>>) -> Vector3<f64> {
    let (first, second) = tangents(normal);
    let flat: Vec<(f64, f64)> = points.map(|pos| (pos.coords.dot(&first), pos.coords.dot(&second))).collect();
    let count = flat.len().max(1) as f64;
    let mean = flat.iter().fold((0.0, 0.0), |sum, p| (sum.0 + p.0 / count, sum.1 + p.1 / count));
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for (x, y) in flat {
        let (dx, dy) = (x - mean.0, y - mean.1);
        xx += dx * dx;
        xy += dx * dy;
        yy += dy * dy;
    }
    let angle = 0.5 * f64::atan2(2.0 * xy, xx - yy);
    first * angle.cos() + second * angle.sin()
}

/// Roughly normal, standard deviation 0.5, never beyond 1.5.
pub(crate) fn bell(rng: &mut ChaCha8Rng) -> f64 {
    rng.random::<f64>() + rng.random::<f64>() + rng.random::<f64>() - 1.5
}
