//! The grasp world: robot, table and object in MuJoCo, felt through the tactile model of calibration.
//!
//! [`GraspConfig`] is the file that says what the robot's own file leaves open (servos, friction, table, task);
//! [`scene::mjcf`] turns both and an object into the text that MuJoCo loads. With the `mujoco` feature, [`World`] is the
//! physics, [`GraspEnv`] an environment whose observations are joint positions, targets and touch, [`GraspBatch`] many
//! of them on every core, and [`trial`] the grasping task with its verdicts. [`Protocol`] says in which trials policies are
//! compared. [`tune`] makes scripts better by trial, [`search`] is an expert that looks for the object by touch, [`learn`] the
//! task with actions, observations and rewards for whoever learns.
//!
//! Touch is not computed here: [`touch::Sense`] gives it, as a rule a sensor model, whose readings are those of replays
//! ([`palpate_sim::live`]). Nothing here reads a clock or a file, trains a network, or knows a particular robot.

mod config;
pub mod controller;
mod error;
mod hand;
pub mod learn;
mod protocol;
mod randomisation;
pub mod scene;
mod script;
pub mod search;
pub mod tune;

#[cfg(feature = "mujoco")]
mod batch;
#[cfg(feature = "mujoco")]
mod env;
#[cfg(feature = "mujoco")]
pub mod touch;
#[cfg(feature = "mujoco")]
pub mod trial;
#[cfg(feature = "mujoco")]
mod world;

pub use config::{
    FrictionConfig, GraspConfig, LinkFriction, PhysicsConfig, RandomisationConfig, ServoConfig, TableConfig,
    TaskConfig,
};
pub use controller::Observation;
pub use error::GraspError;
pub use protocol::Protocol;
pub use randomisation::Randomisation;
pub use script::{Again, Script, ScriptKey, ScriptRun, Sensed};

#[cfg(feature = "mujoco")]
pub use {
    batch::GraspBatch,
    env::{GraspEnv, GraspScene, Start},
    world::{Contacts, World},
};
