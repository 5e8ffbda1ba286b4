//! Takes on the shipped hand: one patch at a time presses, taps and holds an object, from several sides.

use std::path::Path;

use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Point3, UnitQuaternion, Vector3};
use palpate_robot_model::{ObjectModel, ObjectPath, Patch, Station};
use palpate_sim::effects::{Chain, Effect, Geometry, Sensed, TakeScene};
use palpate_sim::{Response, Theta};

pub(crate) const THETA: Theta = Theta { lambda_con_m: 0.003, alpha_per_m: 250.0, lambda_pre_pa: 30_000.0 };

/// Widths of the soft chain.
pub(crate) const SOFT: [f64; 2] = [0.1, 0.1];

pub(crate) fn station(name: &str) -> Station {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/stations");
    let read = |path: &str| std::fs::read(folder.join(path)).map_err(|err| err.to_string());
    Station::read(name, read).expect("the shipped station is valid")
}

/// The thresholds' ratios as the station has them.
pub(crate) fn response(station: &Station) -> Response {
    let streams = station.streams.iter();
    Response {
        off_fractions: streams.map(|stream| (stream.stream.clone(), stream.off_fraction())).collect(),
        ..Response::default()
    }
}

/// A take: what the joints really did, what their encoders said, and when.
#[derive(Clone)]
pub(crate) struct Take {
    pub(crate) object: ObjectModel,
    pub(crate) base_from_object: ObjectPath,
    pub(crate) times_s: Vec<f64>,
    /// Without noise.
    pub(crate) clean: Vec<f64>,
    /// With that of the encoders.
    pub(crate) measured: Vec<f64>,
}

impl Take {
    pub(crate) fn scene<'a>(&'a self, station: &'a Station, positions: &'a [f64]) -> TakeScene<'a> {
        TakeScene {
            station,
            object: &self.object,
            base_from_object: &self.base_from_object,
            surroundings: &[],
            frame_times_s: &self.times_s,
            positions,
            arrival_times_s: &[],
            frozen_for_s: &[],
            tares: &[],
        }
    }
}

/// Uniform in 0..1 and normal numbers, the same every time.
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Which patch touches what, and with which joints.
pub(crate) struct Plan {
    pub(crate) patch: &'static str,
    pub(crate) joints: &'static [&'static str],
    pub(crate) object: &'static str,
}

pub(crate) const INDEX: Plan = Plan {
    patch: "index_tip",
    joints: &["index_mcp_side", "index_mcp_forward", "index_pip", "index_dip"],
    object: "sphere_50mm",
};
pub(crate) const THUMB: Plan = Plan {
    patch: "thumb_tip",
    joints: &["thumb_cmc", "thumb_axial", "thumb_mcp", "thumb_ip"],
    object: "cylinder_25x100mm",
};
pub(crate) const PALM: Plan =
    Plan { patch: "palm_middle", joints: &["joint1", "joint2", "joint3", "joint5"], object: "sphere_50mm" };

const REST: [(&str, f64); 14] = [
    ("joint3", -1.2),
    ("joint5", 1.2),
    ("index_mcp_forward", 0.3),
    ("index_pip", 0.4),
    ("index_dip", 0.3),
    ("middle_mcp_forward", -0.25),
    ("ring_mcp_forward", -0.25),
    ("thumb_cmc", 0.3),
    ("thumb_mcp", 0.2),
    ("thumb_ip", 0.2),
    ("index_mcp_side", 0.1),
    ("thumb_axial", 0.1),
    ("joint2", 0.1),
    ("joint1", 0.1),
];

/// The middle of a patch's taxels and their mean normal, in the frame of its link.
fn middle(patch: &Patch) -> (Point3<f64>, Vector3<f64>) {
    let count = patch.taxels_in_link.len() as f64;
    let center = patch.taxels_in_link.iter().map(|taxel| taxel.coords).sum::<Vector3<f64>>() / count;
    let normal: Vector3<f64> = patch.taxel_normals_in_link.iter().map(|normal| normal.into_inner()).sum();
    (Point3::from(center), normal.normalize())
}

/// Depth along the normal and two shifts across it over time: presses, taps and holds at several speeds.
fn motion(noise: &mut Noise, num_presses: usize) -> Vec<(f64, Vector3<f64>)> {
    let mut time_s = 0.0;
    let mut at = Vector3::new(0.0, 0.0, -0.008);
    let mut knots = vec![(time_s, at)];
    let mut go = |time_s: &mut f64, at: &mut Vector3<f64>, to: Vector3<f64>, speed: f64| {
        *time_s += ((to - *at).norm() / speed).max(0.02);
        *at = to;
        knots.push((*time_s, to));
    };
    for press in 0..num_presses {
        let across = |noise: &mut Noise| 0.012 * (noise.uniform() - 0.5);
        let (x, y) = (across(noise), across(noise));
        let speed = [0.01, 0.03, 0.08][press % 3];
        let depth = 0.001 + 0.003 * noise.uniform();
        let hold_s = [0.05, 0.6, 0.2, 1.5][press % 4];
        go(&mut time_s, &mut at, Vector3::new(x, y, -0.008), 0.03);
        go(&mut time_s, &mut at, Vector3::new(x, y, depth), speed);
        time_s += hold_s;
        go(&mut time_s, &mut at, Vector3::new(x, y, depth), 1.0);
        go(&mut time_s, &mut at, Vector3::new(x, y, -0.008), [0.08, 0.02, 0.01, 0.04, 0.02][press % 5]);
        time_s += 0.3;
    }
    knots
}

pub(crate) fn take(station: &Station, plan: &Plan, num_presses: usize, seed: u64) -> Take {
    let robot = &station.robot;
    let dof = |name: &str| robot.dofs().position(|joint| joint.name == name).expect("a joint of the hand");
    let mut rest = vec![0.0; robot.num_dofs()];
    for (name, position) in REST {
        rest[dof(name)] = position;
    }
    let patch = station.layout.patches.iter().find(|patch| patch.id == plan.patch).expect("a patch");
    let (center_in_link, normal_in_link) = middle(patch);
    let mut poses = Vec::new();
    let mut center = |positions: &[f64]| {
        robot.forward_kinematics(positions, &mut poses);
        (poses[patch.link] * center_in_link, poses[patch.link] * normal_in_link)
    };
    let (start, normal) = center(&rest);

    // Step by step to where the centre should be, with the joints of the plan.
    let dofs: Vec<usize> = plan.joints.iter().map(|name| dof(name)).collect();
    let mut solve = |positions: &mut Vec<f64>, target: Point3<f64>| {
        for _ in 0..4 {
            let here = center(positions).0;
            let mut jacobian = DMatrix::zeros(3, dofs.len());
            for (column, &dof) in dofs.iter().enumerate() {
                let mut moved = positions.clone();
                moved[dof] += 1e-5;
                jacobian.set_column(column, &((center(&moved).0 - here) / 1e-5));
            }
            let square = &jacobian * jacobian.transpose() + DMatrix::identity(3, 3) * 1e-7;
            let inverse = square.try_inverse().expect("damped");
            let step =
                jacobian.transpose() * inverse * DVector::from_column_slice((target - here).as_slice());
            for (&dof, step) in dofs.iter().zip(step.iter()) {
                positions[dof] += step;
            }
        }
    };

    let mut noise = Noise(seed);
    let knots = motion(&mut noise, num_presses);
    let other = if normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let x_axis = normal.cross(&other).normalize();
    let frame = Matrix3::from_columns(&[x_axis, normal.cross(&x_axis), normal]);
    let (mut times_s, mut clean) = (Vec::new(), Vec::new());
    let mut positions = rest.clone();
    let (mut time_s, mut knot) = (0.0, 0);
    while time_s < knots[knots.len() - 1].0 {
        while knots[knot + 1].0 < time_s {
            knot += 1;
        }
        let (from, to) = (knots[knot], knots[knot + 1]);
        let share = (time_s - from.0) / (to.0 - from.0);
        solve(&mut positions, start + frame * (from.1 + (to.1 - from.1) * share));
        times_s.push(time_s);
        clean.extend_from_slice(&positions);
        // Joint logs are not quite regular.
        time_s += 0.1 + 0.004 * (noise.uniform() - 0.5);
    }
    let measured = clean.iter().map(|position| position + 0.0003 * noise.normal()).collect();

    let object = station.objects[plan.object].clone();
    let radius_m = if plan.object.starts_with("sphere") { 0.05 } else { 0.025 };
    let upright =
        UnitQuaternion::rotation_between(&Vector3::z(), &x_axis).unwrap_or_else(UnitQuaternion::identity);
    let base_from_object =
        ObjectPath::Still(Isometry3::from_parts((start + normal * radius_m).coords.into(), upright));
    Take { object, base_from_object, times_s, clean, measured }
}

/// Thumb and index finger tap each other away from any object.
pub(crate) fn touching_fingers(station: &Station, seed: u64) -> Take {
    let robot = &station.robot;
    let dof = |name: &str| robot.dofs().position(|joint| joint.name == name).expect("a joint of the hand");
    let patch = |id: &str| station.layout.patches.iter().find(|patch| patch.id == id).expect("a patch");
    let (thumb, index) = (patch("thumb_tip"), patch("index_tip"));
    let joints = ["thumb_cmc", "thumb_axial", "thumb_mcp", "thumb_ip", "index_mcp_forward", "index_pip"];
    let dofs: Vec<usize> = joints.iter().map(|name| dof(name)).collect();
    let mut poses = Vec::new();
    let mut apart = |positions: &[f64]| {
        robot.forward_kinematics(positions, &mut poses);
        (poses[thumb.link] * middle(thumb).0) - (poses[index.link] * middle(index).0)
    };
    // From the open hand to where the pads meet.
    let mut open = vec![0.0; robot.num_dofs()];
    for (name, position) in REST {
        open[dof(name)] = position;
    }
    let mut closed = open.clone();
    for _ in 0..200 {
        let gap = apart(&closed);
        let mut jacobian = DMatrix::zeros(3, dofs.len());
        for (column, &dof) in dofs.iter().enumerate() {
            let mut moved = closed.clone();
            moved[dof] += 1e-5;
            jacobian.set_column(column, &((apart(&moved) - gap) / 1e-5));
        }
        let square = &jacobian * jacobian.transpose() + DMatrix::identity(3, 3) * 1e-5;
        let step = jacobian.transpose()
            * square.try_inverse().expect("damped")
            * DVector::from_column_slice(gap.as_slice());
        for (&dof, step) in dofs.iter().zip(step.iter()) {
            closed[dof] -= step.clamp(-0.05, 0.05);
        }
    }
    let mut noise = Noise(seed);
    let (mut times_s, mut clean) = (Vec::new(), Vec::new());
    for frame in 0..200 {
        let share = 0.9 + 0.1 * (0.15 * f64::from(frame)).sin();
        times_s.push(0.1 * f64::from(frame));
        clean.extend(open.iter().zip(&closed).map(|(open, closed)| open + share * (closed - open)));
    }
    let measured = clean.iter().map(|position| position + 0.0003 * noise.normal()).collect();
    let object = station.objects["wedge_80mm"].clone();
    let base_from_object = ObjectPath::Still(Isometry3::translation(2.0, 2.0, 2.0));
    Take { object, base_from_object, times_s, clean, measured }
}

/// A chain for each take, its geometry computed once for kinematic effects that stay.
pub(crate) fn sense(
    station: &Station,
    takes: &[Take],
    measured: bool,
    effects: &[Effect],
    soft_widths: &[f64],
    cache: Option<&[Geometry]>,
) -> Vec<Sensed> {
    let response = response(station);
    let chain = Chain::new(THETA, &response, effects, soft_widths);
    takes
        .iter()
        .enumerate()
        .map(|(idx, take)| {
            let scene = take.scene(station, if measured { &take.measured } else { &take.clean });
            match cache {
                Some(geometry) => chain.sense_contact(&scene, &geometry[idx]),
                None => chain.sense(&scene).expect("a valid take"),
            }
        })
        .collect()
}
