//! The contact trace: against a plain loop, on rigid motion, on bad paths, on several threads.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use palpate_robot_model::{ObjectShape, Robot, SensorKind};
use palpate_sim::geometry::SignedDistance;
use palpate_sim::replay::{NEAR_M, PatchTrace, ReplayError, contact_trace};
use proptest::prelude::*;

use crate::probe::{NUM_DOFS, ball, base_from_object, layout, path, replay, robot};

fn objects() -> Vec<SignedDistance> {
    let corner = |i: u32| {
        let side = |bit: u32| if (i >> bit) & 1 == 1 { 0.035 } else { -0.035 };
        Point3::new(side(2), side(1), side(0))
    };
    let part = ObjectShape::Cylinder { radius_m: 0.03, height_m: 0.08 };
    let shapes = [
        ObjectShape::Sphere { radius_m: 0.05 },
        ObjectShape::Cylinder { radius_m: 0.04, height_m: 0.1 },
        ObjectShape::Box { size_m: [0.07, 0.08, 0.09] },
        ObjectShape::ConvexParts { parts: vec![(0..8).map(corner).collect()] },
        ObjectShape::Compound { parts: vec![(Isometry3::translation(0.01, 0.0, 0.0), part)] },
    ];
    shapes.iter().map(|shape| SignedDistance::new(shape).expect("valid object")).collect()
}

#[test]
fn trace_is_what_a_plain_loop_over_all_nodes_finds() {
    let (robot, positions) = (robot(), path(203));
    let layout = layout(&robot);
    for object in objects() {
        let trace = replay(&object, &base_from_object(), &positions);
        assert_eq!(trace.num_frames, 203);
        let (mut touched, mut far, mut near) = (0, 0, 0);
        let mut root_from_link = Vec::new();
        for (frame, frame_positions) in positions.chunks(NUM_DOFS).enumerate() {
            robot.forward_kinematics(frame_positions, &mut root_from_link);
            for (patch, felt) in layout.patches.iter().zip(&trace.patches) {
                let object_from_link = base_from_object().inverse() * root_from_link[patch.link];
                let distance_m =
                    |node: usize| object.distance_m(&(object_from_link * patch.nodes[node].pos_in_link));
                match &**felt {
                    PatchTrace::Proximity { min_distance_m, .. } => {
                        let exact = (0..patch.nodes.len()).map(distance_m).fold(f64::INFINITY, f64::min);
                        let found = min_distance_m[frame];
                        if exact < NEAR_M {
                            assert!((found - exact).abs() < 1e-12, "{}: {found} against {exact}", patch.id);
                            near += 1;
                        } else {
                            assert!(
                                found >= NEAR_M && found <= exact + 1e-12,
                                "{}: {found} against {exact}",
                                patch.id
                            );
                            far += 1;
                        }
                    }
                    PatchTrace::Pressure { offsets, entries } => {
                        let mut found = entries[PatchTrace::entry_range(offsets, frame)].iter();
                        for node in 0..patch.nodes.len() {
                            let exact_pa = -distance_m(node) * patch.stiffness_pa_per_m;
                            if exact_pa > 1e-3 {
                                let &(found_node, pressure_pa) =
                                    found.next().expect("every touched node has an entry");
                                assert_eq!(found_node as usize, node);
                                assert!(
                                    (pressure_pa - exact_pa).abs() < 1e-5,
                                    "{pressure_pa} against {exact_pa}"
                                );
                                touched += 1;
                            }
                        }
                        assert_eq!(found.next(), None);
                    }
                }
            }
        }
        assert!(
            touched > 50 && far > 50 && near > 50,
            "the path must cover all cases: {touched} {far} {near}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Robot and object moved together through the world feel the same.
    #[test]
    fn rigid_motion_of_everything_changes_nothing(
        shift in prop::array::uniform3(-2.0..2.0_f64), turn in prop::array::uniform3(-3.0..3.0_f64)
    ) {
        let world_from_base = Isometry3::new(Vector3::from(shift), Vector3::from(turn));
        let (roll, pitch, yaw) = world_from_base.rotation.euler_angles();
        let urdf = format!(
            r#"<robot name="moved"><link name="world"/><link name="base"/>
              <joint name="mount" type="fixed"><parent link="world"/><child link="base"/>
              <origin xyz="{:?} {:?} {:?}" rpy="{roll:?} {pitch:?} {yaw:?}"/></joint>{}"#,
            shift[0], shift[1], shift[2],
            crate::probe::URDF.split_once("<link name=\"base\"/>").expect("the probe begins with its base").1,
        );
        let moved = Robot::from_urdf("moved.urdf", &urdf, &[]).expect("valid robot");
        let positions = path(61);
        let object = ball();
        let there = contact_trace(&moved, &layout(&moved), &object, &(world_from_base * base_from_object()).into(), &positions)
            .expect("valid path");
        let here = replay(&object, &base_from_object(), &positions);
        let layout = layout(&moved);
        let raw_there = palpate_sim::tactile::raw_signals(&layout, &there, 200.0);
        let raw_here = palpate_sim::tactile::raw_signals(&layout, &here, 200.0);
        prop_assert!(raw_here.iter().any(|&pressure_pa| pressure_pa > 1000.0));
        for (i, (a, b)) in raw_there.iter().zip(&raw_here).enumerate() {
            let channel = &layout.channels[i % layout.num_channels()];
            let tolerance = match layout.streams[channel.stream].kind {
                SensorKind::Proximity => 1e-12,
                SensorKind::Pressure => 1e-4,
            };
            prop_assert!((a - b).abs() < tolerance, "{}: {} against {}", channel.id, a, b);
        }
    }

    /// A ball looks the same from every side.
    #[test]
    fn turning_a_ball_about_its_centre_changes_nothing(turn in prop::array::uniform3(-3.0..3.0_f64)) {
        let mut turned = base_from_object();
        turned.rotation = UnitQuaternion::new(Vector3::from(turn));
        let positions = path(61);
        let layout = layout(&robot());
        let raw = |pose| palpate_sim::tactile::raw_signals(&layout, &replay(&ball(), pose, &positions), 200.0);
        for (a, b) in raw(&turned).iter().zip(raw(&base_from_object())) {
            prop_assert!((a - b).abs() < 1e-4, "{} against {}", a, b);
        }
    }
}

#[test]
fn non_finite_position_is_named_by_frame_and_joint() {
    let (robot, mut positions) = (robot(), path(10));
    positions[7 * NUM_DOFS + 1] = f64::NAN;
    let error = contact_trace(&robot, &layout(&robot), &ball(), &base_from_object().into(), &positions)
        .expect_err("NaN");
    let message = "failed to replay frame 7: position of joint \"swing\" is NaN, expected a finite number";
    assert_eq!(error.to_string(), message);
    positions[4 * NUM_DOFS + 2] = f64::INFINITY;
    let error = contact_trace(&robot, &layout(&robot), &ball(), &base_from_object().into(), &positions)
        .expect_err("infinite");
    assert_eq!(
        error,
        ReplayError::NonFinitePosition { frame: 4, joint: "twist".into(), value: f64::INFINITY }
    );
}

#[test]
fn ragged_path_and_lost_object_are_refused() {
    let (robot, positions) = (robot(), path(10));
    let layout = layout(&robot);
    let error = contact_trace(&robot, &layout, &ball(), &base_from_object().into(), &positions[1..])
        .expect_err("ragged");
    assert_eq!(error, ReplayError::RaggedPath { num_values: 29, num_dofs: 3 });
    let lost = Isometry3::translation(f64::NAN, 0.0, 0.0);
    let error = contact_trace(&robot, &layout, &ball(), &lost.into(), &positions).expect_err("lost");
    assert!(matches!(error, ReplayError::NonFiniteObjectPose { .. }), "{error}");
}

#[test]
fn empty_path_gives_an_empty_trace() {
    let trace = replay(&ball(), &base_from_object(), &[]);
    assert_eq!(trace.num_frames, 0);
    for patch in &trace.patches {
        match &**patch {
            PatchTrace::Proximity { min_distance_m, .. } => assert!(min_distance_m.is_empty()),
            PatchTrace::Pressure { offsets, entries } => {
                assert_eq!((&offsets[..], entries.len()), (&[0][..], 0));
            }
        }
    }
    assert!(palpate_sim::tactile::raw_signals(&layout(&robot()), &trace, 100.0).is_empty());
}

#[cfg(feature = "batch")]
#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let robot = robot();
    let layout = layout(&robot);
    let run = |num_threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads).build().expect("threads");
        pool.install(|| {
            let trace = replay(&ball(), &base_from_object(), &path(1003));
            let raw = palpate_sim::tactile::raw_signals(&layout, &trace, 317.0);
            (trace, raw.iter().map(|value| value.to_bits()).collect::<Vec<_>>())
        })
    };
    let one = run(1);
    assert!(one.1.iter().any(|&bits| f64::from_bits(bits) > 1000.0));
    for num_threads in [2, 5] {
        assert!(run(num_threads) == one, "{num_threads} threads");
    }
}
