//! The convex hull of a few hundred points: the surface of a convex part.

use nalgebra::{Point3, Vector3};

/// Triangles of the convex hull, counter-clockwise seen from outside. Empty if the points lie in a plane.
///
/// One point at a time: the faces that see it go, and it is joined to the edge of the hole. Quadratic, which is fine
/// for the parts of a convex decomposition (tens to hundreds of points).
pub(super) fn convex_hull(points: &[Point3<f32>]) -> Vec<[u32; 3]> {
    let Some(start) = first_tetrahedron(points) else { return Vec::new() };
    let [a, b, c, d] = start;
    let inside = Point3::from(
        (points[a as usize].coords
            + points[b as usize].coords
            + points[c as usize].coords
            + points[d as usize].coords)
            / 4.0,
    );
    let size = points.iter().map(|p| (p - inside).norm()).fold(0.0, f32::max);
    let tolerance = 1e-5 * size;
    let mut faces: Vec<[u32; 3]> = [[a, b, c], [a, c, d], [a, d, b], [b, d, c]]
        .into_iter()
        .map(
            |face| if height_above(points, face, &inside) > 0.0 { [face[0], face[2], face[1]] } else { face },
        )
        .collect();
    for (index, point) in points.iter().enumerate() {
        let (seen, kept): (Vec<_>, Vec<_>) =
            faces.iter().partition(|face| height_above(points, **face, point) > tolerance);
        if seen.is_empty() {
            continue;
        }
        let edges = |face: &[u32; 3]| [[face[0], face[1]], [face[1], face[2]], [face[2], face[0]]];
        let seen_edges: Vec<[u32; 2]> = seen.iter().flat_map(edges).collect();
        faces = kept;
        // An edge between two faces that go is there twice, once each way; the others are the rim of the hole.
        for [from, to] in &seen_edges {
            if !seen_edges.contains(&[*to, *from]) {
                faces.push([*from, *to, index as u32]);
            }
        }
    }
    faces
}

/// Distance of `point` from the plane of `face`, positive outside. Zero for a face without an area.
fn height_above(points: &[Point3<f32>], face: [u32; 3], point: &Point3<f32>) -> f32 {
    let [a, b, c] = face.map(|index| points[index as usize]);
    (b - a).cross(&(c - a)).try_normalize(1e-20).map_or(0.0, |normal: Vector3<f32>| normal.dot(&(point - a)))
}

/// Four points that are far from lying in a plane.
fn first_tetrahedron(points: &[Point3<f32>]) -> Option<[u32; 4]> {
    let farthest = |measure: &dyn Fn(&Point3<f32>) -> f32| -> Option<(usize, f32)> {
        points.iter().enumerate().map(|(i, p)| (i, measure(p))).max_by(|x, y| x.1.total_cmp(&y.1))
    };
    let a = *points.first()?;
    let (b_idx, length) = farthest(&|p| (p - a).norm())?;
    let b = points[b_idx];
    let (c_idx, area) = farthest(&|p| (b - a).cross(&(p - a)).norm())?;
    let c = points[c_idx];
    let normal = (b - a).cross(&(c - a));
    let (d_idx, volume) = farthest(&|p| normal.dot(&(p - a)).abs())?;
    (volume > 1e-5 * length.powi(3) && area > 0.0).then_some([0, b_idx as u32, c_idx as u32, d_idx as u32])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn point() -> impl Strategy<Value = Point3<f32>> {
        [-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0].prop_map(Point3::from)
    }

    proptest! {
        #[test]
        fn every_point_is_inside_and_the_surface_is_closed(points in prop::collection::vec(point(), 8..60)) {
            let faces = convex_hull(&points);
            prop_assert!(faces.len() >= 4);
            for face in &faces {
                for point in &points {
                    prop_assert!(height_above(&points, *face, point) < 1e-3);
                }
                for (from, to) in [(face[0], face[1]), (face[1], face[2]), (face[2], face[0])] {
                    let twins = faces.iter().filter(|f| [[f[0], f[1]], [f[1], f[2]], [f[2], f[0]]].contains(&[to, from])).count();
                    prop_assert_eq!(twins, 1);
                }
            }
            // Euler's formula for a closed triangle mesh: F = 2 V - 4.
            let mut corners: Vec<u32> = faces.iter().flatten().copied().collect();
            corners.sort_unstable();
            corners.dedup();
            prop_assert_eq!(faces.len(), 2 * corners.len() - 4);
        }
    }

    #[test]
    fn a_cube_has_twelve_triangles_whatever_else_lies_inside() {
        let mut points: Vec<_> =
            (0..8).map(|i| Point3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2 & 1) as f32)).collect();
        points.push(Point3::new(0.5, 0.4, 0.3));
        assert_eq!(convex_hull(&points).len(), 12);
    }

    #[test]
    fn points_in_a_plane_have_no_hull() {
        let points: Vec<_> = (0..9).map(|i| Point3::new((i % 3) as f32, (i / 3) as f32, 0.0)).collect();
        assert!(convex_hull(&points).is_empty());
        assert!(convex_hull(&[]).is_empty());
    }
}
