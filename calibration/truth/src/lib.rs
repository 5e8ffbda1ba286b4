//! The truth world: what emulated stations really feel, with tactile physics of its own, and the sessions it records.
//!
//! [`Truth`] is the file that says what is hidden, [`Emulation`] that file with the station and the plan it names.
//! [`TruthWorld`] is the world, stepped at 1 kHz: springs and dampers for each spot of elastomer, sampled converters,
//! firmware thresholds, transport queues. It shares the robot model and the geometry with `palpate_sim`, never the tactile
//! model: what it hides must not be found by inverting the code that hid it. [`record_session`] moves it through the
//! primitives and writes takes. [`TruthSense`] is its sense of touch alone, for a robot and an object that another simulator
//! moves.

pub mod actuator;
mod bench;
mod hidden;
mod motion;
mod noise;
mod secrets;
mod session;
mod stage;
mod truth;
mod world;

pub use bench::{Case, Expected, Strength, cases};
pub use hidden::Hidden;
pub use session::{EmulationError, record_session};
pub use stage::Stage;
pub use truth::{Elastomer, Emulation, FrontEnd, JointTruth, MountOffset, StreamTruth, Truth};
pub use world::{Arrival, Event, Placed, Resistance, TruthSense, TruthTouch, TruthWorld};
