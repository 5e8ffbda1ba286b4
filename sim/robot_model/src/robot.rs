//! A tree of links and joints read from URDF, and its forward kinematics.

mod path;
mod simplify;
mod urdf;

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::ModelError;
pub use path::{KnownPoses, LinkPoses, LinkTracker};
pub use simplify::{SimplifiedUrdf, simplify_urdf};

/// A kinematic tree. Links are stored parents before children; link 0 is the root.
#[derive(Clone, Debug)]
pub struct Robot {
    /// The URDF's `name`.
    pub name: String,
    /// Links, parents before children; index 0 is the root.
    pub links: Vec<Link>,
    /// Joints, in the order of their child links: `joints[i]` moves `links[i + 1]`.
    pub joints: Vec<Joint>,
    /// For each degree of freedom, in the station's order, the index of its joint.
    dof_joints: Vec<usize>,
}

/// One rigid body.
#[derive(Clone, Debug)]
pub struct Link {
    /// Name in the URDF.
    pub name: String,
    /// Visual shapes, in the link's frame.
    pub visuals: Vec<LinkGeometry>,
    /// Collision shapes, in the link's frame.
    pub collisions: Vec<LinkGeometry>,
    /// Its mass; `None` for a link without one, such as a mere frame.
    pub inertial: Option<Inertial>,
}

/// Mass of a link and how it is distributed.
#[derive(Clone, Debug, PartialEq)]
pub struct Inertial {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the link's frame, m.
    pub com_in_link: Point3<f64>,
    /// Inertia about the centre of mass along the axes of the link's frame, kg m^2.
    pub inertia_in_link: Matrix3<f64>,
}

/// A shape fixed to a link.
#[derive(Clone, Debug)]
pub struct LinkGeometry {
    /// Pose of the shape in the link.
    pub link_from_shape: Isometry3<f64>,
    /// The shape, centred on its own frame; cylinders and capsules along z, as in URDF.
    pub shape: LinkShape,
    /// Linear RGBA from the URDF's material, if any.
    pub rgba: Option<[f32; 4]>,
}

impl LinkGeometry {
    /// Lowest and highest coordinates, m, of the shape in the frame that `frame_from_link` leads to. Exact, not those of a
    /// box around it.
    pub fn bounds(&self, frame_from_link: &Isometry3<f64>) -> [Point3<f64>; 2] {
        let frame_from_shape = frame_from_link * self.link_from_shape;
        let axes = frame_from_shape.rotation.to_rotation_matrix();
        // How far the shape reaches from its centre along each axis of the frame; of a cylinder, the rim does.
        let reach = Vector3::from_fn(|axis, _| {
            let along = axes.matrix().row(axis);
            let along_z = along[2].abs();
            match self.shape {
                LinkShape::Box { size_m } => {
                    0.5 * along.iter().zip(size_m).map(|(along, size_m)| along.abs() * size_m).sum::<f64>()
                }
                LinkShape::Cylinder { radius_m, length_m } => {
                    0.5 * length_m * along_z + radius_m * along[0].hypot(along[1])
                }
                LinkShape::Capsule { radius_m, length_m } => 0.5 * length_m * along_z + radius_m,
                LinkShape::Sphere { radius_m } => radius_m,
            }
        });
        let centre = Point3::from(frame_from_shape.translation.vector);
        [centre - reach, centre + reach]
    }
}

/// Primitive shapes of a link. Meshes are not supported: our robots are drawn from primitives.
#[derive(Clone, Debug, PartialEq)]
pub enum LinkShape {
    /// Full edge lengths, m.
    Box {
        /// Edge lengths along x, y, z, m.
        size_m: [f64; 3],
    },
    /// A cylinder along z.
    Cylinder {
        /// Radius, m.
        radius_m: f64,
        /// Full length, m.
        length_m: f64,
    },
    /// A cylinder with round ends along z; `length_m` is that of the cylindrical part.
    Capsule {
        /// Radius, m.
        radius_m: f64,
        /// Length of the cylindrical part, m.
        length_m: f64,
    },
    /// A ball.
    Sphere {
        /// Radius, m.
        radius_m: f64,
    },
}

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// Does not move.
    Fixed,
    /// Turns about its axis; position in rad.
    Revolute,
    /// Slides along its axis; position in m.
    Prismatic,
}

/// A joint between two links.
#[derive(Clone, Debug)]
pub struct Joint {
    /// Name in the URDF.
    pub name: String,
    /// How it moves.
    pub kind: JointKind,
    /// Index of the parent link.
    pub parent_link: usize,
    /// Index of the child link.
    pub child_link: usize,
    /// Pose of the joint (and of the child link at position zero) in the parent link.
    pub parent_from_joint: Isometry3<f64>,
    /// Axis of motion in the joint frame.
    pub axis_in_joint: Unit<Vector3<f64>>,
    /// Limits, for joints that move and have them.
    pub limits: Option<JointLimits>,
    /// Which degree of freedom drives it, in the station's order; `None` for fixed joints.
    pub dof: Option<usize>,
    /// The joint that it follows, where the URDF says so. It is a degree of freedom all the same: a recording may hold
    /// what it really did.
    pub mimic: Option<Mimic>,
}

/// A joint follows another: its position is `multiplier` times the other's plus `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mimic {
    /// Index of the joint that it follows, in [`Robot::joints`]. That one moves, and following on from it ends.
    pub joint: usize,
    /// Position of this joint for each unit of the other's, rad or m.
    pub multiplier: f64,
    /// Position of this joint where the other is at zero, rad or m.
    pub offset: f64,
}

/// A degree of freedom moves with another that follows none: it is at `multiplier` times the other's position plus
/// `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Led {
    /// The one that follows.
    pub dof: usize,
    /// The one that it moves with.
    pub leader: usize,
    /// Its position for each unit of the leader's, rad or m.
    pub multiplier: f64,
    /// Its position where the leader is at zero, rad or m.
    pub offset: f64,
}

/// Limits of a joint, rad or m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// Lowest position.
    pub lower: f64,
    /// Highest position.
    pub upper: f64,
    /// Largest speed, per s.
    pub velocity: f64,
    /// Largest torque (N m) or force (N).
    pub effort: f64,
}

impl Robot {
    /// Reads a URDF. `file` names it in errors. Degrees of freedom come in the order of `dof_names`, which must
    /// name every moving joint once; an empty list means the URDF's own order.
    ///
    /// Continuous joints become [`JointKind::Revolute`] without limits. A moving joint whose URDF gives no limits has
    /// none here. A joint that mimics another is a degree of freedom of its own, and [`Joint::mimic`] says what it follows.
    ///
    /// Refused, naming the joint or link: a joint whose parent or child link is missing, loops and more than one root,
    /// duplicate names, joints with several degrees of freedom, joints that mimic fixed ones or themselves, meshes,
    /// non-finite numbers, sizes that are not positive, masses that are not positive and inertias that no body can have,
    /// crossed limits, a zero axis, unknown or missing names in `dof_names`.
    pub fn from_urdf(file: &str, text: &str, dof_names: &[String]) -> Result<Self, ModelError> {
        urdf::read(file, text, dof_names)
    }

    /// Number of degrees of freedom.
    pub fn num_dofs(&self) -> usize {
        self.dof_joints.len()
    }

    /// The joint of each degree of freedom, in order.
    pub fn dofs(&self) -> impl ExactSizeIterator<Item = &Joint> {
        self.dof_joints.iter().map(|&joint_idx| &self.joints[joint_idx])
    }

    /// The degrees of freedom that follow others: `(its index, index of the other, how)`, those that others follow first.
    pub fn mimics(&self) -> Vec<(usize, usize, Mimic)> {
        // How many joints are followed until one follows no other.
        let depth = |joint: &Joint| {
            let (mut mimic, mut depth) = (joint.mimic, 0);
            while let Some(Mimic { joint, .. }) = mimic {
                (mimic, depth) = (self.joints[joint].mimic, depth + 1);
            }
            depth
        };
        let mut mimics: Vec<_> = self.joints.iter().filter(|joint| joint.mimic.is_some()).collect();
        mimics.sort_by_key(|joint| depth(joint));
        let dofs = |joint: &Joint| {
            let mimic = joint.mimic?;
            Some((joint.dof?, self.joints[mimic.joint].dof?, mimic))
        };
        mimics.into_iter().filter_map(dofs).collect()
    }

    /// Moves every degree of freedom that follows another to where it follows it to.
    pub fn follow(&self, positions: &mut [f64]) {
        for (dof, followed, mimic) in self.mimics() {
            positions[dof] = mimic.multiplier * positions[followed] + mimic.offset;
        }
    }

    /// The degrees of freedom that follow others, with the one at the end of each chain, which follows none.
    pub fn led(&self) -> Vec<Led> {
        let mut led: Vec<Led> = Vec::new();
        for (dof, followed, mimic) in self.mimics() {
            let of_followed = led.iter().find(|other| other.dof == followed).copied();
            let of_followed =
                of_followed.unwrap_or(Led { dof: followed, leader: followed, multiplier: 1.0, offset: 0.0 });
            led.push(Led {
                dof,
                leader: of_followed.leader,
                multiplier: mimic.multiplier * of_followed.multiplier,
                offset: mimic.multiplier * of_followed.offset + mimic.offset,
            });
        }
        led
    }

    /// Index of the link called `name`.
    pub fn link_index(&self, name: &str) -> Option<usize> {
        self.links.iter().position(|link| link.name == name)
    }

    /// Pose of every link in the root frame: `root_from_link[i]` belongs to `links[i]`.
    ///
    /// `positions` holds one value per degree of freedom (rad or m); limits are not applied, because a measured
    /// position is a fact. `root_from_link` is resized to the number of links, so that a caller can reuse it.
    ///
    /// # Panics
    /// If `positions` has the wrong length: a caller's bug, since readers check lengths when data comes in.
    ///
    /// # Example
    /// ```
    /// use palpate_robot_model::Robot;
    ///
    /// let urdf = r#"<robot name="arm">
    ///   <link name="base"/>
    ///   <link name="tip"/>
    ///   <joint name="lift" type="prismatic">
    ///     <parent link="base"/> <child link="tip"/>
    ///     <origin xyz="0.1 0 0"/> <axis xyz="0 0 1"/>
    ///   </joint>
    /// </robot>"#;
    /// let robot = Robot::from_urdf("arm.urdf", urdf, &[])?;
    /// let mut root_from_link = Vec::new();
    /// robot.forward_kinematics(&[0.25], &mut root_from_link);
    /// let tip_in_root = root_from_link[1].translation.vector;
    /// assert_eq!((tip_in_root.x, tip_in_root.z), (0.1, 0.25));
    /// # Ok::<(), palpate_robot_model::ModelError>(())
    /// ```
    pub fn forward_kinematics(&self, positions: &[f64], root_from_link: &mut Vec<Isometry3<f64>>) {
        assert_eq!(positions.len(), self.num_dofs(), "one position per degree of freedom");
        root_from_link.clear();
        root_from_link.push(Isometry3::identity());
        for joint in &self.joints {
            root_from_link.push(joint.child_pose(root_from_link, positions));
        }
    }
}

impl Joint {
    /// Pose of the child link in the root frame, given those of all links before it and one position per degree of freedom.
    fn child_pose(&self, root_from_link: &[Isometry3<f64>], positions: &[f64]) -> Isometry3<f64> {
        let root_from_joint = root_from_link[self.parent_link] * self.parent_from_joint;
        match self.dof {
            Some(dof) => self.moved(&root_from_joint, positions[dof]),
            None => root_from_joint,
        }
    }

    /// Pose of the child link after moving by `position` from the joint frame: `root_from_joint * motion`, without
    /// the multiplications by one and zero.
    fn moved(&self, root_from_joint: &Isometry3<f64>, position: f64) -> Isometry3<f64> {
        match self.kind {
            JointKind::Fixed => *root_from_joint,
            JointKind::Revolute => Isometry3::from_parts(
                root_from_joint.translation,
                root_from_joint.rotation * UnitQuaternion::from_axis_angle(&self.axis_in_joint, position),
            ),
            JointKind::Prismatic => {
                let slide_in_root = root_from_joint.rotation * (self.axis_in_joint.into_inner() * position);
                Isometry3::from_parts(
                    Translation3::from(root_from_joint.translation.vector + slide_in_root),
                    root_from_joint.rotation,
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix4, Rotation3};
    use proptest::prelude::*;

    use super::*;

    /// One joint of a random chain: kind, xyz, rpy, axis, position.
    type ChainJoint = (usize, [f64; 3], [f64; 3], [f64; 3], f64);

    fn chain_joint() -> impl Strategy<Value = ChainJoint> {
        let xyz = prop::array::uniform3(-0.5..0.5);
        let rpy = prop::array::uniform3(-3.0..3.0);
        let axis = prop::array::uniform3(-1.0..1.0)
            .prop_filter("axis is not zero", |a: &[f64; 3]| a.iter().map(|v| v * v).sum::<f64>() > 0.01);
        (0_usize..4, xyz, rpy, axis, -2.0..2.0)
    }

    const KINDS: [&str; 4] = ["fixed", "revolute", "continuous", "prismatic"];

    fn xyz_text(v: &[f64; 3]) -> String {
        format!("{:?} {:?} {:?}", v[0], v[1], v[2])
    }

    fn chain_urdf(chain: &[ChainJoint]) -> String {
        let mut urdf = String::from("<robot name=\"chain\"><link name=\"l0\"/>");
        for (i, (kind, xyz, rpy, axis, _)) in chain.iter().enumerate() {
            urdf += &format!(
                "<link name=\"l{next}\"/><joint name=\"j{i}\" type=\"{kind}\"><parent link=\"l{i}\"/><child link=\"l{next}\"/>\
                 <origin xyz=\"{xyz}\" rpy=\"{rpy}\"/><axis xyz=\"{axis}\"/></joint>",
                next = i + 1,
                kind = KINDS[*kind],
                xyz = xyz_text(xyz),
                rpy = xyz_text(rpy),
                axis = xyz_text(axis),
            );
        }
        urdf + "</robot>"
    }

    /// The same motion as 4x4 matrices, straight from the URDF's definition (fixed-axis roll, pitch, yaw).
    fn chain_matrix(chain: &[ChainJoint], sign: f64) -> Matrix4<f64> {
        let mut root_from_link = Matrix4::identity();
        for (kind, xyz, rpy, axis, position) in chain {
            let axis = Unit::new_normalize(Vector3::from(*axis));
            let motion = match KINDS[*kind] {
                "fixed" => Matrix4::identity(),
                "prismatic" => Matrix4::new_translation(&(axis.into_inner() * *position * sign)),
                _ => Rotation3::from_axis_angle(&axis, *position * sign).to_homogeneous(),
            };
            let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), rpy[2])
                * Rotation3::from_axis_angle(&Vector3::y_axis(), rpy[1])
                * Rotation3::from_axis_angle(&Vector3::x_axis(), rpy[0]);
            root_from_link = root_from_link
                * Matrix4::new_translation(&Vector3::from(*xyz))
                * rotation.to_homogeneous()
                * motion;
        }
        root_from_link
    }

    fn positions(chain: &[ChainJoint]) -> Vec<f64> {
        chain.iter().filter(|joint| KINDS[joint.0] != "fixed").map(|joint| joint.4).collect()
    }

    proptest! {
        #[test]
        fn chain_is_the_product_of_its_transforms(chain in prop::collection::vec(chain_joint(), 1..9)) {
            let robot = Robot::from_urdf("chain.urdf", &chain_urdf(&chain), &[]).expect("valid chain");
            let mut root_from_link = Vec::new();
            robot.forward_kinematics(&positions(&chain), &mut root_from_link);
            prop_assert_eq!(root_from_link.len(), chain.len() + 1);
            for (i, pose) in root_from_link.iter().enumerate() {
                let difference = (pose.to_homogeneous() - chain_matrix(&chain[..i], 1.0)).abs().max();
                prop_assert!(difference < 1e-12, "link {} is off by {}", i, difference);
            }
        }

        #[test]
        fn motion_and_its_inverse_cancel(joint in chain_joint()) {
            let robot = Robot::from_urdf("chain.urdf", &chain_urdf(&[joint]), &[]).expect("valid chain");
            let joint_frame = &robot.joints[0];
            let there = joint_frame.moved(&joint_frame.parent_from_joint, joint.4);
            let back = joint_frame.moved(&there, -joint.4);
            let difference = (back.to_homogeneous() - joint_frame.parent_from_joint.to_homogeneous()).abs().max();
            prop_assert!(difference < 1e-14, "off by {}", difference);
        }

        #[test]
        fn order_of_dof_names_moves_columns_only(chain in prop::collection::vec(chain_joint(), 2..9)) {
            let own = Robot::from_urdf("chain.urdf", &chain_urdf(&chain), &[]).expect("valid chain");
            let mut names: Vec<String> = own.dofs().map(|joint| joint.name.clone()).collect();
            names.reverse();
            let reversed = Robot::from_urdf("chain.urdf", &chain_urdf(&chain), &names).expect("valid chain");
            let mut columns = positions(&chain);
            let (mut poses, mut poses_reversed) = (Vec::new(), Vec::new());
            own.forward_kinematics(&columns, &mut poses);
            columns.reverse();
            reversed.forward_kinematics(&columns, &mut poses_reversed);
            prop_assert_eq!(poses, poses_reversed);
        }
    }

    #[test]
    fn buffer_is_reused_without_reallocation() {
        let chain: Vec<ChainJoint> =
            (0..7).map(|i| (i % 4, [0.1; 3], [0.2; 3], [0.0, 1.0, 0.0], 0.3)).collect();
        let robot = Robot::from_urdf("chain.urdf", &chain_urdf(&chain), &[]).expect("valid chain");
        let mut root_from_link = Vec::new();
        robot.forward_kinematics(&positions(&chain), &mut root_from_link);
        let (first, storage) = (root_from_link.clone(), root_from_link.as_ptr());
        robot.forward_kinematics(&positions(&chain), &mut root_from_link);
        assert_eq!(root_from_link, first);
        assert_eq!(root_from_link.as_ptr(), storage);
    }

    /// Points on the surface of a shape, among them those that reach furthest along any direction, to within a degree.
    fn surface(shape: &LinkShape) -> Vec<Point3<f64>> {
        let turn = |step: i32| f64::from(step).to_radians();
        let circle = |radius_m: f64, z: f64| {
            (0..360).map(move |step| Point3::new(radius_m * turn(step).cos(), radius_m * turn(step).sin(), z))
        };
        let ball = |radius_m: f64, from_z: f64| {
            (-90..=90).flat_map(move |step| {
                circle(
                    radius_m * turn(step).cos(),
                    from_z * f64::from(step.signum()) + radius_m * turn(step).sin(),
                )
            })
        };
        match *shape {
            LinkShape::Box { size_m } => (0..8)
                .map(|corner: u32| {
                    Point3::from(Vector3::from_fn(|axis, _| {
                        size_m[axis] * (f64::from(corner >> axis & 1) - 0.5)
                    }))
                })
                .collect(),
            LinkShape::Cylinder { radius_m, length_m } => {
                [-0.5, 0.5].into_iter().flat_map(|end| circle(radius_m, end * length_m)).collect()
            }
            LinkShape::Capsule { radius_m, length_m } => ball(radius_m, 0.5 * length_m).collect(),
            LinkShape::Sphere { radius_m } => ball(radius_m, 0.0).collect(),
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

        #[test]
        fn bounds_hold_the_whole_shape_and_nothing_more(
            kind in 0_usize..4,
            size in prop::array::uniform3(0.01..0.3),
            poses in prop::array::uniform2(prop::array::uniform6(-3.0..3.0)),
        ) {
            let [pose, link] = poses.map(|p| {
                Isometry3::new(Vector3::new(p[0], p[1], p[2]), Vector3::new(p[3], p[4], p[5]))
            });
            let [radius_m, length_m, _] = size;
            let shape = match kind {
                0 => LinkShape::Box { size_m: size },
                1 => LinkShape::Cylinder { radius_m, length_m },
                2 => LinkShape::Capsule { radius_m, length_m },
                _ => LinkShape::Sphere { radius_m },
            };
            let points: Vec<Point3<f64>> = surface(&shape).iter().map(|at| link * pose * at).collect();
            let geometry = LinkGeometry { link_from_shape: pose, shape, rgba: None };
            let [low, high] = geometry.bounds(&link);
            for axis in 0..3 {
                let found = points.iter().map(|at| at[axis]);
                let (least, most) = (found.clone().fold(f64::MAX, f64::min), found.fold(f64::MIN, f64::max));
                // A degree of a circle of 0.3 m is 0.05 mm of its radius.
                prop_assert!((0.0..1e-4).contains(&(least - low[axis] + 1e-12)), "{least} {}", low[axis]);
                prop_assert!((0.0..1e-4).contains(&(high[axis] - most + 1e-12)), "{most} {}", high[axis]);
            }
        }
    }
}
