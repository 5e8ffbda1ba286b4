//! What the driver knows about one servo.

use palpate_device_protocol::dynamixel::{HardwareError, PingReply};

use super::plan::ServoPlan;
use super::registers::Condition;
use super::step::SetUp;
use super::words;

/// No joint of the hand turns faster, rad/s: the no-load speed of its servos is 8.5.
const MAX_SPEED_RAD_PER_SEC: f64 = 12.0;
/// And what a reading may be off besides, rad.
const MAX_JUMP_RAD: f64 = 0.2;

/// One servo of the line.
#[derive(Clone, Debug)]
pub(crate) struct Servo {
    pub(crate) plan: ServoPlan,
    pub(crate) presence: Presence,
    /// What it said about itself.
    pub(crate) identity: Option<PingReply>,
    /// Whether its torque is on, as it last said itself.
    pub(crate) torque_on: bool,
    /// Whether it was told to switch its torque on and has not said since that it is off.
    pub(crate) told_on: bool,
    /// Whether the driver has armed it, so that it gets goals.
    pub(crate) armed: bool,
    /// Cycles in which it is still told to switch its torque off, whatever is believed of it.
    pub(crate) offs_left: u32,
    /// Its set-up, where one is under way.
    pub(crate) setup: Option<SetUp>,
    /// How often it may still be told to restart, which was asked for.
    pub(crate) reboots_left: u32,
    pub(crate) hardware_error: HardwareError,
    /// Stopped because the line was silent.
    pub(crate) watchdog_tripped: bool,
    /// Why it could not be set up; empty if it could.
    pub(crate) setup_problem: String,
    /// Its condition is to be read before those of others.
    pub(crate) is_urgent: bool,
    /// When a whole answer last came.
    pub(crate) heard_ns: u64,
    /// Position believed last, and when.
    believed: Option<(f64, u64)>,
    /// A position that was not believed, and when.
    doubted: Option<(f64, u64)>,
}

/// Whether a servo can be talked to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Presence {
    /// Answers and is set up.
    Ready,
    /// Restarts; is looked for from this time on.
    Restarting { look_ns: u64, since_ns: u64 },
    /// Does not answer; is looked for at this time.
    Missing { look_ns: u64 },
    /// Answers, and is not driven, because it is not what is expected or refuses to be set up.
    Unusable,
}

impl Servo {
    pub(crate) fn new(plan: ServoPlan) -> Self {
        Self {
            plan,
            presence: Presence::Missing { look_ns: 0 },
            identity: None,
            torque_on: false,
            told_on: false,
            armed: false,
            offs_left: 0,
            setup: None,
            reboots_left: 0,
            hardware_error: HardwareError(0),
            watchdog_tripped: false,
            setup_problem: String::new(),
            is_urgent: false,
            heard_ns: 0,
            believed: None,
            doubted: None,
        }
    }

    pub(crate) fn is_ready(&self) -> bool {
        self.presence == Presence::Ready
    }

    /// Whether a position that was read can be: joints do not jump. A second reading that agrees with the first is
    /// believed whatever it says, because the servo may have restarted.
    pub(crate) fn believes(&mut self, position_rad: f64, at_ns: u64) -> bool {
        let agrees = |(earlier_rad, earlier_ns): (f64, u64)| {
            let dt_s = at_ns.saturating_sub(earlier_ns) as f64 * 1e-9;
            (position_rad - earlier_rad).abs() <= MAX_JUMP_RAD + MAX_SPEED_RAD_PER_SEC * dt_s
        };
        if self.believed.is_none_or(agrees) || self.doubted.is_some_and(agrees) {
            self.believed = Some((position_rad, at_ns));
            self.doubted = None;
            true
        } else {
            self.doubted = Some((position_rad, at_ns));
            false
        }
    }

    /// The servo angle that was believed last, if that was at most `max_age_ns` ago.
    pub(crate) fn position_rad(&self, now_ns: u64, max_age_ns: u64) -> Option<f64> {
        let (position_rad, at_ns) = self.believed?;
        (now_ns.saturating_sub(at_ns) <= max_age_ns).then_some(position_rad)
    }

    /// What was known of its position is void: it was set up anew.
    pub(crate) fn forget_position(&mut self) {
        (self.believed, self.doubted) = (None, None);
    }

    /// Takes in what the servo says about itself. `true` if it has lost what it was set up with, as after a loss of
    /// power.
    pub(crate) fn note(&mut self, condition: &Condition, current_limit_ma: i64) -> bool {
        self.torque_on = condition.torque_on;
        self.hardware_error = condition.hardware_error;
        self.watchdog_tripped = condition.watchdog_tripped;
        self.is_urgent = false;
        if !condition.torque_on {
            self.armed = false;
        }
        let gains = [condition.p, condition.i, condition.d];
        gains != [self.plan.p, self.plan.i, self.plan.d].map(i64::from)
            || condition.goal_current_ma != current_limit_ma
    }

    /// What is wrong, with what to do; empty when all is well.
    pub(crate) fn problem(&self) -> String {
        match self.presence {
            Presence::Missing { .. } => words::missing().to_owned(),
            Presence::Restarting { .. } => "is restarting".to_owned(),
            Presence::Unusable => self.setup_problem.clone(),
            Presence::Ready if self.hardware_error != HardwareError(0) => {
                words::hardware_error(self.hardware_error)
            }
            // Limp, it is in nobody's way: the next arming clears it.
            Presence::Ready if self.watchdog_tripped && self.torque_on => {
                "stopped itself because the line was silent for too long: disarm, and arm again".to_owned()
            }
            Presence::Ready => String::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn servo() -> Servo {
        let joint = "index_pip".to_owned();
        let plan = ServoPlan { joint, dof: 0, id: 2, zero_rad: 3.0, direction: 1.0, p: 600, i: 0, d: 200 };
        Servo { presence: Presence::Ready, ..Servo::new(plan) }
    }

    #[test]
    fn a_position_that_no_joint_can_reach_is_believed_only_when_it_is_read_again() {
        let mut servo = servo();
        assert!(servo.believes(3.0, 0) && servo.believes(3.08, 10 * MS));
        assert!(!servo.believes(5.0, 20 * MS), "no joint jumps by 2 rad in 10 ms");
        assert!(servo.believes(3.1, 30 * MS), "and that was not believed in any way");
        assert!(!servo.believes(-1.0, 40 * MS));
        assert!(!servo.believes(7.0, 50 * MS), "two wild readings that differ");
        assert!(servo.believes(7.01, 60 * MS), "the same again: the servo counts anew");
        assert_eq!(servo.position_rad(65 * MS, 10 * MS), Some(7.01));
        assert_eq!(servo.position_rad(80 * MS, 10 * MS), None);
    }
}
