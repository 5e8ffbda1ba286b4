//! Messages between the server and those who talk to it: the page, scripts, policies.
//!
//! [`proto`] holds what is compact and binary (traces, the stream and control sockets), [`api`] the JSON of the HTTP API and
//! of the command line, reports included, [`markdown`] how headings of the manual are found and addressed. What recordings
//! hold is `palpate_messages`. Pure; runs in the browser.

pub mod api;
pub mod markdown;

/// Generated protobuf messages.
#[expect(missing_docs, clippy::large_enum_variant, reason = "generated from documented .proto files")]
pub mod proto {
    include!(concat!(env!("OUT_DIR"), "/palpate.rs"));
}
