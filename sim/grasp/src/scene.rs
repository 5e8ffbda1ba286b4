//! The scene as MJCF text: robot, servos, table and object. No physics library is needed to write it.

use std::fmt::{self, Write as _};

use nalgebra::{Isometry3, Matrix3, Point3};
use palpate_robot_model::{ConvexShape, JointKind, Link, LinkShape, ObjectModel, Robot};
use palpate_sim::body::MassProperties;

use crate::{GraspConfig, GraspError, Randomisation};

/// Name of the object's body and of its free joint.
pub const OBJECT: &str = "object";

/// Name of the table's geom.
pub const TABLE: &str = "table";

/// Which of the others each kind touches: `(contype, conaffinity)` of MuJoCo, where two touch when the first number of
/// one and the second of the other share a bit.
mod contact_bits {
    /// Touches object, table and hand.
    pub(super) const THING: (u32, u32) = (1, 3);
    /// Touches things.
    pub(super) const HAND: (u32, u32) = (2, 0);
    /// Touches things and its like.
    pub(super) const MUTUAL: (u32, u32) = (6, 4);
    /// Touches nothing.
    pub(super) const NOTHING: (u32, u32) = (0, 0);
}

/// The scene with `object` of this `mass` in it, varied by `randomisation`; the text that MuJoCo loads.
///
/// Bodies, joints and actuators have the names of links and degrees of freedom; actuators are in the robot's order.
/// Refuses objects without convex parts and moving links without a mass.
pub fn mjcf(
    robot: &Robot,
    config: &GraspConfig,
    object: &ObjectModel,
    mass: &MassProperties,
    randomisation: &Randomisation,
) -> Result<String, GraspError> {
    text(robot, config, object, mass, randomisation, None)
}

/// The same scene for devices that control the hand's joints themselves: actuators of the hand are torques, and the physics
/// takes steps of `timestep_s`. Actuators of the joints before the hand stay servos.
pub fn mjcf_driven(
    robot: &Robot,
    config: &GraspConfig,
    object: &ObjectModel,
    mass: &MassProperties,
    randomisation: &Randomisation,
    timestep_s: f64,
) -> Result<String, GraspError> {
    text(robot, config, object, mass, randomisation, Some(timestep_s))
}

/// `mjcf` with a key frame called `start`, to which other programs can reset: the robot at `positions` (one per degree of
/// freedom) with its targets there, the object at `base_from_object`.
pub fn with_start(mjcf: &str, robot: &Robot, positions: &[f64], base_from_object: &Isometry3<f64>) -> String {
    let (t, q) = (base_from_object.translation.vector, base_from_object.rotation);
    let mut in_tree = Vec::new();
    dofs_below(robot, 0, &mut in_tree);
    let qpos = in_tree.iter().map(|&dof| positions[dof]).chain([t.x, t.y, t.z, q.w, q.i, q.j, q.k]);
    let text = |values: &mut dyn Iterator<Item = f64>| {
        values.map(|value| value.to_string()).collect::<Vec<_>>().join(" ")
    };
    let key = format!(
        r#"<keyframe><key name="start" qpos="{}" ctrl="{}"/></keyframe>"#,
        text(&mut qpos.into_iter()),
        text(&mut positions.iter().copied())
    );
    mjcf.replace("</mujoco>", &format!("{key}\n</mujoco>"))
}

/// Degrees of freedom between `link` and the leaves, in the order of the text: MuJoCo numbers positions by it.
fn dofs_below(robot: &Robot, link: usize, dofs: &mut Vec<usize>) {
    for joint in robot.joints.iter().filter(|joint| joint.parent_link == link) {
        dofs.extend(joint.dof);
        dofs_below(robot, joint.child_link, dofs);
    }
}

fn text(
    robot: &Robot,
    config: &GraspConfig,
    object: &ObjectModel,
    mass: &MassProperties,
    randomisation: &Randomisation,
    driven_s: Option<f64>,
) -> Result<String, GraspError> {
    let in_hand = links_of_hand(robot, config);
    let scene = Scene { robot, config, object, mass, randomisation, in_hand, driven_s };
    let mut xml = String::new();
    scene.write(&mut xml).map_err(|failure| match failure {
        Failure::Problem(problem) => GraspError::Scene(problem),
        Failure::Format => GraspError::Scene("the text could not be written".to_owned()),
    })?;
    Ok(xml)
}

/// Per link, whether it is the hand's root or comes after it.
pub fn links_of_hand(robot: &Robot, config: &GraspConfig) -> Vec<bool> {
    let mut in_hand = vec![robot.links[0].name == config.hand_root];
    for joint in &robot.joints {
        in_hand.push(in_hand[joint.parent_link] || robot.links[joint.child_link].name == config.hand_root);
    }
    in_hand
}

/// Per link, the number of the digit it belongs to: those that hang from the hand's root by a joint that moves, numbered
/// in the order of the robot's file. `None` for the root and everything else.
pub fn digits(robot: &Robot, config: &GraspConfig) -> Vec<Option<usize>> {
    let in_hand = links_of_hand(robot, config);
    let mut digits = vec![None; robot.links.len()];
    let mut num_digits = 0;
    for joint in &robot.joints {
        digits[joint.child_link] = match digits[joint.parent_link] {
            None if in_hand[joint.parent_link] && joint.dof.is_some() => {
                num_digits += 1;
                Some(num_digits - 1)
            }
            of_parent => of_parent,
        };
    }
    digits
}

struct Scene<'a> {
    robot: &'a Robot,
    config: &'a GraspConfig,
    object: &'a ObjectModel,
    mass: &'a MassProperties,
    randomisation: &'a Randomisation,
    in_hand: Vec<bool>,
    /// Physics step where the hand is driven by torques, s.
    driven_s: Option<f64>,
}

enum Failure {
    Problem(String),
    Format,
}

impl From<fmt::Error> for Failure {
    fn from(_: fmt::Error) -> Self {
        Self::Format
    }
}

impl Scene<'_> {
    fn write(&self, xml: &mut String) -> Result<(), Failure> {
        let physics = &self.config.physics;
        let friction = &self.config.friction;
        writeln!(xml, r#"<mujoco model="grasp">"#)?;
        writeln!(xml, r#"<compiler angle="radian" autolimits="true" balanceinertia="true"/>"#)?;
        writeln!(
            xml,
            r#"<option timestep="{}" integrator="implicitfast" solver="Newton" cone="elliptic" impratio="{}" iterations="{}" ls_iterations="{}"><flag autoreset="disable"/></option>"#,
            self.driven_s.unwrap_or(physics.timestep_s),
            physics.impratio,
            physics.iterations,
            physics.line_search_iterations
        )?;
        writeln!(
            xml,
            r#"<default><geom condim="4" solref="{} {}" friction="{} {} {}"/></default>"#,
            physics.contact_time_constant_s,
            physics.contact_damping_ratio,
            friction.robot,
            friction.torsional_m,
            friction.rolling_m
        )?;
        let object = self.object()?;
        writeln!(xml, "<asset>{}</asset>", object.meshes)?;
        writeln!(xml, "<worldbody>")?;
        let table = &self.config.table;
        let [x, y, z] = table.size_m.map(|edge_m| 0.5 * edge_m);
        let (contype, conaffinity) = contact_bits::THING;
        writeln!(
            xml,
            r#"<geom name="{TABLE}" type="box" size="{x} {y} {z}" pos="{} {} {}" friction="{} {} {}" contype="{contype}" conaffinity="{conaffinity}"/>"#,
            table.center_m[0],
            table.center_m[1],
            table.top_m - z,
            friction.table,
            friction.torsional_m,
            friction.rolling_m
        )?;
        self.link(xml, 0, &Isometry3::identity())?;
        xml.push_str(&object.body);
        writeln!(xml, "</worldbody>\n<actuator>")?;
        for (joint, servo) in self.robot.dofs().zip(self.config.servos_by_dof(self.robot)) {
            if self.driven_s.is_some() && self.in_hand[joint.child_link] {
                writeln!(
                    xml,
                    r#"<motor name="{0}" joint="{0}" ctrlrange="-{1} {1}"/>"#,
                    joint.name, servo.max_torque_n_m
                )?;
                continue;
            }
            let varied =
                if self.in_hand[joint.child_link] { self.randomisation.stiffness_factor } else { 1.0 };
            let range = joint.limits.map_or_else(String::new, |limits| {
                format!(r#" ctrlrange="{} {}""#, limits.lower, limits.upper)
            });
            writeln!(
                xml,
                r#"<position name="{0}" joint="{0}" kp="{1}" kv="{2}" forcerange="-{3} {3}"{range}/>"#,
                joint.name,
                servo.stiffness_n_m_per_rad * varied,
                servo.damping_gain_n_m_s_per_rad,
                servo.max_torque_n_m
            )?;
        }
        writeln!(xml, "</actuator>\n</mujoco>")?;
        Ok(())
    }

    /// A link with everything that hangs from it.
    fn link(
        &self,
        xml: &mut String,
        link_idx: usize,
        parent_from_link: &Isometry3<f64>,
    ) -> Result<(), Failure> {
        let link = &self.robot.links[link_idx];
        let in_hand = self.in_hand[link_idx];
        let weightless = if in_hand { "" } else { r#" gravcomp="1""# };
        writeln!(xml, r#"<body name="{}"{}{weightless}>"#, link.name, pose(parent_from_link))?;
        if let Some(inertial) = &link.inertial {
            let factor = if in_hand { self.randomisation.link_mass_factor } else { 1.0 };
            let inertia = inertial.inertia_in_link * factor;
            self::inertial(xml, inertial.mass_kg * factor, &inertial.com_in_link, &inertia)?;
        }
        if let Some(joint_idx) = link_idx.checked_sub(1) {
            self.joint(xml, joint_idx, link)?;
        }
        self.collisions(xml, link, in_hand)?;
        for joint in self.robot.joints.iter().filter(|joint| joint.parent_link == link_idx) {
            self.link(xml, joint.child_link, &joint.parent_from_joint)?;
        }
        writeln!(xml, "</body>")?;
        Ok(())
    }

    fn joint(&self, xml: &mut String, joint_idx: usize, link: &Link) -> Result<(), Failure> {
        let joint = &self.robot.joints[joint_idx];
        let kind = match joint.kind {
            JointKind::Fixed => return Ok(()),
            JointKind::Revolute => "hinge",
            JointKind::Prismatic => "slide",
        };
        if link.inertial.is_none() {
            return Err(Failure::Problem(format!(
                "link {:?} moves but has no mass; add its <inertial> to the robot's file",
                link.name
            )));
        }
        let Some(servo) = self.config.servos.iter().find(|servo| servo.joints.contains(&joint.name)) else {
            return Err(Failure::Problem(format!("joint {:?} has no servo", joint.name)));
        };
        let in_hand = self.in_hand[joint.child_link];
        let (damping, friction_loss) = if in_hand {
            (self.randomisation.joint_damping_factor, self.randomisation.friction_loss_factor)
        } else {
            (1.0, 1.0)
        };
        let axis = joint.axis_in_joint;
        let range = joint
            .limits
            .map_or_else(String::new, |limits| format!(r#" range="{} {}""#, limits.lower, limits.upper));
        writeln!(
            xml,
            r#"<joint name="{}" type="{kind}" axis="{} {} {}" damping="{}" armature="{}" frictionloss="{}"{range}/>"#,
            joint.name,
            axis.x,
            axis.y,
            axis.z,
            servo.joint_damping_n_m_s_per_rad * damping,
            servo.armature_kg_m2,
            servo.friction_loss_n_m * friction_loss
        )?;
        Ok(())
    }

    fn collisions(&self, xml: &mut String, link: &Link, in_hand: bool) -> Result<(), Failure> {
        let (contype, conaffinity) = match (in_hand, self.config.mutual_contacts.contains(&link.name)) {
            (false, _) => contact_bits::NOTHING,
            (true, false) => contact_bits::HAND,
            (true, true) => contact_bits::MUTUAL,
        };
        let friction = &self.config.friction;
        let own = friction.links.iter().find(|entry| entry.links.contains(&link.name));
        let sliding = own
            .map_or(friction.robot, |entry| self.randomisation.fingertip_friction.unwrap_or(entry.sliding));
        for geometry in &link.collisions {
            let shape = match geometry.shape {
                LinkShape::Box { size_m } => ConvexShape::Box { size_m },
                LinkShape::Cylinder { radius_m, length_m } => {
                    ConvexShape::Cylinder { radius_m, height_m: length_m }
                }
                LinkShape::Capsule { radius_m, length_m } => ConvexShape::Capsule { radius_m, length_m },
                LinkShape::Sphere { radius_m } => ConvexShape::Sphere { radius_m },
            };
            writeln!(
                xml,
                r#"<geom {}{} friction="{sliding} {} {}" contype="{contype}" conaffinity="{conaffinity}"/>"#,
                primitive(&shape).unwrap_or_default(),
                pose(&geometry.link_from_shape),
                friction.torsional_m,
                friction.rolling_m
            )?;
        }
        Ok(())
    }

    fn object(&self) -> Result<ObjectText, Failure> {
        let problem = |problem: String| {
            Failure::Problem(format!("object {:?} cannot be grasped: {problem}", self.object.id))
        };
        let parts = self.object.shape.convex_parts().map_err(problem)?;
        let friction = &self.config.friction;
        let (contype, conaffinity) = contact_bits::THING;
        let mut text = ObjectText { meshes: String::new(), body: String::new() };
        let (meshes, body) = (&mut text.meshes, &mut text.body);
        writeln!(body, r#"<body name="{OBJECT}"><freejoint name="{OBJECT}"/>"#)?;
        let factor = self.randomisation.object_mass_factor;
        let com_in_object = self.mass.com_in_object + self.randomisation.object_com_offset_m;
        inertial(body, self.mass.mass_kg * factor, &com_in_object, &(self.mass.inertia_kg_m2 * factor))?;
        for (idx, part) in parts.iter().enumerate() {
            let shape = match (&part.shape, primitive(&part.shape)) {
                (_, Some(primitive)) => primitive,
                (ConvexShape::Hull { points }, None) => {
                    write!(meshes, r#"<mesh name="{OBJECT}_{idx}" vertex=""#)?;
                    points.iter().try_for_each(|p| write!(meshes, "{} {} {} ", p.x, p.y, p.z))?;
                    writeln!(meshes, r#""/>"#)?;
                    format!(r#"type="mesh" mesh="{OBJECT}_{idx}""#)
                }
                (shape, None) => return Err(problem(format!("part {idx} is {shape:?}"))),
            };
            writeln!(
                body,
                r#"<geom {shape}{} friction="{} {} {}" contype="{contype}" conaffinity="{conaffinity}"/>"#,
                pose(&part.object_from_part),
                friction.object,
                friction.torsional_m,
                friction.rolling_m
            )?;
        }
        writeln!(body, "</body>")?;
        Ok(text)
    }
}

/// Mass, centre of mass and inertia (about it, along the body's axes) of a body.
fn inertial(xml: &mut String, mass_kg: f64, com: &Point3<f64>, i: &Matrix3<f64>) -> fmt::Result {
    writeln!(
        xml,
        r#"<inertial pos="{} {} {}" mass="{mass_kg}" fullinertia="{} {} {} {} {} {}"/>"#,
        com.x,
        com.y,
        com.z,
        i[(0, 0)],
        i[(1, 1)],
        i[(2, 2)],
        i[(0, 1)],
        i[(0, 2)],
        i[(1, 2)]
    )
}

struct ObjectText {
    meshes: String,
    body: String,
}

/// Type and size of a shape that MuJoCo has; cylinders and capsules lie along z in both worlds. `None` for hulls.
fn primitive(shape: &ConvexShape) -> Option<String> {
    Some(match *shape {
        ConvexShape::Sphere { radius_m } => format!(r#"type="sphere" size="{radius_m}""#),
        ConvexShape::Box { size_m: [x, y, z] } => {
            format!(r#"type="box" size="{} {} {}""#, 0.5 * x, 0.5 * y, 0.5 * z)
        }
        ConvexShape::Cylinder { radius_m, height_m } => {
            format!(r#"type="cylinder" size="{radius_m} {}""#, 0.5 * height_m)
        }
        ConvexShape::Capsule { radius_m, length_m } => {
            format!(r#"type="capsule" size="{radius_m} {}""#, 0.5 * length_m)
        }
        ConvexShape::Hull { .. } => return None,
    })
}

fn pose(parent_from_child: &Isometry3<f64>) -> String {
    let t = parent_from_child.translation.vector;
    let q = parent_from_child.rotation;
    format!(r#" pos="{} {} {}" quat="{} {} {} {}""#, t.x, t.y, t.z, q.w, q.i, q.j, q.k)
}
