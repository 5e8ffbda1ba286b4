//! Signed distance from points to the touched object, and clearance of robot links (parry).

mod clearance;
mod convex;
mod mesh;

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use palpate_robot_model::{LinkShape, ObjectShape};
use parry3d_f64::math::{Pose, Rotation, Vector};
use parry3d_f64::shape::{SharedShape, TriMesh};

pub use clearance::LinkClearance;

/// A shape that answers signed-distance queries, in the object's own frame.
///
/// Distances are exact (to rounding) outside of every shape and inside of single primitives, convex parts and meshes.
/// Unions (convex parts, compounds) take the smallest distance over their parts: exact outside; inside, where parts
/// overlap or share a face, the depth is that of the deepest part, which is at most the true depth. In every case the
/// result changes by no more than the query point moves (1-Lipschitz).
#[derive(Clone, Debug)]
pub struct SignedDistance {
    shape: Shape,
    bounding_radius_m: f64,
}

#[derive(Clone, Debug)]
enum Shape {
    Ball { radius: f64 },
    Cylinder { radius: f64, half_height: f64 },
    Capsule { radius: f64, half_length: f64 },
    Cuboid { half_extents: Vector3<f64> },
    Convex(convex::Convex),
    Mesh(TriMesh),
    Union(Vec<Part>),
}

#[derive(Clone, Debug)]
struct Part {
    object_from_part: Isometry3<f64>,
    part_from_object: Isometry3<f64>,
    shape: SignedDistance,
}

impl SignedDistance {
    /// Prepares `shape`; says why when it has no inside (an open mesh) or is degenerate.
    ///
    /// # Example
    /// ```
    /// use nalgebra::Point3;
    /// use palpate_robot_model::ObjectShape;
    /// use palpate_sim::geometry::SignedDistance;
    ///
    /// let ball = SignedDistance::new(&ObjectShape::Sphere { radius_m: 0.05 })?;
    /// assert!((ball.distance_m(&Point3::new(0.0, 0.03, 0.0)) + 0.02).abs() < 1e-12);
    /// # Ok::<(), String>(())
    /// ```
    pub fn new(shape: &ObjectShape) -> Result<Self, String> {
        let (shape, bounding_radius_m) = match shape {
            &ObjectShape::Sphere { radius_m } => {
                check_sizes("sphere radius", &[radius_m])?;
                return Ok(Self::of_link_shape(&LinkShape::Sphere { radius_m }));
            }
            &ObjectShape::Cylinder { radius_m, height_m } => {
                check_sizes("cylinder radius and height", &[radius_m, height_m])?;
                return Ok(Self::of_link_shape(&LinkShape::Cylinder { radius_m, length_m: height_m }));
            }
            &ObjectShape::Capsule { radius_m, length_m } => {
                check_sizes("capsule radius and length", &[radius_m, length_m])?;
                return Ok(Self::of_link_shape(&LinkShape::Capsule { radius_m, length_m }));
            }
            &ObjectShape::Box { size_m } => {
                check_sizes("box size", &size_m)?;
                return Ok(Self::of_link_shape(&LinkShape::Box { size_m }));
            }
            ObjectShape::ConvexParts { parts } => {
                let convex_part = |(i, points): (usize, &Vec<Point3<f64>>)| {
                    let convex = convex::Convex::new(points)
                        .map_err(|problem| format!("convex part {i}: {problem}"))?;
                    let bounding_radius_m = mesh::radius_about_origin(points);
                    Ok(Part {
                        object_from_part: Isometry3::identity(),
                        part_from_object: Isometry3::identity(),
                        shape: Self { shape: Shape::Convex(convex), bounding_radius_m },
                    })
                };
                union(parts.iter().enumerate().map(convex_part).collect::<Result<_, String>>()?)?
            }
            ObjectShape::Mesh { vertices, triangles } => {
                (Shape::Mesh(mesh::closed(vertices, triangles)?), mesh::radius_about_origin(vertices))
            }
            ObjectShape::Compound { parts } => {
                let posed_part = |(i, (object_from_part, shape)): (usize, &(Isometry3<f64>, ObjectShape))| {
                    if !is_finite(object_from_part) {
                        return Err(format!("part {i}: its pose must be finite"));
                    }
                    Ok(Part {
                        object_from_part: *object_from_part,
                        part_from_object: object_from_part.inverse(),
                        shape: Self::new(shape).map_err(|problem| format!("part {i}: {problem}"))?,
                    })
                };
                union(parts.iter().enumerate().map(posed_part).collect::<Result<_, String>>()?)?
            }
        };
        Ok(Self { shape, bounding_radius_m })
    }

    /// Of a shape of a link, in the shape's own frame.
    pub(crate) fn of_link_shape(shape: &LinkShape) -> Self {
        let (shape, bounding_radius_m) = match *shape {
            LinkShape::Box { size_m } => {
                let half_extents = 0.5 * Vector3::from(size_m);
                (Shape::Cuboid { half_extents }, half_extents.norm())
            }
            LinkShape::Cylinder { radius_m, length_m } => {
                let half_height = 0.5 * length_m;
                (Shape::Cylinder { radius: radius_m, half_height }, radius_m.hypot(half_height))
            }
            LinkShape::Capsule { radius_m, length_m } => {
                let half_length = 0.5 * length_m;
                (Shape::Capsule { radius: radius_m, half_length }, radius_m + half_length)
            }
            LinkShape::Sphere { radius_m } => (Shape::Ball { radius: radius_m }, radius_m),
        };
        Self { shape, bounding_radius_m }
    }

    /// Signed distance of `pos_in_object` to the surface, m; negative inside.
    pub fn distance_m(&self, pos_in_object: &Point3<f64>) -> f64 {
        self.distance_below_m(pos_in_object, f64::INFINITY)
    }

    /// Radius about the object's origin that holds all of it, m: a cheap bound to skip far patches with.
    pub fn bounding_radius_m(&self) -> f64 {
        self.bounding_radius_m
    }

    /// The signed distance where it is below `limit_m`; else any value from `limit_m` up to the distance, which is
    /// much cheaper to tell for meshes.
    pub fn distance_below_m(&self, pos_in_object: &Point3<f64>, limit_m: f64) -> f64 {
        let p = pos_in_object;
        match &self.shape {
            &Shape::Ball { radius } => ball_distance(p, radius),
            &Shape::Cylinder { radius, half_height } => cylinder_distance(p, radius, half_height),
            &Shape::Capsule { radius, half_length } => capsule_distance(p, radius, half_length),
            Shape::Cuboid { half_extents } => cuboid_distance(p, half_extents),
            Shape::Convex(convex) => convex.distance_below(p, limit_m),
            Shape::Mesh(mesh) => mesh::distance_below(mesh, p, limit_m),
            Shape::Union(parts) => {
                let mut smallest = f64::INFINITY;
                for part in parts {
                    let pos_in_part = part.part_from_object * p;
                    smallest = smallest.min(part.shape.distance_below_m(&pos_in_part, limit_m.min(smallest)));
                }
                smallest
            }
        }
    }

    /// A value that the distance is not below, and that takes no search over a surface.
    fn lower_bound_m(&self, pos_in_object: &Point3<f64>) -> f64 {
        match &self.shape {
            Shape::Mesh(_) => pos_in_object.coords.norm() - self.bounding_radius_m,
            Shape::Union(parts) => parts
                .iter()
                .map(|part| part.shape.lower_bound_m(&(part.part_from_object * pos_in_object)))
                .fold(f64::INFINITY, f64::min),
            Shape::Convex(convex) => convex.farthest_plane(pos_in_object),
            _ => self.distance_m(pos_in_object),
        }
    }

    /// Calls `visit(i, distance)` for every point, as [`Self::distance_below_m`] has it. The shape is looked at once
    /// and the pose is turned into a matrix, so that the loop over the points is plain arithmetic.
    pub(crate) fn for_each_distance_below(
        &self,
        object_from_frame: &Isometry3<f64>,
        points_in_frame: &[Point3<f64>],
        limit_m: f64,
        mut visit: impl FnMut(usize, f64),
    ) {
        let rotation = object_from_frame.rotation.to_rotation_matrix().into_inner();
        let translation = object_from_frame.translation.vector;
        let points = Posed { points: points_in_frame, rotation, translation };
        match &self.shape {
            &Shape::Ball { radius } => points.each(|p| ball_distance(&p, radius), visit),
            &Shape::Cylinder { radius, half_height } => {
                points.each(|p| cylinder_distance(&p, radius, half_height), visit);
            }
            &Shape::Capsule { radius, half_length } => {
                points.each(|p| capsule_distance(&p, radius, half_length), visit);
            }
            Shape::Cuboid { half_extents } => points.each(|p| cuboid_distance(&p, half_extents), visit),
            Shape::Convex(_) | Shape::Mesh(_) | Shape::Union(_) => {
                for (i, p) in points_in_frame.iter().enumerate() {
                    visit(i, self.distance_below_m(&points.to_object(p), limit_m));
                }
            }
        }
    }

    /// Smallest distance over the points if below `limit_m`, else `limit_m`. Each distance found is the limit of the
    /// next search, which makes meshes and convex parts several times faster than one by one.
    pub(crate) fn min_distance_below_m(
        &self,
        object_from_frame: &Isometry3<f64>,
        points_in_frame: &[Point3<f64>],
        limit_m: f64,
    ) -> f64 {
        let mut smallest = limit_m;
        if matches!(self.shape, Shape::Convex(_) | Shape::Mesh(_) | Shape::Union(_)) {
            // What is cheap to tell says where to look first and what need not be looked at.
            let points: Vec<(Point3<f64>, f64)> = points_in_frame
                .iter()
                .map(|p| {
                    let pos_in_object = object_from_frame * p;
                    (pos_in_object, self.lower_bound_m(&pos_in_object))
                })
                .collect();
            let nearest = points.iter().min_by(|(_, one), (_, other)| one.total_cmp(other));
            for (pos_in_object, bound_m) in nearest.into_iter().chain(&points) {
                if *bound_m < smallest {
                    smallest = smallest.min(self.distance_below_m(pos_in_object, smallest));
                }
            }
        } else {
            self.for_each_distance_below(object_from_frame, points_in_frame, limit_m, |_, distance| {
                smallest = smallest.min(distance);
            });
        }
        smallest
    }

    /// The shapes as parry has them, each with its pose in the object; solid but for meshes, which are surfaces.
    fn parry_parts(&self, object_from_self: &Isometry3<f64>, parts: &mut Vec<(Pose, SharedShape)>) {
        let shape = match &self.shape {
            &Shape::Ball { radius } => SharedShape::ball(radius),
            &Shape::Cylinder { radius, half_height } => SharedShape::cylinder(half_height, radius),
            &Shape::Capsule { radius, half_length } => SharedShape::capsule_y(half_length, radius),
            Shape::Cuboid { half_extents: h } => SharedShape::cuboid(h.x, h.y, h.z),
            Shape::Convex(convex) => SharedShape::new(convex.surface().clone()),
            Shape::Mesh(mesh) => SharedShape::new(mesh.clone()),
            Shape::Union(union) => {
                for part in union {
                    part.shape.parry_parts(&(object_from_self * part.object_from_part), parts);
                }
                return;
            }
        };
        let along_y = matches!(self.shape, Shape::Cylinder { .. } | Shape::Capsule { .. });
        parts.push((parry_pose(object_from_self, along_y), shape));
    }
}

/// Points in a frame, and the frame's pose in an object.
struct Posed<'a> {
    points: &'a [Point3<f64>],
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

impl Posed<'_> {
    fn to_object(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * p.coords + self.translation)
    }

    /// Calls `visit(i, distance)` for every point. Blocks of a fixed length let the compiler work on several points at once.
    fn each(&self, distance: impl Fn(Point3<f64>) -> f64, mut visit: impl FnMut(usize, f64)) {
        const BLOCK: usize = 16;
        for (block, points) in self.points.chunks(BLOCK).enumerate() {
            let mut in_object = [[0.0; BLOCK]; 3];
            for (i, p) in points.iter().enumerate() {
                in_object.iter_mut().zip(p.iter()).for_each(|(axis, value)| axis[i] = *value);
            }
            let [xs, ys, zs] = &in_object;
            let mut distances = [0.0; BLOCK];
            for (i, of_point) in distances.iter_mut().enumerate() {
                *of_point = distance(self.to_object(&Point3::new(xs[i], ys[i], zs[i])));
            }
            for (i, of_point) in distances[..points.len()].iter().enumerate() {
                visit(block * BLOCK + i, *of_point);
            }
        }
    }
}

fn union(parts: Vec<Part>) -> Result<(Shape, f64), String> {
    let radius = |part: &Part| part.object_from_part.translation.vector.norm() + part.shape.bounding_radius_m;
    let bounding_radius_m = parts.iter().map(radius).fold(0.0, f64::max);
    if parts.is_empty() {
        return Err("has no parts; expected at least one".to_owned());
    }
    Ok((Shape::Union(parts), bounding_radius_m))
}

fn check_sizes(name: &str, sizes_m: &[f64]) -> Result<(), String> {
    if sizes_m.iter().all(|size| size.is_finite() && *size > 0.0) {
        Ok(())
    } else {
        Err(format!("{name} {sizes_m:?} must be finite and positive, in m"))
    }
}

pub(crate) fn is_finite(pose: &Isometry3<f64>) -> bool {
    pose.translation.vector.iter().all(|v| v.is_finite())
        && pose.rotation.coords.iter().all(|v| v.is_finite())
}

// Primitives in closed form, the same numbers as parry's projections (a test compares them) without their branches.

fn ball_distance(p: &Point3<f64>, radius: f64) -> f64 {
    p.coords.norm() - radius
}

fn cylinder_distance(p: &Point3<f64>, radius: f64, half_height: f64) -> f64 {
    let radial = (p.x * p.x + p.y * p.y).sqrt() - radius;
    let axial = p.z.abs() - half_height;
    let (radial_out, axial_out) = (radial.max(0.0), axial.max(0.0));
    (radial_out * radial_out + axial_out * axial_out).sqrt() + radial.max(axial).min(0.0)
}

fn capsule_distance(p: &Point3<f64>, radius: f64, half_length: f64) -> f64 {
    let beyond = (p.z.abs() - half_length).max(0.0);
    (p.x * p.x + p.y * p.y + beyond * beyond).sqrt() - radius
}

fn cuboid_distance(p: &Point3<f64>, half_extents: &Vector3<f64>) -> f64 {
    let beyond = p.coords.abs() - half_extents;
    let outside = beyond.map(|v| v.max(0.0)).norm();
    outside + beyond.x.max(beyond.y).max(beyond.z).min(0.0)
}

pub(crate) fn parry_vector(p: &Point3<f64>) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

/// `pose` for parry. Its cylinders and capsules lie along y, ours along z: `along_y` turns y to z first.
fn parry_pose(pose: &Isometry3<f64>, along_y: bool) -> Pose {
    let turned = if along_y {
        pose.rotation
            * nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2)
    } else {
        pose.rotation
    };
    let q = turned.quaternion();
    let t = pose.translation.vector;
    Pose::from_parts(Vector::new(t.x, t.y, t.z), Rotation::from_xyzw(q.i, q.j, q.k, q.w))
}

#[cfg(test)]
mod tests;
