//! Takes and sessions on disk, through the public API only.
#![expect(clippy::unwrap_used, reason = "helpers of tests stop at what they do not expect, as tests do")]

mod crashes;
mod growing;
mod import;
mod import_axes;
mod import_moving;
mod import_names;
mod import_parquet;
mod import_tares;
mod live;
mod moving;
mod session;
mod shipped_stations;
mod support;
mod take;
mod take_damage;
