//! A tree of links and joints read from URDF, and its forward kinematics.

use nalgebra::{Isometry3, Unit, Vector3};

use crate::ModelError;

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
    /// Refused, naming the joint or link: a joint whose parent or child link is missing, loops and more than one
    /// root, mimic joints, meshes, non-finite numbers, a zero axis, unknown or missing names in `dof_names`.
    pub fn from_urdf(file: &str, text: &str, dof_names: &[String]) -> Result<Self, ModelError> {
        let _ = (file, text, dof_names);
        todo!()
    }

    /// Number of degrees of freedom.
    pub fn num_dofs(&self) -> usize {
        self.dof_joints.len()
    }

    /// The joint of each degree of freedom, in order.
    pub fn dofs(&self) -> impl ExactSizeIterator<Item = &Joint> {
        self.dof_joints.iter().map(|&joint_idx| &self.joints[joint_idx])
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
    pub fn forward_kinematics(&self, positions: &[f64], root_from_link: &mut Vec<Isometry3<f64>>) {
        let _ = (positions, root_from_link);
        todo!()
    }
}
