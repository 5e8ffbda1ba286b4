//! The shipped objects: the calibration objects and the twenty of the grasping benchmark.

use std::{collections::BTreeMap, fs};

use palpate_robot_model::{ObjectGroup, ObjectModel};

use crate::repository;

fn shipped() -> BTreeMap<String, ObjectModel> {
    let folder = repository().join("assets/objects");
    let mut objects = BTreeMap::new();
    for entry in fs::read_dir(&folder).expect("assets/objects") {
        let path = entry.expect("an entry").path();
        let Some(file) =
            path.file_name().and_then(|name| name.to_str()).filter(|name| name.ends_with(".toml"))
        else {
            continue;
        };
        let text = fs::read_to_string(&path).expect("a text");
        let read_mesh = |mesh: &str| fs::read(folder.join(mesh)).map_err(|err| err.to_string());
        let object = ObjectModel::from_toml(file, &text, read_mesh).unwrap_or_else(|err| panic!("{err}"));
        assert_eq!(format!("{}.toml", object.id), file, "a file is called as its object");
        objects.insert(object.id.clone(), object);
    }
    objects
}

#[test]
fn the_benchmark_has_its_ten_seen_and_ten_unseen_objects() {
    let objects = shipped();
    let of = |group| -> Vec<&str> {
        let grouped = objects.values().filter(|object| object.group == Some(group));
        grouped.map(|object| object.id.as_str()).collect()
    };
    assert_eq!(
        of(ObjectGroup::Seen),
        ["ball", "big_egg", "box", "cross", "cube", "cubeball", "egg", "h_shape", "hollow_cube", "hourglass",]
    );
    assert_eq!(
        of(ObjectGroup::Unseen),
        [
            "c_shape",
            "cylinder",
            "e_shape",
            "fork",
            "hash",
            "ring",
            "snowman",
            "t_shape",
            "tetrahedral",
            "triple",
        ]
    );
}

#[test]
fn every_benchmark_object_has_a_density_and_convex_parts() {
    for object in shipped().values().filter(|object| object.group.is_some()) {
        assert!(object.density_kg_m3.is_some(), "{}", object.id);
        let parts = object.shape.convex_parts().unwrap_or_else(|err| panic!("{}: {err}", object.id));
        assert!(!parts.is_empty(), "{}", object.id);
    }
}
