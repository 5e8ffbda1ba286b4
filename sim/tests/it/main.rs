//! Laws of replay and tactile model on a small made-up probe.

mod probe;
mod replay;
mod tactile;
