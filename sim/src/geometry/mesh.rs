//! Closed triangle meshes with an inside.

use std::collections::HashMap;

use nalgebra::Point3;
use parry3d_f64::query::{PointQuery, PointQueryWithLocation};
use parry3d_f64::shape::{TriMesh, TriMeshFlags};

use super::parry_vector;

/// A triangle smaller than this has no normal that could tell inside from outside, m^2.
const MIN_TRIANGLE_AREA_M2: f64 = 1e-16;

/// Largest distance of `points` from the origin.
pub(super) fn radius_about_origin(points: &[Point3<f64>]) -> f64 {
    points.iter().map(|p| p.coords.norm()).fold(0.0, f64::max)
}

/// The mesh with pseudo-normals, which give the sign of distances (Baerentzen and Aanaes 2005), or why it has no
/// inside. Vertices at equal positions are merged first: STL repeats them for every triangle.
pub(super) fn closed(vertices: &[Point3<f64>], triangles: &[[u32; 3]]) -> Result<TriMesh, String> {
    if triangles.is_empty() {
        return Err("mesh has no triangles".to_owned());
    }
    if let Some(i) = vertices.iter().position(|v| !v.iter().all(|c| c.is_finite())) {
        return Err(format!(
            "mesh vertex {i} is {:?}, expected finite coordinates in m",
            vertices[i].coords.as_slice()
        ));
    }
    for (i, triangle) in triangles.iter().enumerate() {
        let Some([a, b, c]) = corners(vertices, triangle) else {
            return Err(format!(
                "mesh triangle {i} names vertices {triangle:?}, but there are {}",
                vertices.len()
            ));
        };
        if 0.5 * (b - a).cross(&(c - a)).norm() < MIN_TRIANGLE_AREA_M2 {
            return Err(format!(
                "mesh triangle {i} has no area; remove degenerate triangles, or check that its unit is m"
            ));
        }
    }
    let points = vertices.iter().map(parry_vector).collect();
    let flags = TriMeshFlags::MERGE_DUPLICATE_VERTICES | TriMeshFlags::ORIENTED;
    let mesh = TriMesh::with_flags(points, triangles.to_vec(), flags)
        .map_err(|err| format!("mesh is unusable: {err}"))?;
    check_closed(&mesh)?;
    if signed_volume(&mesh) <= 0.0 {
        return Err(
            "mesh is inside out: expected counter-clockwise triangles seen from outside; flip its normals"
                .to_owned(),
        );
    }
    Ok(mesh)
}

fn corners(vertices: &[Point3<f64>], triangle: &[u32; 3]) -> Option<[Point3<f64>; 3]> {
    let [a, b, c] = triangle.map(|i| vertices.get(i as usize).copied());
    Some([a?, b?, c?])
}

/// In a closed, consistently oriented surface every directed edge has its opposite exactly once.
fn check_closed(mesh: &TriMesh) -> Result<(), String> {
    let mut edges: HashMap<(u32, u32), usize> = HashMap::new();
    let directed = |&[a, b, c]: &[u32; 3]| [(a, b), (b, c), (c, a)];
    for edge in mesh.indices().iter().flat_map(directed) {
        *edges.entry(edge).or_default() += 1;
    }
    // Over the triangles, not the map: the message must not depend on the map's order.
    for (a, b) in mesh.indices().iter().flat_map(directed) {
        let at = || {
            let (p, q) = (mesh.vertices()[a as usize], mesh.vertices()[b as usize]);
            format!("the edge from ({}, {}, {}) to ({}, {}, {}) m", p.x, p.y, p.z, q.x, q.y, q.z)
        };
        if edges[&(a, b)] > 1 {
            return Err(format!(
                "mesh has {} running the same way in several triangles; expected a surface without doubled or flipped \
                 triangles",
                at()
            ));
        }
        if !edges.contains_key(&(b, a)) {
            return Err(format!(
                "mesh is open at {}, so it has no inside; close its holes, or use convex parts",
                at()
            ));
        }
    }
    Ok(())
}

pub(super) fn signed_volume(mesh: &TriMesh) -> f64 {
    mesh.triangles().map(|t| t.a.dot(t.b.cross(t.c)) / 6.0).sum()
}

/// Signed distance to a closed mesh if below `limit`, else a value from `limit` up to it.
pub(super) fn distance_below(mesh: &TriMesh, p: &Point3<f64>, limit: f64) -> f64 {
    let p = parry_vector(p);
    let outside_bounds = mesh.local_aabb().distance_to_local_point(p, true);
    if outside_bounds > 0.0 {
        if outside_bounds >= limit {
            return outside_bounds;
        }
        // Certainly outside, so the search may stop at the limit.
        let nearest = mesh.project_local_point_and_get_location_with_max_dist(p, false, limit.min(f64::MAX));
        return nearest.map_or(limit, |(projection, _)| (projection.point - p).length());
    }
    let (projection, _) = mesh.project_local_point_and_get_location(p, false);
    let distance = (projection.point - p).length();
    if projection.is_inside { -distance } else { distance }
}
