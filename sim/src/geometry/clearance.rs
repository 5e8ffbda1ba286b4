//! How far the robot's links stay from the object.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Point3, Vector3};
use palpate_robot_model::{LinkShape, Robot};
use parry3d_f64::math::Pose;
use parry3d_f64::query;
use parry3d_f64::shape::SharedShape;

use super::{SignedDistance, parry_pose};

/// Spacing of the surface samples that measure how deep a link is inside the object, m.
const SAMPLE_SPACING_M: f64 = 0.003;

/// Collision shapes of every link, prepared for clearance queries against an object.
#[derive(Clone)]
pub struct LinkClearance {
    /// Per link of the robot.
    links: Vec<Vec<LinkBody>>,
}

#[derive(Clone)]
struct LinkBody {
    link_from_shape: Isometry3<f64>,
    /// Whether parry has this shape along its y axis.
    along_y: bool,
    shape: SharedShape,
    /// Centre and surface samples, in the shape's frame.
    samples: Vec<Point3<f64>>,
}

impl LinkClearance {
    /// Prepares the collision shapes of `robot`.
    pub fn new(robot: &Robot) -> Self {
        let body = |geometry: &palpate_robot_model::LinkGeometry| LinkBody {
            link_from_shape: geometry.link_from_shape,
            along_y: matches!(geometry.shape, LinkShape::Cylinder { .. } | LinkShape::Capsule { .. }),
            shape: parry_shape(&geometry.shape),
            samples: samples(&geometry.shape),
        };
        Self { links: robot.links.iter().map(|link| link.collisions.iter().map(body).collect()).collect() }
    }

    /// Smallest signed distance between the collision shapes of link `link_idx` and the object, m; infinite for a link
    /// without collision shapes.
    ///
    /// `object_from_link` is `base_from_object.inverse() * root_from_link[link_idx]`.
    ///
    /// Apart, it is parry's distance between the shapes, good to about a micrometre. Overlapping, it is never
    /// positive: the signed distance of the deepest of the link's surface samples, which are 3 mm apart, so that a
    /// point of the link can be up to 2 mm deeper; zero where the overlap reaches no sample.
    pub fn link_clearance_m(
        &self,
        link_idx: usize,
        object_from_link: &Isometry3<f64>,
        object: &SignedDistance,
    ) -> f64 {
        let mut object_parts = Vec::new();
        object.parry_parts(&Isometry3::identity(), &mut object_parts);
        let clearance = |body: &LinkBody| body.clearance_m(object_from_link, object, &object_parts);
        self.links[link_idx].iter().map(clearance).fold(f64::INFINITY, f64::min)
    }

    /// The link with the smallest clearance among those that `counts` accepts, and that clearance, m. `None` if no
    /// such link has a collision shape.
    ///
    /// `root_from_link` comes from [`Robot::forward_kinematics`]; see [`Self::link_clearance_m`] for the accuracy.
    pub fn nearest_link_m(
        &self,
        root_from_link: &[Isometry3<f64>],
        base_from_object: &Isometry3<f64>,
        object: &SignedDistance,
        counts: impl Fn(usize) -> bool,
    ) -> Option<(usize, f64)> {
        let mut object_parts = Vec::new();
        object.parry_parts(&Isometry3::identity(), &mut object_parts);
        let object_from_base = base_from_object.inverse();
        let mut nearest = None;
        for (link_idx, bodies) in self.links.iter().enumerate().filter(|(link_idx, _)| counts(*link_idx)) {
            for body in bodies {
                let object_from_link = object_from_base * root_from_link[link_idx];
                let smallest = nearest.map_or(f64::INFINITY, |(_, clearance)| clearance);
                if body.is_beyond(&object_from_link, object, smallest) {
                    continue;
                }
                let clearance = body.clearance_m(&object_from_link, object, &object_parts);
                if clearance < smallest {
                    nearest = Some((link_idx, clearance));
                }
            }
        }
        nearest
    }
}

impl LinkBody {
    /// Whether its bounding ball alone shows that the clearance is not below `clearance_m`.
    fn is_beyond(
        &self,
        object_from_link: &Isometry3<f64>,
        object: &SignedDistance,
        clearance_m: f64,
    ) -> bool {
        if clearance_m == f64::INFINITY {
            return false;
        }
        let radius = self.shape.compute_local_bounding_sphere().radius;
        let center_in_object = object_from_link * Point3::from(self.link_from_shape.translation.vector);
        object.distance_below_m(&center_in_object, clearance_m + radius) >= clearance_m + radius
    }

    fn clearance_m(
        &self,
        object_from_link: &Isometry3<f64>,
        object: &SignedDistance,
        object_parts: &[(Pose, SharedShape)],
    ) -> f64 {
        let object_from_shape = object_from_link * self.link_from_shape;
        let pose = parry_pose(&object_from_shape, self.along_y);
        let apart = object_parts
            .iter()
            .map(|(part_pose, part)| {
                // Every pair of these shapes is supported; if that ever changed, the samples below would decide.
                query::distance(&pose, &*self.shape, part_pose, &**part).map_or(0.0, |found| found.distance)
            })
            .fold(f64::INFINITY, f64::min);
        // Meshes are surfaces to parry: a link wholly inside of one is apart from it.
        let center_in_object = Point3::from(object_from_shape.translation.vector);
        if apart > 0.0 && object.distance_below_m(&center_in_object, 0.0) >= 0.0 {
            return apart;
        }
        let mut deepest = 0.0_f64;
        object.for_each_distance_below(&object_from_shape, &self.samples, 0.0, |_, distance| {
            deepest = deepest.min(distance);
        });
        deepest
    }
}

fn parry_shape(shape: &LinkShape) -> SharedShape {
    match *shape {
        LinkShape::Box { size_m: [x, y, z] } => SharedShape::cuboid(0.5 * x, 0.5 * y, 0.5 * z),
        LinkShape::Cylinder { radius_m, length_m } => SharedShape::cylinder(0.5 * length_m, radius_m),
        LinkShape::Capsule { radius_m, length_m } => SharedShape::capsule_y(0.5 * length_m, radius_m),
        LinkShape::Sphere { radius_m } => SharedShape::ball(radius_m),
    }
}

/// Numbers from -half to half, at most the spacing apart, both ends included.
fn span(half: f64) -> impl Iterator<Item = f64> + Clone {
    let steps = (2.0 * half / SAMPLE_SPACING_M).ceil().max(1.0);
    (0..=steps as usize).map(move |i| -half + 2.0 * half * i as f64 / steps)
}

/// Angles around a circle of `radius`, at most the spacing apart along it.
fn around(radius: f64) -> impl Iterator<Item = f64> + Clone {
    let steps = (TAU * radius / SAMPLE_SPACING_M).ceil().max(4.0);
    (0..steps as usize).map(move |i| TAU * i as f64 / steps)
}

/// The centre, then points of the surface, in the shape's frame (cylinders and capsules along z).
fn samples(shape: &LinkShape) -> Vec<Point3<f64>> {
    let mut points = vec![Point3::origin()];
    match *shape {
        LinkShape::Box { size_m } => {
            let half = Vector3::from(size_m) * 0.5;
            for axis in 0..3 {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                for a in span(half[u]) {
                    for b in span(half[v]) {
                        for side in [-half[axis], half[axis]] {
                            let mut point = Point3::origin();
                            (point[axis], point[u], point[v]) = (side, a, b);
                            points.push(point);
                        }
                    }
                }
            }
        }
        LinkShape::Cylinder { radius_m, length_m } => {
            side(radius_m, 0.5 * length_m, &mut points);
            let rings = (radius_m / SAMPLE_SPACING_M).ceil();
            for ring in 0..=rings as usize {
                let r = radius_m * ring as f64 / rings;
                for angle in around(r) {
                    for z in [-0.5 * length_m, 0.5 * length_m] {
                        points.push(Point3::new(r * angle.cos(), r * angle.sin(), z));
                    }
                }
            }
        }
        LinkShape::Capsule { radius_m, length_m } => {
            side(radius_m, 0.5 * length_m, &mut points);
            ball(radius_m, 0.5 * length_m, &mut points);
        }
        LinkShape::Sphere { radius_m } => ball(radius_m, 0.0, &mut points),
    }
    points
}

fn side(radius: f64, half_length: f64, points: &mut Vec<Point3<f64>>) {
    for z in span(half_length) {
        points.extend(around(radius).map(|angle| Point3::new(radius * angle.cos(), radius * angle.sin(), z)));
    }
}

/// A ball whose halves are moved apart along z by `half_length` each.
fn ball(radius: f64, half_length: f64, points: &mut Vec<Point3<f64>>) {
    let steps = (PI * radius / SAMPLE_SPACING_M).ceil().max(4.0);
    for i in 0..=steps as usize {
        let polar = PI * i as f64 / steps;
        let ring = radius * polar.sin();
        let z = radius * polar.cos();
        let offset = if z >= 0.0 { half_length } else { -half_length };
        points.extend(
            around(ring).map(|angle| Point3::new(ring * angle.cos(), ring * angle.sin(), z + offset)),
        );
    }
}
