//! Servo packets in damaged streams.

use palpate_device_protocol::dynamixel::{
    BROADCAST_ID, BulkRead, BulkWrite, Decoder, ErrorByte, FactoryReset, FastBlock, Instruction, Packet,
    Request, Status, encode_fast, parse_fast, stuff, unstuff,
};
use proptest::prelude::*;

use crate::dynamixel::captured;
use crate::streams::{assert_every_byte_is_accounted_for, cuts, pieces};

/// Bytes that make headers and stuffing likely.
fn byte() -> impl Strategy<Value = u8> {
    prop_oneof![3 => Just(0xFF), 2 => Just(0xFD), 2 => Just(0), 1 => Just(3), 2 => any::<u8>()]
}

fn bytes(max: usize) -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(byte(), 0..max)
}

fn instruction() -> impl Strategy<Value = Instruction> {
    let ids = || prop::collection::vec(0..=252_u8, 0..17);
    let data = || prop::collection::vec(byte(), 1..20);
    let read = (0..=252_u8, any::<u16>(), any::<u16>()).prop_map(|(id, address, length)| BulkRead {
        id,
        address,
        length,
    });
    let reads = prop::collection::vec(read, 0..9);
    let write =
        (0..=252_u8, any::<u16>(), bytes(9)).prop_map(|(id, address, data)| BulkWrite { id, address, data });
    prop_oneof![
        Just(Instruction::Ping),
        Just(Instruction::Action),
        Just(Instruction::Reboot),
        Just(Instruction::ClearTurns),
        Just(Instruction::FactoryReset(FactoryReset::KeepIdAndBaud)),
        (any::<u16>(), any::<u16>()).prop_map(|(address, length)| Instruction::Read { address, length }),
        (any::<u16>(), data()).prop_map(|(address, data)| Instruction::Write { address, data }),
        (any::<u16>(), data()).prop_map(|(address, data)| Instruction::RegWrite { address, data }),
        (any::<u16>(), any::<u16>(), ids()).prop_map(|(address, length, ids)| Instruction::SyncRead {
            address,
            length,
            ids
        }),
        (any::<u16>(), any::<u16>(), ids()).prop_map(|(address, length, ids)| Instruction::FastSyncRead {
            address,
            length,
            ids
        }),
        (any::<u16>(), prop::collection::vec((0..=252_u8, prop::array::uniform4(byte())), 0..17)).prop_map(
            |(address, data)| {
                let data = data.into_iter().map(|(id, bytes)| (id, bytes.to_vec())).collect();
                Instruction::SyncWrite { address, length: 4, data }
            }
        ),
        reads.clone().prop_map(Instruction::BulkRead),
        reads.prop_map(Instruction::FastBulkRead),
        prop::collection::vec(write, 0..9).prop_map(Instruction::BulkWrite),
    ]
}

fn request() -> impl Strategy<Value = Request> {
    (0..=252_u8, instruction()).prop_map(|(id, instruction)| Request { id, instruction })
}

/// Good frames with rubbish between them.
fn stream() -> impl Strategy<Value = Vec<u8>> {
    let frame = request().prop_map(|request| request.encode().expect("a request"));
    prop::collection::vec(prop_oneof![2 => frame, 1 => bytes(30)], 0..8).prop_map(|parts| parts.concat())
}

fn decode(stream: &[u8], cuts: &[usize]) -> (Vec<Packet>, Decoder) {
    let mut decoder = Decoder::default();
    let mut packets = Vec::new();
    let mut fed = 0;
    for piece in pieces(stream, cuts) {
        packets.extend(decoder.feed(piece));
        fed += piece.len();
        assert_every_byte_is_accounted_for(decoder.counters(), decoder.pending().len(), fed);
    }
    assert_eq!(decoder.counters().frames, packets.len() as u64);
    (packets, decoder)
}

proptest! {
    #[test]
    fn stuffing_is_undone_and_leaves_no_header(body in bytes(60)) {
        let stuffed = stuff(&body);
        prop_assert_eq!(unstuff(&stuffed), body);
        prop_assert!(!stuffed.windows(4).any(|window| window == [0xFF, 0xFF, 0xFD, 0]));
    }

    #[test]
    fn requests_survive_the_line(request in request()) {
        let (packets, _) = decode(&request.encode().expect("a request"), &[7]);
        prop_assert_eq!(packets.len(), 1);
        prop_assert_eq!(Request::from_packet(&packets[0]), Ok(request));
    }

    #[test]
    fn statuses_survive_the_line(id in 0..=252_u8, error in any::<u8>(), data in bytes(40)) {
        let status = Status { id, error: ErrorByte(error), data };
        let (packets, _) = decode(&status.encode().expect("a status"), &[3]);
        prop_assert_eq!(packets.len(), 1);
        prop_assert_eq!(Status::from_packet(&packets[0]), Ok(status));
    }

    #[test]
    fn joint_answers_survive_the_line(data in prop::collection::vec((any::<u8>(), prop::array::uniform10(byte())), 1..17)) {
        let blocks: Vec<FastBlock> = (0..).zip(&data)
            .map(|(id, (error, data))| FastBlock { id, error: ErrorByte(*error), data: data.to_vec() })
            .collect();
        let asked: Vec<(u8, u16)> = blocks.iter().map(|block| (block.id, 10)).collect();
        let (packets, _) = decode(&encode_fast(&blocks, &asked).expect("blocks"), &[11]);
        prop_assert_eq!(packets.len(), 1);
        let reply = parse_fast(&packets[0], &asked).expect("a joint status");
        prop_assert_eq!(reply.blocks, blocks);
    }

    #[test]
    fn any_bytes_in_any_pieces_give_the_same_packets(stream in stream(), one in cuts(), other in cuts()) {
        let (packets, decoder) = decode(&stream, &one);
        let (again, decoder_again) = decode(&stream, &other);
        prop_assert_eq!(packets, again);
        prop_assert_eq!(decoder.counters(), decoder_again.counters());
    }

    #[test]
    fn any_packet_can_be_read_and_written(stream in bytes(400)) {
        for packet in decode(&stream, &[400]).0 {
            let _ = (Request::from_packet(&packet), Status::from_packet(&packet));
            packet.encode().expect("a packet that was decoded");
        }
    }

    #[test]
    fn a_good_frame_is_delivered_with_its_last_byte_whatever_came_before(
        rubbish in prop_oneof![bytes(200), prop::collection::vec(any::<u8>(), 0..200)],
        request in request(),
    ) {
        // A checksum of 16 bits may fit rubbish; such a stream says nothing about resynchronisation.
        prop_assume!(decode(&rubbish, &[50]).1.counters().frames == 0);
        let frame = request.encode().expect("a request");
        let stream = [rubbish.clone(), frame.clone()].concat();
        let (packets, decoder) = decode(&stream, &[13]);
        // The rubbish may end as a header that swallows the frame's first bytes and happens to fit: 1 in 65536.
        prop_assert_eq!(packets.len(), 1);
        prop_assert_eq!(Request::from_packet(&packets[0]), Ok(request));
        prop_assert_eq!(decoder.counters().dropped_bytes, rubbish.len() as u64);
        prop_assert_eq!(decoder.pending().len(), 0);
    }

    #[test]
    fn a_damaged_frame_costs_no_other(which in 0..100_usize, at in any::<prop::sample::Index>(), flip in 1..=255_u8) {
        let captured = captured();
        let frames = &captured[which..which + 3];
        let mut damaged = frames[1].clone();
        let at = at.index(damaged.len());
        damaged[at] ^= flip;
        let (packets, decoder) = decode(&[&frames[0][..], &damaged, &frames[2]].concat(), &[17]);
        let (good, _) = decode(&[&frames[0][..], &frames[2]].concat(), &[17]);
        // Up to 16 flipped bits in a row never pass this checksum, so the damaged frame itself is always noticed.
        prop_assert_eq!(packets, good);
        prop_assert_eq!(decoder.counters().dropped_bytes, damaged.len() as u64);
    }

    #[test]
    fn a_dropped_byte_costs_one_frame(which in 0..100_usize, at in any::<prop::sample::Index>()) {
        let captured = captured();
        let frames = &captured[which..which + 3];
        let mut damaged = frames[1].clone();
        damaged.remove(at.index(damaged.len()));
        let (packets, _) = decode(&[&frames[0][..], &damaged, &frames[2]].concat(), &[17]);
        let (good, _) = decode(&[&frames[0][..], &frames[2]].concat(), &[17]);
        prop_assert_eq!(packets, good);
    }
}

#[test]
fn a_length_beyond_reason_is_not_waited_for() {
    let ping = Request { id: 1, instruction: Instruction::Ping }.encode().expect("a ping");
    let mut decoder = Decoder::default();
    let huge = [0xFF, 0xFF, 0xFD, 0, 1, 0xFF, 0xFF];
    assert_eq!(decoder.feed(&[&huge[..], &ping].concat()).len(), 1);
    assert_eq!((decoder.counters().malformed, decoder.counters().dropped_bytes), (1, 7));
    // A believable one neither: the frame behind it arrives first.
    let long = [0xFF, 0xFF, 0xFD, 0, BROADCAST_ID, 0xE8, 0x03];
    assert_eq!(decoder.feed(&[&long[..], &ping].concat()).len(), 1);
    assert!(decoder.pending().is_empty());
    assert_eq!(decoder.counters().dropped_bytes, 14);
}

#[test]
fn a_status_without_its_error_byte_is_malformed() {
    let packet = Packet { id: 1, instruction: 0x55, params: vec![] };
    let mut decoder = Decoder::default();
    assert_eq!(decoder.feed(&packet.encode().expect("a packet")), []);
    assert_eq!(decoder.counters().malformed, 1);
}
