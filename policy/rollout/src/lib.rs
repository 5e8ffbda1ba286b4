//! A policy on a hand: a client of a studio like any page, in a process of its own.
//!
//! [`run()`] takes control through the command socket, sends heartbeats and targets, reads the live stream, and runs trials
//! of a [`policy`]. The safety layer knows no exception for it; a rollout that dies, freezes or misbehaves ends as a page
//! does that does the same. What the policy saw and wanted, what the safety layer let through and what happened is
//! [recorded](record), and a [verdict] is suggested from what the robot itself felt. Observations and targets are made by
//! [`palpate_grasp::learn::ActorState`], as in training.
//!
//! Nothing here simulates: it needs no physics library, and the server needs nothing of it.

mod args;
mod attempt;
mod campaign;
mod command;
#[cfg(feature = "learned")]
pub mod features;
pub mod fit;
mod hand;
pub mod inject;
mod journal;
pub mod link;
pub mod operator;
pub mod outcome;
pub mod policy;
pub mod read;
pub mod record;
pub mod run;
pub mod studio;
mod take;
pub mod task;
pub mod trial;
pub mod verdict;

pub use args::RolloutArgs;
pub use command::command;
pub use run::run;
pub use take::Recorded;
