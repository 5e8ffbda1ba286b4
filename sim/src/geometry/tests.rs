use nalgebra::UnitQuaternion;
use palpate_robot_model::{LinkShape, Robot};
use parry3d_f64::query::PointQuery;
use proptest::prelude::*;

use super::*;

fn new(shape: &ObjectShape) -> SignedDistance {
    SignedDistance::new(shape).expect("valid shape")
}

fn sphere(radius_m: f64) -> ObjectShape {
    ObjectShape::Sphere { radius_m }
}

fn cylinder() -> ObjectShape {
    ObjectShape::Cylinder { radius_m: 0.025, height_m: 0.1 }
}

fn capsule() -> ObjectShape {
    ObjectShape::Capsule { radius_m: 0.02, length_m: 0.06 }
}

const BOX_SIZE_M: [f64; 3] = [0.04, 0.06, 0.1];

fn cuboid() -> ObjectShape {
    ObjectShape::Box { size_m: BOX_SIZE_M }
}

/// Corners of [`cuboid`], x slowest.
fn box_corners() -> Vec<Point3<f64>> {
    let sides = [-0.5, 0.5];
    let corner = |i: usize| {
        let side = |axis: usize, bit: usize| sides[(i >> bit) & 1] * BOX_SIZE_M[axis];
        Point3::new(side(0, 2), side(1, 1), side(2, 0))
    };
    (0..8).map(corner).collect()
}

const BOX_TRIANGLES: [[u32; 3]; 12] = [
    [0, 1, 3],
    [0, 3, 2],
    [4, 6, 7],
    [4, 7, 5],
    [0, 4, 5],
    [0, 5, 1],
    [2, 3, 7],
    [2, 7, 6],
    [0, 2, 6],
    [0, 6, 4],
    [1, 5, 7],
    [1, 7, 3],
];

fn box_mesh() -> ObjectShape {
    ObjectShape::Mesh { vertices: box_corners(), triangles: BOX_TRIANGLES.to_vec() }
}

/// Every triangle with its own three vertices, as STL has it.
fn box_soup() -> ObjectShape {
    let corners = box_corners();
    let vertices = BOX_TRIANGLES.iter().flatten().map(|&i| corners[i as usize]).collect();
    ObjectShape::Mesh { vertices, triangles: (0..12).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect() }
}

const SPHERE_RADIUS_M: f64 = 0.05;

/// A sphere as an octahedron, subdivided `levels` times.
fn sphere_mesh(levels: usize) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let axes = [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y(), Vector3::z(), -Vector3::z()];
    let mut vertices: Vec<Vector3<f64>> = axes.to_vec();
    let mut triangles =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..levels {
        // Every edge's midpoint appears once per neighbouring triangle; merging is part of what is tested.
        let mut finer = Vec::new();
        for [a, b, c] in triangles {
            let mut middle = |i: u32, j: u32| {
                vertices.push((vertices[i.min(j) as usize] + vertices[i.max(j) as usize]).normalize());
                vertices.len() as u32 - 1
            };
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    (vertices.into_iter().map(|v| Point3::from(v * SPHERE_RADIUS_M)).collect(), triangles)
}

fn compound() -> ObjectShape {
    let posed = |x, shape| {
        let rotation = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.9);
        (Isometry3::from_parts(nalgebra::Translation3::new(x, 0.01, -0.02), rotation), shape)
    };
    ObjectShape::Compound {
        parts: vec![posed(0.0, cuboid()), posed(0.05, box_mesh()), posed(-0.04, sphere(0.02))],
    }
}

fn convex() -> ObjectShape {
    let shifted = box_corners().iter().map(|p| p + Vector3::new(0.1, 0.0, 0.0)).collect();
    ObjectShape::ConvexParts { parts: vec![box_corners(), shifted] }
}

fn point(reach: f64) -> impl Strategy<Value = Point3<f64>> {
    prop::array::uniform3(-reach..reach).prop_map(Point3::from)
}

fn any_shape() -> impl Strategy<Value = ObjectShape> {
    let mesh = {
        let (vertices, triangles) = sphere_mesh(2);
        ObjectShape::Mesh { vertices, triangles }
    };
    prop::sample::select(vec![
        sphere(0.05),
        cylinder(),
        capsule(),
        cuboid(),
        box_mesh(),
        box_soup(),
        mesh,
        compound(),
        convex(),
    ])
}

proptest! {
    #[test]
    fn distance_changes_no_faster_than_the_point_moves(
        shape in any_shape(), a in point(0.12), step in point(0.01), far in point(0.2)
    ) {
        let object = new(&shape);
        for b in [a + step.coords, far] {
            let change = (object.distance_m(&a) - object.distance_m(&b)).abs();
            prop_assert!(change <= (a - b).norm() + 1e-12, "{} over {}", change, (a - b).norm());
        }
    }

    #[test]
    fn closed_forms_are_parrys_distances(p in point(0.12)) {
        use parry3d_f64::shape::{Ball, Capsule, Cuboid, Cylinder};
        let v = parry_vector(&p);
        let turned = parry3d_f64::math::Vector::new(p.x, p.z, -p.y);
        let h = Vector::new(0.5 * BOX_SIZE_M[0], 0.5 * BOX_SIZE_M[1], 0.5 * BOX_SIZE_M[2]);
        let parrys = [
            (sphere(0.05), Ball::new(0.05).distance_to_local_point(v, false)),
            (cylinder(), Cylinder::new(0.05, 0.025).distance_to_local_point(turned, false)),
            (capsule(), Capsule::new_y(0.03, 0.02).distance_to_local_point(turned, false)),
            (cuboid(), Cuboid::new(h).distance_to_local_point(v, false)),
        ];
        for (shape, expected) in parrys {
            let ours = new(&shape).distance_m(&p);
            prop_assert!((ours - expected).abs() < 1e-12, "{:?}: {} against {}", shape, ours, expected);
        }
    }

    #[test]
    fn box_is_the_same_as_primitive_mesh_soup_and_hull(p in point(0.12)) {
        let expected = new(&cuboid()).distance_m(&p);
        let hull = ObjectShape::ConvexParts { parts: vec![box_corners()] };
        for shape in [box_mesh(), box_soup(), hull] {
            let distance = new(&shape).distance_m(&p);
            prop_assert!((distance - expected).abs() < 1e-12, "{:?}: {} against {}", shape, distance, expected);
        }
    }

    #[test]
    fn meshed_sphere_is_within_its_sagitta(p in point(0.12)) {
        let (vertices, triangles) = sphere_mesh(4);
        let flat_distance = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| vertices[i as usize]);
            (b - a).cross(&(c - a)).normalize().dot(&a.coords)
        };
        let sagitta = SPHERE_RADIUS_M - triangles.iter().map(flat_distance).fold(f64::INFINITY, f64::min);
        prop_assert!(sagitta > 0.0 && sagitta < 5e-4);
        let meshed = new(&ObjectShape::Mesh { vertices: vertices.clone(), triangles }).distance_m(&p);
        let hull = new(&ObjectShape::ConvexParts { parts: vec![vertices] }).distance_m(&p);
        let exact = new(&sphere(SPHERE_RADIUS_M)).distance_m(&p);
        prop_assert!(meshed >= exact - 1e-12 && meshed <= exact + sagitta + 1e-12, "{} against {}", meshed, exact);
        prop_assert!((hull - meshed).abs() < 1e-9, "hull {} against mesh {}", hull, meshed);
    }

    #[test]
    fn limit_changes_nothing_below_it(shape in any_shape(), p in point(0.12), limit in -0.01..0.06) {
        let object = new(&shape);
        let (exact, limited) = (object.distance_m(&p), object.distance_below_m(&p, limit));
        if exact < limit {
            prop_assert!((limited - exact).abs() < 1e-12, "{} against {}", limited, exact);
        } else {
            prop_assert!(limited >= limit - 1e-12 && limited <= exact + 1e-12, "{} against {}", limited, exact);
        }
    }

    #[test]
    fn loop_over_points_gives_single_distances(shape in any_shape(), points in prop::collection::vec(point(0.1), 5)) {
        let object = new(&shape);
        let pose = Isometry3::new(Vector3::new(0.01, -0.02, 0.03), Vector3::new(0.4, 0.5, -0.6));
        let mut visited = 0;
        object.for_each_distance_below(&pose, &points, f64::INFINITY, |i, distance| {
            assert_eq!(i, visited);
            assert!((distance - object.distance_m(&(pose * points[i]))).abs() < 1e-12);
            visited += 1;
        });
        prop_assert_eq!(visited, 5);
    }

    #[test]
    fn smallest_distance_has_the_bits_of_a_full_query(
        shape in any_shape(), points in prop::collection::vec(point(0.1), 12), limit in -0.01..0.08,
    ) {
        let distance = new(&shape);
        // In the object's own frame: loops and single queries round a pose differently.
        let here = Isometry3::identity();
        let full = points.iter().map(|p| distance.distance_m(p)).fold(limit, f64::min);
        prop_assert_eq!(distance.min_distance_below_m(&here, &points, limit).to_bits(), full.to_bits());
    }

    #[test]
    fn everything_is_within_the_bounding_radius(shape in any_shape(), direction in point(1.0)) {
        prop_assume!(direction.coords.norm() > 0.1);
        let object = new(&shape);
        let outside = Point3::from(direction.coords.normalize() * (object.bounding_radius_m() + 1e-9));
        prop_assert!(object.distance_m(&outside) > 0.0);
    }

    #[test]
    fn clearance_of_a_link_ball_is_its_distance_less_its_radius(center in point(0.12), shape in any_shape()) {
        let radius_m = 0.015;
        let robot = robot(&format!(r#"<sphere radius="{radius_m}"/>"#));
        prop_assert_eq!(&robot.links[0].collisions[0].shape, &LinkShape::Sphere { radius_m });
        let object = new(&shape);
        let object_from_link = Isometry3::from_parts(center.into(), UnitQuaternion::identity());
        let clearance = LinkClearance::new(&robot).link_clearance_m(0, &object_from_link, &object);
        let exact = object.distance_m(&center) - radius_m;
        if exact > 1e-6 {
            prop_assert!((clearance - exact).abs() < 1e-6, "{} against {}", clearance, exact);
        } else if exact < -1e-6 {
            prop_assert!(clearance <= 0.0 && clearance >= exact - 1e-9, "{} against {}", clearance, exact);
            // Two balls: unless one holds the other's centre, a point of the one lies that deep. Corners are less deep.
            if matches!(shape, ObjectShape::Sphere { .. }) && center.coords.norm() > radius_m {
                prop_assert!(clearance <= (exact + 0.003).min(0.0), "{} against {}", clearance, exact);
            }
        }
    }

    #[test]
    fn link_shapes_turn_and_move_with_their_link(angle in -3.0..3.0_f64, gap in 0.001..0.05_f64) {
        // A long cylinder along its own z, laid along x by its pose in the link, beside the sphere.
        let robot = robot(r#"<cylinder radius="0.01" length="0.2"/>"#);
        let spin = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle);
        let object_from_link = Isometry3::from_parts(Vector3::new(0.07, 0.0, 0.06 + gap).into(), spin);
        let clearance = LinkClearance::new(&robot).link_clearance_m(0, &object_from_link, &new(&sphere(0.05)));
        prop_assert!((clearance - gap).abs() < 1e-6, "{} against {}", clearance, gap);
    }
}

/// One link with `geometry` turned from z to x.
fn robot(geometry: &str) -> Robot {
    let urdf = format!(
        r#"<robot name="one"><link name="only"><collision><origin rpy="0 1.5707963267948966 0"/>
        <geometry>{geometry}</geometry></collision></link></robot>"#
    );
    Robot::from_urdf("one.urdf", &urdf, &[]).expect("valid robot")
}

#[test]
fn nearest_link_skips_what_does_not_count() {
    let urdf = r#"<robot name="two">
        <link name="near"><collision><geometry><capsule radius="0.01" length="0.05"/></geometry></collision></link>
        <link name="far"><collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
        <link name="bare"/>
        <joint name="a" type="fixed"><parent link="near"/><child link="far"/><origin xyz="0.1 0 0"/></joint>
        <joint name="b" type="fixed"><parent link="near"/><child link="bare"/></joint></robot>"#;
    let robot = Robot::from_urdf("two.urdf", urdf, &[]).expect("valid robot");
    let mut root_from_link = Vec::new();
    robot.forward_kinematics(&[], &mut root_from_link);
    let base_from_object = Isometry3::translation(-0.1, 0.0, 0.0);
    let object = new(&sphere(0.05));
    let clearance = LinkClearance::new(&robot);
    let (link, distance) =
        clearance.nearest_link_m(&root_from_link, &base_from_object, &object, |_| true).expect("two bodies");
    assert_eq!(robot.links[link].name, "near");
    assert!((distance - 0.04).abs() < 1e-6, "{distance}");
    let far = robot.link_index("far").expect("far");
    let (link, distance) = clearance
        .nearest_link_m(&root_from_link, &base_from_object, &object, |link| link == far)
        .expect("a body");
    assert_eq!(link, far);
    assert!((distance - 0.14).abs() < 1e-6, "{distance}");
    let bare = robot.link_index("bare").expect("bare");
    assert_eq!(
        clearance.nearest_link_m(&root_from_link, &base_from_object, &object, |link| link == bare),
        None
    );
    let object_from_link = base_from_object.inverse() * root_from_link[bare];
    assert_eq!(clearance.link_clearance_m(bare, &object_from_link, &object), f64::INFINITY);
}

#[test]
fn link_inside_a_mesh_is_not_clear() {
    let (vertices, triangles) = sphere_mesh(3);
    let object = new(&ObjectShape::Mesh { vertices, triangles });
    let clearance = LinkClearance::new(&robot(r#"<box size="0.02 0.01 0.01"/>"#));
    let depth = clearance.link_clearance_m(0, &Isometry3::identity(), &object);
    assert!(depth < -0.049, "{depth}");
}

#[test]
fn unusable_shapes_say_why() {
    let refusal = |shape: ObjectShape| SignedDistance::new(&shape).expect_err("must be refused");
    let corners = box_corners();
    let mesh = |triangles: &[[u32; 3]]| ObjectShape::Mesh {
        vertices: corners.clone(),
        triangles: triangles.to_vec(),
    };
    assert!(refusal(sphere(-1.0)).contains("sphere radius [-1.0] must be finite and positive"));
    assert!(refusal(sphere(f64::NAN)).contains("sphere radius"));
    assert!(refusal(ObjectShape::Box { size_m: [1.0, 0.0, 1.0] }).contains("box size"));
    assert!(refusal(ObjectShape::Cylinder { radius_m: 0.1, height_m: 0.0 }).contains("cylinder"));
    assert!(refusal(mesh(&BOX_TRIANGLES[1..])).contains("mesh is open at the edge from"));
    assert!(refusal(mesh(&BOX_TRIANGLES.map(|[a, b, c]| [a, c, b]))).contains("inside out"));
    let mut one_flipped = BOX_TRIANGLES;
    one_flipped[4].swap(0, 1);
    assert!(refusal(mesh(&one_flipped)).contains("flipped"));
    assert!(refusal(mesh(&[])).contains("no triangles"));
    assert!(refusal(mesh(&[[0, 1, 8]])).contains("triangle 0 names vertices [0, 1, 8], but there are 8"));
    assert!(refusal(mesh(&[[0, 1, 1]])).contains("triangle 0 has no area"));
    let mut broken = corners.clone();
    broken[3].y = f64::INFINITY;
    let message = refusal(ObjectShape::Mesh { vertices: broken, triangles: BOX_TRIANGLES.to_vec() });
    assert!(message.contains("vertex 3"), "{message}");
    let flat = corners.iter().map(|p| Point3::new(p.x, p.y, 0.0)).collect();
    let message = refusal(ObjectShape::ConvexParts { parts: vec![corners.clone(), flat] });
    assert!(message.contains("convex part 1: its points lie in one plane"), "{message}");
    assert!(refusal(ObjectShape::ConvexParts { parts: vec![] }).contains("no parts"));
    let bad_part = ObjectShape::Compound { parts: vec![(Isometry3::identity(), sphere(0.0))] };
    assert!(refusal(bad_part).contains("part 0: sphere radius"));
    let lost =
        ObjectShape::Compound { parts: vec![(Isometry3::translation(f64::NAN, 0.0, 0.0), sphere(0.1))] };
    assert!(refusal(lost).contains("part 0: its pose"));
}
