//! Whole-system tests; see the crate's documentation.

mod calibration;
mod devices;
mod devices_check;
mod faults;
mod page;
mod probe_bench;
mod takes;
