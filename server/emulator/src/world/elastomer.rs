//! A soft layer as a sheet of elements, stepped through time.

use nalgebra::{Isometry3, Point3, Vector3};
use palpate_robot_model::Patch;
use palpate_sim::geometry::SignedDistance;

use crate::truth::Elastomer;

/// Deformation below this is rest, m.
const STILL_M: f64 = 1e-7;

/// One patch's soft layer.
///
/// Each element is a standard linear solid: a slow spring with a damper, and a relaxing branch (spring and damper in
/// series) beside it. Neighbours pull on each other; the object pushes through a stiff one-sided contact spring. In
/// units of the slow spring's stiffness, with `x` the displacement, `z` that of the relaxing branch's damper and `p` the
/// penetration of the undeformed surface:
///
/// `damping x' = contact max(0, p - x) - x - relaxing (x - z) + sum_n c_n (x_n - x)`, `relaxing_s z' = x - z`
#[derive(Clone, Debug)]
pub(crate) struct Layer {
    config: Elastomer,
    pub(crate) link: usize,
    /// Elements in the link's frame, where they really are.
    pub(crate) pos_in_link: Vec<Point3<f64>>,
    centre: Point3<f64>,
    radius_m: f64,
    /// Neighbours of element `i`: `neighbours[offsets[i]..offsets[i + 1]]`, with their pull.
    offsets: Vec<usize>,
    neighbours: Vec<(usize, f64)>,
    /// Surface that an element stands for, m2.
    pub(crate) area_m2: f64,
    /// Displacement of each element, m.
    pub(crate) displacement_m: Vec<f64>,
    relaxed_m: Vec<f64>,
    velocity: Vec<f64>,
    depth_start_m: Vec<f64>,
    depth_end_m: Vec<f64>,
    /// Whether anything moves or touches.
    pub(crate) awake: bool,
}

impl Layer {
    /// The layer of `patch`, moved by `mount_offset` (in the link's frame). `dt_s` is the step it will take; says why
    /// not where such steps would blow up.
    pub(crate) fn new(
        patch: &Patch,
        config: &Elastomer,
        mount_offset: &Isometry3<f64>,
        dt_s: f64,
    ) -> Result<Self, String> {
        let mut pos_in_link: Vec<Point3<f64>> = Vec::new();
        for node in &patch.nodes {
            if pos_in_link.iter().all(|pos| (pos - node.pos_in_link).norm() >= config.spacing_m) {
                pos_in_link.push(node.pos_in_link);
            }
        }
        let count = pos_in_link.len();
        if count == 0 {
            return Err(format!("patch {:?} has no surface nodes", patch.id));
        }
        let nearest = |idx: usize| {
            (0..count)
                .filter(|&other| other != idx)
                .map(|other| (pos_in_link[other] - pos_in_link[idx]).norm())
                .fold(f64::INFINITY, f64::min)
        };
        let spacing_m =
            if count > 1 { (0..count).map(nearest).sum::<f64>() / count as f64 } else { config.spacing_m };
        let mut offsets = vec![0];
        let mut neighbours = Vec::new();
        let mut most_pull = 0.0_f64;
        for idx in 0..count {
            let mut pull = 0.0;
            for other in 0..count {
                let apart_m = (pos_in_link[other] - pos_in_link[idx]).norm();
                if other != idx && apart_m < 1.7 * spacing_m {
                    // Laplacian on six neighbours: 2/3 of the squared reach over the squared distance.
                    let weight = 2.0 / 3.0 * (config.coupling_m / apart_m).powi(2);
                    neighbours.push((other, weight));
                    pull += weight;
                }
            }
            most_pull = most_pull.max(pull);
            offsets.push(neighbours.len());
        }
        // Explicit steps are stable while a step times the fastest rate stays below 1 (2 is the limit).
        let rate = (1.0 + config.contact_ratio + config.relaxing_ratio + 2.0 * most_pull) / config.damping_s;
        if dt_s * rate > 1.0 {
            return Err(format!(
                "elastomer: an element's fastest time constant is {:.2} ms, below the step of {:.0} ms: raise damping_s \
                 or spacing_m, or lower contact_ratio or coupling_m",
                1e3 / rate,
                dt_s * 1e3
            ));
        }
        let origin = patch.link_from_patch.translation.vector;
        for pos in &mut pos_in_link {
            let about_origin = mount_offset.rotation * (pos.coords - origin);
            *pos = Point3::from(about_origin + origin + mount_offset.translation.vector);
        }
        let centre = Point3::from(
            pos_in_link.iter().fold(Vector3::zeros(), |sum, pos| sum + pos.coords) / count as f64,
        );
        let radius_m = pos_in_link.iter().map(|pos| (pos - centre).norm()).fold(0.0, f64::max);
        Ok(Self {
            config: *config,
            link: patch.link,
            pos_in_link,
            centre,
            radius_m,
            offsets,
            neighbours,
            // Between a square and a hexagonal arrangement.
            area_m2: 0.93 * spacing_m * spacing_m,
            displacement_m: vec![0.0; count],
            relaxed_m: vec![0.0; count],
            velocity: vec![0.0; count],
            depth_start_m: vec![0.0; count],
            depth_end_m: vec![0.0; count],
            awake: false,
        })
    }

    /// Tells where the layer will be at the end of the coming steps.
    pub(crate) fn approach(&mut self, object: &SignedDistance, object_from_link: &Isometry3<f64>) {
        std::mem::swap(&mut self.depth_start_m, &mut self.depth_end_m);
        if object.distance_m(&(object_from_link * self.centre)) > self.radius_m {
            self.depth_end_m.fill(0.0);
        } else {
            for (depth_m, pos) in self.depth_end_m.iter_mut().zip(&self.pos_in_link) {
                *depth_m = -object.distance_m(&(object_from_link * pos));
            }
            self.awake |= self.depth_end_m.iter().any(|&depth| depth > 0.0);
        }
    }

    /// One step of `dt_s`, `fraction` of the way to where [`Layer::approach`] said.
    pub(crate) fn step(&mut self, dt_s: f64, fraction: f64) {
        if !self.awake {
            return;
        }
        let config = &self.config;
        let mut largest = 0.0_f64;
        for idx in 0..self.displacement_m.len() {
            let x = self.displacement_m[idx];
            let depth =
                self.depth_start_m[idx] + (self.depth_end_m[idx] - self.depth_start_m[idx]) * fraction;
            let pulls: f64 = self.neighbours[self.offsets[idx]..self.offsets[idx + 1]]
                .iter()
                .map(|&(other, weight)| weight * (self.displacement_m[other] - x))
                .sum();
            // The contact pushes only, never pulls; the layer may lag behind a surface that leaves.
            let push = if depth > 0.0 { config.contact_ratio * (depth - x).max(0.0) } else { 0.0 };
            let relaxing = config.relaxing_ratio * (x - self.relaxed_m[idx]);
            self.velocity[idx] = (push - x - relaxing + pulls) / config.damping_s;
            largest = largest.max(x.abs()).max(self.relaxed_m[idx].abs()).max(depth);
        }
        for idx in 0..self.displacement_m.len() {
            let x = self.displacement_m[idx];
            self.relaxed_m[idx] += dt_s * (x - self.relaxed_m[idx]) / config.relaxing_s;
            self.displacement_m[idx] = x + dt_s * self.velocity[idx];
        }
        if largest < STILL_M {
            self.displacement_m.fill(0.0);
            self.relaxed_m.fill(0.0);
            self.awake = false;
        }
    }
}
