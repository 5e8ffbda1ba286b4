//! The conversation with the emulated box, in its own time: no sockets, no threads, no clock.

use std::path::Path;

use palpate_device_protocol::xarm::{ReportDecoder, ReportKind};
use palpate_emulator::{EmulatedStation, Faults, ReportPort};

use super::*;
use crate::arm::velocity::VelocityEstimate;

const MS: u64 = 1_000_000;
/// Setpoints come this often.
const SETPOINT_MS: u64 = 10;
/// They are valid for this long.
const VALID_MS: u64 = 150;
/// And the joints are held for so long after that.
const HOLD_MS: u64 = 600;
const RAD_PER_SEC: f64 = 0.6;

/// What gives the setpoints: time since the bench was set up, ms, to an order.
type Orders = Box<dyn Fn(u64, &[f64]) -> Option<Order>>;

struct Bench {
    station: EmulatedStation,
    session: Session,
    client: u64,
    reports: ReportDecoder,
    velocities: VelocityEstimate,
    now_ns: u64,
    order: Option<Order>,
    orders: Orders,
    /// Bytes that a stall of the network holds up, in both directions.
    stalled: Option<(Vec<u8>, Vec<u8>, Vec<u8>)>,
    /// Measured joints at every ms.
    path: Vec<Vec<f64>>,
}

fn joints() -> Vec<String> {
    (1..=6).map(|number| format!("joint{number}")).collect()
}

fn bench() -> Bench {
    let truth = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../assets/truth/demo.toml");
    let mut station = EmulatedStation::new(&truth, 7).expect("the demonstration's station");
    let limits = Limits { rad_per_sec: vec![RAD_PER_SEC; 6], rad_per_sec2: vec![5.0; 6] };
    let client = station.connect();
    let mut bench = Bench {
        station,
        session: Session::new(joints(), limits, HOLD_MS * MS, 0),
        client,
        reports: ReportDecoder::new(ReportKind::Real),
        velocities: VelocityEstimate::new(6),
        now_ns: 0,
        order: None,
        orders: Box::new(|_, _| None),
        stalled: None,
        path: Vec::new(),
    };
    bench.session.connected(0);
    // Who commands begins without torque, as the safety layer does.
    bench.session.tick(0, Some(&order(false, 0, &[0.0; 6])));
    bench
}

fn order(torque: bool, now_ms: u64, joints_rad: &[f64]) -> Order {
    let valid_until_ns = (now_ms + VALID_MS) * MS;
    Order { torque, lead_through: false, joints_rad: joints_rad.to_vec(), valid_until_ns, disarms: 0 }
}

impl Bench {
    fn now_ms(&self) -> u64 {
        self.now_ns / MS
    }

    /// Encoders as the box reports them; those of the arm have no offset against the truth that matters here.
    fn measured(&self) -> Vec<f64> {
        self.session.seen.as_ref().expect("a report").joints_rad.clone()
    }

    fn step_ms(&mut self) {
        self.now_ns += MS;
        let (now_ns, client) = (self.now_ns, self.client);
        self.station.advance(now_ns);
        self.path.push(self.station.positions()[..6].to_vec());
        let mut answers = self.station.arm_output(client, now_ns);
        let mut reports: Vec<u8> = Vec::new();
        for (port, bytes) in self.station.reports(now_ns) {
            if port == ReportPort::Real {
                reports.extend(bytes);
            }
        }
        let mut commands = self.session.take_output();
        if let Some((held_answers, held_reports, held_commands)) = &mut self.stalled {
            held_answers.append(&mut answers);
            held_reports.append(&mut reports);
            held_commands.append(&mut commands);
        }
        for report in self.reports.feed(&reports) {
            let velocities = self.velocities.add(now_ns, &report.joint_rad[..6]);
            let fastest = velocities.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
            self.session.report(now_ns, &report, fastest);
        }
        self.session.receive(now_ns, &answers);
        if self.now_ms().is_multiple_of(SETPOINT_MS)
            && let Some(seen) = &self.session.seen
            && let Some(order) = (self.orders)(self.now_ms(), &seen.joints_rad)
        {
            self.order = Some(order);
        }
        if self.now_ns.is_multiple_of(TICK_NS) {
            let order = self.order.clone();
            self.session.tick(now_ns, order.as_ref());
        }
        if !commands.is_empty() {
            self.station.arm_input(client, &commands, now_ns);
        }
    }

    fn run_ms(&mut self, ms: u64) {
        (0..ms).for_each(|_| self.step_ms());
    }

    /// Runs until something holds, for as long as it may take.
    fn run_until(&mut self, most_ms: u64, what: &str, holds: impl Fn(&Self) -> bool) {
        for _ in 0..most_ms {
            if holds(self) {
                return;
            }
            self.step_ms();
        }
        panic!("not {what} after {most_ms} ms: {:?} {:?}", self.session.phase, self.session.link());
    }

    /// Follows a path given relative to where the joints are now.
    fn follow(&mut self, way: impl Fn(f64) -> f64 + 'static) {
        let (begun_ms, start) = (self.now_ms(), self.measured());
        self.orders = Box::new(move |now_ms, _| {
            let moved = way((now_ms - begun_ms) as f64 * 1e-3);
            let joints_rad: Vec<f64> = start.iter().map(|at_rad| at_rad + moved).collect();
            Some(order(true, now_ms, &joints_rad))
        });
    }

    fn stand(&mut self) {
        self.follow(|_| 0.0);
    }

    fn disarm(&mut self) {
        self.orders = Box::new(|now_ms, at| Some(order(false, now_ms, at)));
    }

    fn no_more_orders(&mut self) {
        self.orders = Box::new(|_, _| None);
    }

    /// Armed, and standing where it is.
    fn armed() -> Self {
        let mut bench = bench();
        bench.run_until(500, "idle", |bench| bench.session.phase == Phase::Idle);
        bench.run_ms(20);
        bench.stand();
        bench.run_until(1000, "following", |bench| bench.session.phase == Phase::Servo);
        bench.run_ms(50);
        bench
    }

    fn set_faults(&mut self, text: &str) {
        let faults = Faults::parse("faults.toml", text, self.station.station()).expect("faults");
        self.station.set_faults(faults, self.now_ns);
    }

    /// Another program's command.
    fn by_another(&mut self, command: &Command) {
        let other = self.station.connect();
        let frame = command.to_frame(1, Protocol::Plain).expect("a frame");
        self.station.arm_input(other, &frame.encode().expect("bytes"), self.now_ns);
        self.station.disconnect(other);
    }

    /// How fast joint 1 was in the ms from `from_ms` on, over any 20 ms, rad/s.
    fn fastest_since(&self, from_ms: u64) -> f64 {
        let path = &self.path[from_ms as usize..];
        path.windows(21).map(|window| (window[20][0] - window[0][0]).abs() / 0.02).fold(0.0, f64::max)
    }

    fn is_still_since(&self, from_ms: u64) -> bool {
        let path = &self.path[from_ms as usize..];
        path.iter().all(|at| at.iter().zip(&path[0]).all(|(now, then)| (now - then).abs() < 1e-6))
    }
}

/// Gently forth and back.
fn wave(t_s: f64) -> f64 {
    0.15 * (1.0 - (2.0 * t_s).cos())
}

const STOP_BUTTON: &str = "[[fault]]\nkind = \"emergency_stop\"";
const COLLISION: &str = "[[fault]]\nkind = \"collision\"";

#[test]
fn a_box_is_asked_who_it_is_and_left_as_it_is_until_somebody_arms() {
    let mut bench = bench();
    assert_eq!(bench.session.link().0, Link::Connecting);
    bench.disarm();
    bench.run_ms(1000);
    assert_eq!(bench.session.link(), (Link::Ready, String::new()));
    let (version, serial) = bench.session.identity();
    assert_eq!(version, Some("6,6,XI1202,AC1302,v1.12.10"));
    assert_eq!(serial, Some("XI120204201B02, AC130202B02L02"));
    assert!(!bench.session.torque_on() && bench.session.protocol == Protocol::KeepAlive);
    assert_eq!(bench.session.seen.as_ref().map(|seen| (seen.state, seen.mode)), Some((4, 0)));
    assert!(bench.is_still_since(0));
}

#[test]
fn nothing_is_switched_on_before_an_order_without_torque_was_seen() {
    let mut bench = bench();
    bench.session = Session::new(joints(), bench.session.limits.clone(), HOLD_MS * MS, 0);
    bench.session.connected(0);
    bench.run_ms(60);
    bench.stand();
    bench.run_ms(500);
    // Torque was wanted before this driver was there: by somebody who knows nothing of the arm as it is.
    assert!(bench.session.phase == Phase::Idle && !bench.session.torque_on());
    bench.disarm();
    bench.run_ms(50);
    bench.stand();
    bench.run_until(1000, "following", |bench| bench.session.phase == Phase::Servo);
}

#[test]
fn an_order_without_torque_counts_though_the_next_one_came_before_it_was_seen() {
    let mut bench = bench();
    bench.session = Session::new(joints(), bench.session.limits.clone(), HOLD_MS * MS, 0);
    bench.session.connected(0);
    bench.orders = Box::new(|now_ms, at| Some(Order { disarms: 1, ..order(true, now_ms, at) }));
    bench.run_until(1000, "following", |bench| bench.session.phase == Phase::Servo);
}

#[test]
fn last_words_stop_the_arm_and_switch_it_off_and_there_are_none_for_one_that_is_off() {
    let mut bench = Bench::armed();
    let taken = bench.measured();
    bench.orders =
        Box::new(move |now_ms, _| Some(Order { lead_through: true, ..order(true, now_ms, &taken) }));
    bench.run_until(1000, "led", |bench| bench.session.phase == Phase::LeadThrough);
    let [stop, off] = bench.session.last_words().expect("it is on");
    let words = [bench.session.take_output(), stop, off].concat();
    bench.station.arm_input(bench.client, &words, bench.now_ns);
    bench.station.advance(bench.now_ns + MS);
    let now = bench.station.control().snapshot();
    assert_eq!((now.arm.mode, now.arm.state), (2, 4));
    assert!(now.torque_on[..6].iter().all(|on| !on));
    let mut off = self::bench();
    off.run_ms(100);
    assert!(off.session.last_words().is_none(), "nothing of it is on");
}

#[test]
fn an_arm_that_a_failed_driver_left_on_is_stopped_and_switched_off_by_the_next() {
    for is_taken_over in [true, false] {
        let mut bench = bench();
        // It yields to hands, and nobody is there any more.
        bench.by_another(&Command::MotionEnable { joint: 8, on: 1 });
        bench.by_another(&Command::SetMode { mode: 2, detection: None });
        bench.by_another(&Command::SetState { state: 0 });
        if is_taken_over {
            bench.session.take_over();
        }
        bench.run_ms(1500);
        let now = bench.station.control().snapshot();
        assert_eq!(bench.session.link().1.contains("yields to hands"), !is_taken_over);
        // What another program has switched on is not this one's to switch off.
        assert_eq!((now.arm.state == 4, now.torque_on[0]), (is_taken_over, !is_taken_over));
    }
}

#[test]
fn setpoints_are_followed_within_the_time_of_three_of_them() {
    let mut bench = Bench::armed();
    let begun_ms = bench.now_ms();
    let start = bench.measured();
    bench.follow(wave);
    let mut worst = 0.0_f64;
    for _ in 0..3000 {
        bench.step_ms();
        let late_s = (bench.now_ms() - begun_ms) as f64 * 1e-3 - 0.025;
        let expected = start[0] + wave(late_s.max(0.0));
        worst = worst.max(
            (bench.path.last().expect("a step")[0] - bench.path[begun_ms as usize][0] + start[0] - expected)
                .abs(),
        );
    }
    // The wave's fastest is 0.3 rad/s: 3 mrad are 10 ms.
    assert!(worst < 0.004, "{worst} rad");
    assert!(bench.fastest_since(begun_ms) < 0.33, "{}", bench.fastest_since(begun_ms));
    assert_eq!(bench.session.link(), (Link::Ready, String::new()));
    assert!(bench.session.torque_on() && bench.session.bad_frames() == 0);
}

#[test]
fn a_setpoint_far_away_is_approached_no_faster_than_the_limit() {
    let mut bench = Bench::armed();
    let begun_ms = bench.now_ms();
    bench.follow(|_| 0.4);
    bench.run_ms(2000);
    let moved = bench.path.last().expect("a step")[0] - bench.path[begun_ms as usize][0];
    assert!((moved - 0.4).abs() < 1e-4, "{moved}");
    assert!(bench.fastest_since(begun_ms) < 1.1 * RAD_PER_SEC, "{}", bench.fastest_since(begun_ms));
}

#[test]
fn expired_setpoints_hold_and_fresh_ones_go_on_without_a_jump() {
    let mut bench = Bench::armed();
    bench.follow(|t_s| 0.3 * t_s);
    bench.run_ms(500);
    let dried_up_ms = bench.now_ms();
    bench.no_more_orders();
    bench.run_ms(700);
    // Valid for 150 ms, and the joints brake.
    assert!(bench.is_still_since(dried_up_ms + VALID_MS + 50));
    assert!(bench.session.phase == Phase::Servo && bench.session.torque_on());
    let again_ms = bench.now_ms();
    bench.follow(|t_s| 0.3 * t_s);
    bench.run_ms(500);
    assert!(bench.fastest_since(again_ms) < 0.4, "{}", bench.fastest_since(again_ms));
    assert!(!bench.is_still_since(again_ms));
}

#[test]
fn an_arm_that_nobody_commands_any_more_is_stopped_and_waits_to_be_armed_anew() {
    let mut bench = Bench::armed();
    bench.follow(wave);
    bench.run_ms(300);
    bench.no_more_orders();
    bench.run_ms(VALID_MS + HOLD_MS - 5);
    assert!(bench.session.phase == Phase::Servo && bench.session.torque_on());
    // It has been still for long enough: what is left is to stop it and to switch it off.
    bench.run_ms(60);
    assert!(bench.session.phase == Phase::Idle && !bench.session.torque_on());
    assert!(bench.session.link().1.contains("arm it again"), "{:?}", bench.session.link());
    let idle_ms = bench.now_ms();
    bench.stand();
    bench.run_ms(500);
    assert!(
        bench.session.phase == Phase::Idle && bench.is_still_since(idle_ms),
        "torque was never off between"
    );
    bench.disarm();
    bench.run_ms(50);
    bench.stand();
    bench.run_until(1000, "following", |bench| bench.session.phase == Phase::Servo);
    assert_eq!(bench.session.link(), (Link::Ready, String::new()));
}

#[test]
fn a_stop_in_full_motion_stands_still_within_a_tenth_of_a_second_and_ends_switched_off() {
    let mut bench = Bench::armed();
    bench.follow(|t_s| 0.5 * t_s);
    bench.run_ms(500);
    let stop_ms = bench.now_ms();
    bench.disarm();
    bench.run_ms(50);
    assert!(bench.session.torque_on(), "motors that are being switched off may still hold");
    bench.run_ms(950);
    assert!(bench.is_still_since(stop_ms + 100));
    assert!(bench.session.phase == Phase::Idle && !bench.session.torque_on());
    assert_eq!(bench.session.seen.as_ref().map(|seen| seen.state), Some(4));
    assert_eq!(bench.session.link(), (Link::Ready, String::new()));
}

#[test]
fn a_stop_is_said_again_until_the_reports_show_it() {
    let mut bench = Bench::armed();
    let output = |bench: &mut Bench| {
        let frames = FrameDecoder::default().feed(&bench.session.take_output());
        frames.iter().filter(|frame| frame.register == 0x0C && frame.content == [4]).count()
    };
    output(&mut bench);
    // Nothing reaches the box, which goes on reporting that it is ready.
    let report = Report { state: 2, mode: 1, ..Report::default() };
    let mut num_stops = 0;
    for step in 0..700 {
        bench.now_ns += TICK_NS;
        let disarmed = order(false, bench.now_ms(), &[0.0; 6]);
        bench.session.report(bench.now_ns, &report, 0.0);
        bench.session.tick(bench.now_ns, Some(&disarmed));
        num_stops += output(&mut bench);
        if step == 200 {
            assert!((10..=12).contains(&num_stops), "{num_stops} stops in a second");
        }
    }
    assert!(matches!(bench.session.phase, Phase::Stopping { .. }));
    let (link, problem) = bench.session.link();
    assert!(link == Link::Fault && problem.contains("emergency stop"), "{link:?} {problem}");
}

#[test]
fn the_emergency_stop_is_explained_and_over_only_when_released_cleared_and_armed_anew() {
    let mut bench = Bench::armed();
    bench.follow(wave);
    bench.run_ms(300);
    bench.set_faults(STOP_BUTTON);
    bench.run_ms(500);
    let (link, problem) = bench.session.link();
    assert!(
        link == Link::Fault && problem.contains("emergency stop button") && problem.contains("error 1"),
        "{problem}"
    );
    assert!(!bench.session.torque_on());
    // Cleared while still pressed: it stays.
    bench.session.clear_fault();
    bench.run_ms(500);
    assert_eq!(bench.session.link().0, Link::Fault);
    bench.set_faults("");
    bench.run_ms(500);
    assert_eq!(bench.session.link().0, Link::Fault, "released is not cleared");
    bench.session.clear_fault();
    bench.run_ms(500);
    assert_eq!(bench.session.link(), (Link::Ready, String::new()));
    // Torque is still wanted by whoever did not notice.
    assert!(bench.session.phase == Phase::Idle && !bench.session.torque_on());
    let cleared_ms = bench.now_ms();
    bench.disarm();
    bench.run_ms(50);
    bench.stand();
    bench.run_until(1000, "following", |bench| bench.session.phase == Phase::Servo);
    bench.run_ms(100);
    assert!(bench.is_still_since(cleared_ms), "it jumped when it was armed");
}

#[test]
fn a_collision_is_explained_and_can_be_recovered_from() {
    let mut bench = Bench::armed();
    bench.follow(wave);
    bench.run_ms(300);
    let hit_ms = bench.now_ms();
    bench.set_faults(COLLISION);
    bench.run_ms(600);
    let (link, problem) = bench.session.link();
    assert!(
        link == Link::Fault && problem.contains("collision") && problem.contains("error 31"),
        "{problem}"
    );
    assert!(bench.is_still_since(hit_ms + 100) && !bench.session.torque_on());
    bench.disarm();
    bench.session.clear_fault();
    bench.run_ms(500);
    assert_eq!(bench.session.link(), (Link::Ready, String::new()));
    bench.stand();
    bench.run_until(1000, "following", |bench| bench.session.phase == Phase::Servo);
    assert_eq!(bench.session.link(), (Link::Ready, String::new()));
}

#[test]
fn an_arm_with_an_error_is_not_armed_and_its_error_is_known_from_the_start() {
    let mut bench = bench();
    bench.set_faults(COLLISION);
    bench.run_ms(100);
    bench.stand();
    bench.run_ms(600);
    let (link, problem) = bench.session.link();
    assert!(link == Link::Fault && problem.contains("error 31"), "{problem}");
    assert!(bench.session.phase == Phase::Idle && !bench.session.torque_on());
}

#[test]
fn lead_through_and_back_keeps_the_arm_where_it_is() {
    let mut bench = Bench::armed();
    let begun_ms = bench.now_ms();
    let far: Vec<f64> = bench.measured();
    bench.orders = Box::new(move |now_ms, _| Some(Order { lead_through: true, ..order(true, now_ms, &far) }));
    bench.run_until(1000, "led", |bench| bench.session.phase == Phase::LeadThrough);
    bench.run_ms(300);
    assert_eq!(bench.session.seen.as_ref().map(|seen| seen.mode), Some(2));
    assert!(bench.session.torque_on());
    bench.stand();
    bench.run_until(1000, "following", |bench| bench.session.phase == Phase::Servo);
    bench.run_ms(200);
    assert_eq!(bench.session.seen.as_ref().map(|seen| seen.mode), Some(1));
    assert!(bench.is_still_since(begun_ms));
    // And it can be armed straight into lead-through, and stopped out of it.
    bench.orders = Box::new(|now_ms, at| Some(Order { lead_through: true, ..order(true, now_ms, at) }));
    bench.run_until(1000, "led", |bench| bench.session.phase == Phase::LeadThrough);
    bench.disarm();
    bench.run_until(1500, "idle", |bench| bench.session.phase == Phase::Idle);
    assert!(!bench.session.torque_on());
}

#[test]
fn an_arm_that_another_program_stops_is_not_fought_for() {
    for command in [
        Command::SetState { state: 4 },
        Command::SetState { state: 3 },
        Command::SetMode { mode: 0, detection: None },
    ] {
        let mut bench = Bench::armed();
        bench.follow(wave);
        bench.run_ms(300);
        bench.by_another(&command);
        bench.run_ms(50);
        let (link, problem) = bench.session.link();
        assert!(link == Link::Fault && problem.contains("program"), "{problem}");
        bench.run_ms(1500);
        assert!(bench.session.phase == Phase::Idle && !bench.session.torque_on());
        bench.disarm();
        bench.run_ms(50);
        let (link, problem) = bench.session.link();
        assert!(link == Link::Ready && problem.contains("program"), "kept until it is armed: {problem}");
        bench.stand();
        bench.run_until(1000, "following", |bench| bench.session.phase == Phase::Servo);
        assert_eq!(bench.session.link(), (Link::Ready, String::new()));
    }
}

#[test]
fn a_stall_of_the_network_is_ridden_out_without_fault_or_jump() {
    let mut bench = Bench::armed();
    let begun_ms = bench.now_ms();
    bench.follow(|t_s| 0.3 * t_s);
    bench.run_ms(500);
    bench.stalled = Some(Default::default());
    bench.run_ms(190);
    let (answers, reports, commands) = bench.stalled.take().expect("held up");
    let num_targets =
        FrameDecoder::default().feed(&commands).iter().filter(|frame| frame.register == SERVO_JOINTS).count();
    assert!(num_targets <= MOST_TARGETS_ON_THE_WAY, "{num_targets} targets would come down at once");
    let now_ns = bench.now_ns;
    for report in bench.reports.feed(&reports) {
        bench.session.report(now_ns, &report, 0.0);
    }
    bench.session.receive(now_ns, &answers);
    bench.station.arm_input(bench.client, &commands, now_ns);
    bench.run_ms(1000);
    assert_eq!(bench.session.link(), (Link::Ready, String::new()));
    assert!(bench.session.phase == Phase::Servo);
    assert!(bench.fastest_since(begun_ms) < 1.1 * RAD_PER_SEC, "{}", bench.fastest_since(begun_ms));
    let behind = 0.3 * (bench.now_ms() - begun_ms) as f64 * 1e-3
        - (bench.path.last().expect("a step")[0] - bench.path[begun_ms as usize][0]);
    assert!(behind < 0.012, "caught up to {behind} rad");
}

#[test]
fn a_silent_box_is_given_up_and_after_that_nothing_moves_before_it_is_armed_anew() {
    let mut bench = Bench::armed();
    bench.follow(wave);
    bench.run_ms(200);
    bench.stalled = Some(Default::default());
    bench.run_until(1500, "given up", |bench| bench.session.broken().is_some());
    assert!(bench.session.broken().is_some_and(|problem| problem.contains("network cable")));
    bench.stalled = None;
    bench.station.disconnect(bench.client);
    bench.client = bench.station.connect();
    bench.session.connected(bench.now_ns);
    assert_eq!((bench.session.broken(), bench.session.link().0), (None, Link::Connecting));
    bench
        .run_until(1500, "stopped", |bench| bench.session.phase == Phase::Idle && !bench.session.torque_on());
    let off_ms = bench.now_ms();
    bench.run_ms(500);
    assert!(bench.session.phase == Phase::Idle && bench.is_still_since(off_ms));
    bench.disarm();
    bench.run_ms(50);
    bench.stand();
    bench.run_until(1000, "following", |bench| bench.session.phase == Phase::Servo);
}

#[test]
fn an_arm_that_does_not_follow_is_not_pulled_along_for_ever() {
    let mut bench = Bench::armed();
    let at = bench.measured();
    let mut most_ahead = 0.0_f64;
    let ready = Report {
        state: 1,
        mode: 1,
        joint_rad: std::array::from_fn(|joint| at.get(joint).copied().unwrap_or(0.0)),
        ..Report::default()
    };
    // The box answers, but joint 1 stays where it is, whatever it is told.
    for ms in (0..4000).step_by(5) {
        bench.now_ns += TICK_NS;
        bench.session.report(bench.now_ns, &ready, 0.0);
        let mut wanted = at.clone();
        wanted[0] += 0.3 * ms as f64 * 1e-3;
        bench.session.tick(bench.now_ns, Some(&order(true, bench.now_ms(), &wanted)));
        let commands = bench.session.take_output();
        bench.station.arm_input(bench.client, &commands, bench.now_ns);
        bench.session.receive(bench.now_ns, &bench.station.arm_output(bench.client, bench.now_ns + MS));
        most_ahead = most_ahead.max(bench.session.follower.at_rad()[0] - at[0]);
    }
    assert!(most_ahead < LEAD_RAD + LEAD_S * RAD_PER_SEC + 0.01, "{most_ahead}");
    let (link, problem) = bench.session.link();
    assert!(link == Link::Fault && problem.contains("joint1 does not follow"), "{link:?} {problem}");
}

#[test]
fn an_arm_with_other_joints_than_the_station_says_is_never_armed() {
    let mut bench = bench();
    bench.session.joints.pop();
    bench.session.connected(0);
    bench.stand_of_five();
    bench.run_ms(1000);
    let (link, problem) = bench.session.link();
    assert!(link == Link::Fault && problem.contains("6 joints") && problem.contains("names 5"), "{problem}");
    assert!(bench.session.phase == Phase::Idle && !bench.session.torque_on());
    bench.session.clear_fault();
    bench.run_ms(300);
    assert_eq!(bench.session.link().0, Link::Fault);
}

impl Bench {
    fn stand_of_five(&mut self) {
        self.orders = Box::new(|now_ms, at| Some(order(true, now_ms, at)));
    }
}

#[test]
fn an_arm_that_is_let_go_is_left_switched_off() {
    let mut bench = Bench::armed();
    bench.no_more_orders();
    bench.order = None;
    bench.run_until(1500, "at rest", |bench| bench.session.is_at_rest());
    assert!(!bench.session.torque_on());
    assert_eq!(bench.session.seen.as_ref().map(|seen| seen.state), Some(4));
}

#[test]
fn bytes_that_are_no_frame_end_the_connection() {
    let mut bench = Bench::armed();
    bench.session.receive(bench.now_ns, &[0xFF; 64]);
    bench.session.tick(bench.now_ns, None);
    assert!(bench.session.broken().is_some_and(|problem| problem.contains("no frame")));
}
