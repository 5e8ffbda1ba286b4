//! The page: what an operator sees in the browser, painted with egui and wgpu.
//!
//! The main type is [`StudioApp`]: it owns the [`store::Store`] (everything the server said), the
//! [`playback::Playback`] (where in which take everybody looks) and the [`route::Route`] (which screen), and calls one
//! function per screen. Natively the crate is a library without a window, so that every panel can be tested; in the
//! browser `web` runs it. It reads no file and knows no particular robot: stations come from the server.

pub mod api_client;
pub mod app;
pub mod commands;
pub mod mirror;
pub mod pacing;
pub mod playback;
pub mod route;
pub mod screens;
pub mod store;
pub mod surface;
pub mod take_data;
pub mod theme;
#[cfg(target_arch = "wasm32")]
mod web;

pub use app::{Platform, StudioApp};
