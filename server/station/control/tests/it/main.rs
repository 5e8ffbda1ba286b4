//! The control loop before the emulated station, with real threads, ports and bytes. What is asserted is asserted in the
//! station's own time: a slow machine makes these tests slow, not red.

mod bench;
mod devices;
mod free_takes;
mod reflex;
mod safety;
mod session;
mod teleoperation;
mod twin;
