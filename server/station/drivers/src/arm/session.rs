//! What is said to the box, and when: frames, reports and time in, bytes out. Neither sockets nor clocks.
//!
//! The box is asked to move only while a valid order wants torque, and after a fault, a stop or a lost connection only
//! once orders without torque have been seen: nothing moves again before somebody arms anew.

mod answers;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use palpate_device_protocol::xarm::{Command, FrameDecoder, NUM_JOINT_SLOTS, Protocol, Report, ReportSafety};

use super::codes::{explain_error, explain_warning};
use super::follow::{Follower, Limits};
use crate::event::Link;

/// Time between two targets in servo mode, ns. The box takes up to 250 a second.
pub(crate) const TICK_NS: u64 = 5_000_000;
/// Targets that may be on their way without an answer. The box goes to each at once, so those that a stall holds up must
/// not come down on it all together.
const MOST_TARGETS_ON_THE_WAY: usize = 4;
/// Time that the box has for an answer, ns; for releasing the brakes it takes longer.
const ANSWER_NS: u64 = 2_000_000_000;
const ENABLE_ANSWER_NS: u64 = 5_000_000_000;
/// The box counts as lost after this long without a report, ns. Stalls of 0.2 s are known.
const SILENT_NS: u64 = 1_000_000_000;
/// Nothing is commanded on reports that are older than this, ns.
const BLIND_NS: u64 = 250_000_000;
/// A stop is said again this often until the reports show it, ns.
const STOP_AGAIN_NS: u64 = 100_000_000;
/// From then on a stop without effect is a fault, ns.
const STOP_FAILED_NS: u64 = 3_000_000_000;
/// A stopped arm that is still for this long is switched off, ns; one that is not, after the second time.
const STILL_NS: u64 = 50_000_000;
const STILL_AT_LAST_NS: u64 = 1_000_000_000;
/// Joints slower than this are still, rad/s.
const STILL_RAD_PER_SEC: f64 = 0.02;
/// The box is asked for errors this often while it is not told targets, ns.
const LOOK_NS: u64 = 200_000_000;
/// The command may be this far ahead of the joints: as far as they get in this time, s, and a little, rad.
const LEAD_S: f64 = 0.25;
const LEAD_RAD: f64 = 0.05;
/// Joints that have been further behind for this long do not follow, ns.
const STUCK_NS: u64 = 1_000_000_000;

/// States that the box reports.
mod state {
    /// What it is told to be; some firmware also reports it.
    pub(super) const TOLD_READY: u8 = 0;
    pub(super) const MOVING: u8 = 1;
    pub(super) const READY: u8 = 2;
    pub(super) const PAUSED: u8 = 3;
    pub(super) const STOPPED: u8 = 4;
    pub(super) const CHANGED: u8 = 5;
}

/// Modes that are used here.
mod mode {
    pub(super) const SERVO: u8 = 1;
    pub(super) const LEAD_THROUGH: u8 = 2;
}

/// What the arm shall do.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Order {
    pub(crate) torque: bool,
    pub(crate) lead_through: bool,
    /// Of the arm's joints, rad.
    pub(crate) joints_rad: Vec<f64>,
    pub(crate) valid_until_ns: u64,
    /// How often orders have begun to be without torque, up to this one.
    pub(crate) disarms: u64,
}

/// Where a conversation with the box has got to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// Asking what it is.
    Hello,
    /// Only listening.
    Idle,
    /// On the way to a mode in which it follows.
    Engaging { step: Step, mode: u8, since_ns: u64 },
    /// Targets are streamed.
    Servo,
    /// The operator's hands move it.
    LeadThrough,
    /// Told to stop until the reports show it and the joints are still.
    Stopping { since_ns: u64, sent_ns: Option<u64> },
    /// Motors are being switched off.
    Disabling,
}

/// Steps of engaging, each with an answer; the last waits for reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Step {
    Enable,
    Mode,
    State,
    Confirm,
}

/// Why the arm does not follow.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Fault {
    /// The box's own error.
    Box(u8),
    /// Something else; gone once somebody disarms.
    Passing(String),
    /// Something that stays until the connection is new.
    Lasting(String),
}

/// A request without an answer yet.
#[derive(Clone, Copy, Debug)]
struct Asked {
    transaction: u16,
    register: u8,
    at_ns: u64,
}

/// What the last report said.
#[derive(Clone, Debug)]
struct Seen {
    at_ns: u64,
    state: u8,
    mode: u8,
    joints_rad: Vec<f64>,
    /// Since which report the joints have been still.
    still_since_ns: Option<u64>,
}

/// A conversation with one box, over as many connections as it takes.
#[derive(Debug)]
pub(crate) struct Session {
    /// Names of the joints, for problems.
    joints: Vec<String>,
    follower: Follower,
    limits: Limits,
    /// Nobody commands any more: then the arm is stopped for good, ns after the last order expired.
    hold_ns: u64,
    decoder: FrameDecoder,
    output: Vec<u8>,
    asked: VecDeque<Asked>,
    next_transaction: u16,
    protocol: Protocol,
    /// Axes, type, serial numbers and version, as the box says them.
    version_text: Option<String>,
    serial_text: Option<String>,
    version: Option<[u32; 3]>,
    phase: Phase,
    fault: Option<Fault>,
    /// Why the arm stopped last, as long as nobody arms it again.
    note: String,
    warning: u8,
    /// Whether the motors are on, as far as answers and reports tell.
    enabled: bool,
    /// Whether this program has switched them on.
    ours: bool,
    /// An order without torque has to be seen first, as at the start: who commands has then seen that the arm is off.
    needs_disarm: bool,
    /// [`Order::disarms`] of the order that was looked at last.
    disarms: u64,
    clear_requested: bool,
    connected_ns: u64,
    seen: Option<Seen>,
    /// `valid_until_ns` of the setpoint that is followed.
    followed_ns: Option<u64>,
    /// When a valid order was last there.
    ordered_ns: Option<u64>,
    looked_ns: Option<u64>,
    is_behind_since_ns: Option<u64>,
    broken: Option<String>,
}

impl Session {
    /// A session with an arm of these joints, which holds for `hold_ns` once orders have dried up. An order without torque
    /// has to come after the first `disarms`.
    pub(crate) fn new(joints: Vec<String>, limits: Limits, hold_ns: u64, disarms: u64) -> Self {
        Self {
            joints,
            follower: Follower::new(limits.clone()),
            limits,
            hold_ns,
            decoder: FrameDecoder::default(),
            output: Vec::new(),
            asked: VecDeque::new(),
            next_transaction: 1,
            protocol: Protocol::Plain,
            version_text: None,
            serial_text: None,
            version: None,
            phase: Phase::Hello,
            fault: None,
            note: String::new(),
            warning: 0,
            enabled: false,
            ours: false,
            needs_disarm: true,
            disarms,
            clear_requested: false,
            connected_ns: 0,
            seen: None,
            followed_ns: None,
            ordered_ns: None,
            looked_ns: None,
            is_behind_since_ns: None,
            broken: None,
        }
    }

    /// The driver before this one failed and may have left motors on: they are this program's to switch off.
    pub(crate) fn take_over(&mut self) {
        self.ours = true;
    }

    /// Frames for a box that is left without anybody who drives it, after all of [`Session::take_output`]: stop, and,
    /// once it has had time to brake, motors off. `None` where nothing is on that this program has switched on.
    pub(crate) fn last_words(&mut self) -> Option<[Vec<u8>; 2]> {
        let commands =
            [Command::SetState { state: state::STOPPED }, Command::MotionEnable { joint: 8, on: 0 }];
        (!self.is_at_rest()).then(|| {
            commands.map(|command| {
                let transaction = self.next_transaction;
                self.next_transaction = if transaction == u16::MAX { 1 } else { transaction + 1 };
                let frame = command.to_frame(transaction, self.protocol).and_then(|frame| frame.encode());
                // Both are small and always fit a frame.
                frame.unwrap_or_default()
            })
        })
    }

    /// A new connection: asks the box what it is.
    pub(crate) fn connected(&mut self, now_ns: u64) {
        let was_engaged = !matches!(self.phase, Phase::Hello | Phase::Idle);
        self.decoder = FrameDecoder::default();
        self.output.clear();
        self.asked.clear();
        self.next_transaction = 1;
        self.protocol = Protocol::Plain;
        (self.fault, self.seen, self.broken, self.warning) = (None, None, None, 0);
        (self.connected_ns, self.looked_ns, self.clear_requested) = (now_ns, None, false);
        // What was armed before the connection was lost stays disarmed until somebody arms it again.
        self.needs_disarm |= was_engaged;
        self.phase = Phase::Hello;
        self.ask(now_ns, &Command::GetVersion {});
        self.ask(now_ns, &Command::GetSerial {});
        self.ask(now_ns, &Command::GetState {});
        self.ask(now_ns, &Command::GetError {});
    }

    /// Bytes for the box since the last call.
    pub(crate) fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.output)
    }

    /// Why the connection has to be given up, if it has.
    pub(crate) fn broken(&self) -> Option<&str> {
        self.broken.as_deref()
    }

    /// Somebody wants the box's errors cleared.
    pub(crate) fn clear_fault(&mut self) {
        self.clear_requested = true;
    }

    /// The link, and what is wrong in words.
    pub(crate) fn link(&self) -> (Link, String) {
        if self.phase == Phase::Hello || self.seen.is_none() {
            return (Link::Connecting, String::new());
        }
        match &self.fault {
            Some(Fault::Box(code)) => return (Link::Fault, explain_error(*code)),
            Some(Fault::Passing(problem) | Fault::Lasting(problem)) => return (Link::Fault, problem.clone()),
            None => {}
        }
        let moved_by_others = self.phase == Phase::Idle
            && self
                .seen
                .as_ref()
                .is_some_and(|seen| seen.state == state::MOVING && seen.still_since_ns.is_none());
        // As after a program that was killed while the arm was led.
        let yields = self.phase == Phase::Idle
            && self.enabled
            && self.seen.as_ref().is_some_and(|seen| {
                seen.mode == mode::LEAD_THROUGH
                    && matches!(seen.state, state::TOLD_READY | state::MOVING | state::READY)
            });
        let problem = if yields {
            "the arm yields to hands, and this program did not tell it to: press its emergency stop, or arm it".to_owned()
        } else if !self.note.is_empty() {
            self.note.clone()
        } else if self.warning != 0 {
            explain_warning(self.warning)
        } else if moved_by_others {
            "another program moves the arm; end it before you arm".to_owned()
        } else {
            String::new()
        };
        (Link::Ready, problem)
    }

    /// Whether the motors hold the joints, as far as answers and reports tell. Those that were told to switch off hold
    /// until they have said that they are off.
    pub(crate) fn torque_on(&self) -> bool {
        self.enabled || matches!(self.phase, Phase::Stopping { .. } | Phase::Disabling)
    }

    /// Model, serial numbers and firmware, as far as they are known.
    pub(crate) fn identity(&self) -> (Option<&str>, Option<&str>) {
        (self.version_text.as_deref(), self.serial_text.as_deref())
    }

    /// The joint whose motor reports an error.
    pub(crate) fn faulty_joint(&self) -> Option<usize> {
        match self.fault {
            Some(Fault::Box(code @ 11..=17)) => Some(usize::from(code - 11)),
            _ => None,
        }
    }

    /// Whether nothing of what this program has switched on is on any more.
    pub(crate) fn is_at_rest(&self) -> bool {
        !(self.is_engaged() || self.ours && self.enabled)
    }

    /// Frames from the box that could not be understood.
    pub(crate) fn bad_frames(&self) -> u64 {
        self.decoder.counters().malformed
    }

    /// Takes a report that came at `received_ns`; the joints move at up to `fastest_rad_per_sec`.
    pub(crate) fn report(&mut self, received_ns: u64, report: &Report, fastest_rad_per_sec: f64) {
        let num_joints = self.joints.len().min(NUM_JOINT_SLOTS);
        let is_still = fastest_rad_per_sec.abs() < STILL_RAD_PER_SEC;
        let still_since_ns = self.seen.as_ref().and_then(|seen| seen.still_since_ns).or(Some(received_ns));
        self.seen = Some(Seen {
            at_ns: received_ns,
            state: report.state,
            mode: report.mode,
            joints_rad: report.joint_rad[..num_joints].to_vec(),
            still_since_ns: still_since_ns.filter(|_| is_still),
        });
        if let Some(safety) = &report.safety {
            self.safety(received_ns, safety);
        }
        match self.phase {
            Phase::Servo => self.watch(received_ns, mode::SERVO),
            Phase::LeadThrough => self.watch(received_ns, mode::LEAD_THROUGH),
            Phase::Engaging { step: Step::Confirm, mode, since_ns }
                if received_ns > since_ns
                    && report.mode == mode
                    && matches!(report.state, state::TOLD_READY | state::MOVING | state::READY) =>
            {
                self.enabled = true;
                self.follow_from_here(received_ns);
                self.phase = if mode == mode::SERVO { Phase::Servo } else { Phase::LeadThrough };
            }
            _ => {}
        }
    }

    /// What only the 5 Hz reports say.
    fn safety(&mut self, now_ns: u64, safety: &ReportSafety) {
        let all = (1_u16 << self.joints.len().min(NUM_JOINT_SLOTS)) - 1;
        self.enabled = u16::from(safety.enable_bits) & all == all;
        self.took_error(now_ns, safety.error, safety.warning);
    }

    /// The box left the mode in which it follows.
    fn watch(&mut self, now_ns: u64, wanted_mode: u8) {
        let Some(seen) = &self.seen else { return };
        let problem = match seen.state {
            state::STOPPED | state::CHANGED => "something other than this program stopped the arm",
            state::PAUSED => "another program paused the arm",
            _ if seen.mode != wanted_mode => "another program changed the mode of the arm",
            _ => return,
        };
        self.fail(now_ns, Fault::Passing(format!("{problem}; end other programs, disarm and arm again")));
        self.look(now_ns);
    }

    /// Says the next things. Called every [`TICK_NS`] and whenever something has come.
    pub(crate) fn tick(&mut self, now_ns: u64, order: Option<&Order>) {
        self.check_alive(now_ns);
        let valid = order.filter(|order| order.valid_until_ns > now_ns);
        if valid.is_some() {
            self.ordered_ns = Some(now_ns);
        }
        // One without torque may have come and gone since the last look.
        let disarms = order.map_or(self.disarms, |order| order.disarms);
        let was_limp = std::mem::replace(&mut self.disarms, disarms) < disarms;
        if was_limp || order.is_some_and(|order| !order.torque) {
            self.needs_disarm = false;
            if matches!(self.fault, Some(Fault::Passing(_))) && !self.is_engaged() {
                self.forgive();
            }
        }
        self.clear_if_asked(now_ns);
        let wants = valid.filter(|order| order.torque && !self.needs_disarm && self.fault.is_none());
        let abandoned =
            self.ordered_ns.is_none_or(|ordered_ns| now_ns.saturating_sub(ordered_ns) > self.hold_ns);
        let limp = order.is_none_or(|order| !order.torque) || abandoned || self.needs_disarm;
        match self.phase {
            Phase::Hello => {}
            Phase::Idle => {
                if let Some(order) = wants.filter(|_| self.seen.is_some()) {
                    self.note.clear();
                    self.engage(now_ns, Step::Enable, order);
                } else if self.ours && self.enabled {
                    self.stop(now_ns);
                }
            }
            Phase::Engaging { .. } | Phase::Servo | Phase::LeadThrough if limp => {
                if abandoned && order.is_some_and(|order| order.torque) {
                    self.needs_disarm = true;
                    "the arm was stopped because commands stayed away; arm it again"
                        .clone_into(&mut self.note);
                }
                self.stop(now_ns);
            }
            Phase::Engaging { step, mode, since_ns } => self.keep_engaging(now_ns, step, mode, since_ns),
            Phase::Servo => match wants {
                Some(order) if order.lead_through => self.engage(now_ns, Step::Mode, order),
                Some(order) => self.servo(now_ns, order),
                // The box stays at its last target by itself.
                None => self.follower.hold(now_ns),
            },
            Phase::LeadThrough => {
                if let Some(order) = wants.filter(|order| !order.lead_through) {
                    self.engage(now_ns, Step::Mode, order);
                }
            }
            Phase::Stopping { since_ns, sent_ns } => self.keep_stopping(now_ns, since_ns, sent_ns),
            Phase::Disabling => {}
        }
        // Answers to targets say by their flags when there is something to look at.
        if self.looked_ns.is_none_or(|looked_ns| now_ns.saturating_sub(looked_ns) >= LOOK_NS) {
            self.look(now_ns);
        }
    }

    fn is_engaged(&self) -> bool {
        !matches!(self.phase, Phase::Hello | Phase::Idle)
    }

    fn check_alive(&mut self, now_ns: u64) {
        let late = self.asked.iter().find(|asked| {
            let is_enable = asked.register == (Command::MotionEnable { joint: 0, on: 0 }).register();
            now_ns.saturating_sub(asked.at_ns) > if is_enable { ENABLE_ANSWER_NS } else { ANSWER_NS }
        });
        let reported_ns = self.seen.as_ref().map_or(self.connected_ns, |seen| seen.at_ns);
        if let Some(late) = late {
            let waited_s = now_ns.saturating_sub(late.at_ns) as f64 * 1e-9;
            self.broken = Some(format!(
                "the control box has not answered register {} for {waited_s:.1} s; check its network cable and power",
                late.register
            ));
        } else if now_ns.saturating_sub(reported_ns) > SILENT_NS {
            self.broken = Some(format!(
                "the control box has not reported for {:.1} s; check its network cable and power",
                now_ns.saturating_sub(reported_ns) as f64 * 1e-9
            ));
        } else if self.bad_frames() > 0 {
            // These frames have neither mark nor checksum: only a new connection is surely in step.
            self.broken = Some("the control box sent bytes that are no frame; connecting anew".to_owned());
        }
    }

    fn clear_if_asked(&mut self, now_ns: u64) {
        if !std::mem::take(&mut self.clear_requested) {
            return;
        }
        if self.fault.is_some() {
            self.ask(now_ns, &Command::ClearError {});
        }
        self.ask(now_ns, &Command::ClearWarning {});
        self.look(now_ns);
        self.forgive();
    }

    /// A fault that is none of the box's is over; what it was is kept for the operator.
    fn forgive(&mut self) {
        if let Some(Fault::Passing(problem)) = &self.fault {
            self.note.clone_from(problem);
            self.fault = None;
        }
    }

    /// The arm does not follow any more, and will not before somebody arms it anew.
    fn fail(&mut self, now_ns: u64, fault: Fault) {
        let is_known = matches!((&self.fault, &fault), (Some(Fault::Box(_)), Fault::Passing(_)));
        if !is_known {
            self.fault = Some(fault);
        }
        self.needs_disarm = true;
        if matches!(self.phase, Phase::Engaging { .. } | Phase::Servo | Phase::LeadThrough) {
            self.stop(now_ns);
        }
    }

    fn engage(&mut self, now_ns: u64, step: Step, order: &Order) {
        let mode = if order.lead_through { mode::LEAD_THROUGH } else { mode::SERVO };
        self.phase = Phase::Engaging { step, mode, since_ns: now_ns };
        self.say_step(now_ns, step, mode);
    }

    fn say_step(&mut self, now_ns: u64, step: Step, mode: u8) {
        match step {
            Step::Enable => {
                self.ours = true;
                self.ask(now_ns, &Command::MotionEnable { joint: 8, on: 1 });
            }
            Step::Mode => {
                let detection = self.version.is_some_and(|version| version >= [1, 10, 0]).then_some(0);
                self.ask(now_ns, &Command::SetMode { mode, detection });
            }
            Step::State => self.ask(now_ns, &Command::SetState { state: state::TOLD_READY }),
            Step::Confirm => {}
        }
    }

    fn keep_engaging(&mut self, now_ns: u64, step: Step, mode: u8, since_ns: u64) {
        if step != Step::Confirm || now_ns.saturating_sub(since_ns) <= ANSWER_NS {
            return;
        }
        let seen = self.seen.as_ref();
        let problem = format!(
            "the control box took the commands but reports state {} and mode {} where ready (2) and mode {mode} were \
             expected; look at the vendor's studio for what it waits for, then arm again",
            seen.map_or(0, |seen| seen.state),
            seen.map_or(0, |seen| seen.mode),
        );
        self.fail(now_ns, Fault::Passing(problem));
        self.look(now_ns);
    }

    fn follow_from_here(&mut self, now_ns: u64) {
        if let Some(seen) = &self.seen {
            self.follower.start(now_ns, &seen.joints_rad);
        }
        (self.followed_ns, self.is_behind_since_ns) = (None, None);
    }

    /// One tick of following.
    fn servo(&mut self, now_ns: u64, order: &Order) {
        let Some(seen) = &self.seen else { return };
        let is_blind = now_ns.saturating_sub(seen.at_ns) > BLIND_NS;
        let num_on_the_way = self.asked.iter().filter(|asked| asked.register == SERVO_JOINTS).count();
        let ahead = |joint: usize| self.follower.at_rad()[joint] - seen.joints_rad[joint];
        let behind = (0..self.joints.len())
            .find(|&joint| ahead(joint).abs() > LEAD_RAD + LEAD_S * self.limits.rad_per_sec[joint]);
        if let Some(joint) = behind.filter(|_| !is_blind) {
            let since_ns = *self.is_behind_since_ns.get_or_insert(now_ns);
            if now_ns.saturating_sub(since_ns) > STUCK_NS {
                let problem = format!(
                    "{} does not follow: it is {:.2} rad from where it was told to be; free the arm, disarm and arm \
                     again",
                    self.joints[joint],
                    ahead(joint).abs()
                );
                self.fail(now_ns, Fault::Passing(problem));
                return;
            }
        } else {
            self.is_behind_since_ns = None;
        }
        if is_blind || behind.is_some() {
            // The next step begins here, at rest.
            self.follower.hold(now_ns);
            self.followed_ns = None;
            return;
        }
        if num_on_the_way >= MOST_TARGETS_ON_THE_WAY {
            return;
        }
        if self.followed_ns != Some(order.valid_until_ns) {
            self.followed_ns = Some(order.valid_until_ns);
            self.follower.aim(now_ns, &order.joints_rad);
        }
        let at_rad = self.follower.step(now_ns);
        let mut joint_rad = [0.0; NUM_JOINT_SLOTS];
        for (slot, at_rad) in joint_rad.iter_mut().zip(at_rad) {
            *slot = *at_rad;
        }
        self.ask(
            now_ns,
            &Command::ServoJoints {
                joint_rad,
                speed_rad_per_sec: 0.0,
                acc_rad_per_sec2: 0.0,
                time_secs: 0.0,
            },
        );
    }

    fn stop(&mut self, now_ns: u64) {
        self.phase = Phase::Stopping { since_ns: now_ns, sent_ns: None };
        self.keep_stopping(now_ns, now_ns, None);
    }

    fn keep_stopping(&mut self, now_ns: u64, since_ns: u64, mut sent_ns: Option<u64>) {
        let seen = self.seen.as_ref();
        let shown = seen.is_some_and(|seen| {
            sent_ns.is_some_and(|_| seen.at_ns > since_ns)
                && matches!(seen.state, state::STOPPED | state::CHANGED)
        });
        if !shown {
            if sent_ns.is_none_or(|sent_ns| now_ns.saturating_sub(sent_ns) >= STOP_AGAIN_NS) {
                self.ask(now_ns, &Command::SetState { state: state::STOPPED });
                sent_ns = Some(now_ns);
            }
            if now_ns.saturating_sub(since_ns) > STOP_FAILED_NS && self.fault.is_none() {
                let problem = "the arm does not report that it stopped; press its emergency stop";
                self.fault = Some(Fault::Passing(problem.to_owned()));
            }
        }
        // An arm that held before it was stopped has been still since then.
        let still_since_ns = self.seen.as_ref().and_then(|seen| seen.still_since_ns);
        let is_still = still_since_ns.is_some_and(|still_ns| now_ns.saturating_sub(still_ns) >= STILL_NS);
        let is_over = shown && (is_still || now_ns.saturating_sub(since_ns) >= STILL_AT_LAST_NS);
        self.phase = if is_over {
            self.ask(now_ns, &Command::MotionEnable { joint: 8, on: 0 });
            Phase::Disabling
        } else {
            Phase::Stopping { since_ns, sent_ns }
        };
    }

    /// Asks for errors and warnings.
    fn look(&mut self, now_ns: u64) {
        let command = Command::GetError {};
        self.looked_ns = Some(now_ns);
        if !self.asked.iter().any(|asked| asked.register == command.register()) {
            self.ask(now_ns, &command);
        }
    }

    fn ask(&mut self, now_ns: u64, command: &Command) {
        let transaction = self.next_transaction;
        let bytes = command.to_frame(transaction, self.protocol).and_then(|frame| frame.encode());
        match bytes {
            Ok(bytes) => {
                self.next_transaction = if transaction == u16::MAX { 1 } else { transaction + 1 };
                self.output.extend(bytes);
                self.asked.push_back(Asked { transaction, register: command.register(), at_ns: now_ns });
            }
            Err(error) => self.broken = Some(format!("a command cannot be sent: {error}")),
        }
    }
}

/// Register of targets in servo mode.
const SERVO_JOINTS: u8 = 0x1D;
