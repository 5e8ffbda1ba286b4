//! The arm's command and report connections: any bytes, in two pieces.
#![no_main]

use libfuzzer_sys::fuzz_target;
use palpate_device_protocol::xarm::{Command, FrameDecoder, Reply, ReportDecoder, ReportKind};

fuzz_target!(|input: (usize, &[u8])| {
    let (cut, bytes) = input;
    let (head, tail) = bytes.split_at(cut.min(bytes.len()));
    let mut whole = FrameDecoder::default();
    let mut split = FrameDecoder::default();
    let frames = whole.feed(bytes);
    assert_eq!(frames, [split.feed(head), split.feed(tail)].concat());
    let counters = whole.counters();
    assert_eq!(counters, split.counters());
    let accounted = counters.frame_bytes + counters.dropped_bytes + whole.pending().len() as u64;
    assert_eq!(accounted, bytes.len() as u64);
    for frame in &frames {
        frame.encode().expect("a frame that was decoded");
        if let Ok(command) = Command::from_frame(frame) {
            assert_eq!(command.to_frame(frame.transaction, frame.protocol).as_ref(), Ok(frame));
        }
        if let Ok((flags, reply)) = Reply::from_frame(frame) {
            assert_eq!(reply.to_frame(frame, flags).as_ref(), Ok(frame));
        }
    }
    for kind in [ReportKind::Normal, ReportKind::Real, ReportKind::Realtime] {
        let mut whole = ReportDecoder::new(kind);
        let mut split = ReportDecoder::new(kind);
        let reports = whole.feed(bytes);
        assert_eq!(reports, [split.feed(head), split.feed(tail)].concat());
        for report in &reports {
            report.encode(kind).expect("a report that was decoded");
        }
    }
});
