//! Poses in which a solid rests on a table.
//!
//! On a table only the convex hull matters. With the table in the direction `down`, the centre of mass is as high above
//! it as the hull reaches along `down`; a pose at rest is a local minimum of that height over all directions, and every
//! minimum of a polyhedron is one of its faces, with the centre of mass above the face.
//!
//! - **Which facets hold.** A facet whose foot of the centre of mass lies outside of it topples over the edge that the
//!   foot is farthest beyond, and so on down to one that holds.
//! - **How likely.** Each facet has the share of directions (solid angle) that it fills as seen from the centre of mass,
//!   and all of that goes to the facet where the toppling ends. This is the quasi-static estimator of Goldberg,
//!   Mirtich, Zhuang, Craig, Carlisle and Canny, "Part pose statistics: estimators and experiments" (IEEE Transactions
//!   on Robotics and Automation 15(5), 1999): drops without speed.
//! - **What counts as one pose.** To leave a facet for a neighbour, the centre of mass must climb over their edge. Facets
//!   between which it climbs by less than [`MIN_BARRIER`] of the object's reach are one pose: the two triangles of a
//!   square face, the facets that stand for the side of a cylinder, a ball as a whole. Ledges so narrow that a touch
//!   tips them belong to their neighbour for the same reason. This is persistence of minima (Edelsbrunner, Letscher
//!   and Zomorodian, "Topological persistence and simplification", 2002). A pose stands for all that differ from it by
//!   rolling without climbing.

use std::{
    cmp::Ordering,
    collections::HashMap,
    f64::consts::{PI, TAU},
};

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, UnitVector3, Vector3};

use super::{Solid, convex_hull};

/// Climb between two facets that makes them two poses, over the largest distance of a point from the centre of mass.
pub const MIN_BARRIER: f64 = 0.01;

/// A stable pose on a table, up to place and yaw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestPose {
    /// Turns the object's axes into the table's, whose z points up. Of all yaws the one that turns least.
    pub table_from_object: UnitQuaternion<f64>,
    /// Height of the object's origin above the table, m; below zero where the origin lies outside of the object.
    pub origin_height_m: f64,
    /// Height of the centre of mass above the table, m.
    pub com_height_m: f64,
    /// Share of slow drops from any orientation that end here; the shares of an object add up to 1.
    pub weight: f64,
    /// How far the centre of mass must rise on the easiest way into another pose, m. `None` for an only pose.
    pub barrier_m: Option<f64>,
}

impl RestPose {
    /// The object resting with its origin above `(x, y)` of the table, turned by `yaw_rad` about the vertical.
    pub fn at(&self, [x_m, y_m]: [f64; 2], yaw_rad: f64) -> Isometry3<f64> {
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        Isometry3::from_parts(Translation3::new(x_m, y_m, self.origin_height_m), yaw * self.table_from_object)
    }

    /// The one of `poses` that `fraction`, evenly drawn from 0 to 1, falls on; `None` for no poses.
    pub fn pick(poses: &[Self], fraction: f64) -> Option<&Self> {
        let mut left = fraction;
        let found = poses.iter().find(|pose| {
            left -= pose.weight;
            left < 0.0
        });
        found.or(poses.last())
    }
}

/// See the module.
pub(super) fn poses(solid: &Solid) -> Result<Vec<RestPose>, String> {
    let com = solid.centroid_in_object();
    let landscape = Landscape::new(solid, &com)?;
    let basin_of = landscape.basins();
    let pose_of = landscape.merged(&basin_of);
    let mut poses: Vec<(UnitVector3<f64>, RestPose)> = Vec::new();
    let total_angle: f64 = landscape.facets.iter().map(|facet| facet.solid_angle).sum();
    for root in 0..landscape.facets.len() {
        if pose_of[root] != root {
            continue;
        }
        let members = landscape.facets.iter().zip(&pose_of).filter(|(_, pose)| **pose == root);
        let weight = members.map(|(facet, _)| facet.solid_angle).sum::<f64>() / total_angle;
        let barrier_m = landscape
            .edges
            .iter()
            .filter(|edge| (pose_of[edge.facets[0]] == root) != (pose_of[edge.facets[1]] == root))
            .map(|edge| edge.saddle_m - landscape.facets[root].height_m)
            .reduce(f64::min);
        let down = settled(solid, &com, landscape.facets[root].normal);
        poses.push((
            down,
            RestPose {
                table_from_object: turning_down(&down),
                origin_height_m: solid.farthest_along(&down),
                com_height_m: solid.farthest_along(&down) - down.dot(&com.coords),
                weight,
                barrier_m,
            },
        ));
    }
    poses.sort_by(likelier_first);
    Ok(poses.into_iter().map(|(_, pose)| pose).collect())
}

/// By weight, then by direction, both without their last digits: symmetric poses differ by rounding only.
fn likelier_first(a: &(UnitVector3<f64>, RestPose), b: &(UnitVector3<f64>, RestPose)) -> Ordering {
    let rounded = |value: f64| (value * 1e6).round() as i64;
    let key = |(down, pose): &(UnitVector3<f64>, RestPose)| {
        (-rounded(pose.weight), rounded(down.z), rounded(down.y), rounded(down.x))
    };
    key(a).cmp(&key(b))
}

/// Turns `down` to minus z by the shortest way.
fn turning_down(down: &UnitVector3<f64>) -> UnitQuaternion<f64> {
    let half_turn = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    UnitQuaternion::rotation_between(down, &-Vector3::z()).unwrap_or_else(half_turn)
}

/// The height of the centre of mass over the facets of the hull and the edges between them.
struct Landscape {
    facets: Vec<Facet>,
    edges: Vec<Edge>,
    /// Largest distance of a point from the centre of mass, m.
    reach_m: f64,
}

struct Facet {
    normal: UnitVector3<f64>,
    /// Height of the centre of mass when the facet lies on the table, m.
    height_m: f64,
    /// As seen from the centre of mass, sr.
    solid_angle: f64,
    /// How far the foot of the centre of mass lies beyond each edge, m, and the facet there.
    beyond_m: [f64; 3],
    neighbours: [usize; 3],
}

struct Edge {
    facets: [usize; 2],
    /// Largest height of the centre of mass while tipping over the edge, m.
    saddle_m: f64,
}

impl Landscape {
    fn new(solid: &Solid, com: &Point3<f64>) -> Result<Self, String> {
        let mut points = Vec::new();
        solid.parts.iter().for_each(|part| part.hull_points(&mut points));
        let (vertices, triangles) = convex_hull(&points)?;
        let from_com: Vec<Vector3<f64>> = vertices.iter().map(|vertex| vertex - com).collect();
        let reach_m = from_com.iter().map(Vector3::norm).fold(0.0, f64::max);
        let open =
            || "the convex hull of its points is not closed; move points that nearly coincide".to_owned();

        let mut facet_at: HashMap<(u32, u32), usize> = HashMap::new();
        for (i, &[a, b, c]) in triangles.iter().enumerate() {
            for edge in [(a, b), (b, c), (c, a)] {
                if facet_at.insert(edge, i).is_some() {
                    return Err(open());
                }
            }
        }
        let mut facets = Vec::with_capacity(triangles.len());
        for &[a, b, c] in &triangles {
            let corners = [a, b, c].map(|i| from_com[i as usize]);
            let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
            let normal = UnitVector3::try_new(normal, 0.0).ok_or_else(open)?;
            let height_m = normal.dot(&corners[0]);
            let mut beyond_m = [0.0; 3];
            let mut neighbours = [0; 3];
            for (k, (i, j)) in [(a, b), (b, c), (c, a)].into_iter().enumerate() {
                let along = (corners[(k + 1) % 3] - corners[k]).try_normalize(0.0).ok_or_else(open)?;
                beyond_m[k] = (normal.scale(height_m) - corners[k]).dot(&along.cross(&normal));
                neighbours[k] = *facet_at.get(&(j, i)).ok_or_else(open)?;
            }
            let solid_angle = solid_angle(&corners);
            facets.push(Facet { normal, height_m, solid_angle, beyond_m, neighbours });
        }
        let mut edges = Vec::with_capacity(3 * facets.len() / 2);
        for (i, triangle) in triangles.iter().enumerate() {
            for k in 0..3 {
                let j = facets[i].neighbours[k];
                if i < j {
                    let ends = [k, (k + 1) % 3].map(|corner| from_com[triangle[corner] as usize]);
                    edges.push(Edge { facets: [i, j], saddle_m: saddle_m(&facets[i], &facets[j], ends) });
                }
            }
        }
        Ok(Self { facets, edges, reach_m })
    }

    /// For every facet, the one on which it ends up.
    fn basins(&self) -> Vec<usize> {
        let next = |i: usize| {
            let facet = &self.facets[i];
            let (edge, beyond_m) = (0..3)
                .map(|k| (k, facet.beyond_m[k]))
                .fold((0, f64::NEG_INFINITY), |best, edge| if edge.1 > best.1 { edge } else { best });
            let neighbour = facet.neighbours[edge];
            // Toppling lowers the centre of mass; what does not is rounding between facets of one plane.
            let falls = (self.facets[neighbour].height_m, neighbour) < (facet.height_m, i);
            (beyond_m > 0.0 && falls).then_some(neighbour)
        };
        let last = |start: usize| {
            let mut i = start;
            while let Some(lower) = next(i) {
                i = lower;
            }
            i
        };
        (0..self.facets.len()).map(last).collect()
    }

    /// For every facet, the lowest facet of its pose.
    fn merged(&self, basin_of: &[usize]) -> Vec<usize> {
        let mut root_of: Vec<usize> = (0..self.facets.len()).collect();
        fn find(root_of: &[usize], mut i: usize) -> usize {
            while root_of[i] != i {
                i = root_of[i];
            }
            i
        }
        let mut by_height: Vec<&Edge> = self.edges.iter().collect();
        by_height.sort_by(|a, b| a.saddle_m.total_cmp(&b.saddle_m).then(a.facets.cmp(&b.facets)));
        for edge in by_height {
            let [a, b] = edge.facets.map(|facet| find(&root_of, basin_of[facet]));
            let key = |i: usize| (self.facets[i].height_m, i);
            let (low, high) = if key(a) <= key(b) { (a, b) } else { (b, a) };
            if edge.saddle_m - self.facets[high].height_m < MIN_BARRIER * self.reach_m {
                root_of[high] = low;
            }
        }
        basin_of.iter().map(|&basin| find(&root_of, basin)).collect()
    }
}

/// Largest height of the centre of mass on the way from one facet to the other over the edge between `ends`.
fn saddle_m(from: &Facet, to: &Facet, ends: [Vector3<f64>; 2]) -> f64 {
    let highest_end = from.height_m.max(to.height_m);
    let Some(along) = (ends[1] - ends[0]).try_normalize(0.0) else { return highest_end };
    let across = ends[0] - along * ends[0].dot(&along);
    // Upright over the edge, if tipping passes through that.
    let turn = from.normal.cross(&to.normal);
    let passes = from.normal.cross(&across).dot(&turn) > 0.0 && across.cross(&to.normal).dot(&turn) > 0.0;
    if passes { across.norm().max(highest_end) } else { highest_end }
}

/// Of a triangle seen from the origin (Van Oosterom and Strackee 1983).
fn solid_angle([a, b, c]: &[Vector3<f64>; 3]) -> f64 {
    let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
    let above = a.dot(&b.cross(c));
    let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * above.atan2(below)
}

/// `down` of a facet, mended where its corners only stand for curved parts: a search for the lowest centre of mass
/// nearby, over the parts themselves. Flat faces are their own minimum and stay as they are.
fn settled(solid: &Solid, com: &Point3<f64>, facet_down: UnitVector3<f64>) -> UnitVector3<f64> {
    const DIRECTIONS: usize = 16;
    let height_m = |down: &UnitVector3<f64>| solid.farthest_along(down) - down.dot(&com.coords);
    let mut down = facet_down;
    let mut lowest_m = height_m(&down);
    let mut step_rad = 0.02;
    let mut turn_rad = 0.0_f64;
    while step_rad > 1e-9 {
        let across = down.cross(&Vector3::ith(down.iamin(), 1.0)).normalize();
        let along = down.cross(&across);
        let tilted = (0..DIRECTIONS).map(|i| {
            let (sin, cos) = (turn_rad + TAU * i as f64 / DIRECTIONS as f64).sin_cos();
            UnitVector3::new_normalize(down.into_inner() + (across * cos + along * sin) * step_rad)
        });
        let best = tilted.map(|down| (height_m(&down), down)).min_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            // A fall by less than this is rounding.
            Some((height, tilted)) if height < lowest_m * (1.0 - 1e-14) => {
                (lowest_m, down) = (height, tilted);
            }
            _ => step_rad *= 0.75,
        }
        // Where two parts touch the table the way down is narrow, so no direction is tried twice.
        turn_rad += 1.0;
    }
    down
}
