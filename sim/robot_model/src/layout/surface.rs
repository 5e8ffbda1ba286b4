//! Shapes of sensing surfaces, and the surface nodes that stand for them.
//!
//! Every surface passes through the origin of the patch frame, where its outward normal is +z. Nodes are the centres
//! of cells of nearly equal area: each curve is cut into the fewest equal pieces no longer than the spacing, so that a
//! node stands for at most `spacing * spacing` of skin and none sits on an edge that it would share.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Point3, Unit, Vector3};
use serde::Deserialize;

use crate::config::positive;

/// More nodes than any real patch needs: a spacing in millimetres that should have been metres ends up here.
const MAX_NODES: f64 = 20_000.0;

/// The shape of a patch, as in the layout file.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum Surface {
    /// A flat rectangle about the origin: `length_m` along x, `width_m` along y.
    Rectangle { length_m: f64, width_m: f64 },
    /// A curved finger pad: the part of a cylinder along x that spans `arc_rad` about +z, `length_m` long, closed at
    /// its +x end by a dome of the same radius that falls away by `dome_rad` (a quarter turn reaches the very tip).
    Arc {
        radius_m: f64,
        arc_rad: f64,
        length_m: f64,
        #[serde(default)]
        dome_rad: f64,
    },
    /// A spherical cap about +z, out to `half_angle_rad` from its apex.
    Cap { radius_m: f64, half_angle_rad: f64 },
}

/// A point of a surface in the patch's frame, with its outward normal.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfacePoint {
    pub(super) pos_in_patch: Point3<f64>,
    pub(super) normal_in_patch: Unit<Vector3<f64>>,
}

impl Surface {
    /// What is wrong with the sizes, if anything.
    pub(super) fn check(&self) -> Result<(), String> {
        match *self {
            Self::Rectangle { length_m, width_m } => {
                positive("length_m", length_m)?;
                positive("width_m", width_m)?;
            }
            Self::Arc { radius_m, arc_rad, length_m, dome_rad } => {
                positive("radius_m", radius_m)?;
                positive("length_m", length_m)?;
                if positive("arc_rad", arc_rad)? > TAU {
                    return Err(format!("arc_rad is {arc_rad}, expected at most a full turn (2 pi)"));
                }
                if !(0.0..=FRAC_PI_2 + 1e-9).contains(&dome_rad) {
                    return Err(format!("dome_rad is {dome_rad}, expected 0 (no dome) to pi / 2"));
                }
            }
            Self::Cap { radius_m, half_angle_rad } => {
                positive("radius_m", radius_m)?;
                if positive("half_angle_rad", half_angle_rad)? > PI {
                    return Err(format!("half_angle_rad is {half_angle_rad}, expected at most pi"));
                }
            }
        }
        Ok(())
    }

    /// Surface nodes no further apart than `spacing_m` along the surface; refuses a spacing that gives too many.
    pub(super) fn sample(&self, spacing_m: f64) -> Result<Vec<SurfacePoint>, String> {
        positive("node_spacing_m", spacing_m)?;
        let most = self.most_nodes(spacing_m);
        if most > MAX_NODES {
            return Err(format!(
                "node_spacing_m = {spacing_m} would give up to {most:.0} surface nodes, expected at most {MAX_NODES}; \
                 make the spacing coarser (it is in metres)"
            ));
        }
        let mut nodes = Vec::new();
        match *self {
            Self::Rectangle { length_m, width_m } => {
                for x in centres(-length_m / 2.0, length_m / 2.0, spacing_m) {
                    for y in centres(-width_m / 2.0, width_m / 2.0, spacing_m) {
                        nodes.push(flat(x, y));
                    }
                }
            }
            Self::Arc { radius_m, arc_rad, length_m, dome_rad } => {
                let spacing_rad = spacing_m / radius_m;
                for x in centres(-length_m / 2.0, length_m / 2.0, spacing_m) {
                    for around in centres(-arc_rad / 2.0, arc_rad / 2.0, spacing_rad) {
                        nodes.push(on_arc(radius_m, x, around));
                    }
                }
                if dome_rad > 0.0 {
                    for down in centres(0.0, dome_rad, spacing_rad) {
                        let ring_spacing_rad = spacing_rad / down.cos().max(1e-9);
                        for around in centres(-arc_rad / 2.0, arc_rad / 2.0, ring_spacing_rad) {
                            nodes.push(on_dome(radius_m, length_m, down, around));
                        }
                    }
                }
            }
            Self::Cap { radius_m, half_angle_rad } => {
                for down in centres(0.0, half_angle_rad, spacing_m / radius_m) {
                    let ring_spacing_rad = spacing_m / (radius_m * down.sin()).max(1e-9 * radius_m);
                    for around in centres(-PI, PI, ring_spacing_rad) {
                        nodes.push(on_cap(radius_m, down, around));
                    }
                }
            }
        }
        Ok(nodes)
    }

    /// The surface point seen at `[x, y]` when looking straight down z, or why there is none.
    pub(super) fn project(&self, [x, y]: [f64; 2]) -> Result<SurfacePoint, String> {
        // Numbers in files have few digits: one that names the edge may fall a rounding error outside of it.
        let slack = 1e-9;
        let outside = || {
            Err(format!("[{x}, {y}] m lies beside the sensing surface; move it inside or enlarge the shape"))
        };
        if !(x.is_finite() && y.is_finite()) {
            return Err(format!("[{x}, {y}] must be finite"));
        }
        match *self {
            Self::Rectangle { length_m, width_m } => {
                if x.abs() > length_m / 2.0 + slack || y.abs() > width_m / 2.0 + slack {
                    return outside();
                }
                Ok(flat(x, y))
            }
            Self::Arc { radius_m, arc_rad, length_m, dome_rad } => {
                let beyond = x - length_m / 2.0;
                if x < -length_m / 2.0 - slack || beyond.max(0.0).hypot(y) > radius_m {
                    return outside();
                }
                if beyond <= 0.0 {
                    let around = (y / radius_m).asin();
                    if around.abs() > arc_rad / 2.0 + slack {
                        return outside();
                    }
                    return Ok(on_arc(radius_m, x, around));
                }
                let down = (beyond / radius_m).asin();
                let around = y.atan2((radius_m.powi(2) - beyond.powi(2) - y.powi(2)).max(0.0).sqrt());
                if down > dome_rad + slack || around.abs() > arc_rad / 2.0 + slack {
                    return outside();
                }
                Ok(on_dome(radius_m, length_m, down, around))
            }
            Self::Cap { radius_m, half_angle_rad } => {
                let from_axis = x.hypot(y);
                if from_axis > radius_m || (from_axis / radius_m).asin() > half_angle_rad + slack {
                    return outside();
                }
                Ok(on_cap(radius_m, (from_axis / radius_m).asin(), y.atan2(x)))
            }
        }
    }

    /// Bounds of the surface as seen down z: `[[min_x, max_x], [min_y, max_y]]`, m.
    pub(super) fn plan_bounds_m(&self) -> [[f64; 2]; 2] {
        match *self {
            Self::Rectangle { length_m, width_m } => {
                [[-length_m / 2.0, length_m / 2.0], [-width_m / 2.0, width_m / 2.0]]
            }
            Self::Arc { radius_m, arc_rad, length_m, dome_rad } => {
                let half_width = radius_m * (arc_rad / 2.0).min(FRAC_PI_2).sin();
                [[-length_m / 2.0, length_m / 2.0 + radius_m * dome_rad.sin()], [-half_width, half_width]]
            }
            Self::Cap { radius_m, half_angle_rad } => {
                let reach = radius_m * half_angle_rad.min(FRAC_PI_2).sin();
                [[-reach, reach], [-reach, reach]]
            }
        }
    }

    /// An upper bound of the number of nodes, before any is made.
    fn most_nodes(&self, spacing_m: f64) -> f64 {
        let pieces = |length_m: f64| num_pieces(length_m, spacing_m);
        match *self {
            Self::Rectangle { length_m, width_m } => pieces(length_m) * pieces(width_m),
            Self::Arc { radius_m, arc_rad, length_m, dome_rad } => {
                (pieces(length_m) + pieces(radius_m * dome_rad)) * pieces(radius_m * arc_rad)
            }
            Self::Cap { radius_m, half_angle_rad } => {
                pieces(radius_m * half_angle_rad)
                    * pieces(TAU * radius_m * half_angle_rad.min(FRAC_PI_2).sin())
            }
        }
    }
}

fn num_pieces(length: f64, spacing: f64) -> f64 {
    // A length of ten spacings is ten pieces, also where the division rounds up.
    (length / spacing - 1e-9).ceil().max(1.0)
}

/// Centres of the fewest equal pieces of `from..to` that are no longer than `spacing`.
fn centres(from: f64, to: f64, spacing: f64) -> impl Iterator<Item = f64> {
    let pieces = num_pieces(to - from, spacing) as usize;
    (0..pieces).map(move |piece| from + (to - from) * (piece as f64 + 0.5) / pieces as f64)
}

fn flat(x: f64, y: f64) -> SurfacePoint {
    SurfacePoint { pos_in_patch: Point3::new(x, y, 0.0), normal_in_patch: Vector3::z_axis() }
}

fn on_arc(radius_m: f64, x: f64, around: f64) -> SurfacePoint {
    round(Point3::new(x, 0.0, -radius_m), radius_m, Vector3::new(0.0, around.sin(), around.cos()))
}

fn on_dome(radius_m: f64, length_m: f64, down: f64, around: f64) -> SurfacePoint {
    let outward = Vector3::new(down.sin(), down.cos() * around.sin(), down.cos() * around.cos());
    round(Point3::new(length_m / 2.0, 0.0, -radius_m), radius_m, outward)
}

fn on_cap(radius_m: f64, down: f64, around: f64) -> SurfacePoint {
    let outward = Vector3::new(down.sin() * around.cos(), down.sin() * around.sin(), down.cos());
    round(Point3::new(0.0, 0.0, -radius_m), radius_m, outward)
}

fn round(centre: Point3<f64>, radius_m: f64, outward: Vector3<f64>) -> SurfacePoint {
    let normal_in_patch = Unit::new_normalize(outward);
    SurfacePoint { pos_in_patch: centre + normal_in_patch.into_inner() * radius_m, normal_in_patch }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn surfaces() -> impl Strategy<Value = Surface> {
        let size = 0.004..0.02_f64;
        prop_oneof![
            (size.clone(), size.clone())
                .prop_map(|(length_m, width_m)| Surface::Rectangle { length_m, width_m }),
            (size.clone(), 0.3..6.0_f64, size.clone(), prop_oneof![Just(0.0), 0.1..FRAC_PI_2]).prop_map(
                |(radius_m, arc_rad, length_m, dome_rad)| Surface::Arc {
                    radius_m,
                    arc_rad,
                    length_m,
                    dome_rad
                }
            ),
            (size, 0.1..3.0_f64)
                .prop_map(|(radius_m, half_angle_rad)| Surface::Cap { radius_m, half_angle_rad }),
        ]
    }

    /// A point of the surface from two numbers in 0..1, written independently of the sampling.
    fn point_at(surface: &Surface, u: f64, v: f64) -> Point3<f64> {
        match *surface {
            Surface::Rectangle { length_m, width_m } => {
                Point3::new((u - 0.5) * length_m, (v - 0.5) * width_m, 0.0)
            }
            Surface::Arc { radius_m, arc_rad, length_m, dome_rad } => {
                let around = (v - 0.5) * arc_rad;
                let along = u * (length_m + radius_m * dome_rad);
                let down = ((along - length_m) / radius_m).max(0.0);
                Point3::new(
                    along.min(length_m) - length_m / 2.0 + radius_m * down.sin(),
                    radius_m * down.cos() * around.sin(),
                    radius_m * (down.cos() * around.cos() - 1.0),
                )
            }
            Surface::Cap { radius_m, half_angle_rad } => {
                let (down, around) = (u * half_angle_rad, v * TAU);
                Point3::new(
                    radius_m * down.sin() * around.cos(),
                    radius_m * down.sin() * around.sin(),
                    radius_m * (down.cos() - 1.0),
                )
            }
        }
    }

    /// How far off the (unbounded) flat, cylindrical or spherical surface a point is, and the way out there.
    fn off_surface(surface: &Surface, p: &Point3<f64>) -> (f64, Vector3<f64>) {
        let (axis_x, radius_m) = match *surface {
            Surface::Rectangle { .. } => return (p.z, Vector3::z()),
            Surface::Arc { radius_m, length_m, .. } => (p.x.min(length_m / 2.0), radius_m),
            Surface::Cap { radius_m, .. } => (0.0, radius_m),
        };
        let out = p - Point3::new(axis_x, 0.0, -radius_m);
        (out.norm() - radius_m, out.normalize())
    }

    proptest! {
        #[test]
        fn nodes_lie_on_the_surface_with_unit_outward_normals(surface in surfaces(), spacing_m in 0.001..0.004_f64) {
            let nodes = surface.sample(spacing_m).unwrap();
            prop_assert!(!nodes.is_empty());
            for node in &nodes {
                let (off, outward) = off_surface(&surface, &node.pos_in_patch);
                prop_assert!(off.abs() < 1e-12, "{off}");
                prop_assert!((node.normal_in_patch.norm() - 1.0).abs() < 1e-12);
                prop_assert!((node.normal_in_patch.into_inner() - outward).norm() < 1e-9);
            }
            let [[min_x, max_x], [min_y, max_y]] = surface.plan_bounds_m();
            for node in &nodes {
                prop_assert!((min_x..=max_x).contains(&node.pos_in_patch.x));
                prop_assert!((min_y..=max_y).contains(&node.pos_in_patch.y));
            }
        }

        #[test]
        fn no_skin_is_further_than_the_spacing_from_a_node(
            surface in surfaces(), spacing_m in 0.001..0.004_f64, u in 0.0..1.0_f64, v in 0.0..1.0_f64,
        ) {
            // Half the diagonal of a square cell is 0.71 spacings; cells next to the apex of a cap are a little longer.
            let p = point_at(&surface, u, v);
            let nodes = surface.sample(spacing_m).unwrap();
            let nearest = nodes.iter().map(|n| (n.pos_in_patch - p).norm()).fold(f64::INFINITY, f64::min);
            prop_assert!(nearest <= 0.8 * spacing_m, "{nearest} from {p}");
        }

        #[test]
        fn node_density_matches_the_spacing(surface in surfaces(), spacing_m in 0.001..0.002_f64) {
            let area = match surface {
                Surface::Rectangle { length_m, width_m } => length_m * width_m,
                Surface::Arc { radius_m, arc_rad, length_m, dome_rad } =>
                    arc_rad * radius_m * (length_m + radius_m * dome_rad.sin()),
                Surface::Cap { radius_m, half_angle_rad } =>
                    TAU * radius_m.powi(2) * (1.0 - half_angle_rad.cos()),
            };
            let nodes = surface.sample(spacing_m).unwrap();
            // At least one node for each spacing x spacing; never three times as many, rounding up included.
            let expected = area / spacing_m.powi(2);
            prop_assert!(nodes.len() as f64 >= 0.95 * expected, "{} < {expected}", nodes.len());
            prop_assert!(nodes.len() as f64 <= 3.0 * expected + 8.0, "{} > {expected}", nodes.len());
        }

        #[test]
        fn a_node_facing_up_projects_onto_itself(surface in surfaces(), spacing_m in 0.001..0.004_f64) {
            for node in surface.sample(spacing_m).unwrap() {
                if node.normal_in_patch.z > 0.05 {
                    let seen = surface.project([node.pos_in_patch.x, node.pos_in_patch.y]).unwrap();
                    prop_assert!((seen.pos_in_patch - node.pos_in_patch).norm() < 1e-8);
                    prop_assert!((seen.normal_in_patch.into_inner() - node.normal_in_patch.into_inner()).norm() < 1e-6);
                }
            }
        }
    }

    #[test]
    fn a_taxel_beside_the_surface_is_refused() {
        let pad = Surface::Arc { radius_m: 0.012, arc_rad: 2.0, length_m: 0.02, dome_rad: 1.0 };
        for beside in [[-0.011, 0.0], [0.0, 0.0115], [0.0215, 0.0], [f64::NAN, 0.0]] {
            assert!(pad.project(beside).is_err(), "{beside:?}");
        }
        assert!(pad.project([0.0195, 0.001]).is_ok());
        let no_dome = Surface::Arc { radius_m: 0.012, arc_rad: 2.0, length_m: 0.02, dome_rad: 0.0 };
        assert!(no_dome.project([0.0105, 0.0]).is_err());
    }

    #[test]
    fn a_spacing_in_millimetres_of_a_large_surface_is_refused_before_it_eats_the_memory() {
        let wall = Surface::Rectangle { length_m: 300.0, width_m: 200.0 };
        assert!(wall.sample(0.002).unwrap_err().contains("coarser"));
        let thread = Surface::Rectangle { length_m: 1e6, width_m: 1e-9 };
        assert!(thread.sample(1e-6).unwrap_err().contains("coarser"));
    }
}
