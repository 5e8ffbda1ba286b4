//! Runs a station: devices, safety layer, recording, guided sessions and the live twin.
//!
//! [`Control`] owns the devices and the one thread that commands them, 200 times a second; everybody else speaks to it
//! through a [`Handle`]. What moves the robot, from a page or by itself, goes through the
//! [safety layer](palpate_safety::Supervisor), under the lease of the connection that acquired it.
//!
//! ```text
//! devices --events--> senses --frames, samples--> recorder thread --> take
//!                       |  '--readings--> supervisor --setpoint--> devices
//! pages --requests--> desk --targets--------^  ^
//! guide of a session --motion of a take--------'            all of it --30 Hz--> pages
//! ```
//!
//! Beside all of it the live twin simulates what the tactile channels should feel and says which of them it does not
//! believe. Nothing here waits: disks, planning and the building of emulated worlds, and the twin have threads of their own.

mod audit;
mod control;
mod control_loop;
mod ending;
mod error;
mod follow;
mod free;
mod guide;
mod guided;
mod guiding;
mod handle;
mod inbox;
mod joints;
mod latch;
mod latency;
mod message;
mod pace;
mod prepare;
mod prepared_take;
mod quality;
mod rates;
mod recorder;
mod reflex;
mod reflexing;
mod refusals;
mod requests;
mod round;
mod rows;
mod senses;
mod shutdown;
mod snapshot;
mod streams;
mod taking;
mod twin;
mod wanted;

pub use audit::{AuditFile, AuditLine, AuditPage, AuditPosition, AuditRotation, read_audit};
pub use control::{Control, ControlConfig};
pub use control_loop::{LOOP_HZ, Publish};
pub use ending::Ending;
pub use error::ControlError;
pub use guided::PlaceObject;
pub use handle::Handle;
pub use message::Answer;
pub use prepared_take::{FindObject, ObjectFiles};
pub use requests::{Caller, Claim};
