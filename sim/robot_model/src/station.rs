//! The station file: which robot, layout, objects, streams and limits belong together.

use std::collections::BTreeMap;

use crate::{ModelError, ObjectModel, Robot, TactileLayout};

/// The texts that make up a station, as they are attached to every take.
///
/// Keys of `files` are paths relative to the station file, as the station names them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StationFiles {
    /// The station file itself, TOML.
    pub station_toml: String,
    /// Everything it names: URDF, layout, objects, their meshes, the nominal sensor model.
    pub files: BTreeMap<String, Vec<u8>>,
}

/// A station, read and checked.
#[derive(Clone, Debug)]
pub struct Station {
    /// Stable id, e.g. `xarm6-leap`.
    pub id: String,
    /// Name for people.
    pub label: String,
    /// The robot, degrees of freedom in the station's order.
    pub robot: Robot,
    /// The tactile layout.
    pub layout: TactileLayout,
    /// Nominal rate of the joint log, Hz.
    pub joint_rate_hz: f64,
    /// Which degrees of freedom carry the hand about (the arm), as opposed to those of the hand.
    pub carrier_dofs: Vec<usize>,
    /// Objects this station knows, by id.
    pub objects: BTreeMap<String, ObjectModel>,
    /// How each stream of the layout is read, same order as `layout.streams`.
    pub streams: Vec<StreamConfig>,
    /// The nominal sensor model, TOML (parsed by `palpate_sim`).
    pub nominal_model_toml: String,
    /// The texts it was read from.
    pub files: StationFiles,
}

/// How the readings of one stream become binary.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamConfig {
    /// Id of the stream in the layout.
    pub stream: String,
    /// A channel is active when its reading exceeds its reference value by more than this, raw units.
    pub on_threshold: f64,
    /// And inactive again below this; equal to `on_threshold` where the firmware has no hysteresis.
    pub off_threshold: f64,
    /// Lowest raw reading that the device can give.
    pub raw_min: f64,
    /// Highest raw reading that the device can give.
    pub raw_max: f64,
}

impl Station {
    /// Reads the station file `file` and everything it names through `read_file` (path relative to the station file
    /// -> bytes, or why not), checking every reference between them.
    pub fn read(
        file: &str,
        read_file: impl FnMut(&str) -> Result<Vec<u8>, String>,
    ) -> Result<Self, ModelError> {
        let _ = (file, read_file);
        todo!()
    }

    /// Reads a station from its texts, as attached to a take.
    pub fn from_files(files: StationFiles) -> Result<Self, ModelError> {
        let _ = files;
        todo!()
    }
}
