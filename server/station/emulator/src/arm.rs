//! The arm and its control box: state, errors, settings and motion.

mod commands;
mod kinematics;
mod motion;
mod report;

use std::collections::VecDeque;

use nalgebra::Isometry3;
use palpate_device_protocol::xarm::{NUM_JOINT_SLOTS, Pose, StateFlags};

use super::control::{ArmSnapshot, Hand, Push};
pub(crate) use kinematics::ArmModel;
use kinematics::from_pose;
use motion::{MOST_RAD_PER_SEC, Move, Track, chase, ramp};
pub use report::ReportPort;

/// Axes, type, serial numbers and firmware, as the box says them.
pub(crate) const VERSION: &str = "6,6,XI1202,AC1302,v1.12.10";
/// Serial numbers of arm and box.
pub(crate) const SERIAL: (&str, &str) = ("XI120204201B02", "AC130202B02L02");

/// States that the box reports.
pub(crate) mod state {
    pub(crate) const MOVING: u8 = 1;
    pub(crate) const READY: u8 = 2;
    pub(crate) const PAUSED: u8 = 3;
    pub(crate) const STOPPED: u8 = 4;
    pub(crate) const CHANGED: u8 = 5;
}

/// Modes that are emulated.
pub(crate) mod mode {
    pub(crate) const POSITION: u8 = 0;
    pub(crate) const SERVO: u8 = 1;
    pub(crate) const LEAD_THROUGH: u8 = 2;
    pub(crate) const JOINT_VELOCITY: u8 = 4;
}

/// Error codes of the box.
pub(crate) mod error {
    pub(crate) const EMERGENCY_STOP: u8 = 1;
    pub(crate) const KINEMATICS: u8 = 21;
    pub(crate) const JOINT_LIMIT: u8 = 23;
    pub(crate) const COLLISION: u8 = 31;
    pub(crate) const BOUNDARY: u8 = 35;
}

/// Warning codes of the box.
pub(crate) mod warning {
    pub(crate) const QUEUE_FULL: u8 = 11;
    pub(crate) const BAD_PARAMETER: u8 = 12;
    pub(crate) const UNKNOWN_COMMAND: u8 = 13;
}

/// Most commands in the queue.
const MOST_QUEUED: usize = 2048;
/// Steps between two looks at the workspace box.
const BOUNDARY_STEPS: u32 = 20;
/// Friction of a joint that does not depend on its speed, N m, and in proportion to it, N m s; its reflected inertia,
/// kg m2; torque per current, N m/A. The first two are those of the vendor's URDF, the others of that size. Gravity is
/// not part of the efforts that the box reports here.
const COULOMB_NM: f64 = 1.0;
const VISCOUS_NM_S: f64 = 1.0;
const INERTIA_KG_M2: f64 = 0.3;
const TORQUE_NM_PER_A: f64 = 10.0;

/// A hand that leads the arm.
const ARM_HAND: Hand = Hand { most_nm: 20.0, nm_s_per_rad: 60.0 };

/// What clients set.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    pub(crate) tcp_offset: Pose,
    pub(crate) load_kg: f64,
    pub(crate) load_center_m: [f64; 3],
    pub(crate) collision_sensitivity: u8,
    pub(crate) teach_sensitivity: u8,
    pub(crate) gravity_direction: [f64; 3],
    pub(crate) joint_jerk: f64,
    pub(crate) joint_most_acc: f64,
    pub(crate) reduced: bool,
    pub(crate) reduced_m_per_sec: f64,
    pub(crate) reduced_rad_per_sec: f64,
    pub(crate) reduced_range_rad: [[f64; 2]; NUM_JOINT_SLOTS],
    pub(crate) bounds_mm: [i32; 6],
    pub(crate) fence: bool,
    pub(crate) rebound: bool,
    pub(crate) self_collision: bool,
    pub(crate) simulation: bool,
    pub(crate) reports_current: bool,
}

impl Settings {
    fn new(model: &ArmModel) -> Self {
        let range = |joint| model.limits(joint).map_or([0.0; 2], |limits| [limits.lower, limits.upper]);
        Self {
            tcp_offset: Pose::default(),
            load_kg: 0.0,
            load_center_m: [0.0; 3],
            collision_sensitivity: 3,
            teach_sensitivity: 3,
            gravity_direction: [0.0, 0.0, -1.0],
            joint_jerk: 200.0,
            joint_most_acc: motion::MOST_RAD_PER_SEC2,
            reduced: false,
            reduced_m_per_sec: 0.25,
            reduced_rad_per_sec: 1.0,
            reduced_range_rad: std::array::from_fn(range),
            bounds_mm: [2000, -2000, 2000, -2000, 2000, -2000],
            fence: false,
            rebound: false,
            self_collision: false,
            simulation: false,
            reports_current: false,
        }
    }
}

/// The box with the arm.
#[derive(Clone, Debug)]
pub(crate) struct ArmBox {
    pub(crate) model: ArmModel,
    pub(crate) joints_rad: Vec<f64>,
    rad_per_sec: Vec<f64>,
    rad_per_sec2: Vec<f64>,
    pub(crate) mode: u8,
    /// [`state::READY`] while it may move; whether it does is in [`ArmBox::state`].
    resting_state: u8,
    error: u8,
    warning: u8,
    brake_bits: u8,
    enable_bits: u8,
    settings: Settings,
    queue: VecDeque<Move>,
    track: Option<Track>,
    /// Where servo mode goes.
    target_rad: Option<Vec<f64>>,
    /// Joint velocities and the steps left for them, if bounded.
    velocity: Option<(Vec<f64>, Option<u64>)>,
    /// Who pushes each joint by hand.
    pushes: Vec<Push>,
    stop_is_pressed: bool,
    until_boundary_look: u32,
    num_rich_reports: u32,
}

impl ArmBox {
    /// A box that was just switched on, its arm at `joints_rad`.
    pub(crate) fn new(model: ArmModel, joints_rad: Vec<f64>) -> Self {
        let settings = Settings::new(&model);
        let still = vec![0.0; joints_rad.len()];
        Self {
            model,
            joints_rad,
            rad_per_sec: still.clone(),
            rad_per_sec2: still.clone(),
            mode: mode::POSITION,
            resting_state: state::STOPPED,
            error: 0,
            warning: 0,
            brake_bits: 0,
            enable_bits: 0,
            settings,
            queue: VecDeque::new(),
            track: None,
            target_rad: None,
            velocity: None,
            pushes: vec![Push::NONE; still.len()],
            stop_is_pressed: false,
            until_boundary_look: 0,
            num_rich_reports: 0,
        }
    }

    /// The state as the box says it.
    pub(crate) fn state(&self) -> u8 {
        if self.resting_state == state::READY && self.is_moving() {
            state::MOVING
        } else {
            self.resting_state
        }
    }

    fn is_moving(&self) -> bool {
        self.track.is_some() || !self.queue.is_empty() || self.rad_per_sec.iter().any(|&v| v != 0.0)
    }

    fn all_joints(&self) -> u8 {
        ((1_u16 << self.model.num_joints()) - 1) as u8
    }

    /// Whether it would move if told to.
    fn is_ready(&self) -> bool {
        let on = self.enable_bits & self.brake_bits & self.all_joints();
        on == self.all_joints() && !matches!(self.resting_state, state::STOPPED | state::CHANGED)
    }

    /// The state byte of every response.
    pub(crate) fn flags(&self) -> StateFlags {
        let mut flags = 0;
        flags |= if self.error != 0 { StateFlags::ERROR.0 } else { 0 };
        flags |= if self.warning != 0 { StateFlags::WARNING.0 } else { 0 };
        flags |= if self.is_ready() { 0 } else { StateFlags::NOT_READY.0 };
        StateFlags(flags)
    }

    fn queue_length(&self) -> u16 {
        (self.queue.len() + usize::from(self.track.is_some())) as u16
    }

    /// The tool's frame on the flange.
    fn tool(&self) -> Isometry3<f64> {
        from_pose(&self.settings.tcp_offset)
    }

    /// The emergency stop's button.
    pub(crate) fn press_stop(&mut self, pressed: bool) {
        self.stop_is_pressed = pressed;
    }

    /// Who pushes a joint by hand.
    pub(crate) fn push_joint(&mut self, joint: usize, push: Push) {
        self.pushes[joint] = push;
    }

    /// Velocities of the joints, rad/s.
    pub(crate) fn rad_per_sec(&self) -> &[f64] {
        &self.rad_per_sec
    }

    /// Whether a joint is enabled with its brake released.
    pub(crate) fn is_driven(&self, joint: usize) -> bool {
        self.enable_bits & self.brake_bits & (1 << joint) != 0
    }

    /// Where the joint is told to be in servo mode, rad; `None` in other modes and before the first target.
    pub(crate) fn goal_rad(&self, joint: usize) -> Option<f64> {
        Some(self.target_rad.as_ref()?[joint])
    }

    /// What the box says of itself.
    pub(crate) fn snapshot(&self) -> ArmSnapshot {
        ArmSnapshot { mode: self.mode, state: self.state(), error: self.error, warning: self.warning }
    }

    /// The arm hit something.
    pub(crate) fn collide(&mut self) {
        self.fail(error::COLLISION);
    }

    fn fail(&mut self, code: u8) {
        if self.error == 0 {
            self.error = code;
        }
        self.halt(state::STOPPED);
    }

    /// Forgets every motion and stays in `resting_state`; the joints brake.
    fn halt(&mut self, resting_state: u8) {
        self.queue.clear();
        self.track = None;
        self.target_rad = None;
        self.velocity = None;
        self.resting_state = resting_state;
    }

    fn most_rad_per_sec(&self) -> f64 {
        if self.settings.reduced {
            self.settings.reduced_rad_per_sec.clamp(0.01, MOST_RAD_PER_SEC)
        } else {
            MOST_RAD_PER_SEC
        }
    }

    /// One step of `dt_s`.
    pub(crate) fn step(&mut self, dt_s: f64) {
        if self.stop_is_pressed && (self.error != error::EMERGENCY_STOP || self.enable_bits != 0) {
            // The button cuts the power whatever the error was.
            self.error = error::EMERGENCY_STOP;
            self.halt(state::STOPPED);
            self.enable_bits = 0;
            self.brake_bits = 0;
        }
        let powered = self.enable_bits & self.all_joints() == self.all_joints();
        let before = self.rad_per_sec.clone();
        if !powered {
            // Brakes hold at once.
            self.rad_per_sec.fill(0.0);
        } else if self.track.is_some() || (!self.queue.is_empty() && self.resting_state == state::READY) {
            self.step_track(dt_s);
        } else if self.mode == mode::LEAD_THROUGH && self.resting_state == state::READY {
            self.step_led(dt_s);
        } else {
            self.step_joints(dt_s);
        }
        for ((acc, now), before) in self.rad_per_sec2.iter_mut().zip(&self.rad_per_sec).zip(&before) {
            *acc = (now - before) / dt_s;
        }
        self.watch_boundary();
    }

    fn step_track(&mut self, dt_s: f64) {
        if self.track.is_none()
            && let Some(next) = self.queue.pop_front()
        {
            match Track::plan(&next, &self.model, &self.joints_rad, self.most_rad_per_sec()) {
                Some(track) => self.track = Some(track),
                None => self.fail(error::KINEMATICS),
            }
        }
        let Some(track) = &mut self.track else { return };
        let joints_rad = track.step(dt_s, self.resting_state == state::PAUSED);
        let done = track.is_done();
        for ((velocity, now), before) in self.rad_per_sec.iter_mut().zip(&joints_rad).zip(&self.joints_rad) {
            *velocity = (now - before) / dt_s;
        }
        self.joints_rad = joints_rad;
        if done {
            self.track = None;
            self.rad_per_sec.fill(0.0);
        }
    }

    /// Targets of servo mode, velocities, or braking.
    fn step_joints(&mut self, dt_s: f64) {
        if let Some((_, Some(steps_left))) = &mut self.velocity {
            *steps_left = steps_left.saturating_sub(1);
            if *steps_left == 0 {
                self.velocity = None;
            }
        }
        let (most, ready) = (self.most_rad_per_sec(), self.resting_state == state::READY);
        for joint in 0..self.joints_rad.len() {
            let now = (self.joints_rad[joint], self.rad_per_sec[joint]);
            let next = match (&self.target_rad, &self.velocity) {
                (Some(target_rad), _) if ready => chase(now, target_rad[joint], most, dt_s),
                (_, Some((wanted, _))) if ready => ramp(now, wanted[joint].clamp(-most, most), dt_s),
                _ => ramp(now, 0.0, dt_s),
            };
            (self.joints_rad[joint], self.rad_per_sec[joint]) = next;
        }
        if let Some(joint) = self.model.beyond_limits(&self.joints_rad) {
            if let Some(limits) = self.model.limits(joint) {
                self.joints_rad[joint] = self.joints_rad[joint].clamp(limits.lower, limits.upper);
                self.rad_per_sec[joint] = 0.0;
            }
            self.fail(error::JOINT_LIMIT);
        }
    }

    /// Lead-through: gravity is made up for, friction and inertia remain, and who pushes moves the arm up to its limits.
    fn step_led(&mut self, dt_s: f64) {
        let most = self.most_rad_per_sec();
        for joint in 0..self.joints_rad.len() {
            let velocity = self.rad_per_sec[joint];
            let torque_nm = self.pushes[joint].torque_nm(velocity, &ARM_HAND) - VISCOUS_NM_S * velocity;
            let pushed = velocity + torque_nm / INERTIA_KG_M2 * dt_s;
            // Dry friction takes speed away and never gives any.
            let slowed = (pushed.abs() - COULOMB_NM / INERTIA_KG_M2 * dt_s).max(0.0).copysign(pushed);
            let velocity = slowed.clamp(-most, most);
            let wanted_rad = self.joints_rad[joint] + velocity * dt_s;
            let angle_rad = match self.model.limits(joint) {
                Some(limits) => wanted_rad.clamp(limits.lower, limits.upper),
                None => wanted_rad,
            };
            self.joints_rad[joint] = angle_rad;
            self.rad_per_sec[joint] = if angle_rad == wanted_rad { velocity } else { 0.0 };
        }
    }

    /// Stops where the tool leaves the workspace box.
    fn watch_boundary(&mut self) {
        if !self.settings.fence || self.error != 0 || !self.is_moving() {
            return;
        }
        self.until_boundary_look = self.until_boundary_look.checked_sub(1).unwrap_or(BOUNDARY_STEPS);
        if self.until_boundary_look > 0 {
            return;
        }
        let tool = self.model.base_from_flange(&self.joints_rad) * self.tool();
        let outside = tool.translation.vector.iter().zip(self.settings.bounds_mm.as_chunks::<2>().0).any(
            |(coordinate_m, [most_mm, least_mm])| {
                let coordinate_mm = coordinate_m * 1e3;
                coordinate_mm > f64::from(*most_mm) || coordinate_mm < f64::from(*least_mm)
            },
        );
        if outside {
            self.fail(error::BOUNDARY);
        }
    }

    /// What moving costs each joint.
    fn effort_nm(&self) -> [f64; NUM_JOINT_SLOTS] {
        let mut effort = [0.0; NUM_JOINT_SLOTS];
        let motion = self.rad_per_sec.iter().zip(&self.rad_per_sec2);
        for (slot, (&velocity, &acc)) in effort.iter_mut().zip(motion) {
            let dry = if velocity == 0.0 { 0.0 } else { COULOMB_NM.copysign(velocity) };
            *slot = INERTIA_KG_M2 * acc + VISCOUS_NM_S * velocity + dry;
        }
        effort
    }

    fn current_a(&self, effort_nm: &[f64; NUM_JOINT_SLOTS]) -> [f64; NUM_JOINT_SLOTS] {
        effort_nm.map(|torque_nm| torque_nm / TORQUE_NM_PER_A)
    }

    /// Velocity of the tool in the base frame, m/s and rad/s, from where it will be in a moment.
    fn tool_twist(&self) -> [f64; 6] {
        let moment_s = 1e-4;
        let tool = self.tool();
        let moved: Vec<f64> =
            self.joints_rad.iter().zip(&self.rad_per_sec).map(|(angle, v)| angle + v * moment_s).collect();
        let (now, next) = (
            self.model.base_from_flange(&self.joints_rad) * tool,
            self.model.base_from_flange(&moved) * tool,
        );
        let linear = (next.translation.vector - now.translation.vector) / moment_s;
        let angular = (next.rotation * now.rotation.inverse()).scaled_axis() / moment_s;
        [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    }
}

#[cfg(test)]
mod tests;
