//! The live station that the studio runs: its devices, its control loop, and the live twin beside it.

mod emulated_devices;
mod live;

pub use emulated_devices::EmulatedDevices;
pub(crate) use live::Live;
pub use live::{LiveStation, RunningStation};
