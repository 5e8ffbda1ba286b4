//! Whole-system tests; see the crate's documentation.

mod api;
mod byte_to_pixel;
mod calibration;
mod devices;
mod devices_check;
mod ending;
mod faults;
mod flipped_bits;
mod flood;
mod full_disk;
mod live_clients;
mod page;
mod probe_bench;
mod python_client;
mod rollouts;
mod scene;
mod takes;
mod unplugging;
