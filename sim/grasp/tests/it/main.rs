//! The grasp world on the shipped hand: its files, its physics, its touch.

#[cfg(feature = "mujoco")]
mod episodes;
mod files;
mod learning;
#[cfg(feature = "mujoco")]
mod physics;
mod scripts;
mod search;
mod tuning;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use palpate_grasp::GraspConfig;
use palpate_robot_model::{ObjectModel, Station};

fn assets() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets")
}

fn text(path: &str) -> String {
    std::fs::read_to_string(assets().join(path)).unwrap_or_else(|err| panic!("{path}: {err}"))
}

fn station() -> Arc<Station> {
    let read =
        |path: &str| std::fs::read(assets().join("stations").join(path)).map_err(|err| err.to_string());
    Arc::new(Station::read("xarm6_leap.toml", read).expect("the shipped station is valid"))
}

const WORLD: &str = "grasp/xarm6_leap.toml";

fn config(station: &Station) -> GraspConfig {
    GraspConfig::from_toml(WORLD, &text(WORLD), &station.robot).unwrap_or_else(|err| panic!("{err}"))
}

fn object(id: &str) -> ObjectModel {
    let path = format!("objects/{id}.toml");
    ObjectModel::from_toml(&path, &text(&path), |mesh| Err(format!("no {mesh}"))).expect("a shipped object")
}
