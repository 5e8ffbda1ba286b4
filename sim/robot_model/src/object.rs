//! Objects that are touched: primitives, convex parts, meshes.

mod convex;
pub(crate) mod mesh;
mod read;
mod revolved;

use nalgebra::{Isometry3, Point3};
use serde::Deserialize;

pub use convex::{ConvexPart, ConvexShape};

/// An object and its shape in its own frame.
#[derive(Clone, Debug)]
pub struct ObjectModel {
    /// Stable id, e.g. `sphere_50mm`.
    pub id: String,
    /// Name for people, e.g. `Sphere, r 50 mm`.
    pub label: String,
    /// Which part of a benchmark it belongs to; `None` for objects that are only touched, never grasped.
    pub group: Option<ObjectGroup>,
    /// Mass over volume, kg/m^3, the same everywhere in the object. `None` where nobody said; objects with a group
    /// have one.
    pub density_kg_m3: Option<f64>,
    /// Its shape, in the object's frame.
    pub shape: ObjectShape,
}

/// Whether a policy meets an object before it is scored on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectGroup {
    /// Experts, encoder and policy are trained on it.
    Seen,
    /// Held out of all training.
    Unseen,
}

impl ObjectGroup {
    /// As files and documents have it: `seen` or `unseen`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Seen => "seen",
            Self::Unseen => "unseen",
        }
    }
}

/// The shape of an object. Signed distances are negative inside.
#[derive(Clone, Debug)]
pub enum ObjectShape {
    /// A ball about the origin.
    Sphere {
        /// Radius, m.
        radius_m: f64,
    },
    /// A cylinder along z about the origin.
    Cylinder {
        /// Radius, m.
        radius_m: f64,
        /// Full height, m.
        height_m: f64,
    },
    /// A cylinder along z about the origin with a half ball on either end.
    Capsule {
        /// Radius, m.
        radius_m: f64,
        /// Length of the straight part, m: the whole is `2 radius_m` longer.
        length_m: f64,
    },
    /// A box about the origin.
    Box {
        /// Full edge lengths, m.
        size_m: [f64; 3],
    },
    /// A union of convex hulls.
    ConvexParts {
        /// Points of each part, in the object's frame, m.
        parts: Vec<Vec<Point3<f64>>>,
    },
    /// A closed triangle mesh, outward counter-clockwise.
    Mesh {
        /// Vertices in the object's frame, m.
        vertices: Vec<Point3<f64>>,
        /// Triangles as vertex indices.
        triangles: Vec<[u32; 3]>,
    },
    /// A union of posed shapes.
    Compound {
        /// Pose of each part in the object, and the part.
        parts: Vec<(Isometry3<f64>, ObjectShape)>,
    },
}

impl ObjectShape {
    /// The shape, `factor` times as large about the object's origin.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        match self {
            &Self::Sphere { radius_m } => Self::Sphere { radius_m: radius_m * factor },
            &Self::Cylinder { radius_m, height_m } => {
                Self::Cylinder { radius_m: radius_m * factor, height_m: height_m * factor }
            }
            &Self::Capsule { radius_m, length_m } => {
                Self::Capsule { radius_m: radius_m * factor, length_m: length_m * factor }
            }
            &Self::Box { size_m } => Self::Box { size_m: size_m.map(|edge_m| edge_m * factor) },
            Self::ConvexParts { parts } => Self::ConvexParts {
                parts: parts.iter().map(|points| points.iter().map(|p| p * factor).collect()).collect(),
            },
            Self::Mesh { vertices, triangles } => Self::Mesh {
                vertices: vertices.iter().map(|vertex| vertex * factor).collect(),
                triangles: triangles.clone(),
            },
            Self::Compound { parts } => Self::Compound {
                parts: parts
                    .iter()
                    .map(|(pose, shape)| {
                        let translation = (pose.translation.vector * factor).into();
                        (Isometry3::from_parts(translation, pose.rotation), shape.scaled(factor))
                    })
                    .collect(),
            },
        }
    }
}
