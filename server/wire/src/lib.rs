//! Messages between the server and those who talk to it: the page, scripts, policies.
//!
//! [`proto`] holds what is compact and binary (traces, the stream and control sockets), [`api`] the JSON of the HTTP API and
//! of the command line, [`markdown`] how headings of the manual are found and addressed. What recordings hold is
//! `palpate_messages`; reports of checks, calibrations and diagnoses are `palpate_reports`. Pure; runs in the browser.

pub mod api;
pub mod markdown;

/// Descriptions of the messages of [`proto`], as compiled.
const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// The serialized `FileDescriptorSet` of the message called `full_name`, of the sockets or of recordings: its file and all
/// that it imports, dependencies first. `None` if there is no such message.
///
/// ```
/// assert!(palpate_wire::descriptor_set("palpate.LiveFrame").is_some());
/// assert!(palpate_wire::descriptor_set("palpate.TactileSample").is_some());
/// assert!(palpate_wire::descriptor_set("palpate.Unknown").is_none());
/// ```
pub fn descriptor_set(full_name: &str) -> Option<Vec<u8>> {
    palpate_messages::descriptor_set_among(DESCRIPTORS, full_name)
        .or_else(|| palpate_messages::descriptor_set(full_name))
}

/// Generated protobuf messages.
#[expect(missing_docs, clippy::large_enum_variant, reason = "generated from documented .proto files")]
pub mod proto {
    include!(concat!(env!("OUT_DIR"), "/palpate.rs"));
}
