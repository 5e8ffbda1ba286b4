//! Points on surfaces, evenly by area.
//!
//! Random lines, every one as likely as any other, cross a surface at points that are even by area (Crofton). A line is
//! followed by steps as long as the signed distance, which skip no surface; where the distance changes its sign is a point.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Point3, Vector3};
use palpate_robot_model::{Link, LinkShape, ObjectShape};
use palpate_sim::geometry::SignedDistance;
use rand::{Rng, RngExt};

/// Nearer to the surface than this counts as on it, m.
const ON_SURFACE_M: f64 = 1e-6;
/// So far before and after a point on the surface, m, the sides are told apart: where parts share a face, both are inside.
const SIDE_M: f64 = 1e-5;
/// Lines that miss before a shape counts as without a surface.
const MAX_LINES: usize = 1_000_000;
/// Lines that a link's area is measured with.
const AREA_LINES: usize = 4000;

/// A surface to draw points from.
pub(crate) struct Surface {
    shape: SignedDistance,
    /// m
    radius_m: f64,
}

impl Surface {
    /// The surface of `shape`; says why where it has no inside.
    pub(crate) fn new(shape: &ObjectShape) -> Result<Self, String> {
        let shape = SignedDistance::new(shape)?;
        let radius_m = shape.bounding_radius_m() * (1.0 + 1e-9) + SIDE_M;
        Ok(Self { shape, radius_m })
    }

    /// The surface of what a link touches with; nothing for a mere frame.
    pub(crate) fn of_link(link: &Link) -> Result<Option<Self>, String> {
        let part = |geometry: &palpate_robot_model::LinkGeometry| {
            let shape = match geometry.shape {
                LinkShape::Box { size_m } => ObjectShape::Box { size_m },
                LinkShape::Cylinder { radius_m, length_m } => {
                    ObjectShape::Cylinder { radius_m, height_m: length_m }
                }
                LinkShape::Capsule { radius_m, length_m } => ObjectShape::Capsule { radius_m, length_m },
                LinkShape::Sphere { radius_m } => ObjectShape::Sphere { radius_m },
            };
            (geometry.link_from_shape, shape)
        };
        let parts: Vec<(Isometry3<f64>, ObjectShape)> = link.collisions.iter().map(part).collect();
        if parts.is_empty() { Ok(None) } else { Self::new(&ObjectShape::Compound { parts }).map(Some) }
    }

    /// `count` points in the shape's frame.
    pub(crate) fn points(&self, count: usize, rng: &mut impl Rng) -> Result<Vec<Point3<f64>>, String> {
        let mut points = Vec::new();
        for _ in 0..MAX_LINES {
            if points.len() >= count {
                points.truncate(count);
                return Ok(points);
            }
            self.cross(rng, &mut points);
        }
        Err("random lines find no surface to draw points from".to_owned())
    }

    /// Its area, m^2, as random lines measure it: a ball's is four of its great disc, and lines cross it twice.
    pub(crate) fn area_m2(&self, rng: &mut impl Rng) -> f64 {
        let mut points = Vec::new();
        (0..AREA_LINES).for_each(|_| self.cross(rng, &mut points));
        points.len() as f64 / AREA_LINES as f64 * TAU * self.radius_m.powi(2)
    }

    /// Adds where a random line crosses the surface.
    fn cross(&self, rng: &mut impl Rng, points: &mut Vec<Point3<f64>>) {
        let z: f64 = 2.0 * rng.random::<f64>() - 1.0;
        let (sin, cos) = (TAU * rng.random::<f64>()).sin_cos();
        let flat = (1.0 - z * z).sqrt();
        let direction = Vector3::new(flat * cos, flat * sin, z);
        let helper = if z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
        let right = direction.cross(&helper).normalize();
        let up = direction.cross(&right);
        let (sin, cos) = (TAU * rng.random::<f64>()).sin_cos();
        let offset = self.radius_m * rng.random::<f64>().sqrt();
        let middle = Point3::from((right * cos + up * sin) * offset);
        let half = (self.radius_m.powi(2) - offset.powi(2)).sqrt();
        let at = |along: f64| middle + direction * along;
        let mut along = -half;
        while along < half {
            let distance = self.shape.distance_m(&at(along)).abs();
            if distance > ON_SURFACE_M {
                along += distance;
                continue;
            }
            let [before, after] = [-SIDE_M, SIDE_M].map(|aside| self.shape.distance_m(&at(along + aside)));
            if (before > 0.0) != (after > 0.0) {
                points.push(at(along));
            }
            along += 2.0 * SIDE_M;
        }
    }
}

/// Shares `count` out by `weights`, the largest remainders first.
pub(crate) fn share_out(count: usize, weights: &[f64]) -> Vec<usize> {
    let sum: f64 = weights.iter().sum();
    let exact: Vec<f64> = weights.iter().map(|weight| weight / sum * count as f64).collect();
    let mut shares: Vec<usize> = exact.iter().map(|exact| exact.floor() as usize).collect();
    let mut order: Vec<usize> = (0..weights.len()).collect();
    order.sort_by(|&left, &right| exact[right].fract().total_cmp(&exact[left].fract()));
    let missing = count - shares.iter().sum::<usize>();
    order.iter().cycle().take(missing).for_each(|&idx| shares[idx] += 1);
    shares
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn points_lie_on_the_surface_and_are_even_by_area() {
        // Two boxes that share a face, and a third that sticks out of them: 4 x 2 x 2 cm, and a cube of 2 cm on top.
        let cube =
            |x: f64, z: f64| (Isometry3::translation(x, 0.0, z), ObjectShape::Box { size_m: [0.02; 3] });
        let shape =
            ObjectShape::Compound { parts: vec![cube(-0.01, 0.0), cube(0.01, 0.0), cube(0.01, 0.02)] };
        let surface = Surface::new(&shape).expect("a solid");
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let points = surface.points(4000, &mut rng).expect("points");
        let distance = SignedDistance::new(&shape).expect("a solid");
        let inside = points.iter().filter(|point| distance.distance_m(point).abs() > 2e-6).count();
        assert_eq!(inside, 0);
        // 40 faces of 1 cm^2 below, less the one under the cube of 4, and 5 such faces of the cube above.
        let area = (40.0 - 4.0 + 20.0) * 1e-4;
        let above = points.iter().filter(|point| point.z > 0.01 + 1e-5).count() as f64 / 4000.0;
        assert!((above - 20e-4 / area).abs() < 0.03, "{above}");
        let measured = surface.area_m2(&mut rng);
        assert!((measured / area - 1.0).abs() < 0.06, "{measured} {area}");
    }

    #[test]
    fn shares_add_up() {
        assert_eq!(share_out(10, &[1.0, 1.0, 1.0]), [4, 3, 3]);
        assert_eq!(share_out(5, &[0.1, 8.0, 1.9]), [0, 4, 1]);
        assert_eq!(share_out(2, &[1.0, 1.0, 1.0]).iter().sum::<usize>(), 2);
    }
}
