//! Laws of replay and tactile model on a small made-up probe.

mod effects;
mod probe;
mod replay;
mod tactile;
