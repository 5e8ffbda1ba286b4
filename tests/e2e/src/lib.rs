//! The whole system from outside: the built binary, a real browser, other people's readers.
//!
//! [`Tools`] says where `cargo xtask test` put everything; [`Studio`] is a running studio and [`Devices`] are emulated
//! devices, both of which end with their owner.

mod devices;
mod studio;
mod tools;

pub use devices::Devices;
pub use studio::Studio;
pub use tools::{Tools, demo_session, root, run_json};
