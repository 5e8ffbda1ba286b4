//! What a motion must keep clear of: the object, felt by points on every link.

use nalgebra::{Isometry3, Point3, Unit, Vector3};
use palpate_robot_model::{LinkGeometry, LinkShape, ObjectModel, Robot, Station, SurfaceNode};
use palpate_sim::geometry::SignedDistance;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Spacing of the points that stand for a link's surface, m.
const POINT_SPACING_M: f64 = 0.008;
const NUM_SURFACE_POINTS: usize = 3000;

/// A station in front of one object: what [`plan_in`](crate::plan_in) needs, made once for all takes with that object.
pub struct Scene<'a> {
    pub(crate) station: &'a Station,
    pub(crate) object: SignedDistance,
    pub(crate) base_from_object: Isometry3<f64>,
    object_from_base: Isometry3<f64>,
    /// Points of the object's surface away from its edges, with outward normals, in the base frame.
    pub(crate) surface: Vec<(Point3<f64>, Unit<Vector3<f64>>)>,
    bodies: Vec<Body>,
    /// For each link, the first link that it is rigidly joined to.
    pub(crate) rigid_root: Vec<usize>,
}

/// Points on one link, in its frame.
struct Body {
    points: Vec<Point3<f64>>,
    centre: Point3<f64>,
    radius_m: f64,
}

/// Distances to the object, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clearance {
    /// Of the links rigidly joined to the touching one.
    pub(crate) own_m: f64,
    /// Of all others.
    pub(crate) others_m: f64,
}

impl<'a> Scene<'a> {
    /// `object` fixed at `base_from_object`; or why its shape has no inside or no smooth surface.
    pub fn new(
        station: &'a Station,
        object: &ObjectModel,
        base_from_object: Isometry3<f64>,
    ) -> Result<Self, String> {
        let distance = SignedDistance::new(&object.shape)?;
        let surface: Vec<_> = surface_points(&distance)
            .into_iter()
            .map(|(pos, normal)| {
                (base_from_object * pos, Unit::new_unchecked(base_from_object.rotation * normal.into_inner()))
            })
            .collect();
        if surface.is_empty() {
            return Err("has no smooth surface to touch".into());
        }
        let bodies = (0..station.robot.links.len()).map(|link| Body::new(station, link)).collect();
        Ok(Self {
            station,
            object: distance,
            base_from_object,
            object_from_base: base_from_object.inverse(),
            surface,
            bodies,
            rigid_root: rigid_roots(&station.robot),
        })
    }

    /// Puts the object elsewhere.
    pub(crate) fn place(&mut self, base_from_object: Isometry3<f64>) {
        let moved = base_from_object * self.object_from_base;
        for (pos, normal) in &mut self.surface {
            *pos = moved * *pos;
            *normal = Unit::new_normalize(moved.rotation * normal.into_inner());
        }
        self.base_from_object = base_from_object;
        self.object_from_base = base_from_object.inverse();
    }

    /// Where the object stands.
    pub fn base_from_object(&self) -> Isometry3<f64> {
        self.base_from_object
    }

    /// How far the links at `frames` (see `Robot::forward_kinematics`) are from the object, m: positive where they are
    /// clear of it, at most about 0.1.
    pub fn clearance_m(&self, frames: &[Isometry3<f64>]) -> f64 {
        self.clearance(frames, None).others_m
    }

    /// Smallest distance of the nodes of `patch` on a link at `base_from_link`, m.
    pub(crate) fn patch_distance_m(&self, patch: usize, base_from_link: &Isometry3<f64>) -> f64 {
        let object_from_link = self.object_from_base * base_from_link;
        let nodes = &self.station.layout.patches[patch].nodes;
        nodes
            .iter()
            .map(|node| self.object.distance_m(&(object_from_link * node.pos_in_link)))
            .fold(f64::INFINITY, f64::min)
    }

    /// How far those links at `frames` that `counts` picks are from the object, up to about 0.1 m. Unlike
    /// [`Self::clearance`], links that no joint moves may count too.
    pub(crate) fn least_m(&self, frames: &[Isometry3<f64>], counts: impl Fn(usize) -> bool) -> f64 {
        let mut least_m = 0.1;
        for (link, body) in self.bodies.iter().enumerate().filter(|(link, _)| counts(*link)) {
            self.lower_to(&mut least_m, body, &(self.object_from_base * frames[link]));
        }
        least_m
    }

    /// Lowers `least_m` to the distance of `body` from the object, if that is smaller.
    fn lower_to(&self, least_m: &mut f64, body: &Body, object_from_link: &Isometry3<f64>) {
        if body.points.is_empty()
            || self.object.distance_m(&(object_from_link * body.centre)) - body.radius_m > *least_m
        {
            return;
        }
        for point in &body.points {
            *least_m = least_m.min(self.object.distance_m(&(object_from_link * point)));
        }
    }

    /// The node of `patch` that is deepest in the object, or nearest to it, on a link at `base_from_link`, and how
    /// far the object's surface is from facing it, rad.
    pub(crate) fn deepest_node(
        &self,
        patch: usize,
        base_from_link: &Isometry3<f64>,
    ) -> Option<(SurfaceNode, f64)> {
        let object_from_link = self.object_from_base * base_from_link;
        let nodes = self.station.layout.patches[patch].nodes.iter();
        let (node, pos) = nodes
            .map(|node| (node, object_from_link * node.pos_in_link))
            .min_by(|(_, a), (_, b)| self.object.distance_m(a).total_cmp(&self.object.distance_m(b)))?;
        let outward = gradient(&self.object, &pos)?;
        let facing = object_from_link.rotation * node.normal_in_link.into_inner();
        Some((*node, facing.angle(&-outward.into_inner())))
    }

    /// How far the links at `frames` are from the object, up to about 0.1 m; `touching` is the link that may touch.
    pub(crate) fn clearance(&self, frames: &[Isometry3<f64>], touching: Option<usize>) -> Clearance {
        let own_root = touching.map(|link| self.rigid_root[link]);
        let mut clearance = Clearance { own_m: 0.1, others_m: 0.1 };
        for (link, body) in self.bodies.iter().enumerate() {
            let least = if own_root == Some(self.rigid_root[link]) {
                &mut clearance.own_m
            } else {
                &mut clearance.others_m
            };
            let object_from_link = self.object_from_base * frames[link];
            // What no joint moves (a table, a base) stands where it stands, even under the object.
            if self.rigid_root[link] == 0 {
                continue;
            }
            self.lower_to(least, body, &object_from_link);
        }
        clearance
    }
}

impl Body {
    fn new(station: &Station, link: usize) -> Self {
        let mut points: Vec<Point3<f64>> =
            station.robot.links[link].collisions.iter().flat_map(shape_points).collect();
        for patch in station.layout.patches.iter().filter(|patch| patch.link == link) {
            let stride = (patch.nodes.len() / 40).max(1);
            points.extend(patch.nodes.iter().step_by(stride).map(|node| node.pos_in_link));
        }
        let count = points.len().max(1) as f64;
        let centre = Point3::from(points.iter().fold(Vector3::zeros(), |sum, pos| sum + pos.coords) / count);
        let radius_m = points.iter().map(|pos| (pos - centre).norm()).fold(0.0, f64::max);
        Self { points, centre, radius_m }
    }
}

/// For each link, the first link that fixed joints tie it to.
fn rigid_roots(robot: &Robot) -> Vec<usize> {
    let mut roots = vec![0; robot.links.len()];
    for joint in &robot.joints {
        roots[joint.child_link] =
            if joint.dof.is_none() { roots[joint.parent_link] } else { joint.child_link };
    }
    roots
}

fn shape_points(geometry: &LinkGeometry) -> Vec<Point3<f64>> {
    let mut points = Vec::new();
    match geometry.shape {
        LinkShape::Box { size_m } => {
            let [nx, ny, nz] = size_m.map(|size| (size / POINT_SPACING_M).ceil().max(1.0) as usize);
            let at = |idx: usize, count: usize, size: f64| size * (idx as f64 / count as f64 - 0.5);
            for x in 0..=nx {
                for y in 0..=ny {
                    for z in 0..=nz {
                        if [0, nx].contains(&x) || [0, ny].contains(&y) || [0, nz].contains(&z) {
                            points.push(Point3::new(
                                at(x, nx, size_m[0]),
                                at(y, ny, size_m[1]),
                                at(z, nz, size_m[2]),
                            ));
                        }
                    }
                }
            }
        }
        LinkShape::Cylinder { radius_m, length_m } => {
            rings(&mut points, length_m, radius_m);
            for z in [-0.5 * length_m, 0.5 * length_m] {
                points.push(Point3::new(0.0, 0.0, z));
                points.extend(circle(0.5 * radius_m, z));
            }
        }
        LinkShape::Capsule { radius_m, length_m } => {
            rings(&mut points, length_m, radius_m);
            dome(&mut points, radius_m, 0.5 * length_m);
        }
        LinkShape::Sphere { radius_m } => {
            points.extend(circle(radius_m, 0.0));
            dome(&mut points, radius_m, 0.0);
        }
    }
    points.iter().map(|pos| geometry.link_from_shape * pos).collect()
}

fn circle(radius_m: f64, z: f64) -> impl Iterator<Item = Point3<f64>> {
    let count = (std::f64::consts::TAU * radius_m / POINT_SPACING_M).ceil().max(6.0) as usize;
    (0..count).map(move |idx| {
        let angle = std::f64::consts::TAU * idx as f64 / count as f64;
        Point3::new(radius_m * angle.cos(), radius_m * angle.sin(), z)
    })
}

fn rings(points: &mut Vec<Point3<f64>>, length_m: f64, radius_m: f64) {
    let count = (length_m / POINT_SPACING_M).ceil().max(1.0) as usize;
    for ring in 0..=count {
        points.extend(circle(radius_m, length_m * (ring as f64 / count as f64 - 0.5)));
    }
}

fn dome(points: &mut Vec<Point3<f64>>, radius_m: f64, centre_z: f64) {
    for latitude in [0.5, 1.0] {
        let (sin, cos) = f64::sin_cos(latitude);
        points.extend(circle(radius_m * cos, centre_z + radius_m * sin));
        points.extend(circle(radius_m * cos, -centre_z - radius_m * sin));
    }
    points.extend([Point3::new(0.0, 0.0, centre_z + radius_m), Point3::new(0.0, 0.0, -centre_z - radius_m)]);
}

/// Points of the surface whose surroundings are smooth, found by marching inwards along random rays.
fn surface_points(object: &SignedDistance) -> Vec<(Point3<f64>, Unit<Vector3<f64>>)> {
    let radius = object.bounding_radius_m();
    // The surface belongs to the object: its sample is the same whatever a session's seed.
    let mut rng = ChaCha8Rng::seed_from_u64(0x5eed);
    let mut direction = || loop {
        let v = Vector3::new(rng.random::<f64>(), rng.random::<f64>(), rng.random::<f64>()) * 2.0
            - Vector3::new(1.0, 1.0, 1.0);
        if let Some(unit) = Unit::try_new(v, 1e-3)
            && v.norm() <= 1.0
        {
            return (unit, v);
        }
    };
    let mut points = Vec::with_capacity(NUM_SURFACE_POINTS);
    for _ in 0..NUM_SURFACE_POINTS {
        let (from, _) = direction();
        let (_, towards) = direction();
        let start = Point3::from(from.into_inner() * radius * 1.2);
        let Some(ray) = Unit::try_new(Point3::from(towards * 0.8 * radius) - start, 1e-9) else { continue };
        let mut travelled = 0.0;
        let hit = (0..200).find_map(|_| {
            let pos = start + ray.into_inner() * travelled;
            let distance = object.distance_m(&pos);
            travelled += distance;
            (distance.abs() < 1e-6).then_some(pos)
        });
        let Some(pos) = hit.filter(|_| travelled < 4.0 * radius) else { continue };
        let Some(normal) = gradient(object, &pos) else { continue };
        let (side, other) = tangents(&normal);
        let smooth = [side, -side, other, -other].iter().all(|offset| {
            gradient(object, &(pos + offset * 0.006)).is_some_and(|near| near.dot(&normal) > 0.93)
        });
        if smooth {
            points.push((pos, normal));
        }
    }
    points
}

fn gradient(object: &SignedDistance, pos: &Point3<f64>) -> Option<Unit<Vector3<f64>>> {
    let step = 1e-5;
    let along = |axis: Vector3<f64>| {
        object.distance_m(&(pos + axis * step)) - object.distance_m(&(pos - axis * step))
    };
    Unit::try_new(Vector3::new(along(Vector3::x()), along(Vector3::y()), along(Vector3::z())), 0.2 * step)
}

/// Two unit vectors that make a right-handed frame with `normal`.
pub(crate) fn tangents(normal: &Unit<Vector3<f64>>) -> (Vector3<f64>, Vector3<f64>) {
    let helper = if normal.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
    let first = normal.cross(&helper).normalize();
    (first, normal.cross(&first))
}
