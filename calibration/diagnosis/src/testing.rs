//! Emulated sessions for tests.

use std::path::Path;

use palpate_recording::Take;
use palpate_sim::SensorModel;
use palpate_truth::Stage;

/// An emulated session, and what its station is told of its sensors.
pub(crate) struct Session {
    pub(crate) stage: Stage,
    pub(crate) takes: Vec<Take>,
    pub(crate) nominal: SensorModel,
}

/// What the shipped truth `name` records with seed 1.
pub(crate) fn session(name: &str) -> Session {
    let truth = format!("{}/../../assets/truth/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let stage = Stage::read(Path::new(&truth)).unwrap();
    let takes = stage.record(&[], 1).unwrap();
    let nominal = SensorModel::from_toml("nominal", &stage.station().nominal_model_toml).unwrap();
    Session { stage, takes, nominal }
}
