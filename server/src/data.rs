//! The data folder: sessions, models, objects, runs and imports, as plain files.

pub(crate) mod archive;
pub mod bars;
pub(crate) mod cache;
pub mod files;
pub(crate) mod index;
pub mod library;
pub mod new_station;
pub(crate) mod objects;
pub(crate) mod store;
pub(crate) mod upload;

pub use index::{IndexReport, rebuild_index};
pub use store::Store;
