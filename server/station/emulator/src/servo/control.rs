//! The servo's own control loop: a profile towards the goal, then a controller for the motor.
//!
//! Feed-forward gains are kept in the table and not used.

use palpate_device_protocol::dynamixel::control_table::{self as registers, OperatingMode, TICKS_PER_TURN};

use super::motor::{Demand, Motor};
use super::table::Table;

/// Time unit of the derivative gain, s. The vendor documents none; with this one the hand's usual gains (P 600, D 200 with
/// current-based position) swing about as little as they do on hardware.
const DERIVATIVE_S: f64 = 0.03;
const TICKS_PER_RAD: f64 = TICKS_PER_TURN / std::f64::consts::TAU;
/// PWM steps of the full supply, current steps of an ampere.
const PWM_STEPS: f64 = 885.0;
const CURRENT_STEPS_PER_A: f64 = 1000.0;
/// Bit of the drive mode: profile registers are times, ms.
const TIME_BASED: i64 = 0x04;

/// Where the profile is, and what the integrator has gathered. Positions are as registers have them, rad.
#[derive(Clone, Debug, Default)]
pub(crate) struct Controller {
    pub(crate) position_rad: f64,
    pub(crate) velocity_rad_per_sec: f64,
    /// Sum of errors, ticks times ms.
    sum: f64,
    /// Largest speed and acceleration on the way to the goal; `None` for as fast as can be.
    most_speed: Option<f64>,
    most_acc: Option<f64>,
}

impl Controller {
    /// Starts over with the joint at rest at `position_rad`.
    pub(crate) fn rest_at(&mut self, position_rad: f64) {
        *self = Self { position_rad, ..Self::default() };
    }

    /// A new goal was written, to which the profile leads from where it is.
    pub(crate) fn plan(&mut self, table: &Table) {
        let acc = table.get(&registers::PROFILE_ACCELERATION);
        let speed = table.get(&registers::PROFILE_VELOCITY);
        if table.get(&registers::DRIVE_MODE) & TIME_BASED != 0 {
            let distance = (table.physical(&registers::GOAL_POSITION) - self.position_rad).abs();
            let total_s = speed as f64 * 1e-3;
            // Acceleration takes at most half of the time.
            let rise_s = (acc as f64 * 1e-3).min(0.5 * total_s);
            let most = distance / (total_s - rise_s);
            self.most_speed = (total_s > 0.0).then_some(most);
            self.most_acc = (rise_s > 0.0).then(|| most / rise_s);
        } else {
            self.most_speed = (speed > 0).then(|| {
                table.physical(&registers::PROFILE_VELOCITY).min(table.physical(&registers::VELOCITY_LIMIT))
            });
            self.most_acc = (acc > 0).then(|| table.physical(&registers::PROFILE_ACCELERATION));
        }
    }

    /// One step of `dt_s` with the joint at `position_rad`, both as registers have it; what the motor shall do.
    pub(crate) fn step(
        &mut self,
        dt_s: f64,
        table: &Table,
        motor: &Motor,
        position_rad: f64,
        sign: f64,
    ) -> Demand {
        let goal_pwm = (table.get(&registers::GOAL_PWM).abs() as f64 / PWM_STEPS).min(1.0);
        let goal_current_a = table.get(&registers::GOAL_CURRENT) as f64 / CURRENT_STEPS_PER_A;
        let velocity = sign * motor.velocity_rad_per_sec;
        match table.mode() {
            OperatingMode::Pwm => Demand::Pwm(sign * table.get(&registers::GOAL_PWM) as f64 / PWM_STEPS),
            OperatingMode::Current => {
                Demand::Current { current_a: sign * goal_current_a, most_pwm: goal_pwm }
            }
            OperatingMode::Velocity => {
                let goal = table.physical(&registers::GOAL_VELOCITY);
                let step = table.physical(&registers::PROFILE_ACCELERATION) * dt_s;
                self.velocity_rad_per_sec = if step > 0.0 {
                    self.velocity_rad_per_sec + (goal - self.velocity_rad_per_sec).clamp(-step, step)
                } else {
                    goal
                };
                let error =
                    (self.velocity_rad_per_sec - velocity) / registers::PRESENT_VELOCITY.unit.per_step();
                let gains = (&registers::VELOCITY_P_GAIN, &registers::VELOCITY_I_GAIN);
                let output = self.pi(table, gains, error, dt_s);
                Demand::Pwm(sign * (output / PWM_STEPS).clamp(-goal_pwm, goal_pwm))
            }
            mode => {
                self.follow(table.physical(&registers::GOAL_POSITION), dt_s);
                let error = (self.position_rad - position_rad) * TICKS_PER_RAD;
                let rate = (self.velocity_rad_per_sec - velocity) * TICKS_PER_RAD * DERIVATIVE_S;
                let gains = (&registers::POSITION_P_GAIN, &registers::POSITION_I_GAIN);
                let output =
                    self.pi(table, gains, error, dt_s) + table.physical(&registers::POSITION_D_GAIN) * rate;
                if mode == OperatingMode::CurrentBasedPosition {
                    let most = goal_current_a.abs();
                    let current_a = sign * (output / CURRENT_STEPS_PER_A).clamp(-most, most);
                    Demand::Current { current_a, most_pwm: goal_pwm }
                } else {
                    Demand::Pwm(sign * (output / PWM_STEPS).clamp(-goal_pwm, goal_pwm))
                }
            }
        }
    }

    fn pi(
        &mut self,
        table: &Table,
        (p, i): (&registers::Register, &registers::Register),
        error: f64,
        dt_s: f64,
    ) -> f64 {
        let gain = table.physical(i);
        self.sum += error * dt_s * 1e3;
        // What the integrator may ask for is what the supply can give.
        let most = if gain > 0.0 { PWM_STEPS / gain } else { 0.0 };
        self.sum = self.sum.clamp(-most, most);
        table.physical(p) * error + gain * self.sum
    }

    /// Moves the profile towards `goal`, speed and acceleration within bounds.
    fn follow(&mut self, goal: f64, dt_s: f64) {
        let distance = goal - self.position_rad;
        let most_speed = self.most_speed.unwrap_or(f64::INFINITY);
        let Some(acc) = self.most_acc else {
            let step = distance.clamp(-most_speed * dt_s, most_speed * dt_s);
            self.position_rad += step;
            // A jump has no speed that a controller could follow.
            self.velocity_rad_per_sec = if most_speed.is_finite() { step / dt_s } else { 0.0 };
            return;
        };
        let braking = (2.0 * acc * distance.abs()).sqrt();
        let wanted = most_speed.min(braking).copysign(distance);
        let change = (wanted - self.velocity_rad_per_sec).clamp(-acc * dt_s, acc * dt_s);
        self.velocity_rad_per_sec += change;
        let step = self.velocity_rad_per_sec * dt_s;
        if distance.abs() <= step.abs().max(1e-6) && self.velocity_rad_per_sec.abs() <= 2.0 * acc * dt_s {
            self.position_rad = goal;
            self.velocity_rad_per_sec = 0.0;
        } else {
            self.position_rad += step;
        }
    }

    /// Whether the profile has arrived.
    pub(crate) fn arrived(&self, table: &Table) -> bool {
        self.position_rad == table.physical(&registers::GOAL_POSITION)
    }
}
