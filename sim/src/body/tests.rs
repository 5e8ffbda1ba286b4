use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Isometry3, UnitQuaternion};
use proptest::prelude::*;

use super::*;

fn solid(shape: &ObjectShape) -> Solid {
    Solid::new(shape).expect("a body")
}

fn cuboid(size_m: [f64; 3]) -> ObjectShape {
    ObjectShape::Box { size_m }
}

fn cylinder(radius_m: f64, height_m: f64) -> ObjectShape {
    ObjectShape::Cylinder { radius_m, height_m }
}

fn sphere(radius_m: f64) -> ObjectShape {
    ObjectShape::Sphere { radius_m }
}

fn corners(size_m: [f64; 3]) -> Vec<Point3<f64>> {
    let sign = |i: usize, bit: usize| if i >> bit & 1 == 0 { -0.5 } else { 0.5 };
    (0..8)
        .map(|i| Point3::new(size_m[0] * sign(i, 0), size_m[1] * sign(i, 1), size_m[2] * sign(i, 2)))
        .collect()
}

fn compound(parts: Vec<(Isometry3<f64>, ObjectShape)>) -> ObjectShape {
    ObjectShape::Compound { parts }
}

fn moved(pose: Isometry3<f64>, shape: ObjectShape) -> ObjectShape {
    compound(vec![(pose, shape)])
}

fn at(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Isometry3::translation(x, y, z)
}

/// Mass properties of all cells of a grid whose middle is inside, by signed distance: an independent integration.
fn by_voxels(shape: &ObjectShape, cells: usize) -> MassProperties {
    let distance = SignedDistance::new(shape).expect("a body");
    let reach = distance.bounding_radius_m();
    let step = 2.0 * reach / cells as f64;
    let middle = |i: usize| -reach + (i as f64 + 0.5) * step;
    let mut inside = Vec::new();
    for x in 0..cells {
        for y in 0..cells {
            for z in 0..cells {
                let p = Point3::new(middle(x), middle(y), middle(z));
                if distance.distance_m(&p) < 0.0 {
                    inside.push(p.coords);
                }
            }
        }
    }
    let cell_kg = step.powi(3);
    let com = inside.iter().sum::<Vector3<f64>>() / inside.len() as f64;
    let mut inertia = Matrix3::zeros();
    for p in &inside {
        let r = p - com;
        // A cube of side s has s^2 / 6 about its own axes.
        inertia += Matrix3::identity() * (r.norm_squared() + step * step / 6.0) - r * r.transpose();
    }
    MassProperties {
        mass_kg: inside.len() as f64 * cell_kg,
        com_in_object: Point3::from(com),
        inertia_kg_m2: inertia * cell_kg,
    }
}

fn assert_close(ours: &MassProperties, expected: &MassProperties, relative: f64, what: &str) {
    let mass = (ours.mass_kg - expected.mass_kg).abs() / expected.mass_kg;
    assert!(mass < relative, "{what}: mass {} against {}", ours.mass_kg, expected.mass_kg);
    let size = (expected.inertia_kg_m2.trace() / expected.mass_kg).sqrt();
    let com = (ours.com_in_object - expected.com_in_object).norm() / size;
    assert!(com < relative, "{what}: centre {} against {}", ours.com_in_object, expected.com_in_object);
    let inertia = (ours.inertia_kg_m2 - expected.inertia_kg_m2).norm() / expected.inertia_kg_m2.norm();
    assert!(inertia < relative, "{what}: inertia {} against {}", ours.inertia_kg_m2, expected.inertia_kg_m2);
}

#[test]
fn primitives_have_their_textbook_masses_and_inertias() {
    let (r, h) = (0.02, 0.07);
    let [a, b, c] = [0.04, 0.06, 0.08];
    // A capsule as a cylinder and two half balls (parallel axes; a half ball's centre is 3/8 r from its flat side).
    let (tube, half_ball) = (PI * r * r * h, 2.0 / 3.0 * PI * r.powi(3));
    let from_middle = h / 2.0 + 0.375 * r;
    let half_ball_across = half_ball * (0.4 * r * r - (0.375 * r).powi(2) + from_middle.powi(2));
    let across = tube * (r * r / 4.0 + h * h / 12.0) + 2.0 * half_ball_across;
    let cases = [
        (
            cuboid([a, b, c]),
            a * b * c,
            [(b * b + c * c) / 12.0, (a * a + c * c) / 12.0, (a * a + b * b) / 12.0],
        ),
        (sphere(r), 4.0 / 3.0 * PI * r.powi(3), [0.4 * r * r; 3]),
        (
            cylinder(r, h),
            PI * r * r * h,
            [r * r / 4.0 + h * h / 12.0, r * r / 4.0 + h * h / 12.0, r * r / 2.0],
        ),
        (ObjectShape::Capsule { radius_m: r, length_m: h }, tube + 2.0 * half_ball, {
            let along = tube * r * r / 2.0 + 2.0 * half_ball * 0.4 * r * r;
            [across, across, along].map(|inertia| inertia / (tube + 2.0 * half_ball))
        }),
    ];
    for (shape, volume, per_mass) in cases {
        let density = 700.0;
        let expected = MassProperties {
            mass_kg: density * volume,
            com_in_object: Point3::origin(),
            inertia_kg_m2: Matrix3::from_diagonal(&Vector3::from(per_mass)) * (density * volume),
        };
        assert_close(&solid(&shape).mass_properties(density), &expected, 1e-12, &format!("{shape:?}"));
    }
}

#[test]
fn box_is_the_same_as_primitive_hull_mesh_halves_and_twice_over() {
    let size = [0.04, 0.06, 0.08];
    let triangles = vec![
        [0, 2, 3],
        [0, 3, 1],
        [4, 5, 7],
        [4, 7, 6],
        [0, 1, 5],
        [0, 5, 4],
        [2, 6, 7],
        [2, 7, 3],
        [0, 4, 6],
        [0, 6, 2],
        [1, 3, 7],
        [1, 7, 5],
    ];
    let half = cuboid([0.02, 0.06, 0.08]);
    let expected = solid(&cuboid(size)).mass_properties(1.0);
    for shape in [
        ObjectShape::ConvexParts { parts: vec![corners(size)] },
        ObjectShape::Mesh { vertices: corners(size), triangles },
        compound(vec![(at(-0.01, 0.0, 0.0), half.clone()), (at(0.01, 0.0, 0.0), half.clone())]),
        // Halves that overlap by half of themselves.
        compound(vec![
            (at(-0.01, 0.0, 0.0), half.clone()),
            (at(0.01, 0.0, 0.0), half.clone()),
            (at(0.0, 0.0, 0.0), half),
        ]),
        compound(vec![(at(0.0, 0.0, 0.0), cuboid(size)), (at(0.0, 0.0, 0.0), cuboid(size))]),
    ] {
        assert_close(&solid(&shape).mass_properties(1.0), &expected, 1e-12, &format!("{shape:?}"));
    }
}

#[test]
fn two_balls_share_their_lens() {
    // The lens of two balls of radius r at distance d: pi (4 r + d) (2 r - d)^2 / 12.
    let (r, d) = (0.03, 0.04_f64);
    let shape = compound(vec![(at(0.0, 0.0, 0.0), sphere(r)), (at(0.6 * d, 0.0, 0.8 * d), sphere(r))]);
    let lens = PI * (4.0 * r + d) * (2.0 * r - d).powi(2) / 12.0;
    let expected = 8.0 / 3.0 * PI * r.powi(3) - lens;
    let volume = solid(&shape).volume_m3();
    assert!((volume - expected).abs() < 2e-4 * lens, "{volume} against {expected}, lens {lens}");
}

#[test]
fn what_has_no_volume_or_no_density_says_so() {
    let flat = ObjectShape::ConvexParts { parts: vec![corners([0.1, 0.1, 0.0])] };
    assert!(Solid::new(&flat).expect_err("flat").contains("part 0"));
    assert!(Solid::new(&sphere(-1.0)).expect_err("negative").contains("sphere radius"));
    let read = |density: &str| {
        let text = format!(
            "id = \"ball\"\nlabel = \"Ball\"\n{density}\nshape = {{ kind = \"sphere\", radius_m = 0.03 }}"
        );
        ObjectModel::from_toml("ball.toml", &text, |_| Err("no mesh".to_owned())).expect("an object")
    };
    let refusal = MassProperties::of(&read("")).expect_err("no density");
    assert!(refusal.contains("\"ball\"") && refusal.contains("density_kg_m3"), "{refusal}");
    let mass_kg = MassProperties::of(&read("density_kg_m3 = 1000.0")).expect("a mass").mass_kg;
    assert!((mass_kg - 4000.0 / 3.0 * PI * 0.03_f64.powi(3)).abs() < 1e-12);
}

fn any_rotation() -> impl Strategy<Value = UnitQuaternion<f64>> {
    prop::array::uniform3(-3.0..3.0_f64).prop_map(|v| UnitQuaternion::from_scaled_axis(Vector3::from(v)))
}

fn any_pose() -> impl Strategy<Value = Isometry3<f64>> {
    (prop::array::uniform3(-0.02..0.02_f64), any_rotation())
        .prop_map(|(t, rotation)| Isometry3::from_parts(t.into(), rotation))
}

fn any_part() -> impl Strategy<Value = ObjectShape> {
    let length = || 0.015..0.05_f64;
    prop_oneof![
        (length(), length(), length()).prop_map(|(a, b, c)| cuboid([a, b, c])),
        length().prop_map(|d| sphere(d / 2.0)),
        (length(), length()).prop_map(|(d, h)| cylinder(d / 2.0, h)),
        (length(), length()).prop_map(|(d, h)| ObjectShape::Capsule { radius_m: d / 2.0, length_m: h }),
        (length(), length(), length())
            .prop_map(|(a, b, c)| ObjectShape::ConvexParts { parts: vec![corners([a, b, c])[..7].to_vec()] }),
    ]
}

fn any_union() -> impl Strategy<Value = ObjectShape> {
    prop::collection::vec((any_pose(), any_part()), 1..4).prop_map(compound)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn unions_weigh_what_their_voxels_weigh(shape in any_union()) {
        assert_close(&solid(&shape).mass_properties(1.0), &by_voxels(&shape, 80), 0.02, "a union");
    }

    #[test]
    fn moving_an_object_moves_its_centre_and_turns_its_inertia(shape in any_union(), pose in any_pose()) {
        let before = solid(&shape).mass_properties(1.0);
        let rotation = pose.rotation.to_rotation_matrix().into_inner();
        let expected = MassProperties {
            mass_kg: before.mass_kg,
            com_in_object: pose * before.com_in_object,
            inertia_kg_m2: rotation * before.inertia_kg_m2 * rotation.transpose(),
        };
        // Columns stand elsewhere in the moved object, so overlaps are integrated to a few digits only.
        assert_close(&solid(&moved(pose, shape)).mass_properties(1.0), &expected, 2e-3, "a moved union");
    }

    #[test]
    fn shares_add_up_and_no_small_tilt_lowers_the_centre_of_mass(shape in any_union()) {
        let solid = solid(&shape);
        let poses = solid.rest_poses().expect("poses");
        assert_at_rest(&solid, &poses, "a union");
    }

    #[test]
    fn poses_do_not_depend_on_how_the_object_is_turned_in_its_file(shape in any_part(), rotation in any_rotation()) {
        let turn = Isometry3::from_parts(Vector3::zeros().into(), rotation);
        let before = solid(&shape).rest_poses().expect("poses");
        let after = solid(&moved(turn, shape)).rest_poses().expect("poses");
        prop_assert_eq!(before.len(), after.len());
        // Heights are heights above the table, so a turn about the vertical, or any other, changes none of them.
        let sorted = |poses: &[RestPose]| {
            let mut heights: Vec<[f64; 3]> =
                poses.iter().map(|pose| [pose.com_height_m, pose.origin_height_m, pose.weight]).collect();
            heights.sort_by(|a, b| a[0].total_cmp(&b[0]));
            heights
        };
        for (a, b) in sorted(&before).into_iter().zip(sorted(&after)) {
            prop_assert!((a[0] - b[0]).abs() < 1e-5 && (a[1] - b[1]).abs() < 1e-5, "{:?} {:?}", a, b);
        }
    }

    #[test]
    fn yaw_turns_the_object_and_leaves_its_height(shape in any_part(), yaw in -3.0..3.0_f64, x in -1.0..1.0_f64) {
        let solid = solid(&shape);
        for pose in solid.rest_poses().expect("poses") {
            let table_from_object = pose.at([x, 0.5], yaw);
            let down = table_from_object.rotation.inverse() * -Vector3::z();
            let lowest = table_from_object.translation.z - solid.farthest_along(&down);
            prop_assert!(lowest.abs() < 1e-9, "the lowest point is {} m above the table", lowest);
            prop_assert_eq!(table_from_object.translation.x, x);
        }
    }
}

/// The laws of poses at rest.
fn assert_at_rest(solid: &Solid, poses: &[RestPose], what: &str) {
    assert!(!poses.is_empty(), "{what} never comes to rest");
    let total: f64 = poses.iter().map(|pose| pose.weight).sum();
    assert!((total - 1.0).abs() < 1e-9, "{what}: shares add up to {total}");
    let com = solid.centroid_in_object();
    for pose in poses {
        let height_m = |tilt: &UnitQuaternion<f64>| {
            let down = pose.table_from_object.inverse() * (tilt.inverse() * -Vector3::z());
            solid.farthest_along(&down) - down.dot(&com.coords)
        };
        let flat = height_m(&UnitQuaternion::identity());
        assert!((flat - pose.com_height_m).abs() < 1e-12);
        // Curved sides are stood for by points, and the search for the lowest pose ends somewhere.
        let [low, high] = solid.bounds_m();
        let slack = 2e-5 * (Point3::from(high) - Point3::from(low)).norm();
        for i in 0..16 {
            let (sin, cos) = (PI / 8.0 * f64::from(i)).sin_cos();
            for tilt_rad in [0.002, 0.01] {
                let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(cos, sin, 0.0) * tilt_rad);
                let tilted = height_m(&tilt);
                assert!(tilted > flat - slack, "{what}: {pose:?} falls from {flat} to {tilted} when tilted");
            }
        }
    }
}

#[test]
fn solids_rest_on_as_many_sides_as_they_have() {
    let tetrahedron = vec![
        Point3::new(1.0, 1.0, 1.0),
        Point3::new(1.0, -1.0, -1.0),
        Point3::new(-1.0, 1.0, -1.0),
        Point3::new(-1.0, -1.0, 1.0),
    ];
    for (shape, expected) in [
        (cuboid([0.06; 3]), 6),
        (cuboid([0.04, 0.06, 0.08]), 6),
        (sphere(0.03), 1),
        (cylinder(0.025, 0.07), 3),
        (ObjectShape::Capsule { radius_m: 0.01, length_m: 0.03 }, 1),
        (ObjectShape::ConvexParts { parts: vec![tetrahedron] }, 4),
        // A needle does not stand on its end, a coin not on its rim for long.
        (cylinder(0.0005, 0.1), 1),
        (cylinder(0.02, 0.001), 2),
    ] {
        let solid = solid(&shape);
        let poses = solid.rest_poses().expect("poses");
        assert_eq!(poses.len(), expected, "{shape:?}: {poses:?}");
        assert_at_rest(&solid, &poses, &format!("{shape:?}"));
        // Nothing of this depends on the unit.
        let large = Solid::new(&shape.scaled(10.0)).expect("a body").rest_poses().expect("poses");
        assert_eq!(large.len(), expected, "{shape:?}, ten times as large");
    }
}

#[test]
fn a_box_lies_on_each_face_as_often_as_the_face_is_seen_from_its_middle() {
    let [a, b, c] = [0.04, 0.06, 0.08_f64];
    // A rectangle a by b at distance c / 2 fills 4 atan(a b / (c sqrt(a^2 + b^2 + c^2))).
    let seen =
        |a: f64, b: f64, c: f64| 4.0 * (a * b / (c * (a * a + b * b + c * c).sqrt())).atan() / (4.0 * PI);
    let poses = solid(&cuboid([a, b, c])).rest_poses().expect("poses");
    for (pose, (height, share)) in poses.iter().step_by(2).zip([
        (a / 2.0, seen(b, c, a)),
        (b / 2.0, seen(a, c, b)),
        (c / 2.0, seen(a, b, c)),
    ]) {
        assert!((pose.com_height_m - height).abs() < 1e-12, "{pose:?}");
        assert!((pose.weight - share).abs() < 1e-12, "{pose:?} against {share}");
    }
    // Over the longest edge of its largest face, the box must rise from a / 2 to half the diagonal of a by b.
    let barrier = poses[0].barrier_m.expect("other poses");
    assert!((barrier - (0.5 * a.hypot(b) - 0.5 * a)).abs() < 1e-12, "{barrier}");
}

#[test]
fn a_leaning_prism_topples_off_its_foot() {
    // Upright sides sheared until the centre of mass is beyond the foot: it cannot stand on either end.
    let points = corners([0.02, 0.02, 0.06]).iter().map(|p| Point3::new(p.x + p.z, p.y, p.z)).collect();
    let solid = solid(&ObjectShape::ConvexParts { parts: vec![points] });
    let poses = solid.rest_poses().expect("poses");
    for pose in &poses {
        let down = pose.table_from_object.inverse() * -Vector3::z();
        assert!(down.z.abs() < 0.9, "it stands on its end: {pose:?}");
    }
    assert_at_rest(&solid, &poses, "a leaning prism");
}

#[test]
fn balls_that_carry_an_object_touch_the_table_exactly() {
    let r = 0.02;
    let ball = |angle: f64| (at(0.02 * angle.cos(), 0.02 * angle.sin(), 0.0), sphere(r));
    let shape = compound(vec![ball(0.3), ball(0.3 + 2.0 * PI / 3.0), ball(0.3 + 4.0 * PI / 3.0)]);
    let tilted = moved(Isometry3::rotation(Vector3::new(0.4, FRAC_PI_2, -0.2)), shape);
    let poses = solid(&tilted).rest_poses().expect("poses");
    assert_eq!(poses.len(), 2, "{poses:?}");
    for pose in poses {
        assert!((pose.com_height_m - r).abs() < 1e-9, "{pose:?}");
    }
}

#[test]
fn picks_follow_the_shares() {
    let poses = solid(&cylinder(0.025, 0.07)).rest_poses().expect("poses");
    let mut counts = vec![0; poses.len()];
    for i in 0..1000 {
        let picked = RestPose::pick(&poses, (f64::from(i) + 0.5) / 1000.0).expect("a pose");
        let idx = poses.iter().position(|pose| pose == picked).expect("one of them");
        counts[idx] += 1;
    }
    for (pose, count) in poses.iter().zip(counts) {
        assert!((pose.weight - f64::from(count) / 1000.0).abs() < 2e-3, "{pose:?} picked {count} times");
    }
    assert!(RestPose::pick(&[], 0.5).is_none());
    assert_eq!(RestPose::pick(&poses, 1.0), poses.last());
}
