//! The data folder: sessions, models, objects, runs and imports, as plain files.

pub mod bars;
pub(crate) mod cache;
pub mod files;
pub mod library;
pub(crate) mod objects;
pub(crate) mod store;
pub(crate) mod upload;

pub use store::Store;
