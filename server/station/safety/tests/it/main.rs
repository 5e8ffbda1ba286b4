//! The safety layer as the control loop uses it, with times given to the nanosecond.

mod bench;
mod properties;
mod rules;
mod stops;
