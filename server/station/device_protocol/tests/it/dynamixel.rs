//! Vendor's examples and captured traffic of the hand's servos.

use palpate_device_protocol::dynamixel::{
    BROADCAST_ID, Decoder, ErrorByte, FastBlock, Instruction, Packet, PingReply, Request, Status,
    StatusError,
    control_table::{OPERATING_MODE, PresentState, Raw},
    encode_fast, parse_fast, parse_fast_bytes,
};
use serde::Deserialize;

use crate::fixtures::{Hex, hex, load};

#[derive(Deserialize)]
struct Fixtures {
    frames: Vec<Frame>,
    crc_of_prefix: Vec<Hex>,
}

#[derive(Deserialize)]
struct Frame {
    from: String,
    bytes: Hex,
    /// Where the client forgets to stuff: the bytes it should have sent.
    reencodes_as: Option<Hex>,
}

pub(crate) fn captured() -> Vec<Vec<u8>> {
    load::<Fixtures>("dynamixel.json").frames.into_iter().map(|frame| frame.bytes.0).collect()
}

fn decode_one(bytes: &[u8]) -> Packet {
    let mut decoder = Decoder::default();
    let mut packets = decoder.feed(bytes);
    assert_eq!(packets.len(), 1, "{bytes:02x?}: {:?}", decoder.counters());
    assert_eq!(decoder.counters().frame_bytes, bytes.len() as u64);
    assert_eq!((decoder.counters().dropped_bytes, decoder.counters().malformed), (0, 0));
    packets.remove(0)
}

/// Ids and lengths of the blocks of a joint answer, for a length that all blocks share.
fn blocks_of(packet: &Packet, length: u16) -> Option<Vec<(u8, u16)>> {
    let num_blocks = (packet.params.len() + 2) / (usize::from(length) + 4);
    let step = usize::from(length) + 4;
    (0..num_blocks).map(|idx| Some((*packet.params.get(idx * step + 1)?, length))).collect()
}

#[test]
fn captured_frames_decode_and_encode_byte_for_byte() {
    let fixtures: Fixtures = load("dynamixel.json");
    assert!(fixtures.frames.len() > 180);
    let mut num_joint = 0;
    for frame in fixtures.frames {
        let bytes = frame.bytes.0;
        let packet = decode_one(&bytes);
        let expected = frame.reencodes_as.map_or(bytes.clone(), |hex| hex.0);
        assert_eq!(packet.encode().expect("a packet"), expected);
        if frame.from == "host" {
            let request = Request::from_packet(&packet).expect("a request");
            assert_eq!(request.encode().expect("a request"), expected, "{request:?}");
        } else if packet.is_fast_status() {
            let joint = [2, 4, 8, 10].into_iter().find_map(|length| {
                let asked = blocks_of(&packet, length)?;
                let reply = parse_fast(&packet, &asked).expect("a joint status");
                reply.first_missing.is_none().then_some((asked, reply.blocks))
            });
            let (asked, blocks) = joint.expect("blocks of the lengths that clients ask for");
            assert!(blocks.len() > 1);
            assert_eq!(encode_fast(&blocks, &asked).expect("blocks"), expected);
            num_joint += 1;
        } else {
            let status = Status::from_packet(&packet).expect("a status");
            assert_eq!(status.encode().expect("a status"), expected, "{status:?}");
        }
    }
    assert!(num_joint >= 3, "{num_joint} joint answers among the captures");
}

#[test]
fn a_joint_answer_cut_short_gives_the_devices_that_answered() {
    let asked = [(3, 4), (7, 4), (4, 4)];
    for (num_blocks, prefix) in load::<Fixtures>("dynamixel.json").crc_of_prefix.into_iter().enumerate() {
        let mut decoder = Decoder::default();
        assert_eq!(decoder.feed(&prefix.0), []);
        let reply = parse_fast_bytes(decoder.pending(), &asked);
        assert_eq!(reply.blocks.len(), num_blocks + 1);
        assert_eq!(reply.first_missing, Some(asked[num_blocks + 1].0));
        // An emulated line on which the next device stays silent.
        assert_eq!(encode_fast(&reply.blocks, &asked).expect("blocks"), prefix.0);
        decoder.flush();
        assert_eq!(decoder.counters().dropped_bytes, prefix.0.len() as u64);
    }
}

#[test]
fn requests_mean_what_the_client_called() {
    let request = |text| Request::from_packet(&decode_one(&hex(text))).expect("a request");
    assert_eq!(request("fffffd00 00 0300 01 1ada"), Request { id: 0, instruction: Instruction::Ping });
    let torque_on = Instruction::Write { address: 64, data: vec![1] };
    assert_eq!(request("fffffd00 00 0600 03 4000 01 c8e7"), Request { id: 0, instruction: torque_on });
    let sync = Instruction::SyncRead { address: 132, length: 4, ids: (0..16).collect() };
    let text = "fffffd00 fe 1700 82 8400 0400 000102030405060708090a0b0c0d0e0f 7e7c";
    assert_eq!(request(text), Request { id: BROADCAST_ID, instruction: sync });
    let modes = request(
        "fffffd00fe2700830b0001000005010502050305040505050605070508050905 0a050b050c050d050e050f05dc1b",
    );
    let Instruction::SyncWrite { address, length, data } = modes.instruction else { panic!("a sync write") };
    assert_eq!((address, length, data.len()), (OPERATING_MODE.address, 1, 16));
    assert!(data.iter().all(|(_, mode)| OPERATING_MODE.decode(mode) == Ok(Raw(5))));
}

#[test]
fn statuses_mean_what_the_client_understood() {
    let status = |text| Status::from_packet(&decode_one(&hex(text))).expect("a status");
    let ping = status("fffffd00 00 0700 55 00 d804 34 9743");
    assert_eq!(ping.ping_reply(), Ok(PingReply { model: 1240, firmware: 52 }));
    let alert = status("fffffd00 03 0500 55 80 00 59d1");
    assert!(alert.error.alert() && alert.error.error().is_none());
    assert_eq!(alert.data, [0], "data beside an alert are valid");
    // Stuffed on the line: -1 mA, three steps of velocity backwards, half a turn.
    let stuffed = status("fffffd00 00 0f00 55 00 ffff fdfdffffff 00080000 4c76");
    let state = PresentState::decode(stuffed.data.as_array().expect("10 bytes")).expect("a state");
    assert_eq!(state.current_ma, -1.0);
    assert!((state.velocity_rad_per_sec + 3.0 * 0.023_981_1).abs() < 1e-6);
    assert!((state.position_rad - std::f64::consts::PI).abs() < 1e-12);
    assert_eq!(state.encode().expect("in range")[..], stuffed.data);
}

#[test]
fn error_bytes_keep_error_and_alert_apart() {
    for byte in 0..=u8::MAX {
        let error = ErrorByte(byte);
        assert_eq!(ErrorByte::new(error.error(), error.alert()), error);
    }
    assert_eq!(ErrorByte(0x87).error(), Some(StatusError::Access));
    assert!(ErrorByte(0x87).alert());
}

#[test]
fn requests_that_cannot_be_sent_are_refused() {
    let request = Request { id: 0xFD, instruction: Instruction::Ping };
    let message = request.encode().expect_err("no such id").to_string();
    assert_eq!(message, "id 253 does not exist, expected 0 to 252 or 254 (all)");
    let data = vec![(1, vec![0; 4]), (2, vec![0; 3])];
    let instruction = Instruction::SyncWrite { address: 116, length: 4, data };
    let message = Request { id: BROADCAST_ID, instruction }.encode().expect_err("uneven").to_string();
    assert_eq!(message, "data for id 2: 3 bytes, expected 4 for every device of a synchronous write");
    let instruction = Instruction::Write { address: 0, data: vec![0; 70_000] };
    let message = Request { id: 1, instruction }.encode().expect_err("too long").to_string();
    assert_eq!(message, "70005 bytes after the length field, expected at most 65535: split the request");
    let block = FastBlock { id: 1, error: ErrorByte::OK, data: vec![0; 3] };
    assert!(encode_fast(&[block], &[(1, 4)]).is_err());
}

#[test]
fn packets_of_the_wrong_shape_are_no_requests() {
    for (instruction, params) in [
        (0x01, vec![0]),
        (0x02, vec![0; 3]),
        (0x03, vec![0; 2]),
        (0x06, vec![3]),
        (0x10, vec![1, 0x44]),
        (0x82, vec![0; 3]),
        (0x83, vec![116, 0, 4, 0, 1, 0, 0]),
        (0x92, vec![0; 6]),
        (0x93, vec![1, 0, 0, 4, 0, 0]),
        (0x77, vec![]),
    ] {
        let packet = Packet { id: 1, instruction, params };
        assert!(Request::from_packet(&packet).is_err(), "{packet:?}");
        assert!(Status::from_packet(&packet).is_err(), "{packet:?}");
    }
}
