//! Convex hulls: half-spaces for the inside, their surface for the outside.

use nalgebra::{Point3, Vector3};
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::TriMesh;
use parry3d_f64::transformation::try_convex_hull;

use super::mesh::signed_volume;
use super::parry_vector;

/// A hull thinner than this is flat, m^3.
const MIN_VOLUME_M3: f64 = 1e-15;

/// Cells along each edge of a cube's face, by which face normals are grouped.
const CELLS_PER_EDGE: usize = 3;
const MAX_GROUPS: usize = 6 * CELLS_PER_EDGE * CELLS_PER_EDGE;
/// Room for rounding in a group's bound, m.
const ROUNDING_M: f64 = 1e-9;

#[derive(Clone, Debug)]
pub(super) struct Convex {
    /// Outward unit normal and offset of each face: `normal . p <= offset` inside. Those of a group are neighbours.
    planes: Vec<(Vector3<f64>, f64)>,
    /// At most [`MAX_GROUPS`].
    groups: Vec<Group>,
    center: Point3<f64>,
    surface: TriMesh,
}

/// Planes whose normals point nearly the same way.
#[derive(Clone, Debug)]
struct Group {
    /// Mean of the normals.
    axis: Vector3<f64>,
    /// Largest distance of a normal from it.
    spread: f64,
    /// Smallest distance of a plane from the centre, m.
    nearest_m: f64,
    planes: std::ops::Range<usize>,
}

impl Convex {
    pub(super) fn new(points: &[Point3<f64>]) -> Result<Self, String> {
        if let Some(i) = points.iter().position(|v| !v.iter().all(|c| c.is_finite())) {
            return Err(format!(
                "point {i} is {:?}, expected finite coordinates in m",
                points[i].coords.as_slice()
            ));
        }
        if points.len() < 4 {
            return Err(format!(
                "has {} points; expected at least four that are not in one plane",
                points.len()
            ));
        }
        let flat = "its points lie in one plane or nearly so; expected a body with a volume, in m";
        let points: Vec<_> = points.iter().map(parry_vector).collect();
        let (vertices, triangles) = try_convex_hull(&points).map_err(|err| format!("{flat} ({err})"))?;
        let surface = TriMesh::new(vertices, triangles).map_err(|err| format!("{flat} ({err})"))?;
        if signed_volume(&surface) < MIN_VOLUME_M3 {
            return Err(flat.to_owned());
        }
        let mut planes = Vec::new();
        for triangle in surface.triangles() {
            // A sliver has no usable normal, and its neighbours bound the hull there anyway.
            let Some(normal) = triangle.normal() else { continue };
            // The supporting plane, so that no rounding of the normal cuts into the hull.
            let offset = surface.vertices().iter().map(|v| normal.dot(*v)).fold(f64::NEG_INFINITY, f64::max);
            planes.push((Vector3::new(normal.x, normal.y, normal.z), offset));
        }
        let middle = surface.local_aabb().center();
        let center = Point3::new(middle.x, middle.y, middle.z);
        let groups = group(&mut planes, &center);
        Ok(Self { planes, groups, center, surface })
    }

    pub(super) fn surface(&self) -> &TriMesh {
        &self.surface
    }

    /// The signed distance if below `limit`, else a value from `limit` up to it. Inside, the distance is that to the nearest
    /// face plane; outside, that plane distance is a lower bound on it.
    pub(super) fn distance_below(&self, p: &Point3<f64>, limit: f64) -> f64 {
        let farthest_plane = self.farthest_plane(p);
        if farthest_plane <= 0.0 || farthest_plane >= limit {
            return farthest_plane;
        }
        let p = parry_vector(p);
        let nearest = self.surface.project_local_point_with_max_dist(p, false, limit.min(f64::MAX));
        nearest.map_or(limit, |projection| (projection.point - p).length().max(farthest_plane))
    }

    /// Largest signed distance to the plane of a face.
    ///
    /// With `c` the centre, `normal . p - offset = normal . (p - c) - distance of the plane from c`, which for a whole group
    /// is at most `axis . (p - c) + spread |p - c| - nearest`: groups that stay below what was found are passed over.
    pub(super) fn farthest_plane(&self, p: &Point3<f64>) -> f64 {
        let from_center = p - self.center;
        let reach = from_center.norm();
        let mut bounds = [f64::NEG_INFINITY; MAX_GROUPS];
        let mut first = 0;
        for (idx, group) in self.groups.iter().enumerate() {
            bounds[idx] = group.axis.dot(&from_center) + group.spread * reach - group.nearest_m + ROUNDING_M;
            if bounds[idx] > bounds[first] {
                first = idx;
            }
        }
        let farthest_of = |group: &Group| {
            let beyond = |(normal, offset): &(Vector3<f64>, f64)| normal.dot(&p.coords) - offset;
            self.planes[group.planes.clone()].iter().map(beyond).fold(f64::NEG_INFINITY, f64::max)
        };
        let mut farthest = self.groups.get(first).map_or(f64::NEG_INFINITY, farthest_of);
        for (idx, group) in self.groups.iter().enumerate() {
            if idx != first && bounds[idx] > farthest {
                farthest = farthest.max(farthest_of(group));
            }
        }
        farthest
    }
}

/// Sorts `planes` by where their normals meet a cube, and says which belong together.
fn group(planes: &mut [(Vector3<f64>, f64)], center: &Point3<f64>) -> Vec<Group> {
    planes.sort_by_key(|(normal, _)| cell(normal));
    let mut groups = Vec::new();
    let mut start = 0;
    for together in planes.chunk_by(|(one, _), (other, _)| cell(one) == cell(other)) {
        let axis = together.iter().map(|(normal, _)| normal).sum::<Vector3<f64>>() / together.len() as f64;
        let apart = |(normal, _): &(Vector3<f64>, f64)| (normal - axis).norm();
        let from_center = |(normal, offset): &(Vector3<f64>, f64)| offset - normal.dot(&center.coords);
        groups.push(Group {
            axis,
            spread: together.iter().map(apart).fold(0.0, f64::max),
            nearest_m: together.iter().map(from_center).fold(f64::INFINITY, f64::min),
            planes: start..start + together.len(),
        });
        start += together.len();
    }
    groups
}

/// Number of the cell of a cube's surface that `normal` points through, below [`MAX_GROUPS`].
fn cell(normal: &Vector3<f64>) -> usize {
    let axis = normal.iamax();
    let along = normal[axis];
    let place = |across: f64| {
        let share = 0.5 * (across / along.abs() + 1.0);
        ((share * CELLS_PER_EDGE as f64) as usize).min(CELLS_PER_EDGE - 1)
    };
    let face = 2 * axis + usize::from(along < 0.0);
    (face * CELLS_PER_EDGE + place(normal[(axis + 1) % 3])) * CELLS_PER_EDGE + place(normal[(axis + 2) % 3])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The points of an egg of many faces, away from the origin.
    fn egg() -> Convex {
        let ring = |i: usize| {
            let t = std::f64::consts::PI * i as f64 / 16.0;
            (0..32).map(move |j| {
                let turn = std::f64::consts::TAU * j as f64 / 32.0;
                let r = 0.022 * t.sin() * (1.0 + 0.15 * t.cos());
                Point3::new(0.01 + r * turn.cos(), r * turn.sin(), -0.03 * t.cos())
            })
        };
        let points: Vec<_> = (0..=16).flat_map(ring).collect();
        Convex::new(&points).expect("a hull")
    }

    proptest! {
        #[test]
        fn groups_that_are_passed_over_hold_no_farther_plane(
            x in -0.1..0.1_f64, y in -0.1..0.1_f64, z in -0.1..0.1_f64, near in 0.0..1.0_f64,
        ) {
            let egg = egg();
            prop_assert!(egg.planes.len() > 500 && egg.groups.len() > 20);
            // Points far outside, near the surface and inside.
            let p = egg.center + near * (Point3::new(x, y, z) - egg.center);
            let all = egg.planes.iter().map(|(normal, offset)| normal.dot(&p.coords) - offset);
            let farthest = all.fold(f64::NEG_INFINITY, f64::max);
            prop_assert_eq!(egg.farthest_plane(&p).to_bits(), farthest.to_bits());
        }
    }
}
