//! The parts of a solid, in the object's frame.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Point3, Vector3};
use palpate_robot_model::{ConvexPart, ConvexShape};

use super::{convex_hull, moments::Moments};

/// Points that stand for a whole ball, and for each rim of a cylinder, where a hull of points is needed.
const BALL_POINTS: usize = 800;
const RIM_POINTS: usize = 64;

#[derive(Clone, Debug)]
pub(super) enum Part {
    /// A shape with a closed form, and its pose.
    Primitive { object_from_part: Isometry3<f64>, shape: Primitive },
    /// Flat faces.
    Polyhedron(Polyhedron),
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Primitive {
    Ball { radius: f64 },
    Cuboid { half_extents: Vector3<f64> },
    Cylinder { radius: f64, half_height: f64 },
    Capsule { radius: f64, half_length: f64 },
}

/// A closed surface of outward triangles; convex wherever it is one of several parts.
#[derive(Clone, Debug)]
pub(super) struct Polyhedron {
    vertices: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
    /// Outward unit normal and offset of every triangle: `normal . p <= offset` inside a convex one.
    planes: Vec<(Vector3<f64>, f64)>,
}

impl Part {
    pub(super) fn new(part: ConvexPart) -> Result<Self, String> {
        let object_from_part = part.object_from_part;
        let shape = match part.shape {
            ConvexShape::Sphere { radius_m } => Primitive::Ball { radius: radius_m },
            ConvexShape::Box { size_m } => Primitive::Cuboid { half_extents: 0.5 * Vector3::from(size_m) },
            ConvexShape::Cylinder { radius_m, height_m } => {
                Primitive::Cylinder { radius: radius_m, half_height: 0.5 * height_m }
            }
            ConvexShape::Capsule { radius_m, length_m } => {
                Primitive::Capsule { radius: radius_m, half_length: 0.5 * length_m }
            }
            ConvexShape::Hull { points } => {
                let points: Vec<_> = points.iter().map(|point| object_from_part * point).collect();
                let (vertices, triangles) = convex_hull(&points)?;
                return Ok(Self::Polyhedron(Polyhedron::new(vertices, triangles)));
            }
        };
        Ok(Self::Primitive { object_from_part, shape })
    }

    pub(super) fn moments(&self) -> Moments {
        match self {
            Self::Polyhedron(body) => Moments::of_surface(&body.vertices, &body.triangles),
            Self::Primitive { object_from_part, shape } => {
                let (volume, mean_squares) = shape.volume_and_mean_squares();
                Moments::of_symmetric(volume, mean_squares, object_from_part)
            }
        }
    }

    /// The point farthest along `direction`.
    pub(super) fn support(&self, direction: &Vector3<f64>) -> Point3<f64> {
        match self {
            Self::Polyhedron(body) => {
                let along = |p: &Point3<f64>| p.coords.dot(direction);
                let best = body.vertices.iter().max_by(|a, b| along(a).total_cmp(&along(b)));
                best.copied().unwrap_or_else(Point3::origin)
            }
            Self::Primitive { object_from_part, shape } => {
                let in_part = object_from_part.rotation.inverse_transform_vector(direction);
                object_from_part * shape.support(&in_part)
            }
        }
    }

    /// Smallest and largest coordinate along `axis`.
    pub(super) fn range(&self, axis: &Vector3<f64>) -> (f64, f64) {
        (self.support(&-axis).coords.dot(axis), self.support(axis).coords.dot(axis))
    }

    /// Directions across which a face of it may keep another part away.
    pub(super) fn face_normals(&self) -> Vec<Vector3<f64>> {
        match self {
            Self::Polyhedron(body) => body.planes.iter().map(|(normal, _)| *normal).collect(),
            Self::Primitive { object_from_part, shape } => {
                let axes: &[Vector3<f64>] = match shape {
                    Primitive::Ball { .. } => &[],
                    Primitive::Cuboid { .. } => &[
                        Vector3::new(1.0, 0.0, 0.0),
                        Vector3::new(0.0, 1.0, 0.0),
                        Vector3::new(0.0, 0.0, 1.0),
                    ],
                    Primitive::Cylinder { .. } | Primitive::Capsule { .. } => &[Vector3::new(0.0, 0.0, 1.0)],
                };
                axes.iter().map(|axis| object_from_part.rotation * axis).collect()
            }
        }
    }

    /// Where the upright line through `(x, y)` is inside a convex part.
    pub(super) fn column(&self, [x, y]: [f64; 2]) -> Option<(f64, f64)> {
        let origin = Point3::new(x, y, 0.0);
        match self {
            Self::Polyhedron(body) => slabs(
                body.planes.iter().map(|(normal, offset)| (offset - normal.dot(&origin.coords), normal.z)),
            ),
            Self::Primitive { object_from_part, shape } => shape.chord(
                &object_from_part.inverse_transform_point(&origin),
                &object_from_part.inverse_transform_vector(&Vector3::z()),
            ),
        }
    }

    /// Points whose convex hull is the part's, or for curved parts nearly so.
    pub(super) fn hull_points(&self, points: &mut Vec<Point3<f64>>) {
        match self {
            Self::Polyhedron(body) => points.extend(&body.vertices),
            Self::Primitive { object_from_part, shape } => {
                points.extend(shape.surface_points().into_iter().map(|point| object_from_part * point));
            }
        }
    }
}

impl Polyhedron {
    pub(super) fn new(vertices: Vec<Point3<f64>>, triangles: Vec<[u32; 3]>) -> Self {
        let plane = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|i| vertices[i as usize]);
            let normal = (b - a).cross(&(c - a)).try_normalize(0.0)?;
            // The supporting plane, so that no rounding of the normal cuts into the hull.
            let offset = [a, b, c].iter().map(|p| normal.dot(&p.coords)).fold(f64::NEG_INFINITY, f64::max);
            Some((normal, offset))
        };
        let planes = triangles.iter().filter_map(plane).collect();
        Self { vertices, triangles, planes }
    }
}

impl Primitive {
    /// Volume, and mean squared coordinates along its own axes.
    fn volume_and_mean_squares(&self) -> (f64, Vector3<f64>) {
        match *self {
            Self::Ball { radius: r } => (4.0 / 3.0 * PI * r.powi(3), Vector3::repeat(r * r / 5.0)),
            Self::Cuboid { half_extents: h } => (8.0 * h.x * h.y * h.z, h.component_mul(&h) / 3.0),
            Self::Cylinder { radius: r, half_height: h } => {
                (TAU * r * r * h, Vector3::new(r * r / 4.0, r * r / 4.0, h * h / 3.0))
            }
            Self::Capsule { radius: r, half_length: h } => {
                let (tube, caps) = (TAU * r * r * h, 4.0 / 3.0 * PI * r.powi(3));
                let across = tube * r * r / 4.0 + caps * r * r / 5.0;
                // The centre of a half ball is 3/8 r above its flat side.
                let along = tube * h * h / 3.0 + caps * (h * h + 0.75 * h * r + r * r / 5.0);
                (tube + caps, Vector3::new(across, across, along) / (tube + caps))
            }
        }
    }

    fn support(&self, direction: &Vector3<f64>) -> Point3<f64> {
        let radial = |radius: f64| {
            let flat = Vector3::new(direction.x, direction.y, 0.0);
            flat.try_normalize(1e-12).map_or_else(Vector3::zeros, |flat| flat * radius)
        };
        let end = |half: f64| Vector3::new(0.0, 0.0, half.copysign(direction.z));
        let ball = |radius: f64| direction.normalize() * radius;
        Point3::from(match *self {
            Self::Ball { radius } => ball(radius),
            Self::Cuboid { half_extents } => half_extents.zip_map(direction, f64::copysign),
            Self::Cylinder { radius, half_height } => radial(radius) + end(half_height),
            Self::Capsule { radius, half_length } => ball(radius) + end(half_length),
        })
    }

    /// Parameters between which `origin + t direction` is inside; `direction` has length 1.
    fn chord(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<(f64, f64)> {
        let ball = |center_z: f64, radius: f64| {
            let from_center = origin.coords - Vector3::new(0.0, 0.0, center_z);
            quadratic(1.0, from_center.dot(direction), from_center.norm_squared() - radius * radius)
        };
        let tube = |radius: f64, half_height: f64| {
            let (o, d) = (origin.coords.xy(), direction.xy());
            let round = quadratic(d.norm_squared(), o.dot(&d), o.norm_squared() - radius * radius)?;
            let flat =
                slabs([(half_height - origin.z, direction.z), (half_height + origin.z, -direction.z)])?;
            Some((round.0.max(flat.0), round.1.min(flat.1))).filter(|(low, high)| low < high)
        };
        match *self {
            Self::Ball { radius } => ball(0.0, radius),
            Self::Cuboid { half_extents } => slabs((0..3).flat_map(|axis| {
                let (o, d) = (origin[axis], direction[axis]);
                [(half_extents[axis] - o, d), (half_extents[axis] + o, -d)]
            })),
            Self::Cylinder { radius, half_height } => tube(radius, half_height),
            Self::Capsule { radius, half_length } => {
                let pieces =
                    [tube(radius, half_length), ball(half_length, radius), ball(-half_length, radius)];
                pieces.into_iter().flatten().reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
            }
        }
    }

    fn surface_points(&self) -> Vec<Point3<f64>> {
        let rims = |radius: f64, half_height: f64| {
            (0..RIM_POINTS).flat_map(move |i| {
                let (sin, cos) = (TAU * i as f64 / RIM_POINTS as f64).sin_cos();
                [-half_height, half_height].map(|z| Point3::new(radius * cos, radius * sin, z))
            })
        };
        match *self {
            Self::Ball { radius } => sphere_points().map(|p| Point3::from(p * radius)).collect(),
            Self::Cuboid { half_extents: h } => {
                let sign = |i: usize, bit: usize| if i >> bit & 1 == 0 { -1.0 } else { 1.0 };
                (0..8).map(|i| Point3::new(h.x * sign(i, 0), h.y * sign(i, 1), h.z * sign(i, 2))).collect()
            }
            Self::Cylinder { radius, half_height } => rims(radius, half_height).collect(),
            Self::Capsule { radius, half_length } => {
                let caps = sphere_points()
                    .map(|p| Point3::from(p * radius + Vector3::new(0.0, 0.0, half_length.copysign(p.z))));
                caps.chain(rims(radius, half_length)).collect()
            }
        }
    }
}

/// Evenly spread unit vectors: a Fibonacci lattice (Gonzalez 2010).
fn sphere_points() -> impl Iterator<Item = Vector3<f64>> {
    let golden_rad = PI * (3.0 - 5.0_f64.sqrt());
    (0..BALL_POINTS).map(move |i| {
        let z = 1.0 - (2 * i + 1) as f64 / BALL_POINTS as f64;
        let radius = (1.0 - z * z).sqrt();
        let (sin, cos) = (golden_rad * i as f64).sin_cos();
        Vector3::new(radius * cos, radius * sin, z)
    })
}

/// Solutions of `a t^2 + 2 b t + c <= 0` for `a >= 0`; everything where the line does not move against the surface.
fn quadratic(a: f64, half_b: f64, c: f64) -> Option<(f64, f64)> {
    if a < 1e-18 {
        return (c < 0.0).then_some((f64::NEG_INFINITY, f64::INFINITY));
    }
    let discriminant = half_b * half_b - a * c;
    (discriminant > 0.0).then(|| {
        let root = discriminant.sqrt();
        ((-half_b - root) / a, (-half_b + root) / a)
    })
}

/// Where `t slope <= room` for all `(room, slope)`.
fn slabs(planes: impl IntoIterator<Item = (f64, f64)>) -> Option<(f64, f64)> {
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    for (room, slope) in planes {
        if slope.abs() < 1e-15 {
            if room < 0.0 {
                return None;
            }
        } else if slope > 0.0 {
            high = high.min(room / slope);
        } else {
            low = low.max(room / slope);
        }
    }
    (low < high).then_some((low, high))
}
