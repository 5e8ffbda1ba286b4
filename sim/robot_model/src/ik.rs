//! Inverse kinematics by damped least squares.

use nalgebra::{Isometry3, Matrix6, Point3, Vector3, Vector6};

use crate::{JointKind, Robot};

/// A metre of position counts as this many radians of rotation.
const RAD_PER_M: f64 = 10.0;
const POSITION_TOLERANCE_M: f64 = 2e-5;
const ROTATION_TOLERANCE_RAD: f64 = 1e-3;

/// What a solution must bring about.
pub struct Goal<'a> {
    /// The link to be moved.
    pub link: usize,
    /// The point of it that matters, in the link's frame.
    pub pos_in_link: &'a Point3<f64>,
    /// Where the link should be, in the base frame.
    pub base_from_link: &'a Isometry3<f64>,
    /// Whether its orientation matters.
    pub oriented: bool,
}

/// Degrees of freedom between the root and `link`, root first.
pub fn chain_dofs(robot: &Robot, link: usize) -> Vec<usize> {
    let mut dofs = Vec::new();
    let mut link = link;
    while link != 0 {
        let joint = &robot.joints[link - 1];
        dofs.extend(joint.dof);
        link = joint.parent_link;
    }
    dofs.reverse();
    dofs
}

/// `dofs` without those that follow others, which are replaced by the ones that they move with; each once.
pub fn leaders(robot: &Robot, dofs: impl IntoIterator<Item = usize>) -> Vec<usize> {
    let led = robot.led();
    let mut leaders = Vec::new();
    for dof in dofs {
        let leader = led.iter().find(|led| led.dof == dof).map_or(dof, |led| led.leader);
        if !leaders.contains(&leader) {
            leaders.push(leader);
        }
    }
    leaders
}

/// Range that motions may use: the limits less a margin, unbounded without limits. A degree of freedom that others
/// follow stays where they are within theirs; one point is left where these exclude each other.
pub fn range(robot: &Robot, dof: usize) -> (f64, f64) {
    let (mut lower, mut upper) = own_range(robot, dof);
    for led in robot.led().iter().filter(|led| led.leader == dof && led.multiplier != 0.0) {
        let (least, most) = own_range(robot, led.dof);
        let [one, other] = [least, most].map(|end| (end - led.offset) / led.multiplier);
        (lower, upper) = (lower.max(one.min(other)), upper.min(one.max(other)));
    }
    if lower > upper {
        let middle = 0.5 * (lower + upper);
        (lower, upper) = (middle, middle);
    }
    (lower, upper)
}

fn own_range(robot: &Robot, dof: usize) -> (f64, f64) {
    robot.dofs().nth(dof).and_then(|joint| joint.limits).map_or(
        (f64::NEG_INFINITY, f64::INFINITY),
        |limits| {
            let margin = 0.01 * (limits.upper - limits.lower);
            (limits.lower + margin, limits.upper - margin)
        },
    )
}

/// Moves `dofs` of `positions` until `goal` is met, within limits; whether it was. Joints that follow others move with
/// them. `frames` is scratch and afterwards holds the links' poses.
pub fn solve(
    robot: &Robot,
    dofs: &[usize],
    goal: &Goal<'_>,
    positions: &mut [f64],
    frames: &mut Vec<Isometry3<f64>>,
) -> bool {
    let led = robot.led();
    let mut dofs = leaders(robot, dofs.iter().copied());
    dofs.retain(|&dof| dof < robot.num_dofs());
    let dofs = &dofs[..];
    // What moves with each: itself, and those that follow it.
    let moved: Vec<Vec<(usize, f64)>> = dofs
        .iter()
        .map(|&dof| {
            let followers = led.iter().filter(|led| led.leader == dof).map(|led| (led.dof, led.multiplier));
            std::iter::once((dof, 1.0)).chain(followers).collect()
        })
        .collect();
    let joints: Vec<_> = robot.dofs().collect();
    let ranges: Vec<_> = dofs.iter().map(|&dof| range(robot, dof)).collect();
    let chain = chain_dofs(robot, goal.link);
    let turns = moved.iter().flatten().any(|&(dof, _)| joints[dof].kind == JointKind::Revolute);
    let target = goal.base_from_link * goal.pos_in_link;
    let mut columns = vec![Vector6::zeros(); dofs.len()];
    for _ in 0..60 {
        robot.forward_kinematics(positions, frames);
        let link_pose = frames[goal.link];
        let point = link_pose * goal.pos_in_link;
        let pos_error = target - point;
        let rot_error = if goal.oriented && turns {
            (goal.base_from_link.rotation * link_pose.rotation.inverse()).scaled_axis()
        } else {
            Vector3::zeros()
        };
        if pos_error.norm() < POSITION_TOLERANCE_M && rot_error.norm() < ROTATION_TOLERANCE_RAD {
            return true;
        }
        let error = stack(&(pos_error * RAD_PER_M), &rot_error);
        let mut gram = Matrix6::<f64>::identity() * (1e-8 + 1e-2 * error.norm_squared().min(0.01));
        for (column, moved) in columns.iter_mut().zip(&moved) {
            let on_chain = moved.iter().filter(|(dof, _)| chain.contains(dof));
            let of_joint = |&(dof, multiplier): &(usize, f64)| {
                let joint = joints[dof];
                let base_from_joint = frames[joint.parent_link] * joint.parent_from_joint;
                let axis = base_from_joint.rotation * joint.axis_in_joint.into_inner();
                let of_joint = match joint.kind {
                    JointKind::Revolute => {
                        let arm = point - Point3::from(base_from_joint.translation.vector);
                        let rotation = if goal.oriented { axis } else { Vector3::zeros() };
                        stack(&(axis.cross(&arm) * RAD_PER_M), &rotation)
                    }
                    JointKind::Prismatic => stack(&(axis * RAD_PER_M), &Vector3::zeros()),
                    JointKind::Fixed => Vector6::zeros(),
                };
                of_joint * multiplier
            };
            let Some(whole) = on_chain.map(of_joint).reduce(|sum, of_joint| sum + of_joint) else {
                *column = Vector6::zeros();
                continue;
            };
            *column = whole;
            gram += *column * column.transpose();
        }
        let Some(factor) = gram.cholesky() else { return false };
        let weights = factor.solve(&error);
        let mut steps: Vec<f64> = columns.iter().map(|column| column.dot(&weights)).collect();
        let largest = steps.iter().fold(0.0_f64, |max, step| max.max(step.abs()));
        if largest > 0.3 {
            steps.iter_mut().for_each(|step| *step *= 0.3 / largest);
        }
        for ((step, &dof), &(lower, upper)) in steps.iter().zip(dofs).zip(&ranges) {
            positions[dof] = (positions[dof] + step).clamp(lower, upper);
        }
        robot.follow(positions);
    }
    false
}

fn stack(top: &Vector3<f64>, bottom: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(top.x, top.y, top.z, bottom.x, bottom.y, bottom.z)
}
