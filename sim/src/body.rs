//! Objects as rigid bodies: volume, mass, centre of mass, inertia, and the poses in which they rest on a table.
//!
//! A [`Solid`] is the union of an object's convex parts. What parts share counts once: each part adds its closed form
//! less what it has in common with the parts before it, so that parts that are apart or touch are exact and only
//! overlaps are integrated numerically. Nothing here simulates; [`rest`] says how poses at rest are found.

mod moments;
mod overlap;
mod part;
pub mod rest;

use nalgebra::{Matrix3, Point3, Vector3};
use palpate_robot_model::{ObjectModel, ObjectShape};
use parry3d_f64::transformation::try_convex_hull;

use self::{moments::Moments, part::Part};
use crate::geometry::SignedDistance;

pub use rest::RestPose;

/// The space that an object fills.
#[derive(Clone, Debug)]
pub struct Solid {
    parts: Vec<Part>,
    moments: Moments,
}

/// Mass properties of a rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassProperties {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the object's frame, m.
    pub com_in_object: Point3<f64>,
    /// Inertia about the centre of mass, along the object's axes, kg m^2.
    pub inertia_kg_m2: Matrix3<f64>,
}

impl Solid {
    /// Prepares `shape`; says why when it has no volume: an open mesh, a flat part, a mesh among other parts (whose
    /// overlap is not known).
    ///
    /// ```
    /// use palpate_robot_model::ObjectShape;
    /// use palpate_sim::body::Solid;
    ///
    /// let cube = Solid::new(&ObjectShape::Box { size_m: [0.06; 3] })?;
    /// assert!((cube.volume_m3() - 0.06_f64.powi(3)).abs() < 1e-12);
    /// assert_eq!(cube.rest_poses()?.len(), 6);
    /// # Ok::<(), String>(())
    /// ```
    pub fn new(shape: &ObjectShape) -> Result<Self, String> {
        // Whatever has no signed distance has no volume either, and says why.
        SignedDistance::new(shape)?;
        let parts = match shape {
            ObjectShape::Mesh { vertices, triangles } => {
                vec![Part::Polyhedron(part::Polyhedron::new(vertices.clone(), triangles.clone()))]
            }
            shape => {
                let parts = shape.convex_parts()?;
                parts.into_iter().map(Part::new).collect::<Result<Vec<_>, String>>()?
            }
        };
        let mut moments = Moments::default();
        for (i, part) in parts.iter().enumerate() {
            moments += part.moments();
            moments -= overlap::shared(part, &parts[..i]);
        }
        if !(moments.volume_m3.is_finite() && moments.volume_m3 > 0.0) {
            return Err(format!("its volume is {} m^3, expected a body with an inside", moments.volume_m3));
        }
        Ok(Self { parts, moments })
    }

    /// Volume, m^3.
    pub fn volume_m3(&self) -> f64 {
        self.moments.volume_m3
    }

    /// Centre of the volume in the object's frame, m: the centre of mass, as density is the same everywhere.
    pub fn centroid_in_object(&self) -> Point3<f64> {
        self.moments.centroid()
    }

    /// Mass properties at `density_kg_m3`.
    pub fn mass_properties(&self, density_kg_m3: f64) -> MassProperties {
        MassProperties {
            mass_kg: self.moments.volume_m3 * density_kg_m3,
            com_in_object: self.moments.centroid(),
            inertia_kg_m2: self.moments.inertia_m5() * density_kg_m3,
        }
    }

    /// Smallest and largest coordinates along the object's axes, m.
    pub fn bounds_m(&self) -> [[f64; 3]; 2] {
        let farthest = |sign: f64| {
            std::array::from_fn(|axis| {
                let direction = Vector3::ith(axis, sign);
                sign * self.farthest_along(&direction)
            })
        };
        [farthest(-1.0), farthest(1.0)]
    }

    /// Edges of the box along the object's axes that just holds it, m.
    pub fn size_m(&self) -> [f64; 3] {
        let [low, high] = self.bounds_m();
        std::array::from_fn(|axis| high[axis] - low[axis])
    }

    /// How it can rest on a table, likeliest first; see [`rest`]. Says why where the hull of its points is degenerate.
    pub fn rest_poses(&self) -> Result<Vec<RestPose>, String> {
        rest::poses(self)
    }

    /// Largest `direction . p` over its points p, m for a unit `direction`.
    pub fn farthest_along(&self, direction: &Vector3<f64>) -> f64 {
        let along = |part: &Part| part.support(direction).coords.dot(direction);
        self.parts.iter().map(along).fold(f64::NEG_INFINITY, f64::max)
    }
}

impl MassProperties {
    /// Those of an object whose file gives its density; says what is missing otherwise.
    pub fn of(object: &ObjectModel) -> Result<Self, String> {
        let Some(density_kg_m3) = object.density_kg_m3 else {
            return Err(format!(
                "object {:?} has no density_kg_m3, so its mass is not known; add it to the object's file",
                object.id
            ));
        };
        let solid =
            Solid::new(&object.shape).map_err(|problem| format!("object {:?}: {problem}", object.id))?;
        Ok(solid.mass_properties(density_kg_m3))
    }
}

/// Vertices, and triangles that are counter-clockwise seen from outside.
type Surface = (Vec<Point3<f64>>, Vec<[u32; 3]>);

/// The convex hull of `points`.
fn convex_hull(points: &[Point3<f64>]) -> Result<Surface, String> {
    let points: Vec<_> = points.iter().map(crate::geometry::parry_vector).collect();
    let (vertices, triangles) =
        try_convex_hull(&points).map_err(|err| format!("its points have no convex hull ({err})"))?;
    Ok((vertices.into_iter().map(|v| Point3::new(v.x, v.y, v.z)).collect(), triangles))
}

#[cfg(test)]
mod tests;
