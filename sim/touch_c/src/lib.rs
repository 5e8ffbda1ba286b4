//! The sensor model as a library for other languages: what `palpate replay` computes, for programs that simulate or train
//! elsewhere.
//!
//! [`TouchScene`] is a station's robot, an object and a sensor model; [`TouchBatch`] is many environments of it, which feel
//! frame by frame and keep what effects remember. [`ffi`] is both behind a C interface, declared in `palpate_touch.h`; the
//! Python module `palpate.touch` calls it. Nothing here simulates motion or knows a simulator: joint positions and the
//! object's pose come from the caller.

mod batch;
mod describe;
mod error;
pub mod ffi;
mod scene;

pub use batch::TouchBatch;
pub use error::TouchError;
pub use scene::{FixedBody, TouchScene};
