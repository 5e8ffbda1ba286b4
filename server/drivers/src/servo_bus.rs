//! The servos of a hand: one thread that reads all of them and gives them their goals, at a steady rate.
//!
//! A cycle reads every servo, reports, decides what the newest goal means now, acts, and spends what is left on the
//! condition of one servo. Answers that are missing or damaged are asked for again a bounded number of times; what
//! is not whole is not used.

mod arming;
mod line;
mod order;
mod plan;
mod present;
mod registers;
mod servo;
mod setup;
mod words;

use std::path::PathBuf;
use std::time::Duration;

use palpate_device_protocol::dynamixel::control_table::{GOAL_POSITION, Model};
use palpate_device_protocol::dynamixel::{HardwareError, Instruction};
use palpate_robot_model::hardware::ServoBusConfig;

use crate::context::{BusHandle, DeviceContext, Goal, LOST_AFTER};
use crate::error::DriverError;
use crate::event::Link;
use line::{Line, RequestError};
use order::{Decider, Order};
use plan::BusPlan;
use present::PresentReader;
use servo::{Presence, Servo};
use setup::{find_and_set_up, read_condition};

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
/// How often the way to the operator is looked at for what slows it down, ns.
const LOOK_FOR_SLOWNESS_NS: u64 = 5_000_000_000;
/// More problems than this are counted, not listed.
const MOST_PROBLEMS: usize = 4;

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
            |context, mut bus| bus.serve(context).map_err(|problem| bus.lost(&problem)),
        );
    })
}

/// An open line with its servos.
struct Bus<'a> {
    plan: &'a BusPlan,
    line: Line,
    servos: Vec<Servo>,
    reader: PresentReader,
    decider: Decider,
    /// Whether goals are followed; not necessarily by every servo.
    armed: bool,
    /// Why arming failed, and until when it is not tried again.
    arm_problem: String,
    arm_again_ns: u64,
    slowness: Option<String>,
    look_for_slowness_ns: u64,
    /// Next servo whose condition is read.
    turn: usize,
}

impl<'a> Bus<'a> {
    /// Opens the port, finds the servos and sets them up.
    fn open(context: &DeviceContext, plan: &'a BusPlan) -> Result<Self, String> {
        let line = Line::open(&plan.path, plan.baud, &context.clock)
            .map_err(|error| words::cannot_open(&plan.path, &error))?;
        let mut bus = Self {
            line,
            servos: plan.servos.iter().cloned().map(Servo::new).collect(),
            reader: PresentReader::default(),
            decider: Decider::new(plan.hold_ns),
            armed: false,
            arm_problem: String::new(),
            arm_again_ns: 0,
            slowness: words::slow_line(&plan.path, None),
            look_for_slowness_ns: context.clock.now_ns() + LOOK_FOR_SLOWNESS_NS,
            turn: 0,
            plan,
        };
        for servo in &mut bus.servos {
            let now_ns = context.clock.now_ns();
            find_and_set_up(&mut bus.line, servo, plan, now_ns, FIRST_PINGS)
                .map_err(|error| format!("{:?}: {error}: plug the adapter in again", plan.path))?;
            if context.stop.is_set() {
                break;
            }
        }
        if bus.servos.iter().all(|servo| matches!(servo.presence, Presence::Missing { .. })) {
            return Err(format!(
                "no servo answers on {:?} at {} baud: check the 5 V supply, the cable from the adapter to the first \
                 servo, and `baud` in the station file",
                plan.path, plan.baud
            ));
        }
        // A request to clear faults that came before there was anybody to clear them is void.
        let _void = context.take_clear_fault();
        bus.tell(context);
        Ok(bus)
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
        // A servo that does not hear this stops by its own watchdog.
        let _unheard = arming::go_limp(&mut self.line, &mut self.servos, 5);
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

    fn cycle(&mut self, context: &DeviceContext, deadline_ns: u64) -> Result<(), RequestError> {
        let clock = &context.clock;
        self.reader.read(context, &mut self.line, &mut self.servos, deadline_ns)?;
        let goal = context.goals.newest();
        let now_ns = clock.now_ns();
        match self.decider.decide(goal.as_ref(), self.armed, now_ns) {
            Order::Limp => self.go_limp()?,
            Order::Hold => {}
            Order::Follow(goal) if self.armed => self.follow(goal)?,
            Order::Follow(goal) if now_ns >= self.arm_again_ns => self.arm(goal, now_ns)?,
            Order::Follow(_) => {}
        }
        if context.take_clear_fault() {
            self.clear_faults(now_ns)?;
        }
        self.look_after_one(now_ns)?;
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

    fn go_limp(&mut self) -> Result<(), RequestError> {
        let was_armed = std::mem::take(&mut self.armed);
        if was_armed || self.servos.iter().any(|servo| servo.is_ready() && servo.torque_on) {
            // What is not confirmed now is tried again in the next cycle.
            let _confirmed = arming::go_limp(&mut self.line, &mut self.servos, 2)?;
        }
        self.arm_problem.clear();
        Ok(())
    }

    fn arm(&mut self, goal: &Goal, now_ns: u64) -> Result<(), RequestError> {
        match arming::arm(&mut self.line, &mut self.servos, self.plan, &goal.positions, now_ns)? {
            Ok(()) => {
                self.armed = true;
                self.arm_problem.clear();
            }
            Err(problem) => {
                self.go_limp()?;
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

    /// Restarts the servos that have tripped, and only those; they are set up again once they answer.
    fn clear_faults(&mut self, now_ns: u64) -> Result<(), RequestError> {
        for servo in &mut self.servos {
            let tripped = servo.is_ready() && servo.hardware_error != HardwareError(0);
            if !tripped && servo.presence != Presence::Unusable {
                continue;
            }
            // One that restarted without its answer arriving is silent, too.
            if let Err(error @ RequestError::Port(_)) = self.line.ask(servo.plan.id, Instruction::Reboot) {
                return Err(error);
            }
            (servo.armed, servo.torque_on) = (false, false);
            servo.presence = Presence::Restarting { look_ns: now_ns + RESTART_NS, since_ns: now_ns };
        }
        Ok(())
    }

    /// Looks for one servo that is away, or else reads the condition of one that is there.
    fn look_after_one(&mut self, now_ns: u64) -> Result<(), RequestError> {
        let due = |servo: &&mut Servo| match servo.presence {
            Presence::Restarting { look_ns, .. } | Presence::Missing { look_ns } => look_ns <= now_ns,
            Presence::Ready | Presence::Unusable => false,
        };
        if let Some(servo) = self.servos.iter_mut().find(due) {
            servo.presence = match servo.presence {
                Presence::Restarting { since_ns, .. } if now_ns - since_ns < LONGEST_RESTART_NS => {
                    Presence::Restarting { look_ns: now_ns + LOOK_FOR_RESTARTED_NS, since_ns }
                }
                _ => Presence::Missing { look_ns: now_ns + LOOK_AGAIN_NS },
            };
            return find_and_set_up(&mut self.line, servo, self.plan, now_ns, LATER_PINGS);
        }
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
                    servo.presence = Presence::Missing { look_ns: now_ns };
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
            .take(MOST_PROBLEMS)
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

fn model_name(model: u16, firmware: u8) -> String {
    match Model::from_number(model) {
        Some(Model::Xl330M288) => format!("XL330-M288, firmware {firmware}"),
        Some(Model::Xc330M288) => format!("XC330-M288, firmware {firmware}"),
        None => format!("model {model}, firmware {firmware}"),
    }
}

#[cfg(all(test, unix))]
mod tests;
