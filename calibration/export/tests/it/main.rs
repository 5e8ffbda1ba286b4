//! Data sets on disk, read again by the Parquet library.
#![expect(clippy::unwrap_used, reason = "helpers of tests stop at what they do not expect, as tests do")]

mod lerobot;
mod refusals;
mod support;
