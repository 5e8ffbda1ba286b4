//! The data folder: sessions, models, objects, runs and imports, as plain files.

pub(crate) mod archive;
pub mod bars;
pub(crate) mod cache;
pub(crate) mod database;
pub mod files;
pub(crate) mod index;
pub mod library;
pub mod new_station;
pub(crate) mod objects;
mod reindex;
pub(crate) mod store;
pub(crate) mod upload;

pub use reindex::{IndexReport, rebuild_index};
pub use store::Store;
