//! From URDF text to a checked [`Robot`].

use std::collections::HashMap;

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use urdf_rs::{Geometry, JointType, Material};

use crate::ModelError;
use crate::robot::{Inertial, Joint, JointKind, JointLimits, Link, LinkGeometry, LinkShape, Mimic, Robot};

/// See [`Robot::from_urdf`].
pub(super) fn read(file: &str, text: &str, dof_names: &[String]) -> Result<Robot, ModelError> {
    let urdf = urdf_rs::read_from_string(text).map_err(|err| {
        ModelError::new(
            file,
            "XML",
            format!("not a URDF: {err}; expected <robot> with <link> and <joint> elements"),
        )
    })?;
    let reader = Reader { file, urdf: &urdf };
    let tree = reader.tree()?;
    let mut links = Vec::with_capacity(urdf.links.len());
    for &urdf_link in &tree.link_order {
        links.push(reader.link(&urdf.links[urdf_link])?);
    }
    let mut joints = Vec::with_capacity(urdf.joints.len());
    for (i, &(urdf_joint, parent_link)) in tree.joint_order.iter().enumerate() {
        joints.push(reader.joint(&urdf.joints[urdf_joint], parent_link, i + 1)?);
    }
    reader.mimics(&mut joints)?;
    let urdf_order: Vec<&str> = urdf.joints.iter().map(|joint| joint.name.as_str()).collect();
    let dof_joints = reader.dof_joints(&joints, &urdf_order, dof_names)?;
    for (dof, &joint_idx) in dof_joints.iter().enumerate() {
        joints[joint_idx].dof = Some(dof);
    }
    Ok(Robot { name: urdf.name.clone(), links, joints, dof_joints })
}

struct Reader<'a> {
    file: &'a str,
    urdf: &'a urdf_rs::Robot,
}

/// Links and joints of the URDF, parents before children.
struct Tree {
    /// Index in the URDF of each link.
    link_order: Vec<usize>,
    /// Index in the URDF of each joint, with the position of its parent in `link_order`.
    joint_order: Vec<(usize, usize)>,
}

impl Reader<'_> {
    fn error(&self, place: String, problem: impl Into<String>) -> ModelError {
        ModelError::new(self.file, place, problem)
    }

    fn at_joint(&self, name: &str, problem: impl Into<String>) -> ModelError {
        self.error(format!("joint {name:?}"), problem)
    }

    fn at_link(&self, name: &str, problem: impl Into<String>) -> ModelError {
        self.error(format!("link {name:?}"), problem)
    }

    /// Checks that the joints connect the links to one tree and walks it from the root, siblings in file order.
    fn tree(&self) -> Result<Tree, ModelError> {
        let (links, joints) = (&self.urdf.links, &self.urdf.joints);
        let place = || format!("robot {:?}", self.urdf.name);
        let mut link_by_name = HashMap::new();
        for (i, link) in links.iter().enumerate() {
            if link_by_name.insert(link.name.as_str(), i).is_some() {
                return Err(self.at_link(&link.name, "defined twice; give every link its own name"));
            }
        }
        let mut parent_joint: Vec<Option<usize>> = vec![None; links.len()];
        let mut child_joints: Vec<Vec<usize>> = vec![Vec::new(); links.len()];
        let mut joint_names = HashMap::new();
        for (i, joint) in joints.iter().enumerate() {
            if joint_names.insert(joint.name.as_str(), i).is_some() {
                return Err(self.at_joint(&joint.name, "defined twice; give every joint its own name"));
            }
            let find = |role: &str, name: &str| {
                link_by_name.get(name).copied().ok_or_else(|| {
                    self.at_joint(
                        &joint.name,
                        format!("{role} link {name:?} does not exist; add the <link> or correct the name"),
                    )
                })
            };
            let parent = find("parent", &joint.parent.link)?;
            let child = find("child", &joint.child.link)?;
            if let Some(other) = parent_joint[child].replace(i) {
                return Err(self.at_joint(
                    &joint.name,
                    format!(
                        "link {:?} is already moved by joint {:?}; closed loops are not supported, \
                         so a link can be the child of one joint only",
                        joint.child.link, joints[other].name
                    ),
                ));
            }
            child_joints[parent].push(i);
        }
        let roots: Vec<usize> = (0..links.len()).filter(|&i| parent_joint[i].is_none()).collect();
        let root = match roots[..] {
            [root] => root,
            [] if links.is_empty() => {
                return Err(self.error(place(), "has no links; expected at least one <link>"));
            }
            [] => {
                return Err(self.loop_error(
                    &(0..links.len()).collect::<Vec<_>>(),
                    &parent_joint,
                    &link_by_name,
                ));
            }
            _ => {
                let names: Vec<&str> = roots.iter().map(|&i| links[i].name.as_str()).collect();
                return Err(self.error(
                    place(),
                    format!(
                        "links {names:?} have no parent joint; expected one root, so join the others to it"
                    ),
                ));
            }
        };
        let mut tree = Tree { link_order: vec![root], joint_order: Vec::with_capacity(joints.len()) };
        // Depth first; the reversed push makes siblings come out in file order.
        let push = |stack: &mut Vec<(usize, usize)>, link: usize, position: usize| {
            stack.extend(child_joints[link].iter().rev().map(|&joint| (joint, position)));
        };
        let mut stack = Vec::new();
        push(&mut stack, root, 0);
        while let Some((joint, parent_position)) = stack.pop() {
            tree.joint_order.push((joint, parent_position));
            let child = link_by_name[joints[joint].child.link.as_str()];
            tree.link_order.push(child);
            push(&mut stack, child, tree.link_order.len() - 1);
        }
        if tree.link_order.len() < links.len() {
            let unreached: Vec<usize> = (0..links.len()).filter(|i| !tree.link_order.contains(i)).collect();
            return Err(self.loop_error(&unreached, &parent_joint, &link_by_name));
        }
        Ok(tree)
    }

    /// Names the joints of a loop among `links`, each of which has a parent joint and is not reached from the root.
    fn loop_error(
        &self,
        links: &[usize],
        parent_joint: &[Option<usize>],
        link_by_name: &HashMap<&str, usize>,
    ) -> ModelError {
        let parent_of = |link: usize| {
            parent_joint[link]
                .map(|joint| (joint, link_by_name[self.urdf.joints[joint].parent.link.as_str()]))
        };
        // Going up from any such link ends in the loop after at most as many steps as there are links.
        let mut link = links[0];
        for _ in 0..self.urdf.links.len() {
            link = parent_of(link).map_or(link, |(_, parent)| parent);
        }
        let start = link;
        let mut names = Vec::new();
        while let Some((joint, parent)) = parent_of(link) {
            names.push(self.urdf.joints[joint].name.as_str());
            link = parent;
            if link == start {
                break;
            }
        }
        names.reverse();
        self.at_joint(names[0], format!("joints {names:?} form a loop; expected a tree with one root link"))
    }

    fn link(&self, link: &urdf_rs::Link) -> Result<Link, ModelError> {
        let visuals = link
            .visual
            .iter()
            .map(|visual| {
                self.geometry(link, &visual.origin, &visual.geometry, self.rgba(visual.material.as_ref()))
            })
            .collect::<Result<_, _>>()?;
        let collisions = link
            .collision
            .iter()
            .map(|collision| self.geometry(link, &collision.origin, &collision.geometry, None))
            .collect::<Result<_, _>>()?;
        let inertial = inertial(&link.inertial).map_err(|problem| self.at_link(&link.name, problem))?;
        Ok(Link { name: link.name.clone(), visuals, collisions, inertial })
    }

    fn geometry(
        &self,
        link: &urdf_rs::Link,
        origin: &urdf_rs::Pose,
        geometry: &Geometry,
        rgba: Option<[f32; 4]>,
    ) -> Result<LinkGeometry, ModelError> {
        let (shape, kind, sizes) = match geometry {
            Geometry::Box { size } => (LinkShape::Box { size_m: size.0 }, "box size", size.0.to_vec()),
            &Geometry::Cylinder { radius, length } => (
                LinkShape::Cylinder { radius_m: radius, length_m: length },
                "cylinder radius and length",
                vec![radius, length],
            ),
            &Geometry::Capsule { radius, length } => (
                LinkShape::Capsule { radius_m: radius, length_m: length },
                "capsule radius and length",
                vec![radius, length],
            ),
            &Geometry::Sphere { radius } => {
                (LinkShape::Sphere { radius_m: radius }, "sphere radius", vec![radius])
            }
            Geometry::Mesh { filename, .. } => {
                return Err(self.at_link(
                    &link.name,
                    format!(
                        "mesh {filename:?} is not supported; describe the shape by boxes, cylinders, capsules \
                         and spheres"
                    ),
                ));
            }
        };
        if !sizes.iter().all(|size| size.is_finite() && *size > 0.0) {
            return Err(
                self.at_link(&link.name, format!("{kind} {sizes:?} must be finite and positive, in m"))
            );
        }
        let link_from_shape = isometry(origin).map_err(|problem| self.at_link(&link.name, problem))?;
        Ok(LinkGeometry { link_from_shape, shape, rgba })
    }

    /// A material's own colour, or that of the robot's material of the same name.
    fn rgba(&self, material: Option<&Material>) -> Option<[f32; 4]> {
        let material = material?;
        let color = material.color.as_ref().or_else(|| {
            self.urdf
                .materials
                .iter()
                .find(|shared| shared.name == material.name)
                .and_then(|shared| shared.color.as_ref())
        })?;
        color.rgba.iter().all(|v| v.is_finite()).then(|| color.rgba.0.map(|v| v as f32))
    }

    fn joint(
        &self,
        joint: &urdf_rs::Joint,
        parent_link: usize,
        child_link: usize,
    ) -> Result<Joint, ModelError> {
        let error = |problem: String| self.at_joint(&joint.name, problem);
        let kind = match joint.joint_type {
            JointType::Fixed => JointKind::Fixed,
            JointType::Revolute | JointType::Continuous => JointKind::Revolute,
            JointType::Prismatic => JointKind::Prismatic,
            JointType::Floating | JointType::Planar | JointType::Spherical => {
                return Err(error(format!(
                    "type {:?} is not supported; expected fixed, revolute, continuous or prismatic",
                    joint.joint_type
                )));
            }
        };
        let parent_from_joint = isometry(&joint.origin).map_err(error)?;
        let axis_in_joint = if kind == JointKind::Fixed {
            Vector3::x_axis()
        } else {
            let axis = Vector3::from(joint.axis.xyz.0);
            if !axis.iter().all(|v| v.is_finite()) {
                return Err(error(format!("axis {:?} must be finite", joint.axis.xyz.0)));
            }
            Unit::try_new(axis, 1e-6).ok_or_else(|| {
                error(format!("axis {:?} is zero; give the direction of motion", joint.axis.xyz.0))
            })?
        };
        let limits = match joint.joint_type {
            JointType::Revolute | JointType::Prismatic => limits(&joint.limit).map_err(error)?,
            _ => None,
        };
        Ok(Joint {
            name: joint.name.clone(),
            kind,
            parent_link,
            child_link,
            parent_from_joint,
            axis_in_joint,
            limits,
            dof: None,
            mimic: None,
        })
    }

    /// Fills in which joints follow others.
    fn mimics(&self, joints: &mut [Joint]) -> Result<(), ModelError> {
        for mimic in &self.urdf.joints {
            let Some(text) = &mimic.mimic else { continue };
            let error = |problem: String| self.at_joint(&mimic.name, problem);
            let find = |joints: &[Joint], name: &str| joints.iter().position(|joint| joint.name == name);
            let (multiplier, offset) = (text.multiplier.unwrap_or(1.0), text.offset.unwrap_or(0.0));
            if !(multiplier.is_finite() && offset.is_finite()) {
                return Err(error(format!(
                    "mimic multiplier {multiplier} and offset {offset} must be finite"
                )));
            }
            let Some(followed) = find(joints, &text.joint) else {
                let problem =
                    format!("mimics joint {:?}, which does not exist; correct the name", text.joint);
                return Err(error(problem));
            };
            let Some(own) = find(joints, &mimic.name) else { continue };
            // A fixed joint has nothing to follow with; some exporters leave the element in.
            if joints[own].kind == JointKind::Fixed {
                continue;
            }
            if joints[followed].kind == JointKind::Fixed {
                let problem =
                    format!("mimics joint {:?}, which is fixed; expected one that moves", text.joint);
                return Err(error(problem));
            }
            joints[own].mimic = Some(Mimic { joint: followed, multiplier, offset });
        }
        for joint in joints.iter() {
            let mut at = joint;
            for _ in 0..=joints.len() {
                match at.mimic {
                    Some(mimic) => at = &joints[mimic.joint],
                    None => break,
                }
            }
            if at.mimic.is_some() {
                let problem = "mimics itself, by way of the joints that it follows; expected one that follows none at the end";
                return Err(self.at_joint(&joint.name, problem));
            }
        }
        Ok(())
    }

    /// For each degree of freedom the index of its joint.
    fn dof_joints(
        &self,
        joints: &[Joint],
        urdf_order: &[&str],
        dof_names: &[String],
    ) -> Result<Vec<usize>, ModelError> {
        let joint_by_name: HashMap<&str, usize> =
            joints.iter().enumerate().map(|(i, joint)| (joint.name.as_str(), i)).collect();
        let moving = |name: &&str| joints[joint_by_name[*name]].kind != JointKind::Fixed;
        if dof_names.is_empty() {
            return Ok(urdf_order.iter().copied().filter(moving).map(|name| joint_by_name[name]).collect());
        }
        let mut dof_joints = Vec::with_capacity(dof_names.len());
        for name in dof_names {
            let known = || urdf_order.iter().copied().filter(moving).collect::<Vec<_>>();
            let &joint_idx = joint_by_name.get(name.as_str()).ok_or_else(|| {
                self.at_joint(
                    name,
                    format!("listed as a degree of freedom but not in the URDF; it has {:?}", known()),
                )
            })?;
            if joints[joint_idx].kind == JointKind::Fixed {
                return Err(
                    self.at_joint(name, "listed as a degree of freedom but fixed; take it off the list")
                );
            }
            if dof_joints.contains(&joint_idx) {
                return Err(
                    self.at_joint(name, "listed twice as a degree of freedom; name every moving joint once")
                );
            }
            dof_joints.push(joint_idx);
        }
        for joint in joints {
            if joint.kind != JointKind::Fixed && !dof_names.contains(&joint.name) {
                return Err(self.at_joint(
                    &joint.name,
                    "moves but is missing from the list of degrees of freedom; add it, or make it fixed",
                ));
            }
        }
        Ok(dof_joints)
    }
}

fn isometry(pose: &urdf_rs::Pose) -> Result<Isometry3<f64>, String> {
    let ([x, y, z], [roll, pitch, yaw]) = (pose.xyz.0, pose.rpy.0);
    if ![x, y, z, roll, pitch, yaw].iter().all(|v| v.is_finite()) {
        return Err(format!("origin xyz {:?} rpy {:?} must be finite", pose.xyz.0, pose.rpy.0));
    }
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw)))
}

/// `None` where the URDF gives no mass, which urdf-rs reads as zeros.
fn inertial(inertial: &urdf_rs::Inertial) -> Result<Option<Inertial>, String> {
    let mass_kg = inertial.mass.value;
    let &urdf_rs::Inertia { ixx, ixy, ixz, iyy, iyz, izz } = &inertial.inertia;
    if mass_kg == 0.0 && [ixx, ixy, ixz, iyy, iyz, izz] == [0.0; 6] {
        return Ok(None);
    }
    if !(mass_kg.is_finite() && mass_kg > 0.0) {
        return Err(format!("mass {mass_kg} must be finite and positive, in kg"));
    }
    let link_from_inertial = isometry(&inertial.origin)?;
    let inertia = Matrix3::new(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz);
    if !inertia.iter().all(|v| v.is_finite()) || inertia.cholesky().is_none() {
        return Err(format!(
            "inertia ixx {ixx}, ixy {ixy}, ixz {ixz}, iyy {iyy}, iyz {iyz}, izz {izz} must be positive about every axis"
        ));
    }
    let turn = link_from_inertial.rotation.to_rotation_matrix().into_inner();
    Ok(Some(Inertial {
        mass_kg,
        com_in_link: Point3::from(link_from_inertial.translation.vector),
        inertia_in_link: turn * inertia * turn.transpose(),
    }))
}

/// Limits of a revolute or prismatic joint; `None` where the URDF gives none, which urdf-rs reads as all zeros, or as
/// infinities from URDF 1.2 on.
fn limits(limit: &urdf_rs::JointLimit) -> Result<Option<JointLimits>, String> {
    let &urdf_rs::JointLimit { lower, upper, velocity, effort, .. } = limit;
    let all = [lower, upper, velocity, effort];
    if all.iter().any(|v| v.is_nan()) {
        return Err(format!(
            "limits lower {lower}, upper {upper}, velocity {velocity}, effort {effort} must be numbers"
        ));
    }
    if all == [0.0; 4] || (lower == f64::NEG_INFINITY && upper == f64::INFINITY) {
        return Ok(None);
    }
    if !all.iter().all(|v| v.is_finite()) {
        return Err(format!(
            "limits lower {lower}, upper {upper}, velocity {velocity}, effort {effort} must all be given and finite"
        ));
    }
    if lower > upper {
        return Err(format!("lower limit {lower} is above upper limit {upper}; swap them"));
    }
    if velocity < 0.0 || effort < 0.0 {
        return Err(format!("velocity limit {velocity} and effort limit {effort} must not be negative"));
    }
    Ok(Some(JointLimits { lower, upper, velocity, effort }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// base -> (slide) -> carriage -> (turn) -> tool, base -> (post, fixed) -> mast; children come first in the file.
    const BENCH: &str = r#"<robot name="bench">
        <material name="steel"><color rgba="0.5 0.6 0.7 1"/></material>
        <link name="tool">
          <visual><geometry><sphere radius="0.01"/></geometry><material name="steel"/></visual>
          <collision><origin xyz="0 0 0.02"/><geometry><capsule radius="0.01" length="0.04"/></geometry></collision>
        </link>
        <link name="carriage">
          <inertial>
            <origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/><mass value="2"/>
            <inertia ixx="1" ixy="0.1" ixz="0" iyy="2" iyz="0" izz="3"/>
          </inertial>
        </link>
        <link name="base"><visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual></link>
        <link name="mast"><collision><geometry><cylinder radius="0.02" length="0.5"/></geometry></collision></link>
        <joint name="turn" type="revolute">
          <parent link="carriage"/><child link="tool"/><axis xyz="0 0 2"/>
          <limit lower="-1" upper="2" velocity="3" effort="4"/>
        </joint>
        <joint name="post" type="fixed"><parent link="base"/><child link="mast"/></joint>
        <joint name="slide" type="prismatic">
          <parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
        </joint>
      </robot>"#;

    fn bench() -> Robot {
        Robot::from_urdf("bench.urdf", BENCH, &[]).expect("valid")
    }

    /// The message that `BENCH` gives after replacing `from`, which must occur, by `to`.
    fn refusal(from: &str, to: &str) -> String {
        assert!(BENCH.contains(from), "{from:?} is not in the fixture");
        Robot::from_urdf("bench.urdf", &BENCH.replacen(from, to, 1), &[])
            .expect_err("must be refused")
            .to_string()
    }

    fn dof_refusal(names: &[&str]) -> String {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        Robot::from_urdf("bench.urdf", BENCH, &names).expect_err("must be refused").to_string()
    }

    #[test]
    fn parents_come_before_children_whatever_the_file_order() {
        let robot = bench();
        let names: Vec<&str> = robot.links.iter().map(|link| link.name.as_str()).collect();
        assert_eq!(names, ["base", "mast", "carriage", "tool"]);
        for (i, joint) in robot.joints.iter().enumerate() {
            assert_eq!(joint.child_link, i + 1);
            assert!(joint.parent_link <= i);
        }
    }

    #[test]
    fn degrees_of_freedom_follow_the_urdf_or_the_list() {
        let own: Vec<String> = bench().dofs().map(|joint| joint.name.clone()).collect();
        assert_eq!(own, ["turn", "slide"]);
        let listed = ["slide".to_owned(), "turn".to_owned()];
        let robot = Robot::from_urdf("bench.urdf", BENCH, &listed).expect("valid");
        let names: Vec<&str> = robot.dofs().map(|joint| joint.name.as_str()).collect();
        assert_eq!(names, ["slide", "turn"]);
        assert_eq!(robot.dofs().map(|joint| joint.dof).collect::<Vec<_>>(), [Some(0), Some(1)]);
    }

    #[test]
    fn shapes_colours_and_limits_are_read() {
        let robot = bench();
        let tool = &robot.links[robot.link_index("tool").expect("tool")];
        assert_eq!(tool.visuals[0].rgba, Some([0.5, 0.6, 0.7, 1.0]));
        assert_eq!(tool.collisions[0].shape, LinkShape::Capsule { radius_m: 0.01, length_m: 0.04 });
        assert_eq!(tool.collisions[0].link_from_shape.translation.z, 0.02);
        let by_name = |name: &str| robot.joints.iter().find(|joint| joint.name == name).expect("joint");
        let turn_limits = JointLimits { lower: -1.0, upper: 2.0, velocity: 3.0, effort: 4.0 };
        assert_eq!(by_name("turn").limits, Some(turn_limits));
        assert_eq!(by_name("turn").axis_in_joint.into_inner(), Vector3::new(0.0, 0.0, 1.0));
        assert_eq!(by_name("slide").limits, None);
    }

    #[test]
    fn masses_are_read_in_the_links_axes() {
        let robot = bench();
        let of = |name: &str| robot.links[robot.link_index(name).expect("link")].inertial.clone();
        assert_eq!(of("base"), None);
        let carriage = of("carriage").expect("a mass");
        assert_eq!((carriage.mass_kg, carriage.com_in_link.z), (2.0, 0.1));
        // A quarter turn about z swaps x and y.
        let expected = Matrix3::new(2.0, -0.1, 0.0, -0.1, 1.0, 0.0, 0.0, 0.0, 3.0);
        assert!((carriage.inertia_in_link - expected).norm() < 1e-12, "{}", carriage.inertia_in_link);
    }

    #[test]
    fn missing_link_is_named() {
        let message = refusal(r#"<parent link="carriage"/>"#, r#"<parent link="carrage"/>"#);
        assert_eq!(
            message,
            "bench.urdf: joint \"turn\": parent link \"carrage\" does not exist; add the <link> or correct the name"
        );
        assert!(refusal(r#"<child link="tool"/>"#, r#"<child link="tol"/>"#).contains("child link \"tol\""));
    }

    #[test]
    fn second_parent_is_refused() {
        let message = refusal(r#"<child link="mast"/>"#, r#"<child link="carriage"/>"#);
        assert!(
            message.contains("joint \"slide\": link \"carriage\" is already moved by joint \"post\""),
            "{message}"
        );
    }

    #[test]
    fn loop_beside_the_root_is_named() {
        let message = refusal(
            r#"<parent link="base"/><child link="carriage"/>"#,
            r#"<parent link="tool"/><child link="carriage"/>"#,
        );
        assert!(
            message.contains("[\"turn\", \"slide\"] form a loop")
                || message.contains("[\"slide\", \"turn\"] form a loop"),
            "{message}"
        );
    }

    #[test]
    fn robot_that_is_all_loop_is_refused() {
        let urdf = r#"<robot name="ring"><link name="a"/><link name="b"/>
            <joint name="ab" type="fixed"><parent link="a"/><child link="b"/></joint>
            <joint name="ba" type="fixed"><parent link="b"/><child link="a"/></joint></robot>"#;
        let message = Robot::from_urdf("ring.urdf", urdf, &[]).expect_err("loop").to_string();
        assert!(message.contains("form a loop"), "{message}");
        let urdf = r#"<robot name="self"><link name="a"/>
            <joint name="aa" type="fixed"><parent link="a"/><child link="a"/></joint></robot>"#;
        let message = Robot::from_urdf("self.urdf", urdf, &[]).expect_err("loop").to_string();
        assert!(message.contains("joint \"aa\""), "{message}");
    }

    #[test]
    fn two_roots_are_named() {
        let message = refusal(r#"<link name="base">"#, r#"<link name="stray"/><link name="base">"#);
        assert!(
            message.contains("[\"base\", \"stray\"]") || message.contains("[\"stray\", \"base\"]"),
            "{message}"
        );
    }

    #[test]
    fn robot_without_links_and_broken_xml_are_refused() {
        let message =
            Robot::from_urdf("none.urdf", r#"<robot name="none"/>"#, &[]).expect_err("empty").to_string();
        assert!(message.contains("has no links"), "{message}");
        for text in ["", "<robot", "<robot name=\"a\"><link/></robot>", "name = 3"] {
            let message = Robot::from_urdf("broken.urdf", text, &[]).expect_err("broken").to_string();
            assert!(message.starts_with("broken.urdf: XML: not a URDF"), "{message}");
        }
    }

    #[test]
    fn unsupported_joints_and_shapes_are_refused() {
        let message = refusal(r#"type="fixed""#, r#"type="floating""#);
        assert!(message.contains("joint \"post\": type Floating is not supported"), "{message}");
        let message = refusal(r#"<sphere radius="0.01"/>"#, r#"<mesh filename="tool.stl"/>"#);
        assert!(message.contains("link \"tool\": mesh \"tool.stl\" is not supported"), "{message}");
    }

    #[test]
    fn joints_that_follow_others_say_how() {
        let with = |slide: &str, turn: &str| {
            let text = BENCH
                .replacen(r#"<axis xyz="1 0 0"/>"#, &format!(r#"<axis xyz="1 0 0"/>{slide}"#), 1)
                .replacen(r#"<axis xyz="0 0 2"/>"#, &format!(r#"<axis xyz="0 0 2"/>{turn}"#), 1);
            Robot::from_urdf("bench.urdf", &text, &[])
        };
        let robot = with(r#"<mimic joint="turn" multiplier="-0.5" offset="0.1"/>"#, "").expect("valid");
        assert_eq!(robot.num_dofs(), 2, "it is a degree of freedom of its own");
        let mimics = robot.mimics();
        let [(own, followed, mimic)] = mimics[..] else { panic!("one follows: {mimics:?}") };
        assert_eq!((own, followed, mimic.multiplier, mimic.offset), (1, 0, -0.5, 0.1));
        for (slide, turn, expected) in [
            (r#"<mimic joint="trun"/>"#, "", "joint \"slide\": mimics joint \"trun\", which does not exist"),
            (r#"<mimic joint="post"/>"#, "", "which is fixed"),
            (r#"<mimic joint="slide"/>"#, "", "joint \"slide\": mimics itself"),
            (r#"<mimic joint="turn"/>"#, r#"<mimic joint="slide"/>"#, "mimics itself"),
            (r#"<mimic joint="turn" multiplier="inf"/>"#, "", "must be finite"),
        ] {
            let message = with(slide, turn).expect_err(expected).to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn duplicate_names_are_refused() {
        assert!(
            refusal(r#"<link name="mast">"#, r#"<link name="tool">"#)
                .contains("link \"tool\": defined twice")
        );
        assert!(refusal(r#"name="post""#, r#"name="slide""#).contains("joint \"slide\": defined twice"));
    }

    #[test]
    fn bad_numbers_are_refused() {
        let cases = [
            (
                r#"<axis xyz="0 0 2"/>"#,
                r#"<axis xyz="0 0 0"/>"#,
                "joint \"turn\": axis [0.0, 0.0, 0.0] is zero",
            ),
            (r#"<axis xyz="0 0 2"/>"#, r#"<axis xyz="0 NaN 2"/>"#, "joint \"turn\": axis"),
            (r#"xyz="0 0 0.02""#, r#"xyz="0 inf 0.02""#, "link \"tool\": origin"),
            (
                r#"radius="0.02""#,
                r#"radius="-0.02""#,
                "link \"mast\": cylinder radius and length [-0.02, 0.5]",
            ),
            (r#"size="0.1 0.2 0.3""#, r#"size="0.1 0 0.3""#, "link \"base\": box size"),
            (r#"lower="-1""#, r#"lower="7""#, "joint \"turn\": lower limit 7 is above upper limit 2"),
            (r#"upper="2""#, r#"upper="NaN""#, "joint \"turn\": limits"),
            (r#"<mass value="2"/>"#, r#"<mass value="-2"/>"#, "link \"carriage\": mass -2 must be finite"),
            (r#"ixx="1""#, r#"ixx="-1""#, "link \"carriage\": inertia ixx -1"),
            (r#"ixy="0.1""#, r#"ixy="5""#, "must be positive about every axis"),
            (r#"velocity="3""#, r#"velocity="-3""#, "joint \"turn\": velocity limit -3"),
        ];
        for (from, to, expected) in cases {
            let message = refusal(from, to);
            assert!(message.contains(expected), "{to}: {message}");
        }
    }

    #[test]
    fn degree_of_freedom_lists_are_checked() {
        assert!(
            dof_refusal(&["slide", "trun"])
                .contains("joint \"trun\": listed as a degree of freedom but not in the URDF")
        );
        assert!(
            dof_refusal(&["slide", "turn", "post"])
                .contains("joint \"post\": listed as a degree of freedom but fixed")
        );
        assert!(dof_refusal(&["slide", "slide"]).contains("joint \"slide\": listed twice"));
        assert!(dof_refusal(&["slide"]).contains("joint \"turn\": moves but is missing"));
    }
}
