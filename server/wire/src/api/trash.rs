//! The trash: what was deleted and can be taken out again.

use serde::{Deserialize, Serialize};

/// An entry of `GET /api/v1/trash`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct TrashEntry {
    /// What it is.
    pub sort: TrashSort,
    /// Its id, as `POST /api/v1/sessions/{session}/restore` and `POST /api/v1/models/{model}/restore` want it.
    pub id: String,
    /// When it was deleted, RFC 3339.
    pub deleted: String,
}

/// What lies in the trash.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum TrashSort {
    /// A session with its takes.
    Session,
    /// A saved sensor model.
    Model,
}
