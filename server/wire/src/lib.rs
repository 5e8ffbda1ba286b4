//! Messages shared by the server, the page and the recordings.
//!
//! [`proto`] holds what is compact and binary (takes, traces, the stream socket), [`api`] the JSON of the HTTP API and
//! of the command line, [`bits`] the packing of activations. Pure; runs in the browser.

pub mod api;
pub mod bits;
/// Generated protobuf messages.
#[expect(missing_docs, reason = "generated from documented .proto files")]
pub mod proto {
    include!(concat!(env!("OUT_DIR"), "/palpate.rs"));
}
