//! The protocols against bytes captured from clients that others wrote, and against damaged streams.

mod boards;
mod dynamixel;
mod dynamixel_streams;
mod fixtures;
mod streams;
mod xarm;
