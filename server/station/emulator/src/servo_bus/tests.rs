//! The bus as a host sees it: requests in, answers out, joints that move.

use palpate_device_protocol::dynamixel::control_table::{
    self as registers, PRESENT_POSITION, PRESENT_TEMPERATURE, Raw, Register,
};
use palpate_device_protocol::dynamixel::{
    BulkRead, BulkWrite, FactoryReset, HardwareError, parse_fast_bytes,
};
use proptest::prelude::*;

use super::*;

const STOPS_RAD: (f64, f64) = (-1.0, 2.0);
const MS_NS: u64 = 1_000_000;

/// A bus with its own clock.
struct Line {
    bus: ServoBus,
    now_ns: u64,
}

impl Line {
    fn new(num_servos: usize) -> Self {
        let joints_rad = vec![0.0; num_servos];
        Self { bus: ServoBus::new(&joints_rad, &vec![STOPS_RAD; num_servos]), now_ns: 0 }
    }

    fn wait(&mut self, ms: u64) {
        for _ in 0..ms {
            self.bus.step();
            self.now_ns += MS_NS;
        }
    }

    /// Sends a request and gives all statuses.
    fn ask(&mut self, id: u8, instruction: Instruction) -> Vec<Status> {
        let bytes = Request { id, instruction }.encode().expect("a request");
        let answers = self.bus.receive(self.now_ns, &bytes);
        let bytes: Vec<u8> = answers.iter().flat_map(|answer| answer.bytes.clone()).collect();
        let packets = Decoder::default().feed(&bytes);
        packets.iter().map(|packet| Status::from_packet(packet).expect("a status")).collect()
    }

    fn one(&mut self, id: u8, instruction: Instruction) -> Status {
        let mut statuses = self.ask(id, instruction);
        assert_eq!(statuses.len(), 1, "{statuses:?}");
        statuses.remove(0)
    }

    fn write(&mut self, id: u8, register: &Register, value: i64) -> Option<StatusError> {
        let data = register.encode(Raw(value)).expect("in range");
        self.one(id, Instruction::Write { address: register.address, data }).error.error()
    }

    fn set(&mut self, id: u8, register: &Register, value: i64) {
        assert_eq!(self.write(id, register, value), None, "{} = {value}", register.name);
    }

    fn get(&mut self, id: u8, register: &Register) -> i64 {
        let read = Instruction::Read { address: register.address, length: register.length };
        let status = self.one(id, read);
        assert_eq!(status.error.error(), None);
        register.decode(&status.data).expect("the register's bytes").0
    }

    fn hardware_error(&mut self, id: u8) -> HardwareError {
        HardwareError(self.get(id, &registers::HARDWARE_ERROR_STATUS) as u8)
    }
}

#[test]
fn broadcast_ping_finds_every_servo_in_turn() {
    let mut line = Line::new(5);
    let statuses = line.ask(BROADCAST_ID, Instruction::Ping);
    assert_eq!(statuses.iter().map(|status| status.id).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    let reply = statuses[3].ping_reply().unwrap();
    assert_eq!((reply.model, reply.firmware), (1240, FIRMWARE));
    assert!(line.ask(9, Instruction::Ping).is_empty(), "nobody has this id");
}

#[test]
fn answers_come_after_return_delay_and_line_time_one_after_another() {
    let mut line = Line::new(3);
    let bytes = Request { id: BROADCAST_ID, instruction: Instruction::Ping }.encode().unwrap();
    // 250 x 2 us, then 14 bytes of ten bits at 4 Mbit/s.
    let due: Vec<u64> = line.bus.receive(7, &bytes).iter().map(|answer| answer.due_ns).collect();
    assert_eq!(due, [535_007, 1_070_007, 1_605_007]);
    line.now_ns = 10 * MS_NS;
    line.set(1, &registers::RETURN_DELAY_TIME, 0);
    let bytes = Request { id: 1, instruction: Instruction::Ping }.encode().unwrap();
    assert_eq!(line.bus.receive(20 * MS_NS, &bytes)[0].due_ns, 20 * MS_NS + 35_000);
}

#[test]
fn a_goal_moves_the_joint_and_stays_within_its_current() {
    let mut line = Line::new(2);
    line.set(1, &registers::OPERATING_MODE, 5);
    for (register, value) in
        [(registers::POSITION_P_GAIN, 600), (registers::POSITION_D_GAIN, 200), (registers::GOAL_CURRENT, 350)]
    {
        line.set(1, &register, value);
    }
    line.set(1, &registers::TORQUE_ENABLE, 1);
    line.set(1, &registers::GOAL_POSITION, 2048 + 400);
    let mut most_ma = 0;
    for _ in 0..2000 {
        line.wait(1);
        most_ma = most_ma.max(line.get(1, &registers::PRESENT_CURRENT).abs());
    }
    let position = line.get(1, &PRESENT_POSITION);
    assert!((position - 2448).abs() < 15, "{position}");
    assert!((300..=350).contains(&most_ma), "{most_ma}");
    assert_eq!(line.get(0, &PRESENT_POSITION), 2048, "the other one stayed");
    assert_eq!(line.get(1, &registers::MOVING), 0);
}

#[test]
fn a_profile_bounds_the_speed() {
    let mut line = Line::new(1);
    line.set(0, &registers::TORQUE_ENABLE, 1);
    line.set(0, &registers::PROFILE_VELOCITY, 40);
    line.set(0, &registers::PROFILE_ACCELERATION, 20);
    line.set(0, &registers::GOAL_POSITION, 3000);
    let mut most = 0;
    for _ in 0..3000 {
        line.wait(1);
        most = most.max(line.get(0, &registers::PRESENT_VELOCITY));
    }
    assert!((38..=44).contains(&most), "{most}");
    assert!((line.get(0, &PRESENT_POSITION) - 3000).abs() < 5);
}

#[test]
fn joints_stop_at_their_stops() {
    let mut line = Line::new(1);
    line.set(0, &registers::TORQUE_ENABLE, 1);
    line.set(0, &registers::GOAL_POSITION, 4095);
    line.wait(500);
    let stop = PRESENT_POSITION.to_raw(std::f64::consts::PI + STOPS_RAD.1).unwrap();
    assert_eq!(Raw(line.get(0, &PRESENT_POSITION)), stop);
    // Pushing on makes the overload protection trip: torque goes, and only a restart brings it back.
    line.wait(1500);
    assert!(line.hardware_error(0).contains(HardwareError::OVERLOAD));
    assert_eq!(line.get(0, &registers::TORQUE_ENABLE), 0);
    let refused = line.one(0, Instruction::Write { address: 64, data: vec![1] });
    assert!(refused.error.alert(), "{refused:?}");
    assert_eq!(line.get(0, &registers::TORQUE_ENABLE), 0);
    line.one(0, Instruction::Reboot);
    assert!(line.ask(0, Instruction::Ping).is_empty(), "it restarts");
    line.wait(400);
    assert!(!line.one(0, Instruction::Ping).error.alert());
    line.set(0, &registers::TORQUE_ENABLE, 1);
    assert_eq!(line.get(0, &registers::TORQUE_ENABLE), 1);
}

#[test]
fn eeprom_is_locked_while_torque_is_on() {
    let mut line = Line::new(1);
    line.set(0, &registers::TORQUE_ENABLE, 1);
    assert_eq!(line.write(0, &registers::OPERATING_MODE, 5), Some(StatusError::Access));
    assert_eq!(line.get(0, &registers::OPERATING_MODE), 3);
    line.set(0, &registers::TORQUE_ENABLE, 0);
    line.set(0, &registers::OPERATING_MODE, 5);
}

#[test]
fn wrong_writes_are_refused_with_the_vendors_codes_and_change_nothing() {
    let mut line = Line::new(1);
    for (register, value, expected) in [
        (&registers::MODEL_NUMBER, 1, StatusError::Access),
        (&registers::PRESENT_POSITION, 1, StatusError::Access),
        (&registers::TORQUE_ENABLE, 2, StatusError::DataRange),
        (&registers::OPERATING_MODE, 2, StatusError::DataRange),
        (&registers::CURRENT_LIMIT, 2353, StatusError::DataRange),
        (&registers::GOAL_PWM, 886, StatusError::DataLimit),
        (&registers::GOAL_VELOCITY, -351, StatusError::DataLimit),
        (&registers::GOAL_POSITION, 4096, StatusError::DataLimit),
        (&registers::BUS_WATCHDOG, -1, StatusError::DataRange),
    ] {
        let before = line.get(0, register);
        assert_eq!(line.write(0, register, value), Some(expected), "{} = {value}", register.name);
        assert_eq!(line.get(0, register), before, "{}", register.name);
    }
    let mut raw = |address: u16, data: &[u8]| {
        line.one(0, Instruction::Write { address, data: data.to_vec() }).error.error()
    };
    assert_eq!(raw(117, &[0]), Some(StatusError::Access), "in the middle of a register");
    assert_eq!(raw(116, &[0, 8]), Some(StatusError::DataLength));
    assert_eq!(raw(66, &[0]), Some(StatusError::Access), "a gap");
    assert_eq!(raw(5000, &[0]), Some(StatusError::Access));
    assert_eq!(raw(112, &[1, 0, 0, 0, 0, 8, 0, 0]), None, "two registers at once");
    // The second of two is wrong: the first is not written either.
    assert_eq!(raw(112, &[2, 0, 0, 0, 0, 0, 1, 0]), Some(StatusError::DataLimit));
    assert_eq!(line.get(0, &registers::PROFILE_VELOCITY), 1);
}

#[test]
fn factory_reset_is_refused() {
    let mut line = Line::new(2);
    line.set(1, &registers::RETURN_DELAY_TIME, 0);
    let status = line.one(1, Instruction::FactoryReset(FactoryReset::All));
    assert_eq!(status.error.error(), Some(StatusError::ResultFail));
    assert_eq!(line.get(1, &registers::RETURN_DELAY_TIME), 0);
}

#[test]
fn status_return_level_silences_writes_then_reads_never_pings() {
    let mut line = Line::new(1);
    line.set(0, &registers::STATUS_RETURN_LEVEL, 1);
    assert!(line.ask(0, Instruction::Write { address: 65, data: vec![1] }).is_empty());
    assert_eq!(line.get(0, &registers::LED), 1, "it obeyed all the same");
    assert!(line.ask(0, Instruction::Write { address: 68, data: vec![0] }).is_empty());
    assert!(line.ask(0, Instruction::Read { address: 65, length: 1 }).is_empty());
    assert_eq!(line.ask(0, Instruction::Ping).len(), 1);
}

#[test]
fn registered_writes_wait_for_the_action() {
    let mut line = Line::new(2);
    for id in [0, 1] {
        line.one(id, Instruction::RegWrite { address: 65, data: vec![1] });
        assert_eq!((line.get(id, &registers::LED), line.get(id, &registers::REGISTERED_INSTRUCTION)), (0, 1));
    }
    assert!(line.ask(BROADCAST_ID, Instruction::Action).is_empty());
    for id in [0, 1] {
        assert_eq!((line.get(id, &registers::LED), line.get(id, &registers::REGISTERED_INSTRUCTION)), (1, 0));
    }
    assert_eq!(line.one(0, Instruction::Action).error.error(), Some(StatusError::Instruction));
}

#[test]
fn synchronous_and_bulk_instructions_reach_those_named() {
    let mut line = Line::new(4);
    let data = vec![(1, vec![1]), (3, vec![1]), (9, vec![1])];
    assert!(line.ask(BROADCAST_ID, Instruction::SyncWrite { address: 65, length: 1, data }).is_empty());
    let statuses =
        line.ask(BROADCAST_ID, Instruction::SyncRead { address: 65, length: 1, ids: vec![3, 0, 1, 9] });
    let seen: Vec<_> = statuses.iter().map(|status| (status.id, status.data[0])).collect();
    assert_eq!(seen, [(3, 1), (0, 0), (1, 1)]);
    line.ask(
        BROADCAST_ID,
        Instruction::BulkWrite(vec![BulkWrite { id: 2, address: 112, data: vec![7, 0, 0, 0] }]),
    );
    let reads = [(2, 112, 4), (1, 144, 2)].map(|(id, address, length)| BulkRead { id, address, length });
    let statuses = line.ask(BROADCAST_ID, Instruction::BulkRead(reads.to_vec()));
    assert_eq!(statuses[0].data, [7, 0, 0, 0]);
    assert_eq!(statuses[1].data, [50, 0], "5.0 V");
}

#[test]
fn a_joint_answer_ends_where_a_servo_is_missing() {
    let mut line = Line::new(3);
    let ask = |line: &mut Line, ids: &[u8]| {
        let instruction = Instruction::FastSyncRead { address: 132, length: 4, ids: ids.to_vec() };
        let bytes = Request { id: BROADCAST_ID, instruction }.encode().unwrap();
        let answers = line.bus.receive(0, &bytes);
        let bytes = answers.first().map_or(Vec::new(), |answer| answer.bytes.clone());
        parse_fast_bytes(&bytes, &ids.iter().map(|&id| (id, 4)).collect::<Vec<_>>())
    };
    let whole = ask(&mut line, &[2, 0, 1]);
    assert_eq!((whole.blocks.len(), whole.first_missing), (3, None));
    assert_eq!(whole.blocks[0].data, 2048_u32.to_le_bytes());
    let short = ask(&mut line, &[2, 7, 1]);
    assert_eq!((short.blocks.len(), short.first_missing), (1, Some(7)));
}

#[test]
fn the_watchdog_stops_a_servo_whose_host_is_silent() {
    let mut line = Line::new(1);
    line.set(0, &registers::TORQUE_ENABLE, 1);
    line.set(0, &registers::BUS_WATCHDOG, 5);
    line.set(0, &registers::PROFILE_VELOCITY, 10);
    line.set(0, &registers::GOAL_POSITION, 3000);
    line.wait(90);
    // Any instruction on the line feeds it.
    assert!(line.ask(17, Instruction::Ping).is_empty());
    line.wait(90);
    assert_eq!(line.get(0, &registers::BUS_WATCHDOG), 5);
    line.wait(150);
    assert_eq!(line.get(0, &registers::BUS_WATCHDOG), -1);
    let stopped = line.get(0, &PRESENT_POSITION);
    line.wait(300);
    assert!((line.get(0, &PRESENT_POSITION) - stopped).abs() < 3);
    assert_eq!(line.write(0, &registers::GOAL_POSITION, 3000), Some(StatusError::DataRange));
    line.set(0, &registers::BUS_WATCHDOG, 0);
    line.set(0, &registers::GOAL_POSITION, 2500);
}

#[test]
fn indirect_registers_lead_where_they_are_told() {
    let mut line = Line::new(1);
    // Slots 1 to 4 to the goal position, slot 5 to the LED.
    let targets: Vec<u8> =
        [116_u16, 117, 118, 119, 65].iter().flat_map(|target| target.to_le_bytes()).collect();
    let status = line.one(0, Instruction::Write { address: 168, data: targets });
    assert_eq!(status.error.error(), None);
    let status = line.one(0, Instruction::Write { address: 208, data: vec![0xC4, 9, 0, 0, 1] });
    assert_eq!(status.error.error(), None);
    assert_eq!((line.get(0, &registers::GOAL_POSITION), line.get(0, &registers::LED)), (2500, 1));
    assert_eq!(line.one(0, Instruction::Read { address: 208, length: 6 }).data, [0xC4, 9, 0, 0, 1, 0]);
    let refused = line.one(0, Instruction::Write { address: 208, data: vec![0, 0] });
    assert_eq!(refused.error.error(), Some(StatusError::DataLength), "half of a register");
}

#[test]
fn faults_show_in_registers() {
    let mut line = Line::new(2);
    line.set(0, &registers::TORQUE_ENABLE, 1);
    let cold = line.get(0, &PRESENT_TEMPERATURE);
    let faults = |stuck, overload, heating_k| ServoFaults { stuck, overload, unpowered: false, heating_k };
    line.bus.set_faults(&[faults(true, false, 20.0), ServoFaults::default()], Some(4.2));
    line.set(0, &registers::GOAL_POSITION, 2300);
    line.wait(200);
    assert_eq!(line.get(0, &PRESENT_TEMPERATURE), cold + 20);
    assert_eq!(line.get(0, &PRESENT_POSITION), 2048, "jammed");
    assert_eq!(line.get(1, &registers::PRESENT_INPUT_VOLTAGE), 41, "the stalled motor costs a tenth");
    line.bus.set_faults(&[faults(false, false, 60.0), faults(false, true, 0.0)], Some(3.0));
    line.wait(10);
    let (hot, loaded) = (line.hardware_error(0), line.hardware_error(1));
    assert_eq!(hot.names(), ["input voltage", "overheating"]);
    assert_eq!(loaded.names(), ["input voltage", "overload"]);
    // The supply's fault goes with its cause, the others with a restart.
    line.bus.set_faults(&[ServoFaults::default(); 2], None);
    line.wait(10);
    assert_eq!(line.hardware_error(0).names(), ["overheating"]);
}

#[test]
fn damaged_requests_are_not_answered() {
    let mut line = Line::new(1);
    let mut bytes = Request { id: 0, instruction: Instruction::Ping }.encode().unwrap();
    bytes[8] ^= 0x10;
    assert!(line.bus.receive(0, &bytes).is_empty());
    let unknown = Packet { id: 0, instruction: 0x77, params: vec![1] }.encode().unwrap();
    let answers = line.bus.receive(0, &unknown);
    let packet = &Decoder::default().feed(&answers[0].bytes)[0];
    assert_eq!(Status::from_packet(packet).unwrap().error.error(), Some(StatusError::Instruction));
}

/// Requests of all kinds, to some servos and with addresses and lengths that mostly exist.
fn any_packet() -> impl Strategy<Value = Vec<u8>> {
    let id = prop_oneof![0_u8..4, Just(BROADCAST_ID)];
    let code = prop_oneof![0_u8..=0x10, 0x80_u8..=0x9F, any::<u8>()];
    let params = prop_oneof![
        proptest::collection::vec(any::<u8>(), 0..24),
        (0_u16..240, 0_u16..24, proptest::collection::vec(0_u8..6, 0..20)).prop_map(
            |(address, length, rest)| {
                [address.to_le_bytes().to_vec(), length.to_le_bytes().to_vec(), rest].concat()
            }
        ),
        (0_u16..240, proptest::collection::vec(any::<u8>(), 0..12)).prop_map(|(address, data)| [
            address.to_le_bytes().to_vec(),
            data
        ]
        .concat()),
    ];
    (id, code, params).prop_map(|(id, instruction, params)| {
        Packet { id, instruction, params }.encode().expect("short enough")
    })
}

proptest! {
    /// Whatever arrives, in whatever pieces: no panic, every answer is a good packet, joints stay finite and within their
    /// stops, and the pieces do not matter.
    #[test]
    fn any_stream_in_any_pieces_gives_the_same_good_answers(
        packets in proptest::collection::vec(
            prop_oneof![3 => any_packet(), 1 => proptest::collection::vec(any::<u8>(), 0..40)], 1..30),
        piece in 1_usize..13,
    ) {
        let mut whole = Line::new(3);
        let mut pieces = Line::new(3);
        for bytes in &packets {
            let at_once = whole.bus.receive(whole.now_ns, bytes);
            let in_pieces: Vec<Answer> =
                bytes.chunks(piece).flat_map(|part| pieces.bus.receive(pieces.now_ns, part)).collect();
            prop_assert_eq!(&at_once, &in_pieces);
            for answer in &at_once {
                prop_assert!(answer.bytes.starts_with(&[0xFF, 0xFF, 0xFD, 0x00]));
                prop_assert!(answer.due_ns >= whole.now_ns);
            }
            whole.wait(3);
            pieces.wait(3);
        }
        for joint_rad in whole.bus.joints_rad() {
            prop_assert!((STOPS_RAD.0 - 1e-9..=STOPS_RAD.1 + 1e-9).contains(&joint_rad), "{joint_rad}");
        }
        let again: Vec<f64> = pieces.bus.joints_rad().collect();
        prop_assert_eq!(whole.bus.joints_rad().collect::<Vec<_>>(), again);
    }
}
