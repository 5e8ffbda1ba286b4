//! The one way to any motor: lease, deadman, limits, ease-in and the latched stop.
