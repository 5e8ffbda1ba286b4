//! Parts of a station by name.

use serde::{Deserialize, Serialize};

/// A part of a station, or several, by id: where an effect acts, or where simulation and measurement disagree.
///
/// In JSON and TOML one key says what it is: `{"stream": "fsr"}`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Place {
    /// All channels of a stream, by its id.
    Stream(String),
    /// One patch, by its id.
    Patch(String),
    /// One channel, by its id.
    Channel(String),
    /// Several channels, by their ids, in an order that the context gives meaning to.
    Channels(Vec<String>),
    /// One joint, by its name.
    Joint(String),
    /// A group of patches, such as a finger.
    Group(String),
    /// Several groups.
    Groups(Vec<String>),
    /// One object, by its id.
    Object(String),
}
