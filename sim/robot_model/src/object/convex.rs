//! Objects as posed convex parts: what physics engines and mass properties work with.

use nalgebra::{Isometry3, Point3};

use super::ObjectShape;

/// A convex part of an object.
#[derive(Clone, Debug)]
pub struct ConvexPart {
    /// Pose of the part's frame in the object's.
    pub object_from_part: Isometry3<f64>,
    /// Its shape, in the part's frame.
    pub shape: ConvexShape,
}

/// The shape of a convex part, about the part's origin.
#[derive(Clone, Debug)]
pub enum ConvexShape {
    /// A ball.
    Sphere {
        /// Radius, m.
        radius_m: f64,
    },
    /// A box.
    Box {
        /// Full edge lengths, m.
        size_m: [f64; 3],
    },
    /// A cylinder along z.
    Cylinder {
        /// Radius, m.
        radius_m: f64,
        /// Full height, m.
        height_m: f64,
    },
    /// A cylinder along z with a half ball on either end.
    Capsule {
        /// Radius, m.
        radius_m: f64,
        /// Length of the straight part, m.
        length_m: f64,
    },
    /// The convex hull of points.
    Hull {
        /// The points, m: at least four that do not lie in one plane; some may lie inside.
        points: Vec<Point3<f64>>,
    },
}

impl ObjectShape {
    /// The convex parts whose union the shape is, in the order of the file; says why where it has none (a mesh).
    ///
    /// ```
    /// use palpate_robot_model::{ConvexShape, ObjectShape};
    ///
    /// let parts = ObjectShape::Sphere { radius_m: 0.03 }.convex_parts()?;
    /// assert!(matches!(parts[0].shape, ConvexShape::Sphere { radius_m: 0.03 }));
    /// # Ok::<(), String>(())
    /// ```
    pub fn convex_parts(&self) -> Result<Vec<ConvexPart>, String> {
        let mut parts = Vec::new();
        self.push_convex_parts(&Isometry3::identity(), &mut parts)?;
        Ok(parts)
    }

    fn push_convex_parts(
        &self,
        object_from_shape: &Isometry3<f64>,
        parts: &mut Vec<ConvexPart>,
    ) -> Result<(), String> {
        let mut push = |shape| parts.push(ConvexPart { object_from_part: *object_from_shape, shape });
        match self {
            &Self::Sphere { radius_m } => push(ConvexShape::Sphere { radius_m }),
            &Self::Cylinder { radius_m, height_m } => push(ConvexShape::Cylinder { radius_m, height_m }),
            &Self::Capsule { radius_m, length_m } => push(ConvexShape::Capsule { radius_m, length_m }),
            &Self::Box { size_m } => push(ConvexShape::Box { size_m }),
            Self::ConvexParts { parts: hulls } => {
                hulls.iter().for_each(|points| push(ConvexShape::Hull { points: points.clone() }));
            }
            Self::Mesh { .. } => {
                return Err(
                    "a mesh has no convex parts; give the object as primitives or convex_parts".to_owned()
                );
            }
            Self::Compound { parts: posed } => {
                for (part_idx, (shape_from_part, shape)) in posed.iter().enumerate() {
                    shape
                        .push_convex_parts(&(object_from_shape * shape_from_part), parts)
                        .map_err(|problem| format!("part {part_idx}: {problem}"))?;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nested_parts_come_in_order_with_their_poses_chained() {
        let at = |x| Isometry3::translation(x, 0.0, 0.0);
        let hulls = vec![vec![Point3::origin(); 4]; 2];
        let shape = ObjectShape::Compound {
            parts: vec![
                (
                    at(1.0),
                    ObjectShape::Compound { parts: vec![(at(2.0), ObjectShape::Box { size_m: [1.0; 3] })] },
                ),
                (at(5.0), ObjectShape::ConvexParts { parts: hulls }),
            ],
        };
        let parts = shape.convex_parts().unwrap();
        let x: Vec<f64> = parts.iter().map(|part| part.object_from_part.translation.x).collect();
        assert_eq!(x, [3.0, 5.0, 5.0]);
        let mesh = ObjectShape::Mesh { vertices: vec![], triangles: vec![] };
        let shape = ObjectShape::Compound { parts: vec![(at(0.0), mesh)] };
        assert!(shape.convex_parts().unwrap_err().starts_with("part 0: a mesh has no convex parts"));
    }
}
