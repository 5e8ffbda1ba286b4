//! Takes and sessions: MCAP in and out, CSV import, checks.
//!
//! A take is one MCAP file: joint states and tactile streams at their own rates, with device and host time, markers,
//! and the station's texts attached ([`TakeWriter`], [`Take`]). A session is a folder of takes with a `session.toml`
//! ([`Session`]), and appears on disk whole or not at all ([`SessionDraft`]). [`import`] turns CSV files into a session,
//! [`check_session`] says what a session is good for.
//!
//! | topic | schema | holds |
//! |---|---|---|
//! | `/joint_states` | `foxglove.JointStates` | measured joint positions, in the station's order |
//! | `/joint_commands` | `foxglove.JointStates` | commanded positions, where there were any |
//! | `/object_pose` | `foxglove.PoseInFrame` | where the object is, of one that moves |
//! | `/tactile/<stream>` | `palpate.TactileSample` | raw readings and activations of a stream of the layout |
//! | `/tactile_axes/<stream>` | `palpate.TactileAxes` | what the axes of its taxels measured, where they have several |
//! | `/markers` | `palpate.Marker` | baseline, repetitions, notes |
//! | `/log` | `foxglove.Log` | lines for people |
//!
//! While hardware is recorded, [`LiveTake`] writes takes that survive the process, and a [`GrowingSession`] is a session
//! whose takes are accepted or set aside one by one; what only the recording needs lies in its `recording.toml`
//! ([`RecordingFile`]).
//!
//! All messages are protobuf. A message's log time is the host's, its publish time the device's own where the device
//! gives one. The station's files are attached under the names the station file uses, the station file itself as
//! `station.toml`; what the take is about is the metadata record `palpate.take`. Chunks are compressed with zstd.
//!
//! What is read is checked when it is read, so that later stages can index without looking: times increase, numbers are
//! finite, each sample has its stream's channels. Nothing here repairs data; [`Take::recover`] says what it left out, and
//! [`close_partial`] gives a take that was cut off an end.

mod axes;
mod check;
mod decode;
mod error;
pub mod files;
mod format;
mod growing;
pub mod import;
mod live;
mod object_poses;
mod plausible;
mod repair;
mod servo_log;
mod session;
mod station_io;
mod take;
mod writer;

pub use check::check_session;
pub use error::RecordingError;
pub use files::replace_file;
pub use growing::{
    GrowingSession, PlannedStep, RecordedTake, RecordingFile, SessionHold, SessionPlan, TakeEnd, TakeState,
};
pub use live::LiveTake;
pub use repair::{Closed, close_partial};
pub use servo_log::{RegisterUnits, ServoLog};
pub use session::{Session, SessionDraft, SessionFile, SessionTake};
pub use station_io::load_station;
pub use take::{AxesLog, JointLog, PoseLog, Recovered, Reference, Span, SpanKind, StreamLog, Take, TakeMeta};
pub use writer::{LogLevel, TactileSampleRef, TakeWriter};
