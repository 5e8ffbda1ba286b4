//! The page as an operator meets it, without a window: the frame, the timelines, and the mirror, on shipped stations and
//! made-up takes.

mod fixture;
mod frame;
mod mirror;
mod timelines;
