//! Jobs as real processes, with studios that are killed.
#![expect(clippy::unwrap_used, reason = "helpers of tests stop at what they do not expect, as tests do")]

mod killed;
mod processes;
mod slurm;
mod support;
