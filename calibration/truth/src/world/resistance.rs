//! What the object does to joints that press a finger into it.

use nalgebra::{Isometry3, Vector3};
use palpate_robot_model::{JointKind, Station};

use super::Placed;
use super::elastomer::Layer;

/// Step of the finite differences that give the surface's direction, m.
const DIFFERENCE_M: f64 = 1e-5;

/// Torque of the object on one joint where that is at present, and how much it grows as the joint presses on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Resistance {
    /// Torque, N m.
    pub torque_nm: f64,
    /// At least the stiffness that the joint feels, other joints of the finger moving along.
    pub stiffness_nm_per_rad: f64,
}

/// Adds up what `object` does to every joint, with the links at `base_from_link`; `of_dof` has one entry for each degree
/// of freedom. Each element pushes as a layer does that has had time to give way.
pub(super) fn add_up(
    station: &Station,
    base_from_link: &[Isometry3<f64>],
    layers: &[Layer],
    object: &Placed,
    of_dof: &mut [Resistance],
) {
    let mut levers: Vec<(usize, f64)> = Vec::new();
    for layer in layers {
        let object_from_link = object.object_from_base * base_from_link[layer.link];
        for (pos_in_link, newton_per_m) in layer.pressed() {
            let pos_in_object = object_from_link * pos_in_link;
            let depth_m = -object.surface.distance_m(&pos_in_object);
            let along = |axis: Vector3<f64>| {
                object.surface.distance_m(&(pos_in_object + axis * DIFFERENCE_M)) + depth_m
            };
            let gradient = Vector3::new(along(Vector3::x()), along(Vector3::y()), along(Vector3::z()));
            // Without a direction, in the very middle of an object, nothing says where to.
            let Some(outward_in_object) = gradient.try_normalize(1e-12) else { continue };
            if depth_m <= 0.0 {
                continue;
            }
            let outward_in_base = object.object_from_base.rotation.inverse() * outward_in_object;
            let pos_in_base = base_from_link[layer.link] * pos_in_link;
            levers.clear();
            let mut link = layer.link;
            while link > 0 {
                let joint = &station.robot.joints[link - 1];
                if let (Some(dof), JointKind::Revolute) = (joint.dof, joint.kind) {
                    let axis_in_base = base_from_link[link].rotation * joint.axis_in_joint.into_inner();
                    let arm = pos_in_base.coords - base_from_link[link].translation.vector;
                    levers.push((dof, axis_in_base.cross(&arm).dot(&outward_in_base)));
                }
                link = joint.parent_link;
            }
            let reach_m: f64 = levers.iter().map(|(_, lever_m)| lever_m.abs()).sum();
            for &(dof, lever_m) in &levers {
                of_dof[dof].torque_nm += newton_per_m * depth_m * lever_m;
                of_dof[dof].stiffness_nm_per_rad += newton_per_m * lever_m.abs() * reach_m;
            }
        }
    }
}
