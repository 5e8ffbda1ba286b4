//! The page as an operator meets it, without a window: the frame, its screens, and the mirror, on shipped stations and
//! made-up takes.

mod calibrate;
mod campaign_plan;
mod diagnose;
mod fixture;
mod frame;
mod help;
mod home;
mod jobs;
mod live;
mod mirror;
mod models;
mod objects;
mod pictures;
mod plans;
mod policy;
mod record;
mod sessions;
mod settings;
mod stop;
mod timelines;
mod trials;
mod twin;
mod watching;
