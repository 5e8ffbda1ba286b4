//! The emulated station: a truth world with its own tactile physics, and the sessions it records.
//!
//! [`Truth`] is the file that says what is hidden; [`TruthWorld`] is the world, stepped at 1 kHz: springs and dampers for
//! each spot of elastomer, sampled converters, firmware thresholds, transport queues. It shares the robot model and the
//! geometry with `palpate_sim`, never the tactile model: what it hides must not be found by inverting the code that hid it.
//! [`record_session`] moves it through the primitives and writes takes. [`TruthSense`] is its sense of touch alone, for a
//! robot and an object that another simulator moves. [`devices`] are the station's servos, arm and tactile boards in the
//! bytes of the real ones.

pub mod actuator;
mod bench;
pub mod devices;
mod hidden;
mod motion;
mod secrets;
mod session;
mod stage;
mod truth;
mod world;

pub use bench::{Case, Expected, Strength, cases};
pub use hidden::Hidden;
pub use session::{EmulationError, record_session};
pub use stage::Stage;
pub use truth::{Elastomer, FrontEnd, JointTruth, MountOffset, StreamTruth, Truth};
pub use world::{TruthSense, TruthTouch, TruthWorld};
