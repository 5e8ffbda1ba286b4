//! The library of effects, on takes of the shipped hand.

mod laws;
mod recover;
pub(crate) mod scene;
