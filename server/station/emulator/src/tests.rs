//! The whole station: bytes and time in, bytes out, and a world that feels the hand.

use std::path::PathBuf;

use palpate_device_protocol::dynamixel::{Decoder, Instruction, Request, Status};
use palpate_device_protocol::lines::{LineDecoder, RowAssembler};
use palpate_device_protocol::xarm::{Command, Pose, Protocol, Reply, ReportDecoder, ReportKind};

use palpate_truth::TruthSense;

use super::*;

const MS_NS: u64 = 1_000_000;
const S_NS: u64 = 1000 * MS_NS;

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/truth").join(name)
}

fn station(seed: u64) -> EmulatedStation {
    EmulatedStation::new(&shipped("demo.toml"), seed).expect("the demonstration's station")
}

fn faults(station: &EmulatedStation, text: &str) -> Faults {
    Faults::parse("faults.toml", text, station.station()).expect("faults")
}

fn line_idx(station: &EmulatedStation, name: &str) -> usize {
    station.lines().iter().position(|line| line == name).expect("a line of this name")
}

fn request(id: u8, instruction: Instruction) -> Vec<u8> {
    Request { id, instruction }.encode().expect("a request")
}

fn frame(command: &Command) -> Vec<u8> {
    command.to_frame(1, Protocol::Plain).and_then(|frame| frame.encode()).expect("a frame")
}

/// An operator's few seconds with the station: every byte that came out, by line.
fn session(station: &mut EmulatedStation, pause_ms: u64) -> Vec<Vec<u8>> {
    let mut heard = vec![Vec::new(); station.lines().len() + 2];
    let client = station.connect();
    for ms in (0..1500).step_by(pause_ms as usize) {
        let now_ns = ms * MS_NS;
        // What is sent does not depend on how often the clock is read.
        let write = |address, data: &[u8]| request(3, Instruction::Write { address, data: data.to_vec() });
        let (to_servos, to_arm) = match ms {
            100 => (write(64, &[1]), Vec::new()),
            200 => (write(116, &2400_u32.to_le_bytes()), Vec::new()),
            300 => (Vec::new(), frame(&Command::MotionEnable { joint: 8, on: 1 })),
            400 => (Vec::new(), frame(&Command::GetJoints { num_arrays: Some(3) })),
            _ if ms % 100 == 0 => {
                let ids = (0..16).collect();
                (request(254, Instruction::SyncRead { address: 126, length: 10, ids }), Vec::new())
            }
            _ => (Vec::new(), Vec::new()),
        };
        if !to_servos.is_empty() {
            station.line_input(0, &to_servos, now_ns);
        }
        if !to_arm.is_empty() {
            station.arm_input(client, &to_arm, now_ns);
        }
        for (line, heard) in heard.iter_mut().take(station.lines().len()).enumerate() {
            heard.extend(station.line_output(line, now_ns));
        }
        let num_lines = station.lines().len();
        heard[num_lines].extend(station.arm_output(client, now_ns));
        for (_, report) in station.reports(now_ns) {
            heard[num_lines + 1].extend(report);
        }
    }
    heard
}

const TROUBLE: &str = r#"
[[fault]]
kind = "flip"
device = "u2d2"
share = 0.01
[[fault]]
kind = "lost"
device = "twintac1"
share = 0.2
[[fault]]
kind = "garbage"
device = "fsr"
share = 0.3
[[fault]]
kind = "delay"
device = "xarm"
delay_s = 0.05
"#;

#[test]
fn same_seed_and_same_bytes_in_give_the_same_bytes_out() {
    let trouble = |seed: u64, pause_ms: u64| {
        let mut station = station(seed);
        let faults = faults(&station, TROUBLE);
        station.set_faults(faults, 0);
        session(&mut station, pause_ms)
    };
    let heard = trouble(5, 1);
    assert!(heard.iter().all(|bytes| bytes.len() > 50), "every line speaks");
    assert!(heard == trouble(5, 1), "the same again");
    // Reading less often gives the same bytes, up to what is not yet due at the last look.
    for (often, seldom) in heard.iter().zip(trouble(5, 20)) {
        assert!(often.starts_with(&seldom) && 2 * seldom.len() > often.len());
    }
    let other = trouble(6, 1);
    assert!(heard[1] != other[1], "another seed, another noise");
}

#[test]
fn boards_speak_at_their_rates_from_their_own_channels() {
    let mut station = station(1);
    let (mut index, mut fsr) = (LineDecoder::new(8), LineDecoder::new(4));
    let mut rows = RowAssembler::new(3);
    let (index_line, fsr_line) = (line_idx(&station, "twintac0"), line_idx(&station, "fsr"));
    // What was sampled before the clients came is on its way: count from when that is over.
    let _early = (station.line_output(index_line, S_NS), station.line_output(fsr_line, S_NS));
    let samples = index.feed(&station.line_output(index_line, 3 * S_NS));
    let frames: Vec<Vec<f64>> = fsr
        .feed(&station.line_output(fsr_line, 3 * S_NS))
        .into_iter()
        .filter_map(|row| rows.push(row))
        .collect();
    assert!((195..=205).contains(&samples.len()), "{} samples in 2 s", samples.len());
    assert!((78..=82).contains(&frames.len()), "{} frames in 2 s", frames.len());
    assert!(samples.iter().flatten().all(|raw| (7900.0..8100.0).contains(raw)), "untouched");
    assert_eq!((index.counters().malformed, fsr.counters().malformed, frames[0].len()), (0, 0, 12));
}

/// Switches the arm's motors on and lets it take motions.
fn enable_arm(station: &mut EmulatedStation, client: u64, now_ns: u64) {
    for command in [
        Command::MotionEnable { joint: 8, on: 1 },
        Command::SetMode { mode: 0, detection: None },
        Command::SetState { state: 0 },
    ] {
        station.arm_input(client, &frame(&command), now_ns);
    }
}

/// Lowers the flange by `down_m` from where it is, and waits until that is done.
fn lower(station: &mut EmulatedStation, client: u64, now_ns: &mut u64, down_m: f64) {
    station.arm_input(client, &frame(&Command::GetPose {}), *now_ns);
    *now_ns += 10 * MS_NS;
    let bytes = station.arm_output(client, *now_ns);
    let answers = FrameDecoder::default().feed(&bytes);
    let (_, reply) = Reply::from_frame(answers.last().expect("an answer")).expect("a reply");
    let Reply::Pose { mut pose } = reply else { panic!("{reply:?}") };
    pose.position_m[2] -= down_m;
    let motion = Command::MoveLine {
        pose: Pose { ..pose },
        speed_m_per_sec: 0.1,
        acc_m_per_sec2: 1.0,
        time_secs: 0.0,
        tail: None,
    };
    station.arm_input(client, &frame(&motion), *now_ns);
    *now_ns += (down_m.abs() / 0.1 * 1e9) as u64 + S_NS;
    station.advance(*now_ns);
}

/// Largest value of each line of a board in the next half second.
fn feel(station: &mut EmulatedStation, line: usize, num_values: usize, now_ns: &mut u64) -> f64 {
    let _before = station.line_output(line, *now_ns);
    *now_ns += S_NS / 2;
    let lines = LineDecoder::new(num_values).feed(&station.line_output(line, *now_ns));
    assert!(lines.len() > 10);
    lines.into_iter().flatten().fold(0.0, f64::max)
}

#[test]
fn a_hand_that_is_moved_onto_the_object_feels_it_until_it_leaves() {
    let mut station = station(2);
    let client = station.connect();
    let mut now_ns = 0;
    enable_arm(&mut station, client, now_ns);
    let fsr = line_idx(&station, "fsr");
    let before = feel(&mut station, fsr, 4, &mut now_ns);
    assert!(before < 50.0, "untouched: {before}");
    let start = station.positions().to_vec();
    // The palm is above the ball; somewhere on the way down it arrives.
    let mut pressed = 0.0;
    let mut down_m = 0.0;
    while pressed < 300.0 && down_m < 0.15 {
        lower(&mut station, client, &mut now_ns, 0.01);
        down_m += 0.01;
        pressed = feel(&mut station, fsr, 4, &mut now_ns);
    }
    assert!(pressed >= 300.0, "nothing felt {down_m} m further down");
    assert!(down_m > 0.02, "felt too soon");
    // Without the object there is nothing to feel, and with it again as much as before.
    let control = station.control();
    control.place_object(None).unwrap();
    station.advance(now_ns + 2 * S_NS);
    now_ns += 2 * S_NS;
    let alone = feel(&mut station, fsr, 4, &mut now_ns);
    assert!(alone < 50.0, "what is gone is felt: {alone}");
    control.place_object(Some("sphere_50mm")).unwrap();
    station.advance(now_ns + 2 * S_NS);
    now_ns += 2 * S_NS;
    let again = feel(&mut station, fsr, 4, &mut now_ns);
    assert!((again - pressed).abs() < 0.15 * pressed, "{again} after {pressed}");
    lower(&mut station, client, &mut now_ns, -down_m);
    let after = feel(&mut station, fsr, 4, &mut now_ns);
    assert!(after < 50.0, "it lingers: {after}");
    let back = station.positions().iter().zip(&start).all(|(now, then)| (now - then).abs() < 1e-4);
    assert!(back, "{:?} against {start:?}", station.positions());
}

#[test]
fn encoders_see_the_truths_offsets_and_arm_and_servos_begin_at_rest() {
    let station = station(0);
    let joint =
        |name: &str| station.station().robot.dofs().position(|joint| joint.name == name).expect("a joint");
    let middle = joint("middle_mcp_forward");
    assert!((station.positions()[middle] - 0.3).abs() < 1e-9);
    let servo = station.hand_dofs.iter().position(|&dof| dof == middle).unwrap();
    let seen_rad = station.bus.joints_rad().nth(servo).unwrap();
    assert!((seen_rad - 0.304).abs() < 1e-9, "{seen_rad}");
}

#[test]
fn faults_reach_the_device_that_they_name() {
    let mut station = station(3);
    let (one, two) = (line_idx(&station, "twintac1"), line_idx(&station, "twintac2"));
    let text = r#"
        [[fault]]
        kind = "unplug"
        device = "twintac1"
        [[fault]]
        kind = "drift"
        channel = "ring_tip.2"
        raw_per_s = 100.0
        [[fault]]
        kind = "lost"
        device = "u2d2"
        share = 1.0
        [[fault]]
        kind = "stuck"
        joint = "index_pip"
        [[fault]]
        kind = "emergency_stop"
    "#;
    let wrong = faults(&station, text);
    station.set_faults(wrong.clone(), S_NS);
    station.line_input(0, &request(0, Instruction::Ping), S_NS);
    // The same file again is no new beginning of the drift.
    station.set_faults(wrong, 2 * S_NS);
    assert!(station.line_output(one, 4 * S_NS).is_empty() && station.line_output(0, 4 * S_NS).is_empty());
    let samples = LineDecoder::new(8).feed(&station.line_output(two, 4 * S_NS));
    let last = samples.last().unwrap();
    assert!((last[2] - 8300.0).abs() < 60.0 && (last[3] - 8000.0).abs() < 60.0, "{last:?}");
    let client = station.connect();
    station.arm_input(client, &frame(&Command::GetError {}), 4 * S_NS);
    let answer = station.arm_output(client, 5 * S_NS);
    assert_eq!(answer[answer.len() - 2..], [1, 0], "the stop button's error");

    station.set_faults(Faults::default(), 5 * S_NS);
    station.line_input(0, &request(0, Instruction::Ping), 5 * S_NS);
    let answer = Decoder::default().feed(&station.line_output(0, 6 * S_NS));
    assert_eq!(Status::from_packet(&answer[0]).unwrap().id, 0);
    assert!(!station.line_output(one, 6 * S_NS).is_empty());
}

#[test]
fn damaged_lines_are_damaged_as_often_as_told_and_delays_keep_the_order() {
    let count = |text: &str| {
        let mut station = station(4);
        let line = line_idx(&station, "twintac0");
        let faults = faults(&station, text);
        station.set_faults(faults, 0);
        let mut decoder = LineDecoder::new(8);
        let samples = decoder.feed(&station.line_output(line, 11 * S_NS));
        (samples.len() as f64, decoder.counters().malformed as f64)
    };
    let fault =
        |kind: &str, more: &str| format!("[[fault]]\nkind = \"{kind}\"\ndevice = \"twintac0\"\n{more}\n");
    let (all, none) = count("");
    assert!((1050.0..1105.0).contains(&all) && none == 0.0, "{all} {none}");
    let (kept, _) = count(&fault("lost", "share = 0.3"));
    assert!((kept / all - 0.7).abs() < 0.05, "{kept} of {all}");
    let (good, bad) = count(&fault("garbage", "share = 0.5"));
    assert!(bad > 0.3 * all && good > 0.3 * all, "{good} and {bad} of {all}");
    let (good, bad) = count(&fault("flip", "share = 0.001"));
    // Some flips give other digits, which no line can tell.
    assert!(bad > 0.0 && good > 0.9 * all, "{good} and {bad} of {all}");
    let (late, bad) = count(&fault("delay", "delay_s = 1.0"));
    assert!((all - late - 100.0).abs() < 3.0 && bad == 0.0, "{late} of {all}");
}

#[test]
fn what_passes_a_line_is_counted() {
    let mut station = station(4);
    let line = line_idx(&station, "twintac0");
    let traffic = |station: &EmulatedStation| station.control().snapshot().traffic[line];
    let lines_of = |bytes: &[u8]| bytes.iter().filter(|&&byte| byte == b'\n').count() as u64;
    let clean = lines_of(&station.line_output(line, 5 * S_NS));
    // What is sent takes a moment to arrive.
    let sent = traffic(&station);
    assert!((clean..clean + 30).contains(&sent.sent) && clean > 400, "{sent:?} {clean}");
    assert_eq!((sent.damaged, sent.flipped_bytes), (0, 0));
    let faults = faults(&station, "[[fault]]\nkind = \"flip\"\ndevice = \"twintac0\"\nshare = 0.01\n");
    station.set_faults(faults, 5 * S_NS);
    let bytes = station.line_output(line, 15 * S_NS).len() as f64;
    let now = traffic(&station);
    let share = now.flipped_bytes as f64 / bytes;
    assert!((0.009..0.011).contains(&share), "{now:?} of {bytes} bytes");
    assert!(now.damaged <= now.flipped_bytes && now.damaged < now.sent - sent.sent, "{now:?}");
    assert!(now.damaged as f64 > 0.5 * now.flipped_bytes as f64, "{now:?}");
}

#[test]
fn wrong_faults_are_refused_with_their_place() {
    let station = station(0);
    for (text, expected) in [
        (
            "[[fault]]\nkind = \"unplug\"\ndevice = \"twintac9\"",
            "fault 1: no device \"twintac9\"; expected one of u2d2",
        ),
        (
            "[[fault]]\nkind = \"flip\"\ndevice = \"xarm\"\nshare = 0.1",
            "is reached by TCP, which loses nothing",
        ),
        ("[[fault]]\nkind = \"lost\"\ndevice = \"fsr\"\nshare = 1.5", "share = 1.5 must be within 0..=1"),
        (
            "[[fault]]\nkind = \"stuck\"\njoint = \"joint1\"",
            "the hand has no joint \"joint1\"; expected one of index",
        ),
        ("[[fault]]\nkind = \"dead_taxel\"\nchannel = \"index_tip.9\"", "the layout has no channel"),
        ("[[fault]]\nkind = \"supply\"\nvolts = nan", "volts = NaN must be within"),
        ("[[fault]]\nkind = \"delay\"\ndevice = \"fsr\"\ndelay_s = -1.0", "delay_s = -1 must be within"),
        ("[[fault]]\nkind = \"unplugged\"", "faults.toml: line 2"),
        ("[[faults]]", "faults.toml: line 1"),
    ] {
        let error = Faults::parse("faults.toml", text, station.station()).expect_err(text).to_string();
        assert!(error.contains(expected), "{error}\nfor {text}");
    }
}

#[test]
fn every_number_of_a_fault_has_a_range() {
    let station = station(0);
    let fault = |kind: &str, rest: &str| format!("[[fault]]\nkind = \"{kind}\"\n{rest}");
    for (kind, with, name, bad, good, range) in [
        ("delay", "device = \"fsr\"", "delay_s", ["1e308", "60.1", "-0.1", "nan"], ["0.0", "60.0"], "0..=60"),
        ("lost", "device = \"fsr\"", "share", ["1e308", "1.01", "-0.01", "nan"], ["0.0", "1.0"], "0..=1"),
        ("garbage", "device = \"fsr\"", "share", ["1e308", "1.01", "-0.01", "nan"], ["0.0", "1.0"], "0..=1"),
        ("flip", "device = \"u2d2\"", "share", ["1e308", "1.01", "-0.01", "nan"], ["0.0", "1.0"], "0..=1"),
        (
            "heating",
            "joint = \"index_pip\"",
            "rise_k",
            ["1e308", "121.0", "-61.0", "nan"],
            ["-60.0", "120.0"],
            "-60..=120",
        ),
        ("supply", "", "volts", ["1e308", "12.1", "-0.1", "nan"], ["0.0", "12.0"], "0..=12"),
        (
            "dead_taxel",
            "channel = \"index_tip.0\"",
            "raw",
            ["1e308", "65536.0", "-1.0", "nan"],
            ["0.0", "65535.0"],
            "0..=65535",
        ),
        (
            "drift",
            "channel = \"index_tip.0\"",
            "raw_per_s",
            ["1e308", "655351.0", "-655351.0", "nan"],
            ["-655350.0", "655350.0"],
            "-655350..=655350",
        ),
    ] {
        for value in bad {
            let text = fault(kind, &format!("{with}\n{name} = {value}"));
            let parsed = Faults::parse("faults.toml", &text, station.station());
            let error = parsed.expect_err(&text).to_string();
            assert!(
                error.contains("fault 1: ") && error.contains(&format!("{name} = ")),
                "{error}\nfor {text}"
            );
            assert!(error.contains(&format!("must be within {range}")), "{error}\nfor {text}");
        }
        for value in good {
            let text = fault(kind, &format!("{with}\n{name} = {value}"));
            faults(&station, &text);
        }
    }
}

#[test]
fn a_servo_without_power_is_silent_and_limp_and_starts_anew_when_it_is_back() {
    let mut station = station(0);
    let control = station.control();
    let dof = station.station().robot.dofs().position(|joint| joint.name == "index_pip").expect("a joint");
    let write = |station: &mut EmulatedStation, address: u16, data: &[u8], now_ns: u64| {
        station.line_input(0, &request(2, Instruction::Write { address, data: data.to_vec() }), now_ns);
        station.line_output(0, now_ns + 5_000_000)
    };
    // Torque on, and a gain that it does not have as delivered.
    assert!(!write(&mut station, 84, &600_u16.to_le_bytes(), 0).is_empty());
    assert!(!write(&mut station, 64, &[1], 10_000_000).is_empty());
    assert!(control.snapshot().torque_on[dof]);
    let loose = faults(&station, "[[fault]]\nkind = \"no_power\"\njoint = \"index_pip\"");
    station.set_faults(loose, 20_000_000);
    station.advance(900_000_000);
    assert!(!control.snapshot().torque_on[dof]);
    let ping = request(2, Instruction::Ping);
    station.line_input(0, &ping, 900_000_000);
    assert!(station.line_output(0, 910_000_000).is_empty(), "it has no power to answer with");
    station.set_faults(Faults::default(), 920_000_000);
    station.line_input(0, &ping, 1_300_000_000);
    assert!(!station.line_output(0, 1_310_000_000).is_empty(), "it has started again");
    assert!(!control.snapshot().torque_on[dof]);
    station.line_input(0, &request(2, Instruction::Read { address: 84, length: 2 }), 1_320_000_000);
    let answer = station.line_output(0, 1_330_000_000);
    assert!(!answer.is_empty() && !answer.windows(2).any(|pair| pair == 600_u16.to_le_bytes()), "{answer:?}");
}

#[test]
fn a_station_without_a_hand_is_refused() {
    let error = EmulatedStation::new(&shipped("bench.toml"), 0).map(|_| ()).expect_err("no hand").to_string();
    assert!(error.contains("has no hand on an arm"), "{error}");
}

#[test]
fn reports_come_at_their_ports_rates_with_the_boxs_time() {
    let mut station = station(0);
    let mut all = Vec::new();
    // Looked at in uneven steps, as by a busy machine.
    for now_ms in (0..=2000).step_by(37).chain([2000]) {
        all.extend(station.reports(now_ms * MS_NS));
    }
    for (port, kind, per_2_s) in [
        (ReportPort::Realtime, ReportKind::Realtime, 500),
        (ReportPort::Real, ReportKind::Real, 200),
        (ReportPort::Normal, ReportKind::Normal, 10),
        (ReportPort::Rich, ReportKind::Normal, 10),
    ] {
        let bytes: Vec<u8> = all.iter().filter(|(of, _)| *of == port).flat_map(|(_, b)| b.clone()).collect();
        let reports = ReportDecoder::new(kind).feed(&bytes);
        assert_eq!(reports.len(), per_2_s, "{port:?}");
        let times: Vec<u64> =
            reports.iter().filter_map(|report| report.realtime.as_ref()).map(|r| r.box_time_us).collect();
        assert!(times.windows(2).all(|pair| pair[1] - pair[0] == 4000), "{port:?}: {times:?}");
        assert_eq!(times.len(), if port == ReportPort::Realtime { per_2_s } else { 0 });
    }
}

/// Currents of the servos, A, and the true joint positions, after the fingers were closed onto the ball with `share` of
/// its resistance; and how far joints still swing.
fn grip(share: f64) -> (Vec<f64>, Vec<f64>, f64) {
    let mut station = station(7);
    let control = station.control();
    control.set_resistance(share).expect("a share");
    let client = station.connect();
    let mut now_ns = 0;
    enable_arm(&mut station, client, now_ns);
    lower(&mut station, client, &mut now_ns, 0.085);
    // Current-based position, gains and bound of the real hand, then closing.
    for id in 0..16 {
        for (address, data) in [
            (11, vec![5]),
            (64, vec![1]),
            (84, 450_u16.to_le_bytes().to_vec()),
            (80, 150_u16.to_le_bytes().to_vec()),
            (102, 300_u16.to_le_bytes().to_vec()),
            (112, 60_u32.to_le_bytes().to_vec()),
        ] {
            station.line_input(0, &request(id, Instruction::Write { address, data }), now_ns);
        }
    }
    for id in [1_u8, 2, 3, 5, 6, 7, 9, 10, 11] {
        let data = 2600_u32.to_le_bytes().to_vec();
        station.line_input(0, &request(id, Instruction::Write { address: 116, data }), now_ns);
    }
    now_ns += 3 * S_NS;
    station.advance(now_ns);
    control.log_motion(2000);
    station.advance(now_ns + S_NS);
    let log = control.take_motion_log();
    let fastest =
        log.steps.iter().flat_map(|step| step.velocities.clone()).fold(0.0, |a: f64, v| a.max(v.abs()));
    let currents = station.bus.servos().iter().map(|servo| servo.current_a()).collect();
    (currents, station.positions().to_vec(), fastest)
}

#[test]
fn fingers_that_close_on_the_object_feel_it_where_that_is_asked_for() {
    let (free, through, _) = grip(0.0);
    let (loaded, held, swing) = grip(1.0);
    let most = |currents: &[f64]| currents.iter().fold(0.0, |a: f64, current| a.max(current.abs()));
    assert!(most(&free) < 0.03, "{free:?}");
    assert!(most(&loaded) > 0.1 && most(&loaded) <= 0.3 + 1e-9, "{loaded:?}");
    // The finger that draws the most stays behind the one that meets nothing.
    let yielded = held.iter().zip(&through).map(|(held, through)| through - held).fold(0.0, f64::max);
    assert!(yielded > 0.02, "{held:?} against {through:?}");
    assert!(station(0).control().set_resistance(1.5).is_err());
    assert!(swing < 0.05, "it settles: {swing} rad/s");
    let (loaded_again, held_again, _) = grip(1.0);
    assert_eq!((loaded, held), (loaded_again, held_again), "the same again");
}

mod bodies {
    //! Devices on bodies that something else simulates: here a hand without friction, one joint of which meets a wall.

    use std::sync::{Mutex, MutexGuard, PoisonError};

    use nalgebra::{Isometry3, Translation3};

    use super::*;

    /// Place of `index_pip` among the hand's joints, which is its servo's id.
    const PIP: u8 = 2;
    const WALL_RAD: f64 = 0.6;

    #[derive(Default)]
    struct Outside {
        base_from_object: Option<Isometry3<f64>>,
        arm_has_hit: bool,
    }

    struct Toy {
        wall_dof: usize,
        felt: FeltObject,
        outside: Arc<Mutex<Outside>>,
    }

    fn lock(outside: &Mutex<Outside>) -> MutexGuard<'_, Outside> {
        outside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    impl Mechanics for Toy {
        fn step(&mut self, drives: &[Drive], positions: &mut [f64], velocities: &mut [f64]) {
            for (dof, drive) in drives.iter().enumerate() {
                match *drive {
                    Drive::Torque { is_jammed: true, .. } => velocities[dof] = 0.0,
                    Drive::Torque { torque_nm, .. } => {
                        velocities[dof] += (torque_nm - 0.03 * velocities[dof]) / 0.005 * 1e-3;
                        positions[dof] += velocities[dof] * 1e-3;
                        if dof == self.wall_dof && positions[dof] > WALL_RAD {
                            (positions[dof], velocities[dof]) = (WALL_RAD, 0.0);
                        }
                    }
                    Drive::Motion { position, velocity } => {
                        (positions[dof], velocities[dof]) = (position, velocity);
                    }
                }
            }
        }

        fn object(&self) -> Option<(&FeltObject, Isometry3<f64>)> {
            Some((&self.felt, lock(&self.outside).base_from_object?))
        }

        fn arm_has_hit(&self) -> bool {
            lock(&self.outside).arm_has_hit
        }
    }

    fn on_toy() -> (EmulatedStation, Arc<Mutex<Outside>>) {
        let truth = shipped("demo.toml");
        let sense = TruthSense::read(&truth).expect("a truth");
        let station = sense.station();
        let felt = FeltObject::new(&sense, &station.objects["sphere_50mm"]).expect("a sphere");
        let wall_dof = station.robot.dofs().position(|joint| joint.name == "index_pip").expect("a joint");
        let outside = Arc::<Mutex<Outside>>::default();
        let positions = EmulatedStation::new(&truth, 4).expect("a station").positions().to_vec();
        let mechanics = Box::new(Toy { wall_dof, felt, outside: Arc::clone(&outside) });
        let bodies = Bodies { mechanics, positions, fixed: Vec::new() };
        (EmulatedStation::with_bodies(&truth, 4, bodies).expect("a station"), outside)
    }

    fn write(station: &mut EmulatedStation, id: u8, address: u16, data: &[u8], now_ns: u64) {
        let bytes = request(id, Instruction::Write { address, data: data.to_vec() });
        station.line_input(0, &bytes, now_ns);
    }

    /// Ticks of a joint angle on a servo that is at half a turn at zero.
    fn ticks(rad: f64) -> [u8; 4] {
        let ticks = 2048.0 + rad / std::f64::consts::TAU * 4096.0;
        (ticks.round() as u32).to_le_bytes()
    }

    #[test]
    fn a_servo_that_is_stopped_draws_current_and_one_that_is_free_arrives() {
        let (mut station, _) = on_toy();
        for (id, goal) in [(PIP, 1.0), (PIP + 4, 1.0)] {
            // Current-based position control within 0.3 A, as the drivers set it up.
            for (address, data) in [(11, &[5][..]), (102, &300_u16.to_le_bytes()), (64, &[1])] {
                write(&mut station, id, address, data, 0);
            }
            write(&mut station, id, 116, &ticks(goal), MS_NS);
        }
        station.advance(3 * S_NS);
        let dof = |id: u8| station.hand_dofs[usize::from(id)];
        let servo = |id: u8| &station.bus.servos()[usize::from(id)];
        assert_eq!(station.positions()[dof(PIP)], WALL_RAD);
        assert!((servo(PIP).current_a() - 0.3).abs() < 0.02, "{} A", servo(PIP).current_a());
        let free = station.positions()[dof(PIP + 4)];
        assert!((free - 1.0).abs() < 0.02 && servo(PIP + 4).current_a().abs() < 0.05, "{free} rad");
        // Servos without torque push nothing, and what is jammed stays.
        assert!(!servo(0).torque_is_on());
        let faults = faults(&station, "[[fault]]\nkind = \"stuck\"\njoint = \"middle_pip\"");
        station.set_faults(faults, 3 * S_NS);
        write(&mut station, PIP + 4, 116, &ticks(0.2), 3 * S_NS);
        station.advance(4 * S_NS);
        assert_eq!(station.positions()[station.hand_dofs[6]], free);
    }

    #[test]
    fn skin_feels_the_object_where_the_bodies_have_it() {
        let (mut station, outside) = on_toy();
        let line = line_idx(&station, "twintac0");
        let mut now_ns = S_NS;
        let alone = feel(&mut station, line, 8, &mut now_ns);
        assert_eq!(station.control().snapshot().object, None);
        let patch = &station.station().layout.patches[0];
        let mut frames = Vec::new();
        station.station().robot.forward_kinematics(station.positions(), &mut frames);
        let on_skin = frames[patch.link] * patch.nodes[patch.nodes.len() / 2].pos_in_link;
        // The middle of the sphere 47 mm outside of a node: 3 mm of it are in the skin.
        let outward =
            frames[patch.link].rotation * patch.nodes[patch.nodes.len() / 2].normal_in_link.into_inner();
        let at = on_skin.coords + 0.047 * outward;
        lock(&outside).base_from_object = Some(Translation3::from(at).into());
        now_ns += S_NS / 2;
        let pressed = feel(&mut station, line, 8, &mut now_ns);
        assert!(pressed > alone + 150.0, "{pressed} after {alone}");
        assert_eq!(station.control().snapshot().object.as_deref(), Some("sphere_50mm"));
        lock(&outside).base_from_object = None;
        now_ns += 2 * S_NS;
        let after = feel(&mut station, line, 8, &mut now_ns);
        assert!(after < alone + 60.0, "{after} after {alone}");
    }

    #[test]
    fn the_box_stops_once_when_the_arm_hits_something() {
        let (mut station, outside) = on_toy();
        station.advance(S_NS);
        assert_eq!(station.control().snapshot().arm.error, 0);
        lock(&outside).arm_has_hit = true;
        station.advance(2 * S_NS);
        let arm = station.control().snapshot().arm;
        assert_eq!((arm.error, arm.state), (31, 4), "a collision stops the arm");
    }

    #[test]
    fn bodies_of_another_robot_are_refused() {
        let truth = shipped("demo.toml");
        let sense = TruthSense::read(&truth).expect("a truth");
        let felt = FeltObject::new(&sense, &sense.station().objects["sphere_50mm"]).expect("a sphere");
        let mechanics = Box::new(Toy { wall_dof: 0, felt, outside: Arc::default() });
        let bodies = Bodies { mechanics, positions: vec![0.0; 3], fixed: Vec::new() };
        let refused = EmulatedStation::with_bodies(&truth, 4, bodies);
        let problem = refused.err().expect("three joints are too few").to_string();
        assert!(problem.contains("the bodies have 3"), "{problem}");
    }
}

#[test]
fn a_joint_that_follows_another_is_refused_by_name() {
    let truth =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tests/fixtures/gripper-station/truth.toml");
    let error = EmulatedStation::new(&truth, 1).map(drop).expect_err("no servo for it").to_string();
    let expected =
        "station: joint \"right\" follows joint \"left\", and emulated devices have a servo for every joint";
    assert!(error.contains(expected), "{error}");
}
