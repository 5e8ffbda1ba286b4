//! Runs a station: devices, safety layer, recording, guided sessions and the live twin.
#![cfg_attr(not(test), expect(dead_code, reason = "the loop that uses these modules comes next"))]

mod joints;
mod latency;
mod rates;
mod round;
mod streams;
