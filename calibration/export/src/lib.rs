//! Takes and trials as data sets of other programs.
//!
//! [`lerobot::export`] writes a LeRobotDataset v3.0. Its files are copies for training: what was recorded stays in the
//! takes (MCAP) and in the records of trials (JSON lines), and the data set names them with their SHA-256.
//!
//! Every feature is sampled on one clock ([`clock`]), and nothing is taken from the future. Nothing is converted: positions
//! stay rad or m, readings stay in the unit of their stream.

pub mod clock;
mod columns;
mod draft;
mod error;
pub mod lerobot;
mod source;
mod statistics;

pub use error::ExportError;
