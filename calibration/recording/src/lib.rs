//! Takes and sessions: MCAP in and out, CSV import, checks.
//!
//! A take is one MCAP file: joint states and tactile streams at their own rates, with device and host time, markers,
//! and the station's texts attached ([`TakeWriter`], [`Take`]). A session is a folder of takes with a `session.toml`
//! ([`Session`]).

mod check;
mod error;
pub mod import;
mod session;
mod station_io;
mod take;
mod writer;

pub use check::check_session;
pub use error::RecordingError;
pub use session::{Session, SessionFile, SessionTake};
pub use station_io::load_station;
pub use take::{JointLog, Span, SpanKind, StreamLog, Take, TakeMeta};
pub use writer::{TakeWriter, TactileSampleRef};
