//! The server without a socket where possible, and the command as people start it.
#![expect(clippy::unwrap_used, reason = "helpers of tests stop at what they do not expect, as tests do")]

mod api;
mod bad_input;
mod calibrations;
mod campaigns;
mod cli;
mod client_paths;
mod comparison;
mod contact_maps;
mod data_folder;
mod diagnoses;
mod docs;
mod document;
mod downloads;
mod foxglove;
mod gate;
mod jobs;
mod magnetic_skin;
mod moving;
mod new_station;
mod operations;
mod people;
mod retention;
mod rollouts;
mod serving;
mod stream;
mod support;
mod training;
mod uploads;
