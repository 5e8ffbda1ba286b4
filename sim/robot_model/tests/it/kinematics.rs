//! Forward kinematics of the shipped arm and hand against published vectors.

use std::collections::BTreeMap;

use nalgebra::{Point3, Rotation3};
use serde::Deserialize;

use crate::{pose_in, repository, station};

/// What the published vectors may be off by: they are rounded to a micrometre or so; 0.1 mm is what we promise.
const TOLERANCE_M: f64 = 1e-4;

#[derive(Deserialize)]
struct Published {
    /// finger -> posture -> position of its tip frame in the palm's frame.
    tip_position_in_palm_m: BTreeMap<String, BTreeMap<String, [f64; 3]>>,
    flange_in_arm_base: Vec<Flange>,
}

#[derive(Deserialize)]
struct Flange {
    q: Vec<f64>,
    xyz_mm: [f64; 3],
    rpy: [f64; 3],
}

fn published() -> Published {
    let path = repository().join("tests/fixtures/kinematics/xarm6_leap_right.json");
    let text = std::fs::read_to_string(path).expect("the published vectors");
    serde_json::from_str(&text).expect("the form of the published vectors")
}

#[test]
fn fingertips_are_where_the_published_vectors_have_them() {
    let robot = station("xarm6_leap.toml").robot;
    let mut compared = 0;
    for (finger, postures) in published().tip_position_in_palm_m {
        // The first joint of each chain is the one that swings the whole finger.
        let first = if finger == "thumb" { "thumb_cmc".to_owned() } else { format!("{finger}_mcp_forward") };
        for (posture, expected) in postures {
            let palm_from_tip =
                pose_in(&robot, "palm", &format!("{finger}_tip"), |joint| match posture.as_str() {
                    "all_zero" => 0.0,
                    "all_0.5rad" => 0.5,
                    "mcp_fwd_1.0_only" => f64::from(u8::from(joint == first)),
                    other => panic!("posture {other}"),
                });
            let off_m = (palm_from_tip * Point3::origin() - Point3::from(expected)).norm();
            assert!(off_m < TOLERANCE_M, "{finger}, {posture}: {off_m} m off");
            compared += 1;
        }
    }
    assert_eq!(compared, 12);
}

#[test]
fn the_flange_is_where_the_arms_maker_has_it() {
    let robot = station("xarm6_leap.toml").robot;
    let flanges = published().flange_in_arm_base;
    assert_eq!(flanges.len(), 4);
    for Flange { q, xyz_mm, rpy } in flanges {
        let flange = pose_in(&robot, "arm_base", "arm_link6", |joint| {
            joint.strip_prefix("joint").and_then(|n| n.parse::<usize>().ok()).map_or(0.0, |n| q[n - 1])
        });
        let off_m = (flange * Point3::origin() - Point3::from(xyz_mm.map(|mm| mm / 1000.0))).norm();
        assert!(off_m < TOLERANCE_M, "{q:?}: {off_m} m off");
        let turned = flange.rotation.angle_to(&Rotation3::from_euler_angles(rpy[0], rpy[1], rpy[2]).into());
        assert!(turned < 1e-4, "{q:?}: {turned} rad off");
    }
}

#[test]
fn the_palm_faces_away_from_the_flange() {
    let robot = station("xarm6_leap.toml").robot;
    let flange_from_palm = pose_in(&robot, "arm_link6", "palm", |_| 0.0);
    assert!((flange_from_palm.translation.vector - nalgebra::Vector3::new(0.03, 0.06, 0.012)).norm() < 1e-9);
    let palm_normal_in_flange = flange_from_palm * -nalgebra::Vector3::z();
    assert!((palm_normal_in_flange - nalgebra::Vector3::z()).norm() < 1e-9);
}
