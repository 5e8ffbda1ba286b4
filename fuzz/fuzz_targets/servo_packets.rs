//! A damaged serial line of servos: any bytes, in two pieces.
#![no_main]

use libfuzzer_sys::fuzz_target;
use palpate_device_protocol::dynamixel::{Decoder, Request, Status, parse_fast_bytes};

fuzz_target!(|input: (usize, &[u8])| {
    let (cut, bytes) = input;
    let (head, tail) = bytes.split_at(cut.min(bytes.len()));
    let mut whole = Decoder::default();
    let mut split = Decoder::default();
    let packets = whole.feed(bytes);
    assert_eq!(packets, [split.feed(head), split.feed(tail)].concat());
    let counters = whole.counters();
    assert_eq!(counters, split.counters());
    let accounted = counters.frame_bytes + counters.dropped_bytes + whole.pending().len() as u64;
    assert_eq!(accounted, bytes.len() as u64);
    for packet in &packets {
        packet.encode().expect("a packet that was decoded");
        if let Ok(request) = Request::from_packet(packet) {
            assert_eq!(request.to_packet().as_ref(), Ok(packet));
        }
        if let Ok(status) = Status::from_packet(packet) {
            assert_eq!(&status.to_packet(), packet);
        }
    }
    let _ = parse_fast_bytes(bytes, &[(0, 10), (1, 10), (2, 4)]);
});
