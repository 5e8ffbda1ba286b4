//! Captured traffic of the arm's vendor client, and damaged streams.

use palpate_device_protocol::xarm::{
    Command, Frame, FrameDecoder, Protocol, Reply, Report, ReportDecoder, ReportKind, StateFlags,
};
use proptest::prelude::*;
use serde::Deserialize;

use crate::fixtures::{Hex, hex, load};
use crate::streams::{assert_every_byte_is_accounted_for, cuts, pieces};

#[derive(Deserialize)]
struct Fixtures {
    frames: Vec<Captured>,
    reports: Vec<CapturedReport>,
}

#[derive(Deserialize)]
struct Captured {
    from: String,
    bytes: Hex,
}

#[derive(Deserialize)]
struct CapturedReport {
    port: u16,
    bytes: Hex,
}

fn kind(port: u16) -> ReportKind {
    if port == 30_003 { ReportKind::Real } else { ReportKind::Normal }
}

fn one(bytes: &[u8]) -> Frame {
    let mut decoder = FrameDecoder::default();
    let mut frames = decoder.feed(bytes);
    assert_eq!((frames.len(), decoder.pending().len()), (1, 0), "{bytes:02x?}");
    frames.remove(0)
}

#[test]
fn captured_frames_decode_and_encode_byte_for_byte() {
    let fixtures: Fixtures = load("xarm.json");
    assert!(fixtures.frames.len() > 200);
    let mut untyped = Vec::new();
    for Captured { from, bytes: Hex(bytes) } in fixtures.frames {
        let frame = one(&bytes);
        assert_eq!(frame.encode().expect("a frame"), bytes);
        if frame.protocol == Protocol::Heartbeat {
            assert_eq!(frame, Frame::heartbeat());
        } else if from == "client" {
            let command = Command::from_frame(&frame).expect("a command");
            if let Command::Other { register, .. } = command {
                untyped.push(register);
            }
            assert_eq!(command.to_frame(frame.transaction, frame.protocol), Ok(frame), "{command:?}");
        } else {
            let (flags, reply) = Reply::from_frame(&frame).expect("a reply");
            assert_eq!(reply.to_frame(&frame, flags), Ok(frame), "{reply:?}");
        }
    }
    untyped.sort_unstable();
    untyped.dedup();
    assert_eq!(untyped, [0x43, 0x4E, 0xC8], "commands that clients send and that have no layout here");
}

#[test]
fn commands_and_replies_mean_what_the_client_called() {
    let command = Command::from_frame(&one(&hex("002e 0003 0011 24 9a99193f 00000000 00000000 00004842")));
    let Ok(Command::SetTcpLoad { mass_kg, center_m }) = command else { panic!("{command:?}") };
    assert!((mass_kg - 0.6).abs() < 1e-7);
    assert_eq!(center_m, [0.0, 0.0, 0.05]);
    let (flags, reply) = Reply::from_frame(&one(&hex("0008 0003 0003 0d 50 04"))).expect("a reply");
    assert!(flags.contains(StateFlags::ERROR) && flags.contains(StateFlags::NOT_READY));
    assert_eq!(reply, Reply::State { state: 4 });
    let joints = Command::ServoJoints {
        joint_rad: [f64::NAN; 7],
        speed_rad_per_sec: 0.0,
        acc_rad_per_sec2: 0.0,
        time_secs: 0.0,
    };
    let error = joints.to_frame(1, Protocol::Plain).expect_err("not a number").to_string();
    assert_eq!(error, "register 0x1d: byte 0: the number is not finite");
    let error = Command::from_frame(&one(&hex("0001 0002 0002 0b 08"))).expect_err("too short").to_string();
    assert_eq!(error, "register 0x0b: 1 bytes, too few for the layout");
}

#[test]
fn captured_reports_decode_and_encode_byte_for_byte() {
    let fixtures: Fixtures = load("xarm.json");
    assert_eq!(fixtures.reports.len(), 4);
    for CapturedReport { port, bytes: Hex(bytes) } in fixtures.reports {
        let mut decoder = ReportDecoder::new(kind(port));
        let reports = decoder.feed(&bytes);
        assert_eq!(reports.len(), 1, "port {port}");
        let report = &reports[0];
        assert_eq!((report.state, report.mode), (4, 0));
        assert!((report.joint_rad[1] + 0.2).abs() < 1e-7);
        assert!((report.pose.position_m[0] - 0.207).abs() < 1e-9);
        assert_eq!(report.encode(kind(port)), Ok(bytes));
        if port == 30_002 {
            assert_eq!(report.safety.expect("safety").collision_sensitivity, 3);
            assert_eq!(report.rest.temperature_c, Some([35; 7]));
            assert_eq!(report.rest.voltage_centivolt, Some([0x0960; 7]));
            assert_eq!(report.rest.current_a, Some([0.25; 7]));
            assert_eq!(report.ready(6), Some(false));
        }
    }
}

#[test]
fn reports_of_every_documented_size_decode_and_encode() {
    let fixtures: Fixtures = load("xarm.json");
    let rich = &fixtures.reports.iter().find(|report| report.port == 30_002).expect("a rich report").bytes.0;
    for (kind, size) in [87, 133, 145, 187, 233, 245, 252, 284, 288, 312, 341, 383, 433, 481, 494, 516, 587]
        .map(|size| (ReportKind::Normal, size))
        .into_iter()
        .chain([87, 135].map(|size| (ReportKind::Real, size)))
        .chain([784, 804].map(|size| (ReportKind::Realtime, size)))
    {
        let mut frame = rich.clone();
        // Frames of 233 bytes are longer than they say.
        frame.resize(if size == 233 { 245 } else { size }, 0);
        frame[..4].copy_from_slice(&(size as u32).to_be_bytes());
        if kind == ReportKind::Realtime {
            frame[4..512].fill(0);
            frame[12] = 0x12;
            frame[116..120].copy_from_slice(&0.5_f32.to_le_bytes());
        }
        let mut decoder = ReportDecoder::new(kind);
        let stream = [&frame[..], &frame].concat();
        let reports: Vec<Report> =
            pieces(&stream, &[31]).into_iter().flat_map(|piece| decoder.feed(piece)).collect();
        assert_eq!(reports.len(), 2, "{kind:?} of {size}");
        assert_eq!(reports[1].encode(kind), Ok(frame), "{kind:?} of {size}");
        assert_eq!(decoder.counters().dropped_bytes, 0);
        if kind == ReportKind::Realtime {
            assert_eq!((reports[1].state, reports[1].mode, reports[1].joint_rad[0]), (2, 1, 0.5));
        }
    }
}

proptest! {
    #[test]
    fn any_bytes_in_any_pieces_give_the_same_frames(
        parts in prop::collection::vec(prop_oneof![
            (0..200_usize).prop_map(|which| load::<Fixtures>("xarm.json").frames[which].bytes.0.clone()),
            prop::collection::vec(prop_oneof![0..4_u8, any::<u8>()], 0..40),
        ], 0..6),
        one in cuts(),
        other in cuts(),
    ) {
        let stream = parts.concat();
        let decode = |cuts: &[usize]| {
            let mut decoder = FrameDecoder::default();
            let mut fed = 0;
            let mut frames = Vec::new();
            for piece in pieces(&stream, cuts) {
                frames.extend(decoder.feed(piece));
                fed += piece.len();
                assert_every_byte_is_accounted_for(decoder.counters(), decoder.pending().len(), fed);
            }
            for frame in &frames {
                let _ = (Command::from_frame(frame), Reply::from_frame(frame));
            }
            (frames, decoder.counters())
        };
        prop_assert_eq!(decode(&one), decode(&other));
    }

    #[test]
    fn any_bytes_in_any_pieces_give_the_same_reports(
        which in 0..4_usize, rubbish in prop::collection::vec(any::<u8>(), 0..300), one in cuts(), other in cuts(),
    ) {
        let captured = &load::<Fixtures>("xarm.json").reports[which];
        let stream = [&captured.bytes.0[..], &rubbish, &captured.bytes.0, &captured.bytes.0].concat();
        let decode = |cuts: &[usize]| {
            let mut decoder = ReportDecoder::new(kind(captured.port));
            let mut fed = 0;
            let mut reports = Vec::new();
            for piece in pieces(&stream, cuts) {
                reports.extend(decoder.feed(piece));
                fed += piece.len();
                assert_every_byte_is_accounted_for(decoder.counters(), decoder.pending().len(), fed);
            }
            (reports, decoder.counters())
        };
        let (reports, counters) = decode(&one);
        prop_assert!(!reports.is_empty());
        prop_assert_eq!((reports, counters), decode(&other));
    }

    #[test]
    fn a_frame_behind_rubbish_that_is_no_header_is_found(
        rubbish in prop::collection::vec(4..=255_u8, 0..100), transaction in 0x0400..=u16::MAX,
    ) {
        let frame = Command::GetState {}.to_frame(transaction, Protocol::KeepAlive).expect("a frame");
        let mut decoder = FrameDecoder::default();
        let frames = decoder.feed(&[rubbish.clone(), frame.encode().expect("a frame")].concat());
        prop_assert_eq!(frames, [frame]);
        prop_assert_eq!(decoder.counters().dropped_bytes, rubbish.len() as u64);
        prop_assert_eq!(decoder.counters().malformed, u64::from(!rubbish.is_empty()));
    }
}
