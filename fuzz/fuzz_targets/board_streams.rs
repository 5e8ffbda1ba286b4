//! Lines and frames of tactile boards: any bytes, in two pieces.
#![no_main]

use libfuzzer_sys::fuzz_target;
use palpate_device_protocol::{framed::SampleDecoder, lines::LineDecoder};

fuzz_target!(|input: (usize, &[u8])| {
    let (cut, bytes) = input;
    let (head, tail) = bytes.split_at(cut.min(bytes.len()));
    let mut whole = SampleDecoder::default();
    let mut split = SampleDecoder::default();
    let samples = whole.feed(bytes);
    assert_eq!(samples, [split.feed(head), split.feed(tail)].concat());
    for sample in &samples {
        sample.encode().expect("a sample that was decoded");
    }
    let counters = whole.counters();
    let accounted = counters.frame_bytes + counters.dropped_bytes + whole.pending().len() as u64;
    assert_eq!(accounted, bytes.len() as u64);
    let mut whole = LineDecoder::new(2);
    let mut split = LineDecoder::new(2);
    assert_eq!(whole.feed(bytes), [split.feed(head), split.feed(tail)].concat());
    let counters = whole.counters();
    let accounted = counters.frame_bytes + counters.dropped_bytes + whole.pending().len() as u64;
    assert_eq!(accounted, bytes.len() as u64);
});
