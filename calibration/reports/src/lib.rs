//! What checks, calibrations and diagnoses found, as the JSON of the HTTP API and of the command line.
//!
//! [`wording`] says in words what the documents hold. Pure; runs in the browser.

mod calibration;
mod check;
mod contact_map;
mod diagnosis;
pub mod wording;

pub use calibration::*;
pub use check::*;
pub use contact_map::*;
pub use diagnosis::*;
