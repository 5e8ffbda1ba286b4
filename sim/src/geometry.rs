//! Signed distance from points to the touched object (parry).

use nalgebra::Point3;
use palpate_robot_model::ObjectShape;

/// A shape that answers signed-distance queries, in the object's own frame.
pub struct SignedDistance {
    // parry shapes, built once
}

impl SignedDistance {
    /// Prepares `shape`; says why when it has no inside (an open mesh) or is degenerate.
    pub fn new(shape: &ObjectShape) -> Result<Self, String> {
        let _ = shape;
        todo!()
    }

    /// Signed distance of `pos_in_object` to the surface, m; negative inside.
    pub fn distance_m(&self, pos_in_object: &Point3<f64>) -> f64 {
        let _ = pos_in_object;
        todo!()
    }

    /// Radius about the object's origin that holds all of it, m: a cheap bound to skip far patches with.
    pub fn bounding_radius_m(&self) -> f64 {
        todo!()
    }
}
