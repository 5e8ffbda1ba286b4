//! The servos of a hand: one thread that reads all of them and gives them their goals, at a steady rate.
//!
//! A cycle reads every servo, reports, decides what the newest goal means now, acts, and spends what is left on one
//! request to one servo: for its condition, or for its set-up where it was away. Answers that are missing or damaged are
//! asked for again a bounded number of times; what is not whole is not used.
//!
//! Every servo that shall have no torque is told so, whether it is believed to have any or not: in [`OFF_CYCLES`] cycles
//! in a row, every [`OFF_AGAIN_NS`] from then on, and once more when the line is let go for whatever reason.

mod arming;
mod line;
mod order;
mod plan;
mod present;
mod registers;
mod servo;
mod setup;
mod step;
mod words;

use std::path::PathBuf;
use std::time::Duration;

use palpate_device_protocol::dynamixel::control_table::{GOAL_POSITION, Model};
use palpate_device_protocol::dynamixel::{HardwareError, Instruction};
use palpate_robot_model::hardware::ServoBusConfig;

use crate::context::{BusHandle, DeviceContext, Goal, LOST_AFTER};
use crate::error::DriverError;
use crate::event::Link;
use arming::{Arming, Progress};
use line::{Line, RequestError};
use order::{Decider, Order};
use plan::BusPlan;
use present::PresentReader;
use servo::{Presence, Servo};
use setup::read_condition;
use step::SetUp;

/// Pings of a servo when the line is opened, and when it is looked for while others are driven.
const FIRST_PINGS: usize = 4;
const LATER_PINGS: usize = 1;
/// Pause between looks for a missing servo, and until a restarted one can answer, ns.
const LOOK_AGAIN_NS: u64 = 500_000_000;
const RESTART_NS: u64 = 350_000_000;
const LOOK_FOR_RESTARTED_NS: u64 = 60_000_000;
/// A servo that has not come back after this long is missing, ns.
const LONGEST_RESTART_NS: u64 = 3_000_000_000;
/// Pause before arming is tried again, ns.
const ARM_AGAIN_NS: u64 = 300_000_000;
/// Cycles in a row in which a servo is told to let go, because nobody confirms that.
const OFF_CYCLES: u32 = 5;
/// It is told again this often for as long as it shall have no torque, ns: one that could not hear may hear again.
const OFF_AGAIN_NS: u64 = 100_000_000;
/// Pause between the last requests of a line that is let go: longer than any of them takes on the line.
const FAREWELL_PAUSE: Duration = Duration::from_millis(2);
/// Times that a servo is told to restart before it is taken to have done so without its answer arriving.
const REBOOTS: u32 = 3;
/// Time that a request to one servo has to fit into before the next cycle begins, ns...
const SPARE_NS: u64 = 2_000_000;
/// ... except in every so many cycles, because a slow line has no time to spare in any.
const MAX_SKIPPED: u32 = 3;
/// How often the way to the operator is looked at for what slows it down, ns.
const LOOK_FOR_SLOWNESS_NS: u64 = 5_000_000_000;
/// More problems than this are counted, not listed.
const MAX_PROBLEMS: usize = 4;

/// Starts the thread of a line of servos on the port at `path`. Joints are held for `hold_ns` once setpoints have dried
/// up, and go limp then.
pub(crate) fn spawn(
    context: DeviceContext,
    config: &ServoBusConfig,
    path: PathBuf,
    hold_ns: u64,
) -> Result<BusHandle, DriverError> {
    let plan = BusPlan::new(config, path, hold_ns)
        .map_err(|problem| DriverError::Config { device: context.id.to_string(), problem })?;
    context.health.set_motors(plan.servos.iter().map(|servo| servo.joint.clone()));
    context.spawn(move |context| {
        context.keep_connected(
            |context| Bus::open(context, &plan),
            |context, mut bus| {
                let served = bus.serve(context).map_err(|problem| bus.lost(&problem));
                // Told before the servos are told to let go, which takes a moment: the other joints are still moving.
                context.lost(&served);
                served
            },
        );
    })
}

/// An open line with its servos. All of them are told to let go when this is dropped, also by a panic.
struct Bus<'a> {
    plan: &'a BusPlan,
    line: Line,
    servos: Vec<Servo>,
    reader: PresentReader,
    decider: Decider,
    /// Whether goals are followed; not necessarily by every servo.
    armed: bool,
    /// Torque on the way up.
    arming: Option<Arming>,
    /// Why arming failed, and until when it is not tried again.
    arm_problem: String,
    arm_again_ns: u64,
    /// Whether servos were driven in the cycle before.
    was_driving: bool,
    /// When servos without torque are told so again.
    off_again_ns: u64,
    slowness: Option<String>,
    look_for_slowness_ns: u64,
    /// Next servo whose condition is read.
    turn: usize,
    /// Whether the next request to one servo is for its condition, while others are driven.
    is_conditions_turn: bool,
    /// Cycles in a row that had no time for a request to one servo.
    num_skipped: u32,
}

impl<'a> Bus<'a> {
    /// Opens the port, finds the servos and sets them up.
    fn open(context: &DeviceContext, plan: &'a BusPlan) -> Result<Self, String> {
        let line = Line::open(&plan.path, plan.baud, &context.clock)
            .map_err(|error| words::cannot_open(&plan.path, &error))?;
        let mut bus = Self::new(context, plan, line);
        bus.find(context)?;
        Ok(bus)
    }

    fn new(context: &DeviceContext, plan: &'a BusPlan, line: Line) -> Self {
        Self {
            line,
            servos: plan.servos.iter().cloned().map(Servo::new).collect(),
            reader: PresentReader::default(),
            decider: Decider::new(plan.hold_ns, context.goals.disarms()),
            armed: false,
            arming: None,
            arm_problem: String::new(),
            arm_again_ns: 0,
            was_driving: false,
            off_again_ns: 0,
            slowness: words::slow_line(&plan.path, None),
            look_for_slowness_ns: context.clock.now_ns() + LOOK_FOR_SLOWNESS_NS,
            turn: 0,
            is_conditions_turn: false,
            num_skipped: 0,
            plan,
        }
    }

    /// Finds the servos and sets them up, one after another: nothing is driven yet.
    fn find(&mut self, context: &DeviceContext) -> Result<(), String> {
        let trouble =
            |error: RequestError| format!("{:?}: {error}: plug the adapter in again", self.plan.path);
        // They may be stiff from before, and finding all of them takes a while.
        let ids = self.ids();
        for _ in 0..OFF_CYCLES {
            arming::tell_off(&mut self.line, &ids).map_err(trouble)?;
        }
        for servo in &mut self.servos {
            servo.setup = Some(SetUp::looking(FIRST_PINGS));
            while servo.setup.is_some() && !context.stop.is_set() {
                let now_ns = context.clock.now_ns();
                setup::go_on(&mut self.line, servo, self.plan, now_ns).map_err(trouble)?;
            }
        }
        if self.servos.iter().all(|servo| matches!(servo.presence, Presence::Missing { .. })) {
            return Err(format!(
                "no servo answers on {:?} at {} baud: check the 5 V supply, the cable from the adapter to the first \
                 servo, and `baud` in the station file",
                self.plan.path, self.plan.baud
            ));
        }
        self.line.limit_waits(self.plan.period);
        self.tell(context);
        Ok(())
    }

    /// Drives the servos until the thread shall end, or the line is lost, which is told in words.
    fn serve(&mut self, context: &DeviceContext) -> Result<(), String> {
        let clock = &context.clock;
        let period_ns = u64::try_from(self.plan.period.as_nanos()).unwrap_or(u64::MAX);
        let mut next_ns = clock.now_ns();
        while !context.stop.is_set() {
            next_ns += period_ns;
            self.cycle(context, next_ns).map_err(|error| error.to_string())?;
            let now_ns = clock.now_ns();
            if now_ns.saturating_sub(self.line.heard_ns()) > LOST_AFTER.as_nanos() as u64 {
                return Err(format!("no servo has answered for {:.1} s", LOST_AFTER.as_secs_f64()));
            }
            if now_ns > next_ns + period_ns {
                // Cycles that are missed are missed: catching up would only crowd the line.
                let missed = (now_ns - next_ns) / period_ns;
                context.health.add_gaps(missed);
                next_ns += missed * period_ns;
            }
            if context.stop.wait(Duration::from_nanos(next_ns.saturating_sub(clock.now_ns()))) {
                break;
            }
        }
        let ids = self.ids();
        for _ in 0..OFF_CYCLES {
            arming::tell_off(&mut self.line, &ids).map_err(|error| error.to_string())?;
            if arming::confirm_off(&mut self.line, &mut self.servos).map_err(|error| error.to_string())? {
                break;
            }
        }
        Ok(())
    }

    /// What to do about a line that was lost.
    fn lost(&mut self, problem: &str) -> String {
        format!(
            "{:?}: {problem}: check the adapter's plug and the hand's supply; the servos stop by themselves after \
             {:.2} s",
            self.plan.path,
            self.plan.watchdog as f64 * 0.02
        )
    }

    /// Ids of all servos of the plan.
    fn ids(&self) -> Vec<u8> {
        self.plan.servos.iter().map(|servo| servo.id).collect()
    }

    /// Whether any servo has torque, or is about to get it, because a goal wants that.
    fn is_driving(&self) -> bool {
        self.armed || self.arming.is_some()
    }

    fn cycle(&mut self, context: &DeviceContext, deadline_ns: u64) -> Result<(), RequestError> {
        #[cfg(test)]
        context.panic_if_asked();
        let clock = &context.clock;
        self.reader.read(context, &mut self.line, &mut self.servos, deadline_ns)?;
        let goal = context.goals.newest();
        let now_ns = clock.now_ns();
        let order = self.decider.decide(goal.as_ref(), self.armed, now_ns);
        match order {
            Order::Limp => {
                (self.armed, self.arming) = (false, None);
                self.servos.iter_mut().for_each(|servo| servo.armed = false);
                self.arm_problem.clear();
            }
            Order::Hold => {}
            Order::Follow(goal) if self.armed => self.follow(goal)?,
            Order::Follow(goal) if now_ns >= self.arm_again_ns => self.arm(goal, now_ns)?,
            Order::Follow(_) => {}
        }
        self.let_go(now_ns)?;
        if context.take_clear_fault() {
            self.clear_faults();
        }
        self.look_after_one(context, deadline_ns)?;
        let now_ns = clock.now_ns();
        self.note_silent(now_ns);
        if now_ns >= self.look_for_slowness_ns {
            self.look_for_slowness_ns = now_ns + LOOK_FOR_SLOWNESS_NS;
            self.slowness = words::slow_line(&self.plan.path, Some(self.line.mean_delay()));
        }
        context.health.add_bad_frames(self.line.take_bad_frames());
        self.tell(context);
        Ok(())
    }

    /// Tells every servo that shall have no torque to switch it off, whether it is believed to have any or not: one whose
    /// answer was lost, one that is missing and one that restarts may hear it all the same.
    fn let_go(&mut self, now_ns: u64) -> Result<(), RequestError> {
        let is_again = now_ns >= self.off_again_ns;
        if is_again {
            self.off_again_ns = now_ns + OFF_AGAIN_NS;
        }
        let is_driving = self.is_driving();
        if std::mem::replace(&mut self.was_driving, is_driving) && !is_driving {
            // Also those that were not driven with the others.
            self.servos.iter_mut().for_each(|servo| servo.offs_left = OFF_CYCLES);
        }
        let mut ids = Vec::with_capacity(self.servos.len());
        for (idx, servo) in self.servos.iter_mut().enumerate() {
            let is_driven = self.armed && servo.armed;
            if is_driven || self.arming.as_ref().is_some_and(|arming| arming.includes(idx)) {
                servo.offs_left = OFF_CYCLES;
            } else if is_again || servo.offs_left > 0 {
                servo.offs_left = servo.offs_left.saturating_sub(1);
                ids.push(servo.plan.id);
            }
        }
        arming::tell_off(&mut self.line, &ids)?;
        if !self.is_driving() {
            // What is not confirmed now is asked again in the next cycle.
            let _confirmed = arming::confirm_off(&mut self.line, &mut self.servos)?;
        }
        Ok(())
    }

    /// One attempt to switch torque on.
    fn arm(&mut self, goal: &Goal, now_ns: u64) -> Result<(), RequestError> {
        let mut arming = self.arming.take().unwrap_or_else(|| Arming::new(&self.servos));
        match arming.go_on(&mut self.line, &mut self.servos, self.plan, &goal.positions, now_ns)? {
            Progress::GoesOn => self.arming = Some(arming),
            Progress::Armed => {
                self.armed = true;
                self.arm_problem.clear();
            }
            Progress::Failed(problem) => {
                self.servos.iter_mut().for_each(|servo| servo.armed = false);
                self.arm_problem = format!("not armed: {problem}");
                self.arm_again_ns = now_ns + ARM_AGAIN_NS;
            }
        }
        Ok(())
    }

    /// Gives every armed servo its goal. If one has stopped by itself, the others do not go on without it.
    fn follow(&mut self, goal: &Goal) -> Result<(), RequestError> {
        if self.servos.iter().any(|servo| servo.is_ready() && servo.watchdog_tripped) {
            return Ok(());
        }
        let armed = self.servos.iter().filter(|servo| servo.is_ready() && servo.armed);
        let goals = armed
            .filter_map(|servo| {
                // The safety layer gives only numbers; without one the servo keeps its last goal.
                let joint_rad = *goal.positions.get(servo.plan.dof)?;
                Some((servo.plan.id, servo.plan.goal_bytes(joint_rad).ok()?))
            })
            .collect();
        self.line.sync_write(GOAL_POSITION.address, goals)
    }

    /// The servos that have tripped, and only those, restart; they are set up again once they answer.
    fn clear_faults(&mut self) {
        for servo in &mut self.servos {
            let has_tripped = servo.is_ready() && servo.hardware_error != HardwareError(0);
            if has_tripped || servo.presence == Presence::Unusable {
                servo.reboots_left = REBOOTS;
            }
        }
    }

    /// Sends one request to one servo: to restart, to go on with the set-up of one that was away, or for the condition
    /// of one that is there. While nothing is driven, set-ups take all of the cycle.
    fn look_after_one(&mut self, context: &DeviceContext, deadline_ns: u64) -> Result<(), RequestError> {
        let is_short = context.clock.now_ns() + SPARE_NS > deadline_ns;
        // Right after a stop nothing is worth a late word to those that shall let go.
        let lets_go = self.servos.iter().any(|servo| servo.offs_left > 0 && servo.offs_left < OFF_CYCLES);
        if is_short && (lets_go || self.num_skipped < MAX_SKIPPED) {
            self.num_skipped += 1;
            return Ok(());
        }
        self.num_skipped = 0;
        if self.restart_one(context.clock.now_ns())? {
            return Ok(());
        }
        let is_driving = self.is_driving();
        // Whoever is away for long does not keep the others' conditions from being read.
        self.is_conditions_turn = is_driving && !self.is_conditions_turn;
        if self.is_conditions_turn {
            return self.read_one(context.clock.now_ns());
        }
        let mut num_asked = 0;
        while let Some(idx) = self.next_to_set_up(context.clock.now_ns()) {
            let now_ns = context.clock.now_ns();
            setup::go_on(&mut self.line, &mut self.servos[idx], self.plan, now_ns)?;
            num_asked += 1;
            if is_driving || context.clock.now_ns() + SPARE_NS > deadline_ns {
                break;
            }
        }
        if num_asked == 0 { self.read_one(context.clock.now_ns()) } else { Ok(()) }
    }

    /// Restarts a servo of which that was asked, if there is one.
    fn restart_one(&mut self, now_ns: u64) -> Result<bool, RequestError> {
        let Some(servo) = self.servos.iter_mut().find(|servo| servo.reboots_left > 0) else {
            return Ok(false);
        };
        match self.line.ask(servo.plan.id, Instruction::Reboot) {
            Err(error @ RequestError::Port(_)) => return Err(error),
            Err(RequestError::Silent { .. }) => servo.reboots_left -= 1,
            _ => servo.reboots_left = 0,
        }
        if servo.reboots_left == 0 {
            // One that restarted without its answer arriving is silent, too.
            (servo.armed, servo.torque_on, servo.setup) = (false, false, None);
            servo.presence = Presence::Restarting { look_ns: now_ns + RESTART_NS, since_ns: now_ns };
        }
        Ok(true)
    }

    /// The servo whose set-up goes on or begins now.
    fn next_to_set_up(&mut self, now_ns: u64) -> Option<usize> {
        if let Some(idx) = self.servos.iter().position(|servo| servo.setup.is_some()) {
            return Some(idx);
        }
        let idx = self.servos.iter().position(|servo| match servo.presence {
            Presence::Restarting { look_ns, .. } | Presence::Missing { look_ns } => look_ns <= now_ns,
            Presence::Ready | Presence::Unusable => false,
        })?;
        let servo = &mut self.servos[idx];
        servo.presence = match servo.presence {
            Presence::Restarting { since_ns, .. } if now_ns - since_ns < LONGEST_RESTART_NS => {
                Presence::Restarting { look_ns: now_ns + LOOK_FOR_RESTARTED_NS, since_ns }
            }
            _ => Presence::Missing { look_ns: now_ns + LOOK_AGAIN_NS },
        };
        (servo.armed, servo.torque_on) = (false, false);
        servo.setup = Some(SetUp::looking(LATER_PINGS));
        Some(idx)
    }

    /// Reads the condition of one servo that is there.
    fn read_one(&mut self, now_ns: u64) -> Result<(), RequestError> {
        let num = self.servos.len();
        let ready = |idx: &usize| self.servos[*idx].is_ready();
        let in_turn = (0..num).map(|step| (self.turn + step) % num);
        let urgent = (0..num).find(|&idx| ready(&idx) && self.servos[idx].is_urgent);
        let Some(idx) = urgent.or_else(|| in_turn.clone().find(ready)) else { return Ok(()) };
        self.turn = (idx + 1) % num;
        let servo = &mut self.servos[idx];
        match read_condition(&mut self.line, servo.plan.id) {
            Ok(condition) => {
                let was_armed = servo.armed;
                let lost_settings = servo.note(&condition, self.plan.current_limit_ma);
                self.reader.note_condition(idx, &condition);
                if lost_settings
                    || (was_armed && !servo.torque_on && servo.hardware_error == HardwareError(0))
                {
                    // It had no power for a moment: as it is, it would move with other gains and currents.
                    tracing::warn!(servo = %servo.plan.name(), "lost its settings; it is set up again, without torque");
                    (servo.armed, servo.presence) = (false, Presence::Missing { look_ns: now_ns });
                }
                Ok(())
            }
            Err(error @ RequestError::Port(_)) => Err(error),
            // The reading of all servos finds out whether it is gone.
            Err(_) => Ok(()),
        }
    }

    /// Servos that nobody has heard of for too long are missing.
    fn note_silent(&mut self, now_ns: u64) {
        for servo in self.servos.iter_mut().filter(|servo| servo.is_ready()) {
            if now_ns.saturating_sub(servo.heard_ns) > LOST_AFTER.as_nanos() as u64 {
                (servo.armed, servo.torque_on) = (false, false);
                servo.presence = Presence::Missing { look_ns: now_ns + LOOK_AGAIN_NS };
            }
        }
    }

    /// Tells operators how the line and its servos are.
    fn tell(&mut self, context: &DeviceContext) {
        let problems: Vec<String> = self.servos.iter().map(Servo::problem).collect();
        // What has befallen several servos is said once.
        let mut befallen: Vec<(&str, Vec<String>)> = Vec::new();
        for (servo, problem) in self.servos.iter().zip(&problems).filter(|(_, problem)| !problem.is_empty()) {
            match befallen.iter_mut().find(|(other, _)| other == problem) {
                Some((_, names)) => names.push(servo.plan.name()),
                None => befallen.push((problem, vec![servo.plan.name()])),
            }
        }
        let mut named: Vec<String> = befallen
            .iter()
            .take(MAX_PROBLEMS)
            .map(|(problem, names)| match &names[..] {
                [first, _, _, ..] => format!("{} servos, {first} the first: {problem}", names.len()),
                names => format!("{}: {problem}", names.join(" and ")),
            })
            .collect();
        if befallen.len() > named.len() {
            named.push(format!("and {} more problems", befallen.len() - named.len()));
        }
        if !self.arm_problem.is_empty() {
            named.push(self.arm_problem.clone());
        }
        let link = if named.is_empty() { Link::Ready } else { Link::Fault };
        named.extend(self.slowness.clone());
        context.health.motors(|motors| {
            for ((motor, servo), problem) in motors.iter_mut().zip(&self.servos).zip(problems) {
                if motor.problem != problem {
                    motor.problem = problem;
                }
                if let (true, Some(identity)) = (motor.identity.is_empty(), servo.identity) {
                    motor.identity = model_name(identity.model, identity.firmware);
                }
            }
        });
        self.reader.tell(context);
        context.link(link, named.join("\n"));
    }
}

impl Drop for Bus<'_> {
    /// The thread ends, the line is lost, or something panicked. What is believed of the servos does not matter here.
    fn drop(&mut self) {
        let ids = self.ids();
        for _ in 0..OFF_CYCLES {
            if arming::tell_off(&mut self.line, &ids).is_err() {
                // The port is gone; the servos stop by their own watchdog.
                break;
            }
            std::thread::sleep(FAREWELL_PAUSE);
        }
    }
}

fn model_name(model: u16, firmware: u8) -> String {
    match Model::from_number(model) {
        Some(Model::Xl330M288) => format!("XL330-M288, firmware {firmware}"),
        Some(Model::Xc330M288) => format!("XC330-M288, firmware {firmware}"),
        None => format!("model {model}, firmware {firmware}"),
    }
}

#[cfg(test)]
mod own_time_tests;
#[cfg(all(test, unix))]
mod tests;
