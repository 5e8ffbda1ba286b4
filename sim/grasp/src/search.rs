//! A search by touch: tries to grasp at one place after the other, and keeps a belief about where the object is.
//!
//! [`Skill`] is how to try once, with every place that the hand can be brought to. [`Closings`] is what trying has been like
//! in simulation; [`Experience`] makes of it what a try at some place would feel like and how likely it is to succeed.
//! [`Belief`] is a distribution over shape and place of the object, and [`Searcher`] the controller that acts on it: the
//! place where success is likeliest, a closing that waits for the opposing digits at the first contact, and then, by what
//! was felt, the lift or another place. What it uses a robot has: commands, joint readings, touch and the time.
//!
//! Simulating closings needs the feature `mujoco`: [`simulate()`]. Nothing else here needs physics, and nothing draws a random
//! number.

mod belief;
mod config;
mod experience;
mod felt;
mod searcher;
#[cfg(feature = "mujoco")]
mod simulate;
mod skill;

pub use belief::{Attempt, Belief, Moment};
pub use config::SearchConfig;
pub use experience::{Closing, Closings, Experience, Senses};
pub use felt::Felt;
pub use searcher::{Prior, Searcher};
#[cfg(feature = "mujoco")]
pub use simulate::simulate;
pub use skill::{Place, Skill};

#[cfg(test)]
mod tests;
