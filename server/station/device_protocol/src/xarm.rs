//! The arm's private TCP protocol (port 502 of the control box) and its report streams (ports 30000 to 30003).
//!
//! Lengths are in m, angles in rad and times in s here; the box counts in mm. Arrays have seven joint slots, as on the
//! line; an arm with fewer axes leaves the last ones zero.
//!
//! TCP neither damages nor loses bytes, and these frames have neither a start mark nor a checksum. A decoder that meets an
//! impossible header can only search for a plausible one; a driver that sees `malformed` counted should reconnect.

mod command;
mod frame;
mod report;

pub use command::{Command, LineTail, NUM_JOINT_SLOTS, Pose, Reply, Text};
pub use frame::{Frame, FrameDecoder, FrameError, MAX_LENGTH, Protocol, StateFlags};
pub use report::{
    Realtime, Report, ReportDecoder, ReportKind, ReportLimits, ReportRest, ReportSafety, ReportTools,
    Wrenches,
};
