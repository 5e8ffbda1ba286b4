//! The documents of `docs/`, which the program carries.

use serde::{Deserialize, Serialize};

/// An entry of `GET /api/v1/docs`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct DocSummary {
    /// Its name, as `GET /api/v1/docs/{doc}` wants it, e.g. `learning`.
    pub name: String,
    /// Its first heading.
    pub title: String,
    /// The first sentence below that, without the marks of Markdown.
    pub sentence: String,
}
