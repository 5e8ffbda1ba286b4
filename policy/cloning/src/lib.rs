//! Policies that imitate an expert: regression (behaviour cloning), diffusion (Chi et al. 2023) and action chunking with
//! Transformers (Zhao et al. 2023).
//!
//! A policy sees a window of what the robot knew lately ([`History`]) and predicts a chunk of the next commands, of
//! which it carries out a few before it looks again. [`Episodes`] are what an expert did; [`CloneConfig`] is the file
//! that says how to learn; [`Trainer`] learns, [`train`] does that in a folder with checkpoints and metrics; [`Cloned`]
//! is the policy that comes out.
//!
//! Actions are differences to the last *command* and not to the measured position: gravity and contact would otherwise
//! take a part of every action away. Commands are part of what is seen. A configuration may say otherwise of both
//! ([`JointValues`]). So may be features that a pretrained encoder makes of
//! each moment: here they are numbers, and the encoder is a file ([`EncoderFile`]) that goes where the policy goes.
//!
//! The same seed gives the same bits for any number of threads on one kind of processor: batches are cut into chunks of
//! fixed size whose gradients are added in order. On a graphics card (feature `gpu`) a training
//! gets other bits. Nothing here knows a robot or a simulator.

mod act;
mod cloned;
mod config;
mod device;
mod episodes;
mod error;
mod file;
mod gru;
mod history;
mod network;
mod pass;
mod policies;
mod run;
mod scaling;
mod schedule;
mod trainer;

pub use cloned::{Cloned, Plan, Robot, Run};
pub use config::{
    ActConfig, ActLoss, CloneConfig, DiffusionConfig, Head, JointValues, Memory, ObservationConfig, Predicts,
    RecurrentConfig,
};
pub use device::TrainingDevice;
pub use episodes::{EncoderFile, Episode, Episodes, Step};
pub use error::CloneError;
pub use file::POLICY_FILE;
pub use history::{History, Moment, Shape, Touch};
pub use palpate_training::{CHECKPOINT_FILE, Finish, METRICS_FILE, Progress, Start};
pub use policies::PaperPolicy;
pub use run::{CONFIG_FILE, Data, train};
pub use trainer::Trainer;
