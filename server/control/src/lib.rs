//! Runs a station: devices, safety layer, recording, guided sessions and the live twin.
