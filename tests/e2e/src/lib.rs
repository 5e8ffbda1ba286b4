//! The whole system from outside: the built binary, a real browser, other people's readers.
//!
//! [`Tools`] says where `cargo xtask test` put everything; [`Studio`] is a running studio, [`Devices`] are emulated
//! devices in a process of their own, and a [`Bench`] is emulated devices that a test can look into. All end with their
//! owner. A [`Board`] is a single tactile board that
//! knows when its bytes left. An [`Operator`] sits at a studio's command socket as a page does.

mod bench;
mod board;
mod devices;
mod operator;
mod studio;
mod tools;
mod turn;

pub use bench::{Bench, MS, still_from_ns};
pub use board::Board;
pub use devices::Devices;
pub use operator::{Operator, Watcher, targets};
pub use studio::{Studio, read_status};
pub use tools::{Tools, demo_session, root, run_json};
pub use turn::{Turn, alone, beside_a_station, together};
