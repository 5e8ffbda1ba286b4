//! Pretraining in a small world, and the laws of its files.

mod checkpoints;
mod learning;
mod world;
