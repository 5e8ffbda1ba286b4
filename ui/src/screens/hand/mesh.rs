//! Triangles with normals and colours: the shapes that robots, skins and objects are drawn from.

use bytemuck::{Pod, Zeroable};
use nalgebra::{Isometry3, Point3, Vector3};

use super::camera::{Bounds, Ray};

/// A corner, as the graphics card gets it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(super) struct Vertex {
    /// Position in the mesh's frame, m.
    pub position: [f32; 3],
    /// Outward unit normal.
    pub normal: [f32; 3],
    /// Linear RGBA, multiplied with the instance's.
    pub color: [f32; 4],
}

/// A triangle mesh, counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Mesh {
    /// Corners.
    pub vertices: Vec<Vertex>,
    /// Three for each triangle.
    pub indices: Vec<u32>,
}

/// A point of an outline that is turned about z, with its outward normal: radius, z, normal's radius, normal's z.
type OutlinePoint = [f32; 4];

/// White: the instance decides.
pub(super) const WHITE: [f32; 4] = [1.0; 4];

impl Mesh {
    /// A box about the origin with full edge lengths and round edges.
    pub(super) fn rounded_box(size_m: [f32; 3], edge_radius_m: f32, color: [f32; 4]) -> Self {
        let half = Vector3::from(size_m) / 2.0;
        let radius = edge_radius_m.clamp(0.0, half.min()).max(1e-6);
        let mut mesh = Self::default();
        for axis in 0..3 {
            for sign in [-1.0f32, 1.0] {
                let (u_axis, v_axis) = ((axis + 1) % 3, (axis + 2) % 3);
                let u_lines = edge_lines(half[u_axis], radius);
                let v_lines = edge_lines(half[v_axis], radius);
                let first = mesh.vertices.len() as u32;
                for &v in &v_lines {
                    for &u in &u_lines {
                        let mut on_cube = Vector3::zeros();
                        on_cube[axis] = sign * half[axis];
                        on_cube[u_axis] = u;
                        on_cube[v_axis] = v;
                        // The box is a smaller one, thickened by `radius`: go to the smaller one and out again.
                        let inner = on_cube.zip_map(&half, |c, h| c.clamp(-(h - radius), h - radius));
                        let normal = (on_cube - inner).normalize();
                        mesh.push(inner + normal * radius, normal, color);
                    }
                }
                mesh.push_grid(first, u_lines.len() as u32, v_lines.len() as u32, sign > 0.0);
            }
        }
        mesh
    }

    /// A cylinder along z about the origin, edges broken by `edge_radius_m`.
    pub(super) fn cylinder(radius_m: f32, length_m: f32, edge_radius_m: f32, color: [f32; 4]) -> Self {
        let (half, edge) = (length_m / 2.0, edge_radius_m.clamp(0.0, radius_m.min(length_m / 2.0)));
        let outline = [
            [0.0, -half, 0.0, -1.0],
            [radius_m - edge, -half, 0.0, -1.0],
            [radius_m - edge * 0.293, -half + edge * 0.293, 0.707, -0.707],
            [radius_m, -half + edge, 1.0, 0.0],
            [radius_m, half - edge, 1.0, 0.0],
            [radius_m - edge * 0.293, half - edge * 0.293, 0.707, 0.707],
            [radius_m - edge, half, 0.0, 1.0],
            [0.0, half, 0.0, 1.0],
        ];
        if edge > 0.0 {
            return Self::turned(&outline, 40, color);
        }
        // Sharp edges need each rim twice, once for either normal.
        let rim = |z: f32, nr: f32, nz: f32| [radius_m, z, nr, nz];
        let sharp = [
            outline[0],
            rim(-half, 0.0, -1.0),
            rim(-half, 1.0, 0.0),
            rim(half, 1.0, 0.0),
            rim(half, 0.0, 1.0),
            outline[7],
        ];
        Self::turned(&sharp, 40, color)
    }

    /// A ball about the origin.
    pub(super) fn sphere(radius_m: f32, segments: u32, color: [f32; 4]) -> Self {
        Self::capsule(radius_m, 0.0, segments, color)
    }

    /// A capsule along z about the origin; `length_m` is that of its cylindrical part.
    pub(super) fn capsule(radius_m: f32, length_m: f32, segments: u32, color: [f32; 4]) -> Self {
        let rings = (segments / 4).max(2);
        let mut outline = Vec::new();
        for (end, first_angle) in [(-1.0f32, -std::f32::consts::FRAC_PI_2), (1.0, 0.0)] {
            for ring in 0..=rings {
                let (sin, cos) =
                    (first_angle + std::f32::consts::FRAC_PI_2 * ring as f32 / rings as f32).sin_cos();
                outline.push([radius_m * cos, end * length_m / 2.0 + radius_m * sin, cos, sin]);
            }
        }
        Self::turned(&outline, segments, color)
    }

    /// A flat lens on the xy plane that bulges along +z, radius one: a taxel's marker.
    pub(super) fn lens(height: f32, segments: u32) -> Self {
        let rings = 5;
        let outline: Vec<OutlinePoint> = (0..=rings)
            .map(|ring| {
                let (sin, cos) = (std::f32::consts::FRAC_PI_2 * ring as f32 / rings as f32).sin_cos();
                let normal = nalgebra::Vector2::new(cos * height, sin).normalize();
                [cos, height * sin, normal.x, normal.y]
            })
            .collect();
        Self::turned(&outline, segments, WHITE)
    }

    /// Small round tiles, one at each point, facing along its normal: the skin of a patch.
    pub(super) fn tiles(
        points: impl IntoIterator<Item = (Point3<f32>, Vector3<f32>)>,
        radius_m: f32,
    ) -> Self {
        const CORNERS: u32 = 8;
        let mut mesh = Self::default();
        for (center, normal) in points {
            let first = mesh.vertices.len() as u32;
            let helper = if normal.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
            let u = normal.cross(&helper).normalize();
            let v = normal.cross(&u);
            mesh.push(center.coords, normal, WHITE);
            for corner in 0..CORNERS {
                let (sin, cos) = (std::f32::consts::TAU * corner as f32 / CORNERS as f32).sin_cos();
                mesh.push(center.coords + (u * cos + v * sin) * radius_m, normal, WHITE);
            }
            for corner in 0..CORNERS {
                mesh.indices.extend([first, first + 1 + corner, first + 1 + (corner + 1) % CORNERS]);
            }
        }
        mesh
    }

    /// Given triangles, each flat. Those without an area are left out.
    pub(super) fn flat(
        corners: &[Point3<f32>],
        triangles: impl IntoIterator<Item = [u32; 3]>,
        color: [f32; 4],
    ) -> Self {
        let mut mesh = Self::default();
        for triangle in triangles {
            let Some([a, b, c]) = corners_of(corners, triangle) else { continue };
            if let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-12) {
                let first = mesh.vertices.len() as u32;
                for corner in [a, b, c] {
                    mesh.push(corner.coords, normal, color);
                }
                mesh.indices.extend([first, first + 1, first + 2]);
            }
        }
        mesh
    }

    /// Adds `other`, moved by `pose`.
    pub(super) fn append(&mut self, other: &Self, pose: &Isometry3<f32>) {
        let first = self.vertices.len() as u32;
        self.vertices.extend(other.vertices.iter().map(|vertex| Vertex {
            position: (pose * Point3::from(vertex.position)).into(),
            normal: (pose.rotation * Vector3::from(vertex.normal)).into(),
            color: vertex.color,
        }));
        self.indices.extend(other.indices.iter().map(|index| index + first));
    }

    /// A ball around all corners.
    pub(super) fn bounds(&self) -> Option<Bounds> {
        Bounds::around(self.vertices.iter().map(|vertex| Point3::from(vertex.position)))
    }

    /// Distance along `ray` (in the mesh's frame) to the nearest triangle that faces it, m.
    pub(super) fn hit(&self, ray: &Ray) -> Option<f32> {
        // Möller and Trumbore, "Fast, minimum storage ray-triangle intersection" (1997), one-sided.
        let (corners, _) = self.indices.as_chunks::<3>();
        corners
            .iter()
            .filter_map(|triangle| {
                let [a, b, c] = triangle.map(|index| Point3::from(self.vertices[index as usize].position));
                let (edge_b, edge_c) = (b - a, c - a);
                let across = ray.direction.cross(&edge_c);
                let det = edge_b.dot(&across);
                if det <= 1e-14 {
                    return None;
                }
                let from_a = ray.origin - a;
                let u = from_a.dot(&across) / det;
                let along = from_a.cross(&edge_b);
                let v = ray.direction.dot(&along) / det;
                let distance = edge_c.dot(&along) / det;
                (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance > 0.0).then_some(distance)
            })
            .min_by(f32::total_cmp)
    }

    /// An outline turned about z, from its lowest point to its highest.
    fn turned(outline: &[OutlinePoint], segments: u32, color: [f32; 4]) -> Self {
        let mut mesh = Self::default();
        let segments = segments.max(3);
        for [radius, z, normal_radius, normal_z] in outline {
            for segment in 0..=segments {
                let (sin, cos) = (std::f32::consts::TAU * segment as f32 / segments as f32).sin_cos();
                let normal = Vector3::new(normal_radius * cos, normal_radius * sin, *normal_z);
                mesh.push(Vector3::new(radius * cos, radius * sin, *z), normal, color);
            }
        }
        mesh.push_grid(0, segments + 1, outline.len() as u32, true);
        mesh
    }

    fn push(&mut self, position: Vector3<f32>, normal: Vector3<f32>, color: [f32; 4]) {
        self.vertices.push(Vertex { position: position.into(), normal: normal.into(), color });
    }

    /// Joins a grid of corners, `columns` wide, into triangles. `outward`: columns x rows points outward.
    fn push_grid(&mut self, first: u32, columns: u32, rows: u32, outward: bool) {
        for row in 0..rows - 1 {
            for column in 0..columns - 1 {
                let a = first + row * columns + column;
                let (b, c, d) = (a + 1, a + columns + 1, a + columns);
                if outward {
                    self.indices.extend([a, b, c, a, c, d]);
                } else {
                    self.indices.extend([a, c, b, a, d, c]);
                }
            }
        }
    }
}

/// The corners of a triangle, if all exist.
fn corners_of(corners: &[Point3<f32>], triangle: [u32; 3]) -> Option<[Point3<f32>; 3]> {
    let [a, b, c] = triangle.map(|index| corners.get(index as usize).copied());
    Some([a?, b?, c?])
}

/// Where a face of a rounded box is cut: finer along its edges.
fn edge_lines(half: f32, radius: f32) -> [f32; 8] {
    let at = |share: f32| half - radius + radius * share;
    [-at(1.0), -at(0.55), -at(0.25), -at(0.0), at(0.0), at(0.25), at(0.55), at(1.0)]
}

#[cfg(test)]
mod tests {
    use nalgebra::Unit;
    use proptest::prelude::*;

    use super::*;

    fn solids() -> Vec<(&'static str, Mesh)> {
        vec![
            ("box", Mesh::rounded_box([0.1, 0.02, 0.3], 0.004, WHITE)),
            ("sharp box", Mesh::rounded_box([0.1, 0.02, 0.3], 0.0, WHITE)),
            ("cylinder", Mesh::cylinder(0.03, 0.2, 0.004, WHITE)),
            ("sharp cylinder", Mesh::cylinder(0.03, 0.2, 0.0, WHITE)),
            ("sphere", Mesh::sphere(0.05, 24, WHITE)),
            ("capsule", Mesh::capsule(0.02, 0.1, 24, WHITE)),
        ]
    }

    #[test]
    fn triangles_face_the_way_their_normals_point() {
        let mut meshes = solids();
        meshes.push(("lens", Mesh::lens(0.4, 16)));
        meshes.push((
            "tiles",
            Mesh::tiles(
                [(Point3::new(0.1, 0.0, 0.0), Vector3::y()), (Point3::origin(), -Vector3::z())],
                0.001,
            ),
        ));
        for (name, mesh) in meshes {
            assert!(
                mesh.vertices.iter().all(|v| (Vector3::from(v.normal).norm() - 1.0).abs() < 2e-3),
                "{name}: unit normals"
            );
            let size = mesh.bounds().expect("corners").radius_m;
            for triangle in mesh.indices.chunks(3) {
                let corner = |i: usize| Vector3::from(mesh.vertices[triangle[i] as usize].position);
                let facing = (corner(1) - corner(0)).cross(&(corner(2) - corner(0)));
                // The triangles at a pole of a turned outline have no area.
                if facing.norm() > 1e-6 * size * size {
                    let normal: Vector3<f32> =
                        triangle.iter().map(|&i| Vector3::from(mesh.vertices[i as usize].normal)).sum();
                    assert!(facing.dot(&normal) > 0.0, "{name}: {triangle:?}");
                }
            }
        }
    }

    #[test]
    fn a_solid_has_the_volume_that_its_sizes_say() {
        use std::f32::consts::PI;
        let expected = [
            ("sharp box", 0.1 * 0.02 * 0.3),
            ("sharp cylinder", PI * 0.03 * 0.03 * 0.2),
            ("sphere", 4.0 / 3.0 * PI * 0.05f32.powi(3)),
            ("capsule", 4.0 / 3.0 * PI * 0.02f32.powi(3) + PI * 0.02 * 0.02 * 0.1),
        ];
        for (name, mesh) in solids() {
            let volume: f32 = mesh
                .indices
                .chunks(3)
                .map(|t| {
                    let corner = |i: usize| Vector3::from(mesh.vertices[t[i] as usize].position);
                    corner(0).dot(&corner(1).cross(&corner(2))) / 6.0
                })
                .sum();
            if let Some((_, wanted)) = expected.iter().find(|(wanted_name, _)| *wanted_name == name) {
                assert!((volume / wanted - 1.0).abs() < 0.03, "{name}: {volume} is not {wanted}");
            }
            assert!(volume > 0.0);
        }
    }

    proptest! {
        #[test]
        fn a_ray_at_the_middle_of_a_ball_hits_its_near_side(x in -1.0f32..1.0, y in -1.0f32..1.0, z in -1.0f32..1.0) {
            let toward = Unit::try_new(Vector3::new(x, y, z), 1e-2);
            prop_assume!(toward.is_some());
            let toward = toward.expect("assumed");
            let ray = Ray { origin: Point3::from(-toward.into_inner()), direction: toward };
            let distance = Mesh::sphere(0.1, 48, WHITE).hit(&ray).expect("in the way");
            prop_assert!((distance - 0.9).abs() < 2e-3, "{distance}");
            let away = Ray { origin: ray.origin, direction: -toward };
            prop_assert!(Mesh::sphere(0.1, 48, WHITE).hit(&away).is_none());
        }
    }
}
