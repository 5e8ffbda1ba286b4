//! A small probe with unequal sizes everywhere: 3 degrees of freedom, one pressure pad (5 x 3 nodes, 4 taxels), one
//! pressure pad with eight taxels (the width that has its own loop) and two proximity patches (2 and 6 nodes).

use nalgebra::{Isometry3, Point3, Vector3};
use palpate_robot_model::{
    Channel, ObjectShape, Patch, Robot, SensorKind, Stream, SurfaceNode, TactileLayout, TaxelAxes,
};
use palpate_sim::geometry::SignedDistance;
use palpate_sim::replay::{ContactTrace, contact_trace};
use palpate_sim::{SensorModel, Theta};

pub(crate) const URDF: &str = r#"<robot name="probe">
    <link name="base"/><link name="sled"/><link name="arm"/><link name="tip"/>
    <joint name="slide" type="prismatic"><parent link="base"/><child link="sled"/><axis xyz="0 0 1"/></joint>
    <joint name="swing" type="continuous">
      <parent link="sled"/><child link="arm"/><origin xyz="0 0 0.02" rpy="0.1 0 0.3"/><axis xyz="0 1 0"/>
    </joint>
    <joint name="twist" type="continuous">
      <parent link="arm"/><child link="tip"/><origin xyz="0.01 0 -0.02"/><axis xyz="0 0 1"/>
    </joint>
  </robot>"#;

pub(crate) const NUM_DOFS: usize = 3;

pub(crate) fn robot() -> Robot {
    Robot::from_urdf("probe.urdf", URDF, &[]).expect("valid robot")
}

/// A grid of `columns x rows` nodes facing down, 4 mm apart about the link's origin moved by `shift`.
fn grid(columns: usize, rows: usize, shift: Vector3<f64>) -> Vec<SurfaceNode> {
    let at = |i: usize, count: usize| (i as f64 - 0.5 * (count as f64 - 1.0)) * 0.004;
    let node = |i: usize| SurfaceNode {
        pos_in_link: Point3::from(Vector3::new(at(i % columns, columns), at(i / columns, rows), 0.0) + shift),
        normal_in_link: -Vector3::z_axis(),
    };
    (0..columns * rows).map(node).collect()
}

pub(crate) fn layout(robot: &Robot) -> TactileLayout {
    let kinds = [("pads", SensorKind::Pressure, 0..12), ("patches", SensorKind::Proximity, 12..14)];
    let streams = kinds.map(|(id, kind, channels)| Stream {
        id: id.into(),
        label: id.into(),
        kind,
        rate_hz: 10.0,
        channels,
        raw_unit: "counts".into(),
        axes: TaxelAxes::One,
    });
    let tip = robot.link_index("tip").expect("tip");
    let arm = robot.link_index("arm").expect("arm");
    // Id, stream, link, nodes, and which of the nodes have a taxel on them.
    let patches = [
        ("pad", 0, tip, grid(5, 3, Vector3::zeros()), vec![0, 4, 7, 14]),
        ("wide", 0, tip, grid(9, 1, Vector3::new(0.0, 0.02, -0.003)), (0..8).collect::<Vec<usize>>()),
        ("near", 1, arm, grid(2, 1, Vector3::new(0.03, 0.0, -0.01)), vec![0]),
        ("side", 1, arm, grid(3, 2, Vector3::new(-0.03, 0.0, -0.01)), vec![3]),
    ];
    let mut layout =
        TactileLayout { name: "probe".into(), streams: streams.into(), patches: vec![], channels: vec![] };
    for (patch, (id, stream, link, nodes, taxels)) in patches.into_iter().enumerate() {
        let first = layout.channels.len();
        layout.channels.extend((0..taxels.len()).map(|taxel| Channel {
            id: format!("{id}.{taxel}"),
            stream,
            patch,
            taxel,
        }));
        layout.patches.push(Patch {
            id: id.into(),
            label: id.into(),
            group: id.into(),
            stream,
            link,
            link_from_patch: Isometry3::identity(),
            taxels_in_link: taxels.iter().map(|&node| nodes[node].pos_in_link).collect(),
            taxel_normals_in_link: vec![-Vector3::z_axis(); taxels.len()],
            map_positions: vec![[0.0; 2]; taxels.len()],
            nodes,
            channels: first..layout.channels.len(),
            stiffness_pa_per_m: 2.5e6,
        });
    }
    layout
}

pub(crate) fn ball() -> SignedDistance {
    SignedDistance::new(&ObjectShape::Sphere { radius_m: 0.05 }).expect("valid object")
}

pub(crate) fn base_from_object() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(0.005, -0.01, -0.06), Vector3::new(0.3, 0.2, 0.1))
}

/// A path that comes from far away, presses, twists and leaves: `num_frames x NUM_DOFS`.
pub(crate) fn path(num_frames: usize) -> Vec<f64> {
    (0..num_frames)
        .flat_map(|frame| {
            let t = frame as f64 / num_frames as f64;
            [0.2 * (t - 0.5).abs() - 0.02, 0.3 * (40.0 * t).sin(), 2.0 * t]
        })
        .collect()
}

pub(crate) fn replay(
    object: &SignedDistance,
    base_from_object: &Isometry3<f64>,
    positions: &[f64],
) -> ContactTrace {
    let robot = robot();
    contact_trace(&robot, &layout(&robot), object, &(*base_from_object).into(), positions)
        .expect("valid path")
}

pub(crate) fn model(lambda_con_m: f64, alpha_per_m: f64, lambda_pre_pa: f64) -> SensorModel {
    let theta = Theta { lambda_con_m, alpha_per_m, lambda_pre_pa };
    SensorModel::plain("test", theta)
}
