//! Learning in small worlds, and the laws of checkpoints.

mod checkpoints;
mod learning;
mod refusals;
mod worlds;
