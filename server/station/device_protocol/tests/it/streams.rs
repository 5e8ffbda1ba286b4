//! What every decoder owes a damaged stream.

use palpate_device_protocol::DecodeCounters;
use proptest::prelude::*;

/// A stream and where it is cut.
pub(crate) fn cuts() -> impl Strategy<Value = Vec<usize>> {
    prop::collection::vec(1..40_usize, 1..20)
}

/// Hands out the stream in pieces of these sizes, over and over.
pub(crate) fn pieces<'a>(stream: &'a [u8], cuts: &[usize]) -> Vec<&'a [u8]> {
    let mut rest = stream;
    let mut pieces = Vec::new();
    for &size in cuts.iter().cycle() {
        if rest.is_empty() {
            break;
        }
        let (piece, tail) = rest.split_at(size.min(rest.len()));
        pieces.push(piece);
        rest = tail;
    }
    pieces
}

pub(crate) fn assert_every_byte_is_accounted_for(counters: DecodeCounters, pending: usize, fed: usize) {
    let accounted = counters.frame_bytes + counters.dropped_bytes + pending as u64;
    assert_eq!(accounted, fed as u64, "{counters:?}, {pending} pending");
}
