//! Messages shared by the server, the page and the recordings.
//!
//! [`proto`] holds what is compact and binary (takes, traces, the stream socket), [`foxglove`] the messages that stock
//! viewers know, [`descriptor_set`] the descriptions of both that go into recordings, [`api`] the JSON of the HTTP API and
//! of the command line, [`bits`] the packing of activations, [`wording`] what documents say in words, [`markdown`] how
//! headings of the manual are found and addressed. Pure; runs in the browser.

pub mod api;
pub mod bits;
pub mod markdown;
mod schema;
pub mod wording;

/// Generated protobuf messages of our own.
#[expect(missing_docs, clippy::large_enum_variant, reason = "generated from documented .proto files")]
pub mod proto {
    include!(concat!(env!("OUT_DIR"), "/palpate.rs"));
}

/// Generated protobuf messages that are field-compatible with Foxglove's schemas of the same names.
#[expect(missing_docs, reason = "generated from documented .proto files")]
pub mod foxglove {
    include!(concat!(env!("OUT_DIR"), "/foxglove.rs"));
}

pub use schema::descriptor_set;
