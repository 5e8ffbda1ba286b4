//! What a trial came to, as the robot's own senses have it. A person decides.
//!
//! No camera looks, so two things stand for "it has the object": digits that are stopped far from where they are told to be (a
//! hand that closed on nothing gets there), and the hand's height. That channels feel something is a reason to believe it, and
//! no condition: a grip may hold where no taxel is, or too softly for one.

use palpate_grasp::GraspConfig;
use palpate_grasp::scene::digits;
use palpate_messages::bits;
use palpate_robot_model::Station;
pub use palpate_wire::api::TrialVerdict;
use palpate_wire::proto::LiveFrame;
use palpate_wire::proto::control_state::Phase;
use palpate_wire::proto::device_status::Link;

/// A joint of a digit that is this far from where it is told to be is stopped by something, rad: with the shipped gains a
/// servo pulls with all the current that it is allowed (0.3 A) from 0.1 rad on.
const STOPPED_RAD: f64 = 0.12;
/// So many digits that are stopped make a grip, as one alone holds nothing.
const GRIP_DIGITS: u32 = 2;

/// They are stopped and not merely behind when that lasts so long, s.
const GRIP_S: f64 = 0.5;
/// A trial goes on for so long after something was held for long enough, s: whoever looks from outside sees it held, too, though
/// the hand rises before what it holds does.
const LOOK_S: f64 = 1.0;

/// Why a trial ended before its time.
#[derive(Clone, Debug, PartialEq)]
pub enum Break {
    /// The station stopped or let go, for this reason.
    Station(String),
    /// Anything that says nothing of the policy.
    Void(String),
}

/// Watches a trial, frame by frame.
#[derive(Clone, Debug)]
pub struct Watch {
    /// By degree of freedom, its digit.
    digit_of_dof: Vec<Option<usize>>,
    hand_root: usize,
    lift_m: f64,
    hold_s: f64,
    lowest_m: f64,
    num_channels: usize,
    last_s: Option<f64>,
    channels_touched: usize,
    /// Since when there has been a grip.
    grip_from_s: Option<f64>,
    time_to_grasp_s: Option<f64>,
    held_s: f64,
    longest_held_s: f64,
    is_raised: bool,
    current_a: f64,
}

/// What a [`Watch`] has to say.
#[derive(Clone, Debug, PartialEq)]
pub struct Suggestion {
    /// How it would count the trial.
    pub verdict: TrialVerdict,
    /// Why.
    pub reasons: Vec<String>,
    /// When enough digits were first stopped on something, s; `None` if they never were.
    pub time_to_grasp_s: Option<f64>,
    /// The longest time for which something was held in the air, s.
    pub held_s: f64,
}

impl Watch {
    /// Of a trial that begins.
    pub fn new(station: &Station, world: &GraspConfig) -> Self {
        let of_link = digits(&station.robot, world);
        Self {
            digit_of_dof: station.robot.dofs().map(|joint| of_link[joint.child_link]).collect(),
            hand_root: station.robot.link_index(&world.hand_root).unwrap_or(0),
            lift_m: world.task.lift_m,
            hold_s: world.task.hold_s,
            lowest_m: f64::INFINITY,
            num_channels: station.layout.num_channels(),
            last_s: None,
            channels_touched: 0,
            grip_from_s: None,
            time_to_grasp_s: None,
            held_s: 0.0,
            longest_held_s: 0.0,
            is_raised: false,
            current_a: 0.0,
        }
    }

    /// Takes in what the stream said `time_s` after the trial began. Whether the object has been held for so long that
    /// nothing more is to be seen.
    pub fn look(&mut self, station: &Station, time_s: f64, live: &LiveFrame) -> bool {
        let positions: Vec<f64> = live.joint_positions.iter().map(|&position| f64::from(position)).collect();
        let commanded = live.control.as_ref().map(|control| control.commanded.as_slice()).unwrap_or_default();
        if positions.len() != self.digit_of_dof.len() || commanded.len() != positions.len() {
            return false;
        }
        let since_s = self.last_s.map_or(0.0, |last_s| (time_s - last_s).max(0.0));
        self.last_s = Some(time_s);
        let num_active = (0..self.num_channels).filter(|&channel| bits::get(&live.active, channel)).count();
        self.channels_touched = self.channels_touched.max(num_active);
        let stopped = self.digit_of_dof.iter().zip(positions.iter().zip(commanded));
        let stopped = stopped.filter(|(_, (at, told))| (*at - f64::from(**told)).abs() > STOPPED_RAD);
        let digits =
            stopped.filter_map(|(digit, _)| *digit).fold(0_u64, |all, digit| all | (1 << (digit % 64)));
        let has_grip = digits.count_ones() >= GRIP_DIGITS;
        self.grip_from_s = has_grip.then_some(self.grip_from_s.unwrap_or(time_s));
        let lasting = self.grip_from_s.filter(|from_s| time_s - from_s >= GRIP_S);
        self.time_to_grasp_s = self.time_to_grasp_s.or(lasting);
        let mut frames = Vec::new();
        station.robot.forward_kinematics(&positions, &mut frames);
        let height_m = frames[self.hand_root].translation.z;
        self.lowest_m = self.lowest_m.min(height_m);
        self.is_raised = height_m >= self.lowest_m + self.lift_m;
        self.held_s = if has_grip && self.is_raised { self.held_s + since_s } else { 0.0 };
        self.longest_held_s = self.longest_held_s.max(self.held_s);
        let motors =
            live.control.iter().flat_map(|control| &control.devices).flat_map(|device| &device.motors);
        self.current_a = motors.map(|motor| f64::from(motor.current_a.abs())).sum();
        self.held_s >= self.hold_s + LOOK_S
    }

    /// Joint targets of the arm at which the hand was lowest are where an object is let go.
    pub fn lowest_m(&self) -> f64 {
        self.lowest_m
    }

    /// What it comes to, if it was not broken off.
    pub fn suggest(&self, broken: Option<&Break>) -> Suggestion {
        let mut reasons = Vec::new();
        let verdict = match broken {
            Some(Break::Void(why)) => {
                reasons.push(why.clone());
                TrialVerdict::Void
            }
            Some(Break::Station(why)) => {
                reasons.push(why.clone());
                TrialVerdict::EmergencyStop
            }
            None if self.longest_held_s >= self.hold_s => TrialVerdict::Success,
            None if self.longest_held_s > 0.0 => TrialVerdict::Slip,
            None => TrialVerdict::EmptyGrasp,
        };
        reasons.push(match self.channels_touched {
            0 => "no channel felt anything: look before you count it".to_owned(),
            1 => "1 channel felt something at most at a time".to_owned(),
            channels => format!("{channels} channels felt something at most at a time"),
        });
        reasons.push(match self.time_to_grasp_s {
            None => format!("never were {GRIP_DIGITS} digits stopped on their way"),
            Some(at_s) => format!("{GRIP_DIGITS} digits were stopped on their way from {at_s:.2} s on"),
        });
        if self.longest_held_s > 0.0 {
            let mm = 1e3 * self.lift_m;
            reasons.push(format!("gripped and raised by {mm:.0} mm for {:.2} s", self.longest_held_s));
        }
        reasons.push(format!("servos drew {:.2} A together at the end", self.current_a));
        let held_s = self.longest_held_s;
        Suggestion { verdict, reasons, time_to_grasp_s: self.time_to_grasp_s, held_s }
    }
}

/// Why the station does not follow any more, if it does not: it stopped, let go, or holds.
pub fn not_following(live: &LiveFrame) -> Option<String> {
    let control = live.control.as_ref()?;
    let fault = control.devices.iter().find(|device| matches!(device.link(), Link::Fault | Link::Lost));
    match control.phase() {
        Phase::Armed => None,
        // It holds for as long as something is wrong, and then follows again.
        Phase::Holding | Phase::Arming => None,
        phase => {
            let word = crate::record::phase_word(phase);
            let fault =
                fault.map(|device| format!("; {}: {}", device.id, device.problem)).unwrap_or_default();
            Some(format!("the station is {word}: {}{fault}", control.reason))
        }
    }
}

/// A device that is lost while the station still follows: a policy that does not feel what it was trained to feel is not tried.
pub fn lost_device(live: &LiveFrame) -> Option<String> {
    let mut devices = live.control.iter().flat_map(|control| &control.devices);
    let lost = devices.find(|device| device.link() == Link::Lost)?;
    Some(format!("{} is lost: {}", lost.id, lost.problem))
}

#[cfg(test)]
mod tests;
