//! The simulator's touch: geometry of contact, the paper's tactile model, and replay of recorded joint paths.
//!
//! The main entry is [`replay::contact_trace`], which reduces a joint path and a touched object to the signals that do not
//! depend on the sensor model's parameters; [`tactile`] turns those into readings for any [`SensorModel`]. [`live`] does
//! both frame by frame, while things move. Nothing here reads a clock or a file; with the `batch` feature a replay uses
//! every core and gives the same bits.

pub mod actuator;
pub mod body;
pub mod effects;
pub mod geometry;
pub mod job;
pub mod live;
mod parallel;
pub mod replay;
mod sensor_model;
pub mod tactile;

pub use sensor_model::{
    MOST_SOFTNESS_M, Response, SensorModel, SensorModelError, StreamTheta, Theta, Thetas,
};
