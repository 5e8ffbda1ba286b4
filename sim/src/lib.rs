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
mod response;
mod sensor_model;
pub mod tactile;
mod theta;
pub mod vectors;

pub use replay::MOST_SOFTNESS_M;
pub use response::Response;
pub use sensor_model::{SensorModel, SensorModelError};
pub use theta::{StreamTheta, Theta, Thetas};
