//! Messages that recordings hold.
//!
//! [`proto`] holds our own, [`foxglove`] those that stock viewers know, [`descriptor_set`] the descriptions of both that go
//! into recordings, [`bits`] the packing of activations. Pure; runs in the browser.

pub mod bits;
mod schema;

/// Generated protobuf messages of our own.
#[expect(missing_docs, reason = "generated from documented .proto files")]
pub mod proto {
    include!(concat!(env!("OUT_DIR"), "/palpate.rs"));
}

/// Generated protobuf messages that are field-compatible with Foxglove's schemas of the same names.
#[expect(missing_docs, reason = "generated from documented .proto files")]
pub mod foxglove {
    include!(concat!(env!("OUT_DIR"), "/foxglove.rs"));
}

pub use schema::{descriptor_set, descriptor_set_among};
