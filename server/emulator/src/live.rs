//! The emulated station in real time.

use std::path::Path;

use palpate_robot_model::Station;

use crate::EmulationError;

/// The emulated station, going through its primitives for ever.
pub struct LiveStation {}

/// The state of a live station at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveSample {
    /// Since the station started, s.
    pub time_s: f64,
    /// Measured joint positions, one per degree of freedom.
    pub positions: Vec<f64>,
    /// One per channel.
    pub active: Vec<bool>,
    /// Raw readings less their reference, one per channel.
    pub raw: Vec<f32>,
    /// What it is doing, for people.
    pub activity: String,
    /// Object in place: id, and pose in the base frame.
    pub object: Option<(String, nalgebra::Isometry3<f64>)>,
    /// Samples taken so far: joints, then each stream of the layout.
    pub samples: Vec<u64>,
}

impl LiveStation {
    /// Prepares the station of the truth file at `truth_path`.
    pub fn new(truth_path: &Path, seed: u64) -> Result<Self, EmulationError> {
        let _ = (truth_path, seed);
        todo!()
    }

    /// The station.
    pub fn station(&self) -> &Station {
        todo!()
    }

    /// Steps the world by `dt_secs` (at most a second) and gives the newest state.
    pub fn advance(&mut self, dt_secs: f64) -> LiveSample {
        let _ = dt_secs;
        todo!()
    }
}
