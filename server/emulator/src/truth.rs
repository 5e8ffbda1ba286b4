//! The truth file.

use serde::{Deserialize, Serialize};

/// What the emulated world is like, and what it hides.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// Version of the format; 1.
    pub format: u32,
    /// Station file, relative to the truth file.
    pub station: String,
}
