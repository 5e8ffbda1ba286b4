//! Objects that are touched: primitives, convex parts, meshes.

use nalgebra::{Isometry3, Point3};

use crate::ModelError;

/// An object and its shape in its own frame.
#[derive(Clone, Debug)]
pub struct ObjectModel {
    /// Stable id, e.g. `sphere_50mm`.
    pub id: String,
    /// Name for people, e.g. `Sphere, r 50 mm`.
    pub label: String,
    /// Its shape, in the object's frame.
    pub shape: ObjectShape,
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

impl ObjectModel {
    /// Reads an object file. `read_mesh` gives the bytes of a mesh that the file names (OBJ or STL).
    ///
    /// Refused, with the reason: non-positive sizes, an open or empty mesh, non-finite vertices.
    pub fn from_toml(
        file: &str,
        text: &str,
        read_mesh: impl FnMut(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Self, ModelError> {
        let _ = (file, text, read_mesh);
        todo!()
    }
}
