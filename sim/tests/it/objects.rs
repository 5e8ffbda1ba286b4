//! The shipped objects as bodies: signed distance, mass and poses at rest.

use std::{fs, path::PathBuf};

use nalgebra::{Point3, Vector3};
use palpate_robot_model::ObjectModel;
use palpate_sim::{
    body::{MassProperties, Solid},
    geometry::SignedDistance,
};

/// Every shipped object.
fn shipped() -> Vec<ObjectModel> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../assets/objects");
    let mut paths: Vec<PathBuf> =
        fs::read_dir(&folder).expect("assets/objects").map(|entry| entry.expect("an entry").path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    paths.sort();
    let object = |path: &PathBuf| {
        let text = fs::read_to_string(path).expect("a text");
        let read_mesh = |mesh: &str| fs::read(folder.join(mesh)).map_err(|err| err.to_string());
        ObjectModel::from_toml(&path.display().to_string(), &text, read_mesh)
            .unwrap_or_else(|err| panic!("{err}"))
    };
    paths.iter().map(object).collect()
}

fn solid(object: &ObjectModel) -> Solid {
    Solid::new(&object.shape).unwrap_or_else(|problem| panic!("{}: {problem}", object.id))
}

#[test]
fn benchmark_objects_fit_a_hand() {
    for object in shipped().iter().filter(|object| object.group.is_some()) {
        let largest_m = solid(object).size_m().into_iter().fold(0.0, f64::max);
        assert!((0.04..=0.08 + 1e-9).contains(&largest_m), "{} is {largest_m} m long", object.id);
        let mass = MassProperties::of(object).expect("a mass");
        assert!((0.02..0.15).contains(&mass.mass_kg), "{} weighs {} kg", object.id, mass.mass_kg);
        let eigenvalues = mass.inertia_kg_m2.symmetric_eigenvalues();
        let [a, b, c] = [eigenvalues[0], eigenvalues[1], eigenvalues[2]];
        assert!(a > 0.0 && b > 0.0 && c > 0.0 && a + b >= c && b + c >= a && a + c >= b, "{}", object.id);
    }
}

#[test]
fn volume_and_centre_agree_with_the_signed_distance() {
    const CELLS: usize = 60;
    for object in shipped() {
        let solid = solid(&object);
        let distance = SignedDistance::new(&object.shape).expect("a signed distance");
        let [low, high] = solid.bounds_m().map(Point3::from);
        // Beyond the bounds nothing is inside.
        let step = (high - low) / CELLS as f64;
        let (mut inside, mut sum) = (0_usize, Vector3::zeros());
        for i in 0..CELLS.pow(3) {
            let cell = [i / CELLS.pow(2), i / CELLS % CELLS, i % CELLS].map(|i| i as f64 + 0.5);
            let p = low + step.component_mul(&Vector3::from(cell));
            if distance.distance_below_m(&p, 1e-9) < 0.0 {
                inside += 1;
                sum += p.coords;
            }
        }
        let volume = inside as f64 * step.product();
        let error = (volume - solid.volume_m3()).abs() / solid.volume_m3();
        assert!(error < 0.02, "{}: {volume} by cells, {} by parts", object.id, solid.volume_m3());
        let apart_m = (Point3::from(sum / inside as f64) - solid.centroid_in_object()).norm();
        assert!(apart_m < 5e-4, "{}: centres are {apart_m} m apart", object.id);
    }
}

#[test]
fn every_shipped_object_rests_in_the_poses_one_would_expect() {
    let expected = [
        ("ball", 1),
        ("big_egg", 1),
        ("box", 6),
        ("c_shape", 4),
        ("cross", 10),
        ("cube", 6),
        ("cubeball", 5),
        ("cylinder", 3),
        ("e_shape", 6),
        ("egg", 1),
        ("fork", 6),
        ("h_shape", 6),
        ("hash", 10),
        ("hollow_cube", 6),
        ("hourglass", 3),
        ("ring", 3),
        ("snowman", 1),
        ("t_shape", 6),
        ("tetrahedral", 4),
        ("triple", 2),
    ];
    let objects = shipped();
    let benchmark = objects.iter().filter(|object| object.group.is_some());
    let found: Vec<(&str, usize)> = benchmark
        .map(|object| (object.id.as_str(), solid(object).rest_poses().expect("poses").len()))
        .collect();
    assert_eq!(found, expected);
}

#[test]
fn a_resting_object_touches_the_table_and_does_not_reach_into_it() {
    for object in shipped() {
        let distance = SignedDistance::new(&object.shape).expect("a signed distance");
        for pose in solid(&object).rest_poses().expect("poses") {
            let table_from_object = pose.at([0.0, 0.0], 0.7);
            let table_m = |x: f64, y: f64, z: f64| {
                distance.distance_m(&table_from_object.inverse_transform_point(&Point3::new(x, y, z)))
            };
            let mut nearest_m = f64::INFINITY;
            for i in 0..121_u32 {
                let [x, y] = [i / 11, i % 11].map(|i| (f64::from(i) - 5.0) * 0.01);
                assert!(table_m(x, y, -1e-6) > 0.0, "{}: {pose:?} is in the table", object.id);
                nearest_m = nearest_m.min(table_m(x, y, 0.0));
            }
            // The points are a centimetre apart, so one is within 7.1 mm of where the object stands.
            assert!(nearest_m < 0.0072, "{}: {pose:?} hovers {nearest_m} m above", object.id);
        }
    }
}
