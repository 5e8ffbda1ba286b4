//! The shipped stations against published figures and against themselves.

mod bad_input;
mod hardware;
mod kinematics;
mod objects;
mod stations;

use std::path::PathBuf;

use nalgebra::Isometry3;
use palpate_robot_model::{Robot, Station};

fn repository() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// A shipped station, read from disk.
fn station(file: &str) -> Station {
    let folder = repository().join("assets/stations");
    Station::read(file, |path| std::fs::read(folder.join(path)).map_err(|err| err.to_string()))
        .unwrap_or_else(|err| panic!("{err}"))
}

/// `reference_from_link` at the positions that `position` gives by joint name.
fn pose_in(
    robot: &Robot,
    reference: &str,
    link: &str,
    mut position: impl FnMut(&str) -> f64,
) -> Isometry3<f64> {
    let positions: Vec<f64> = robot.dofs().map(|joint| position(&joint.name)).collect();
    let mut root_from_link = Vec::new();
    robot.forward_kinematics(&positions, &mut root_from_link);
    let index = |name: &str| robot.link_index(name).unwrap_or_else(|| panic!("link {name}"));
    root_from_link[index(reference)].inverse() * root_from_link[index(link)]
}
