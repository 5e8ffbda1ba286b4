//! Objects: what is touched and grasped.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// An entry of `GET /api/v1/objects`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ObjectEntry {
    /// Id; the name of its file where that cannot be read.
    pub id: String,
    /// Whether it comes from the data folder, as opposed to the binary.
    pub own: bool,
    /// What it is, or why it cannot be used.
    #[cfg_attr(feature = "openapi", schema(value_type = ObjectContent))]
    pub content: Result<ObjectDocument, String>,
    /// Takes that touched it.
    pub takes: Vec<ObjectTake>,
}

/// What an object is, or why it cannot be used, as `serde` writes a `Result`.
#[cfg(feature = "openapi")]
#[derive(utoipa::ToSchema)]
#[expect(dead_code, reason = "its form is all that is asked of it")]
enum ObjectContent {
    /// What it is.
    Ok(ObjectDocument),
    /// Why it cannot be used.
    Err(String),
}

/// An object that can be used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ObjectDocument {
    /// Name for people.
    pub label: String,
    /// `seen` or `unseen`, for objects of a benchmark.
    pub group: Option<String>,
    /// Edges of the box along its axes that just holds it, m.
    pub size_m: [f64; 3],
    /// Volume, m^3.
    pub volume_m3: f64,
    /// Mass, kg, where its file gives a density.
    pub mass_kg: Option<f64>,
    /// Centre of mass in its frame, m.
    pub com_m: [f64; 3],
    /// How it rests on a table, likeliest first.
    pub rest_poses: Vec<RestPoseDocument>,
    /// Its file, which the page parses with `palpate_robot_model` to draw it.
    pub object_toml: String,
    /// Meshes that the file names, by the name it uses; bytes as base64.
    pub meshes_base64: BTreeMap<String, String>,
}

/// A stable pose on a table, up to place and yaw.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RestPoseDocument {
    /// Turns the object's axes into the table's, whose z points up: w, x, y, z.
    pub quaternion_wxyz: [f64; 4],
    /// Height of the object's origin above the table, m.
    pub origin_height_m: f64,
    /// Height of the centre of mass above the table, m.
    pub com_height_m: f64,
    /// Share of slow drops that end here.
    pub weight: f64,
    /// How far the centre of mass must rise to tip into another pose, m; `None` for an only pose.
    pub barrier_m: Option<f64>,
}

/// A take that touched an object.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ObjectTake {
    /// Session id.
    pub session: String,
    /// Take id.
    pub take: String,
}
