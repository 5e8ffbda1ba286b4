//! Where the arm's flange is, and which joints bring it somewhere.

use std::sync::Arc;

use nalgebra::{DMatrix, Isometry3, Point3, Translation3, UnitQuaternion, Vector6};
use palpate_device_protocol::xarm::{NUM_JOINT_SLOTS, Pose};
use palpate_robot_model::ik::{Goal as ReachGoal, solve as reach};
use palpate_robot_model::{JointLimits, Station};

/// Newton steps on top of what is near enough for a touch.
const REFINEMENTS: usize = 3;

/// The station's carrier as the box sees it: a chain from its base to its flange.
#[derive(Clone, Debug)]
pub(crate) struct ArmModel {
    station: Arc<Station>,
    base_link: usize,
    flange_link: usize,
    /// Positions of all degrees of freedom, for those that are not the arm's.
    others: Vec<f64>,
}

impl ArmModel {
    /// The arm of `station` with the other joints at `positions`; `None` if it has none, or more joints than the line
    /// has slots.
    pub(crate) fn new(station: Arc<Station>, positions: Vec<f64>) -> Option<Self> {
        let dofs = &station.carrier_dofs;
        if dofs.len() > NUM_JOINT_SLOTS {
            return None;
        }
        let (first, last) = (*dofs.first()?, *dofs.last()?);
        let base_link = station.robot.dofs().nth(first)?.parent_link;
        let flange_link = station.robot.dofs().nth(last)?.child_link;
        Some(Self { station, base_link, flange_link, others: positions })
    }

    pub(crate) fn num_joints(&self) -> usize {
        self.station.carrier_dofs.len()
    }

    pub(crate) fn limits(&self, joint: usize) -> Option<JointLimits> {
        let dof = *self.station.carrier_dofs.get(joint)?;
        self.station.robot.dofs().nth(dof)?.limits
    }

    /// The first joint that `joints_rad` puts beyond its limits.
    pub(crate) fn beyond_limits(&self, joints_rad: &[f64]) -> Option<usize> {
        // What a 32-bit number of the line makes of a limit is still within it.
        let slack_rad = 1e-5;
        (0..self.num_joints().min(joints_rad.len())).find(|&joint| {
            self.limits(joint).is_some_and(|limits| {
                let angle_rad = joints_rad[joint];
                !(limits.lower - slack_rad..=limits.upper + slack_rad).contains(&angle_rad)
            })
        })
    }

    /// Pose of the flange in the arm's base.
    pub(crate) fn base_from_flange(&self, joints_rad: &[f64]) -> Isometry3<f64> {
        let mut frames = Vec::new();
        self.station.robot.forward_kinematics(&self.positions(joints_rad), &mut frames);
        frames[self.base_link].inverse() * frames[self.flange_link]
    }

    /// Joints near `start_rad` that bring the flange to `base_from_flange`.
    pub(crate) fn joints_rad(
        &self,
        base_from_flange: &Isometry3<f64>,
        start_rad: &[f64],
    ) -> Option<Vec<f64>> {
        let mut positions = self.positions(start_rad);
        let mut frames = Vec::new();
        self.station.robot.forward_kinematics(&positions, &mut frames);
        let target = frames[self.base_link] * base_from_flange;
        let goal = ReachGoal {
            link: self.flange_link,
            pos_in_link: &Point3::origin(),
            base_from_link: &target,
            oriented: true,
        };
        let dofs = &self.station.carrier_dofs;
        let found = reach(&self.station.robot, dofs, &goal, &mut positions, &mut frames);
        let near: Vec<f64> = dofs.iter().map(|&dof| positions[dof]).collect();
        found.then(|| self.refined(base_from_flange, near))
    }

    /// Joints that are near enough for a touch, brought as near as the box comes: Newton steps with a Jacobian by
    /// differences. Where they lead nowhere, for instance beyond a limit, the joints stay as they were.
    fn refined(&self, target: &Isometry3<f64>, near_rad: Vec<f64>) -> Vec<f64> {
        let difference_rad = 1e-6;
        let num_joints = near_rad.len();
        let mut joints_rad = near_rad.clone();
        for _ in 0..REFINEMENTS {
            let now = self.base_from_flange(&joints_rad);
            let mut jacobian = DMatrix::zeros(6, num_joints);
            for joint in 0..num_joints {
                let mut moved_rad = joints_rad.clone();
                moved_rad[joint] += difference_rad;
                let change = apart(&now, &self.base_from_flange(&moved_rad)) / difference_rad;
                jacobian.set_column(joint, &change);
            }
            let wanted = apart(&now, target);
            let Ok(steps) = jacobian.svd(true, true).solve(&wanted, 1e-6) else { return near_rad };
            for (joint_rad, step) in joints_rad.iter_mut().zip(&steps) {
                *joint_rad += step;
            }
        }
        let error = |joints_rad: &[f64]| apart(&self.base_from_flange(joints_rad), target).norm();
        let is_better = error(&joints_rad) < error(&near_rad) && self.beyond_limits(&joints_rad).is_none();
        if is_better { joints_rad } else { near_rad }
    }

    fn positions(&self, joints_rad: &[f64]) -> Vec<f64> {
        let mut positions = self.others.clone();
        for (&dof, &angle_rad) in self.station.carrier_dofs.iter().zip(joints_rad) {
            positions[dof] = angle_rad;
        }
        positions
    }
}

/// How far `to` is from `from`: m and rad.
fn apart(from: &Isometry3<f64>, to: &Isometry3<f64>) -> Vector6<f64> {
    let way = to.translation.vector - from.translation.vector;
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z)
}

/// As the box says it: roll, pitch and yaw about fixed axes.
pub(crate) fn to_pose(isometry: &Isometry3<f64>) -> Pose {
    let (roll, pitch, yaw) = isometry.rotation.euler_angles();
    Pose { position_m: isometry.translation.vector.into(), rpy_rad: [roll, pitch, yaw] }
}

/// The other way round.
pub(crate) fn from_pose(pose: &Pose) -> Isometry3<f64> {
    let [x, y, z] = pose.position_m;
    let [roll, pitch, yaw] = pose.rpy_rad;
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
}
