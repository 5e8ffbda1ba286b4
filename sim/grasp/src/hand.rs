//! The hand as one body that the joints before it carry.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use palpate_robot_model::Robot;
use palpate_robot_model::ik::{self, Goal};

use crate::GraspConfig;

/// How the hand's root is moved from where it is, along the axes of the base.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct HandMove {
    pub(crate) offset_m: Vector3<f64>,
    /// About the vertical through the middle of the region that objects start in.
    pub(crate) yaw_rad: f64,
}

impl HandMove {
    /// Moves the carriers in `positions` so that the hand's root moves so; whether they reach.
    pub(crate) fn reach(&self, robot: &Robot, config: &GraspConfig, positions: &mut [f64]) -> bool {
        let Some(hand_root) = robot.link_index(&config.hand_root) else { return false };
        let mut frames = Vec::new();
        robot.forward_kinematics(positions, &mut frames);
        let base_from_hand = self.pose(config, &frames[hand_root]);
        bring(robot, hand_root, &base_from_hand, positions, &mut frames)
    }

    /// Where a hand goes that is at `base_from_hand`.
    pub(crate) fn pose(&self, config: &GraspConfig, base_from_hand: &Isometry3<f64>) -> Isometry3<f64> {
        let center = Translation3::new(config.task.center_m[0], config.task.center_m[1], 0.0);
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw_rad);
        Translation3::from(self.offset_m) * center * yaw * center.inverse() * base_from_hand
    }
}

/// Degrees of freedom that carry the hand, root first.
pub(crate) fn carrier_dofs(robot: &Robot, config: &GraspConfig) -> Vec<usize> {
    robot.link_index(&config.hand_root).map_or_else(Vec::new, |link| ik::chain_dofs(robot, link))
}

/// Moves the joints before `hand_root` in `positions` until it is at `base_from_hand`; whether they reach.
pub(crate) fn bring(
    robot: &Robot,
    hand_root: usize,
    base_from_hand: &Isometry3<f64>,
    positions: &mut [f64],
    frames: &mut Vec<Isometry3<f64>>,
) -> bool {
    let goal = Goal {
        link: hand_root,
        pos_in_link: &Point3::origin(),
        base_from_link: base_from_hand,
        oriented: true,
    };
    ik::solve(robot, &ik::chain_dofs(robot, hand_root), &goal, positions, frames)
}
