//! Laws of replay and tactile model on a small made-up probe.

mod effects;
mod live;
mod moving;
mod objects;
mod probe;
mod replay;
mod tactile;
