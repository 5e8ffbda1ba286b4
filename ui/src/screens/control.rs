//! Commanding a live station by hand: joints, presets, jogging, lead-through, and the health of its devices.
//!
//! The lease, arming and STOP are in the top bar, because every screen needs them; here is what moves. [`joints`] says
//! which controls a station has (pure), [`panel`] and [`devices`] draw them.

pub mod devices;
pub mod joints;
pub mod panel;
pub mod wording;
