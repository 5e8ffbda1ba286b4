//! The shipped stations: their channels, and patches that lie where a sensor can.

use nalgebra::{Point3, Vector3};
use palpate_robot_model::{LinkGeometry, LinkShape, ObjectShape, SensorKind, Station};

use crate::{pose_in, station};

fn both() -> [Station; 2] {
    [station("xarm6_leap.toml"), station("probe_bench.toml")]
}

#[test]
fn the_leap_station_has_its_44_channels_and_22_joints_in_order() {
    let station = station("xarm6_leap.toml");
    assert_eq!(station.id, "xarm6-leap");
    assert_eq!(station.robot.num_dofs(), 22);
    assert_eq!(station.carrier_dofs, [0, 1, 2, 3, 4, 5]);
    assert_eq!(station.layout.num_channels(), 44);
    let [twintac, fsr] = &station.layout.streams[..] else { panic!("two streams") };
    assert_eq!(
        (twintac.channels.clone(), twintac.kind, twintac.rate_hz),
        (0..32, SensorKind::Pressure, 100.0)
    );
    assert_eq!((fsr.channels.clone(), fsr.kind, fsr.rate_hz), (32..44, SensorKind::Proximity, 40.0));
    let ids: Vec<&str> =
        [0, 8, 16, 24, 32, 35, 36, 43].map(|i| station.layout.channels[i].id.as_str()).to_vec();
    assert_eq!(
        ids,
        [
            "index_tip.0",
            "middle_tip.0",
            "ring_tip.0",
            "thumb_tip.0",
            "palm_heel",
            "palm_ring",
            "index_proximal",
            "thumb_distal"
        ]
    );
    let tip_nodes: usize =
        station.layout.patches.iter().filter(|p| p.channels.len() == 8).map(|p| p.nodes.len()).sum();
    assert!((700..=900).contains(&tip_nodes), "{tip_nodes} nodes on the fingertips");
    for patch in station.layout.patches.iter().filter(|p| p.channels.len() == 1) {
        assert!((20..=100).contains(&patch.nodes.len()), "{}: {} nodes", patch.id, patch.nodes.len());
    }
}

#[test]
fn the_probe_bench_has_15_channels_of_both_kinds_and_3_joints() {
    let station = station("probe_bench.toml");
    assert_eq!(station.id, "probe-bench");
    assert_eq!(station.robot.num_dofs(), 3);
    let kinds: Vec<_> = station.layout.streams.iter().map(|s| (s.kind, s.channels.clone())).collect();
    assert_eq!(kinds, [(SensorKind::Pressure, 0..9), (SensorKind::Proximity, 9..15)]);
}

#[test]
fn both_stations_know_the_calibration_objects_and_survive_a_take() {
    for station in both() {
        assert!(matches!(station.objects["sphere_50mm"].shape, ObjectShape::Sphere { radius_m: 0.05 }));
        assert!(matches!(
            station.objects["cylinder_25x100mm"].shape,
            ObjectShape::Cylinder { radius_m: 0.025, height_m: 0.1 }
        ));
        assert!(
            matches!(&station.objects["wedge_80mm"].shape, ObjectShape::Mesh { triangles, .. } if triangles.len() == 8)
        );
        let again = Station::from_files(station.files.clone()).unwrap();
        assert_eq!(again.layout.channels, station.layout.channels);
        assert_eq!(again.files, station.files);
    }
}

#[test]
fn patches_lie_on_the_outside_of_their_link() {
    for station in both() {
        for patch in &station.layout.patches {
            let shapes = &station.robot.links[patch.link].collisions;
            for node in &patch.nodes {
                let depth =
                    |p: Point3<f64>| shapes.iter().map(|s| distance(s, &p)).fold(f64::INFINITY, f64::min);
                let off_m = depth(node.pos_in_link);
                assert!((-1e-6..2e-3).contains(&off_m), "{}: a node is {off_m} m off the link", patch.id);
                let above_m = depth(node.pos_in_link + node.normal_in_link.into_inner() * 2e-3);
                assert!(above_m > 0.0, "{}: a normal points into the link", patch.id);
            }
            for (taxel, normal) in patch.taxels_in_link.iter().zip(&patch.taxel_normals_in_link) {
                let nearest = patch
                    .nodes
                    .iter()
                    .min_by(|a, b| (a.pos_in_link - taxel).norm().total_cmp(&(b.pos_in_link - taxel).norm()));
                let nearest = nearest.expect("a patch has nodes");
                assert!((nearest.pos_in_link - taxel).norm() < 2.5e-3, "{}", patch.id);
                assert!(nearest.normal_in_link.dot(normal) > 0.9, "{}", patch.id);
            }
        }
    }
}

#[test]
fn every_patch_faces_an_object_in_the_closed_hand() {
    let station = station("xarm6_leap.toml");
    let posture = |joint: &str| match joint {
        "thumb_cmc" => 1.0,
        "thumb_mcp" => 0.4,
        "thumb_ip" => 0.5,
        _ if joint.ends_with("_mcp_forward") || joint.ends_with("_pip") => 0.9,
        _ if joint.ends_with("_dip") => 0.6,
        _ => 0.0,
    };
    // A ball that rests on the palm, in front of the middle finger.
    let centre_in_palm = Point3::new(-0.035, -0.03, -0.085);
    for patch in &station.layout.patches {
        let palm_from_link = pose_in(&station.robot, "palm", &station.robot.links[patch.link].name, posture);
        let palm_from_patch = palm_from_link * patch.link_from_patch;
        let towards = (centre_in_palm - palm_from_patch * Point3::origin()).normalize();
        let facing = (palm_from_patch * Vector3::z()).dot(&towards);
        assert!(facing > 0.2, "{} faces the ball by {facing}", patch.id);
    }
}

#[test]
fn the_bench_can_press_every_taxel_on_a_ball() {
    let station = station("probe_bench.toml");
    let (centre, radius_m) = (Point3::new(0.0, 0.0, 0.06), 0.05);
    let home = pose_in(&station.robot, "table", "ram", |_| 0.0);
    for patch in &station.layout.patches {
        for (taxel, normal) in patch.taxels_in_link.iter().zip(&patch.taxel_normals_in_link) {
            let touched = centre - (home * normal.into_inner()) * radius_m;
            let travel = touched - home * taxel;
            for (joint, position) in station.robot.dofs().zip(travel.iter()) {
                let limits = joint.limits.expect("the stages have ends");
                assert!(
                    (limits.lower..=limits.upper).contains(position),
                    "{}: {} at {position}",
                    patch.id,
                    joint.name
                );
            }
        }
    }
}

#[test]
fn taxels_do_not_overlap_on_the_flat_map() {
    for station in both() {
        let all: Vec<[f64; 2]> =
            station.layout.patches.iter().flat_map(|p| p.map_positions.clone()).collect();
        assert_eq!(all.len(), station.layout.num_channels());
        for (i, a) in all.iter().enumerate() {
            for b in &all[..i] {
                assert!((a[0] - b[0]).hypot(a[1] - b[1]) > 4.0, "{a:?} {b:?}");
            }
        }
    }
}

/// Signed distance of a point of the link to one of its shapes, m; negative inside.
fn distance(geometry: &LinkGeometry, pos_in_link: &Point3<f64>) -> f64 {
    let p = geometry.link_from_shape.inverse() * pos_in_link;
    let box_like = |q: &[f64]| {
        let outside: f64 = q.iter().map(|d| d.max(0.0).powi(2)).sum();
        outside.sqrt() + q.iter().copied().fold(f64::NEG_INFINITY, f64::max).min(0.0)
    };
    match geometry.shape {
        LinkShape::Box { size_m } => box_like(&[0, 1, 2].map(|axis| p[axis].abs() - size_m[axis] / 2.0)),
        LinkShape::Cylinder { radius_m, length_m } => {
            box_like(&[p.x.hypot(p.y) - radius_m, p.z.abs() - length_m / 2.0])
        }
        LinkShape::Capsule { radius_m, length_m } => {
            let beyond = (p.z.abs() - length_m / 2.0).max(0.0);
            (p.x.powi(2) + p.y.powi(2) + beyond.powi(2)).sqrt() - radius_m
        }
        LinkShape::Sphere { radius_m } => p.coords.norm() - radius_m,
    }
}
