//! A soft layer as a sheet of elements, stepped through time.

use nalgebra::{Isometry3, Point3, Vector3};
use palpate_robot_model::Patch;
use palpate_sim::geometry::SignedDistance;

use crate::truth::Elastomer;

/// Deformation below this is rest, m.
const STILL_M: f64 = 1e-7;
/// Skins that overlap by more do not touch: one is behind the other, m.
const MOST_OVERLAP_M: f64 = 0.006;
/// A step is divided into at most so many.
const MOST_SUB_STEPS: f64 = 4.0;

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
    /// Outward, at each element.
    normals_in_link: Vec<Vector3<f64>>,
    /// Distance between neighbours, m.
    apart_m: f64,
    centre: Point3<f64>,
    radius_m: f64,
    /// Neighbours of element `i`: `neighbours[offsets[i]..offsets[i + 1]]`, with their pull.
    offsets: Vec<usize>,
    neighbours: Vec<(usize, f64)>,
    /// Surface that an element stands for, m2.
    pub(crate) area_m2: f64,
    /// Displacement of each element, m.
    displacement_m: Vec<f64>,
    /// Air below the layer, which it gives before a sensor feels anything, m.
    gap_m: f64,
    /// Dashpot beside the slow spring, s: part of what a sensor feels.
    viscous_s: f64,
    /// Displacement that a sensor feels, where that is not the displacement, m.
    felt_m: Vec<f64>,
    /// Steps that each step is divided into, to stay stable.
    sub_steps: usize,
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
        let mut normals_in_link = Vec::new();
        for node in &patch.nodes {
            if pos_in_link.iter().all(|pos| (pos - node.pos_in_link).norm() >= config.spacing_m) {
                pos_in_link.push(node.pos_in_link);
                normals_in_link.push(mount_offset.rotation * node.normal_in_link.into_inner());
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
        let sub_steps = (dt_s * rate).ceil().max(1.0);
        if sub_steps > MOST_SUB_STEPS {
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
            normals_in_link,
            apart_m: spacing_m,
            centre,
            radius_m,
            offsets,
            neighbours,
            // Between a square and a hexagonal arrangement.
            area_m2: 0.93 * spacing_m * spacing_m,
            displacement_m: vec![0.0; count],
            relaxed_m: vec![0.0; count],
            gap_m: 0.0,
            viscous_s: 0.0,
            felt_m: Vec::new(),
            sub_steps: sub_steps as usize,
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

    /// Tells of another thing that will be there at the end of the coming steps; to be called after [`Layer::approach`].
    pub(crate) fn approach_also(&mut self, thing: &SignedDistance, thing_from_link: &Isometry3<f64>) {
        if thing.distance_m(&(thing_from_link * self.centre)) > self.radius_m {
            return;
        }
        for (depth_m, pos) in self.depth_end_m.iter_mut().zip(&self.pos_in_link) {
            *depth_m = depth_m.max(-thing.distance_m(&(thing_from_link * pos)));
        }
        self.awake |= self.depth_end_m.iter().any(|&depth| depth > 0.0);
    }

    /// Tells that there will be no object at the end of the coming steps.
    pub(crate) fn recede(&mut self) {
        std::mem::swap(&mut self.depth_start_m, &mut self.depth_end_m);
        self.depth_end_m.fill(0.0);
    }

    /// Tells where another layer will be at the end of the coming steps; to be called after [`Layer::approach`]. Two
    /// soft skins that overlap each give way by half.
    pub(crate) fn approach_layer(&mut self, other: &Layer, self_from_other: &Isometry3<f64>) {
        let reach_m = self.radius_m + other.radius_m;
        if (self_from_other * other.centre - self.centre).norm() > reach_m {
            return;
        }
        for (pos, normal) in other.pos_in_link.iter().zip(&other.normals_in_link) {
            let (pos, normal) = (self_from_other * pos, self_from_other * normal);
            for (idx, own) in self.pos_in_link.iter().enumerate() {
                let inside = own - pos;
                let overlap_m = -inside.dot(&normal);
                let beside_m = (inside + normal * overlap_m).norm();
                let faces = self.normals_in_link[idx].dot(&normal) < 0.0;
                if faces && (0.0..MOST_OVERLAP_M).contains(&overlap_m) && beside_m < 0.75 * self.apart_m {
                    self.depth_end_m[idx] = self.depth_end_m[idx].max(0.5 * overlap_m);
                    self.awake = true;
                }
            }
        }
    }

    /// Elements that are pressed, in the link's frame, each with the stiffness that it has once it has given way, N/m.
    pub(crate) fn pressed(&self) -> impl Iterator<Item = (&Point3<f64>, f64)> {
        let Elastomer { modulus_pa, thickness_m, contact_ratio, .. } = self.config;
        let newton_per_m = modulus_pa / thickness_m * self.area_m2 * contact_ratio / (1.0 + contact_ratio);
        let pressed = self.pos_in_link.iter().zip(&self.depth_end_m).filter(|(_, depth_m)| **depth_m > 0.0);
        pressed.map(move |(pos, _)| (pos, newton_per_m))
    }

    /// Puts air under the layer and a dashpot into it.
    pub(crate) fn with(mut self, gap_m: f64, viscous_s: f64) -> Self {
        (self.gap_m, self.viscous_s) = (gap_m, viscous_s);
        if gap_m > 0.0 || viscous_s > 0.0 {
            self.felt_m = vec![0.0; self.displacement_m.len()];
        }
        self
    }

    /// Stress of each element over the stiffness of its slow spring, m, as a sensor below it feels it.
    pub(crate) fn felt_m(&self) -> &[f64] {
        if self.felt_m.is_empty() { &self.displacement_m } else { &self.felt_m }
    }

    /// One step of `dt_s`, from the part `from` to the part `to` of the way to where [`Layer::approach`] said.
    pub(crate) fn step(&mut self, dt_s: f64, from: f64, to: f64) {
        for sub_step in 1..=self.sub_steps {
            if !self.awake {
                break;
            }
            let fraction = if sub_step == self.sub_steps {
                to
            } else {
                from + (to - from) * sub_step as f64 / self.sub_steps as f64
            };
            self.sub_step(dt_s / self.sub_steps as f64, fraction);
        }
        for (idx, felt) in self.felt_m.iter_mut().enumerate() {
            let stress = self.displacement_m[idx] + self.viscous_s * self.velocity[idx];
            *felt = if self.awake { (stress - self.gap_m).max(0.0) } else { 0.0 };
        }
    }

    fn sub_step(&mut self, dt_s: f64, fraction: f64) {
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

#[cfg(test)]
mod tests {
    use nalgebra::Translation3;
    use palpate_robot_model::ObjectShape;

    use super::*;

    const CONFIG: Elastomer = Elastomer {
        spacing_m: 0.002,
        thickness_m: 0.005,
        modulus_pa: 1e5,
        contact_ratio: 8.0,
        relaxing_ratio: 0.9,
        relaxing_s: 0.2,
        damping_s: 0.03,
        coupling_m: 0.002,
    };
    const DT_S: f64 = 1e-3;

    /// A flat pad of 2 cm about the link's origin, facing +z.
    fn pad() -> Patch {
        let at = |idx: i32| f64::from(idx) * 0.002;
        let normal = Vector3::z_axis();
        let nodes = (-5..=5).flat_map(|x| (-5..=5).map(move |y| Point3::new(at(x), at(y), 0.0)));
        Patch {
            id: "pad".into(),
            label: String::new(),
            group: String::new(),
            stream: 0,
            link: 0,
            link_from_patch: Isometry3::identity(),
            nodes: nodes
                .map(|pos_in_link| palpate_robot_model::SurfaceNode { pos_in_link, normal_in_link: normal })
                .collect(),
            taxels_in_link: vec![Point3::origin()],
            taxel_normals_in_link: vec![normal],
            channels: 0..1,
            stiffness_pa_per_m: 1.0,
            map_positions: vec![[0.0; 2]],
        }
    }

    /// Presses a ball `depth_m` into the pad for `press_s`, takes it away, and gives the middle's displacement per step.
    fn press(config: &Elastomer, depth_m: f64, press_s: f64, after_s: f64) -> Vec<f64> {
        let ball = SignedDistance::new(&ObjectShape::Sphere { radius_m: 0.02 }).expect("a ball");
        let mut layer = Layer::new(&pad(), config, &Isometry3::identity(), DT_S).expect("stable");
        let middle = layer.pos_in_link.iter().position(|pos| pos.coords.norm() < 1e-9).expect("a middle");
        let steps = |seconds: f64| (seconds / DT_S) as usize;
        (0..steps(press_s) + steps(after_s))
            .map(|step| {
                let height_m = if step < steps(press_s) { 0.02 - depth_m } else { 0.1 };
                layer.approach(&ball, &Isometry3::translation(0.0, 0.0, -height_m));
                layer.step(DT_S, 1.0, 1.0);
                layer.displacement_m[middle]
            })
            .collect()
    }

    #[test]
    fn deeper_presses_give_more_and_never_more_than_the_depth() {
        let peaks: Vec<f64> = [0.0005, 0.001, 0.002]
            .iter()
            .map(|&depth_m| {
                let peak = press(&CONFIG, depth_m, 1.0, 0.0).into_iter().fold(0.0, f64::max);
                assert!(peak < depth_m, "{peak} at {depth_m}");
                peak
            })
            .collect();
        assert!(peaks[0] < peaks[1] && peaks[1] < peaks[2] && peaks[0] > 1e-4, "{peaks:?}");
    }

    #[test]
    fn released_layer_lingers_then_rests_and_longer_with_a_stronger_relaxing_branch() {
        let lag = |relaxing_ratio: f64| {
            let trace = press(&Elastomer { relaxing_ratio, ..CONFIG }, 0.001, 1.0, 6.0);
            assert_eq!(trace.last(), Some(&0.0), "comes to rest");
            let peak = trace[999];
            trace[1000..].iter().position(|x| *x < 0.2 * peak).expect("falls")
        };
        assert!(lag(0.9) > lag(0.2) + 50, "{} against {} ms", lag(0.9), lag(0.2));
    }

    #[test]
    fn skins_that_overlap_give_way_by_half_each_and_others_do_not_feel() {
        let pressed = |overlap_m: f64, turn_rad: f64| {
            let new = || Layer::new(&pad(), &CONFIG, &Isometry3::identity(), DT_S).expect("stable");
            let (mut layer, other) = (new(), new());
            let facing = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), turn_rad);
            let above = Isometry3::from_parts(Translation3::new(0.0, 0.0, -overlap_m), facing);
            layer.approach_layer(&other, &above);
            layer.depth_end_m.iter().copied().fold(0.0, f64::max)
        };
        let facing_rad = std::f64::consts::PI;
        assert!((pressed(0.002, facing_rad) - 0.001).abs() < 1e-9);
        assert_eq!(pressed(-0.002, facing_rad), 0.0, "apart");
        assert_eq!(pressed(0.002, 0.0), 0.0, "back to front");
    }

    #[test]
    fn untouched_layer_sleeps_and_stiff_steps_are_refused() {
        assert!(press(&CONFIG, -0.001, 0.5, 0.0).iter().all(|x| *x == 0.0));
        let stiff = Elastomer { damping_s: 1e-4, ..CONFIG };
        let error =
            Layer::new(&pad(), &stiff, &Isometry3::identity(), DT_S).map(|_| ()).expect_err("unstable");
        assert!(error.contains("raise damping_s"), "{error}");
    }
}
