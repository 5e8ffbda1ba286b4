//! The live station as one document, for scripts that want to look rather than listen.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// `GET /api/v1/live`: the newest state of the live station.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct LiveDocument {
    /// Seconds since the station started.
    pub time_s: f64,
    /// Measured joint positions by name, rad or m.
    pub joints: BTreeMap<String, f64>,
    /// Commanded joint positions by name, rad or m; empty while disarmed.
    pub commanded: BTreeMap<String, f64>,
    /// Channels that feel something, by id.
    pub active: Vec<String>,
    /// `disarmed`, `arming`, `armed`, `holding`, `disarming` or `stopped`.
    pub phase: String,
    /// Why it holds, stopped or cannot be armed; empty when all is well.
    pub reason: String,
    /// Who holds the lease; empty for nobody.
    pub holder: String,
    /// Whether a stop is confirmed by telemetry.
    pub stop_confirmed: bool,
    /// Rate of the control loop over the last second, its mean and that of its worst second, Hz.
    pub loop_hz: [f64; 3],
    /// From a device's byte to the stream, ms: the newest, and the 95th percentile of the last ten seconds.
    pub latency_ms: [f64; 2],
    /// The devices.
    pub devices: Vec<LiveDevice>,
}

/// A device of a live station.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct LiveDevice {
    /// Id in the station's file.
    pub id: String,
    /// `connecting`, `ready`, `fault` or `lost`.
    pub link: String,
    /// What is wrong and what to do; empty when all is well.
    pub problem: String,
    /// Samples per second: over the last second, mean, and of the worst second, Hz.
    pub rate_hz: [f64; 3],
    /// Samples that did not come in time.
    pub gaps: u64,
    /// Frames dropped for a bad checksum or form.
    pub bad_frames: u64,
    /// Times connected again.
    pub reconnects: u64,
}

/// Body of `POST /api/v1/emulator/object`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PlaceObject {
    /// Object id of the station; nothing stands there without one.
    pub object: Option<String>,
}

/// Body of `PUT /api/v1/live/model`: the sensor model that the live twin simulates with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct LiveModel {
    /// Id of a saved model, or `nominal` for the station's own.
    pub model: String,
}
