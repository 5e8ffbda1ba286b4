//! The truth behind servo logs: a geared motor on a pendulum, stepped at 20 kHz.
//!
//! Formulated apart from `palpate_sim::actuator`: dry friction is a bristle that bends (LuGre), the winding has an
//! inductance, rotor and joint are two bodies with a stiff, damped gear between them, the firmware closes its loop at
//! 1 kHz on encoder counts, and the supply recovers with a lag. [`servo_cases`] lists what may be hidden.

mod cases;
mod motion;

use std::collections::{BTreeMap, VecDeque};
use std::f64::consts::TAU;

use palpate_recording::{RegisterUnits, ServoLog};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

pub use cases::{ServoCase, ServoCaseKind, servo_cases};
pub use motion::Motion;

/// Step of the world, s.
const STEP_S: f64 = 5e-5;
/// Steps of the world per turn of the firmware's loop.
const STEPS_PER_LOOP: usize = 20;
/// Turns of the firmware's loop over which it takes the speed.
const LOOPS_OF_SPEED: usize = 8;
/// Length of a log, s.
const DURATION_S: f64 = 6.0;
/// Time between samples, s, and the share of it that jitters upwards.
const SAMPLE_S: f64 = 5.3e-3;
const SAMPLE_JITTER: f64 = 0.05;
const GRAVITY_M_PER_S2: f64 = 9.81;
const MASS_KG: f64 = 0.49;
const LENGTH_M: f64 = 0.1;
const SUPPLY_V: f64 = 7.4;
/// Inductance of the winding, H.
const INDUCTANCE_H: f64 = 1e-3;
/// Inertia of the rotor seen at the joint, kg m^2: that of the datasheet.
const ROTOR_KG_M2: f64 = 5e-4;
/// Stiffness and damping of the gear, N m / rad and N m s / rad.
const GEAR_NM_PER_RAD: f64 = 400.0;
const GEAR_NM_S_PER_RAD: f64 = 0.25;
/// Stiffness and damping of the bristle, N m / rad and N m s / rad.
const BRISTLE_NM_PER_RAD: f64 = 80.0;
const BRISTLE_NM_S_PER_RAD: f64 = 0.08;
/// Time constant of the supply's recovery, s.
const SUPPLY_LAG_S: f64 = 5e-4;
/// Standard deviation of a voltage reading, V.
const SUPPLY_NOISE_V: f64 = 0.2;
/// Position gains that are recorded.
const GAINS: [f64; 3] = [100.0, 200.0, 400.0];

/// What an emulated servo is really like, beyond what its datasheet says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ServoTruth {
    /// Friction per speed, N m s / rad.
    pub viscous_nm_s_per_rad: f64,
    /// Friction that depends on the direction alone, N m.
    pub coulomb_nm: f64,
    /// Friction at rest beyond that of motion, N m; gone at some 0.3 rad/s.
    pub stribeck_nm: f64,
    /// Friction per torque between the flanks of the gear.
    pub load_friction: f64,
    /// Time that commands take, s.
    pub latency_s: f64,
    /// Play of the gear, rad.
    pub play_rad: f64,
    /// Internal resistance of the supply, ohm.
    pub supply_resistance_ohm: f64,
    /// Reading of the encoder while the load hangs, rad.
    pub encoder_offset_rad: f64,
    /// Torque of gravity beyond the stated one, as a share.
    pub gravity: f64,
    /// Position gain beyond the stated one, as a share.
    pub gain: f64,
    /// Inertia of rotor and gear beyond the datasheet's, kg m^2.
    pub inertia_kg_m2: f64,
    /// Derivative gain of the firmware over its position gain, s.
    pub derivative_s: f64,
    /// Most current that the driver gives, A; 0 for a driver that gives any.
    pub current_limit_a: f64,
    /// Torque on the joint that is always there, N m.
    pub constant_torque_nm: f64,
    /// Whether negative PWM readings are stored unsigned.
    pub wraps: bool,
    /// Amplitude of a torque that repeats with the angle, N m (fourteen times a turn).
    pub ripple_nm: f64,
    /// Share of the torque constant that heat takes by the end of a log.
    pub thermal: f64,
    /// Friction of one spot of the gear, N m, over 0.15 rad from 0.2 rad on.
    pub spot_nm: f64,
    /// Friction of motions in the positive direction alone, N m.
    pub one_sided_nm: f64,
    /// Twist of a loose coupling between gear and joint, rad / N m.
    pub coupling_rad_per_nm: f64,
    /// Bits of the encoder's count that always read 0.
    pub stuck_encoder_bits: i64,
    /// Share of the full duty that the driver withholds.
    pub duty_withheld: f64,
    /// What its registers stand for, which the logs say. Gains are set to be those of the default units.
    pub units: RegisterUnits,
    /// Whether the logs do not say what the joint carries.
    pub load_unstated: bool,
}

/// Records every motion at every gain on the servo that `truth` describes: 15 logs.
///
/// `seed` also draws the servo's own torque constant, resistance and supply, which differ from the datasheet's as those
/// of real ones do. Same seed, same logs, for any number of threads.
pub fn record_servo(truth: &ServoTruth, seed: u64) -> Vec<ServoLog> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let motor = Motor {
        torque_constant_nm_per_a: 0.4 * rng.random_range(0.9..1.1),
        resistance_ohm: 3.4 * rng.random_range(0.9..1.15),
        supply_v: SUPPLY_V * rng.random_range(0.97..1.02),
    };
    let register = RegisterUnits::default().duty_per_rad(1.0) / truth.units.duty_per_rad(1.0);
    let runs: Vec<(f64, Motion)> = GAINS
        .iter()
        .flat_map(|&gain| Motion::ALL.iter().map(move |&motion| (gain * register, motion)))
        .collect();
    runs.into_par_iter()
        .enumerate()
        .map(|(idx, (gain, motion))| {
            let rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1009).wrapping_add(idx as u64 + 1));
            World::new(truth, &motor, gain, motion, rng).record(idx)
        })
        .collect()
}

struct Motor {
    torque_constant_nm_per_a: f64,
    resistance_ohm: f64,
    supply_v: f64,
}

struct World<'a> {
    truth: &'a ServoTruth,
    motor: &'a Motor,
    gain_register: f64,
    motion: Motion,
    rng: ChaCha8Rng,
    time_s: f64,
    joint_rad: f64,
    joint_rad_per_s: f64,
    rotor_rad: f64,
    rotor_rad_per_s: f64,
    bristle_rad: f64,
    current_a: f64,
    supply_v: f64,
    duty: f64,
    /// Commands on their way: when they take effect, the goal, and whether the torque is on.
    queue: VecDeque<(f64, f64, bool)>,
    goal_rad: f64,
    torque_on: bool,
    /// What the encoder showed in the last turns of the loop, rad: the firmware's speed.
    shown_rad: VecDeque<f64>,
}

impl<'a> World<'a> {
    fn new(
        truth: &'a ServoTruth,
        motor: &'a Motor,
        gain_register: f64,
        motion: Motion,
        rng: ChaCha8Rng,
    ) -> Self {
        Self {
            truth,
            motor,
            gain_register,
            motion,
            rng,
            time_s: 0.0,
            joint_rad: 0.0,
            joint_rad_per_s: 0.0,
            rotor_rad: 0.0,
            rotor_rad_per_s: 0.0,
            bristle_rad: 0.0,
            current_a: 0.0,
            supply_v: motor.supply_v,
            duty: 0.0,
            queue: VecDeque::new(),
            goal_rad: 0.0,
            torque_on: true,
            shown_rad: VecDeque::new(),
        }
    }

    fn record(mut self, idx: usize) -> ServoLog {
        let mut log = ServoLog {
            id: format!("{:02}-{}-kp{}", idx + 1, self.motion.name(), self.gain_register),
            joint: "emulated".to_owned(),
            fields: BTreeMap::from([
                ("kp".to_owned(), self.gain_register.to_string()),
                ("trajectory".to_owned(), self.motion.name().to_owned()),
                ("motor".to_owned(), "emulated".to_owned()),
            ]),
            position_gain_register: Some(self.gain_register),
            mass_kg: if self.truth.load_unstated { 0.0 } else { MASS_KG },
            length_m: LENGTH_M,
            supply_v: Some(SUPPLY_V),
            units: self.truth.units,
            ..ServoLog::default()
        };
        let mut next_s = 0.0035;
        let mut step = 0;
        while self.time_s < DURATION_S {
            if self.time_s >= next_s {
                self.sample(&mut log);
                // Waiting times of a busy bus: mostly on time, sometimes late.
                let late = -(1.0 - self.rng.random::<f64>()).ln() * SAMPLE_JITTER;
                next_s = self.time_s + SAMPLE_S * (0.98 + late);
            }
            if step % STEPS_PER_LOOP == 0 {
                self.firmware();
            }
            self.step();
            step += 1;
        }
        log
    }

    /// The host sends a goal and reads the registers.
    fn sample(&mut self, log: &mut ServoLog) {
        let (goal_rad, on) = self.motion.goal(self.time_s);
        self.queue.push_back((self.time_s + self.truth.latency_s, goal_rad, on));
        let noise_v = SUPPLY_NOISE_V * gauss(&mut self.rng);
        let pwm = (self.duty * self.truth.units.full_pwm).round();
        log.times_s.push(self.time_s);
        log.goals_rad.push(goal_rad);
        log.torque_on.push(on);
        log.positions_rad.push(self.encoder_rad());
        log.pwm_register.push(if self.truth.wraps && pwm < 0.0 { pwm + 65_536.0 } else { pwm });
        log.input_v.push(((self.supply_v + noise_v) * 10.0).round() / 10.0);
    }

    /// What the encoder on the joint shows, in whole counts.
    fn encoder_rad(&self) -> f64 {
        let count_rad = TAU / self.truth.units.counts_per_turn;
        let centre = self.truth.units.counts_per_turn / 2.0;
        let count = ((self.joint_rad + self.truth.encoder_offset_rad) / count_rad).round() + centre;
        ((count as i64 & !self.truth.stuck_encoder_bits) as f64 - centre) * count_rad
    }

    fn firmware(&mut self) {
        while self.queue.front().is_some_and(|(due_s, ..)| *due_s <= self.time_s) {
            if let Some((_, goal_rad, on)) = self.queue.pop_front() {
                (self.goal_rad, self.torque_on) = (goal_rad, on);
            }
        }
        let shown_rad = self.encoder_rad();
        self.shown_rad.push_back(shown_rad);
        let before_rad =
            if self.shown_rad.len() > LOOPS_OF_SPEED { self.shown_rad.pop_front() } else { None };
        let turned_rad = before_rad.map_or(0.0, |before_rad| shown_rad - before_rad);
        let speed_rad_per_s = turned_rad / (LOOPS_OF_SPEED as f64 * STEPS_PER_LOOP as f64 * STEP_S);
        let error_rad = self.goal_rad - shown_rad - self.truth.derivative_s * speed_rad_per_s;
        let units = &self.truth.units;
        let counts = error_rad * units.counts_per_turn / TAU;
        let pwm = counts * self.gain_register * (1.0 + self.truth.gain) / units.unit_gain;
        let most = 1.0 - self.truth.duty_withheld;
        self.duty = if self.torque_on { (pwm / units.full_pwm).clamp(-most, most) } else { 0.0 };
    }

    fn step(&mut self) {
        let truth = self.truth;
        let heat = 1.0 - truth.thermal * self.time_s / DURATION_S;
        let constant = self.motor.torque_constant_nm_per_a * heat;
        if self.torque_on {
            let across_v = self.duty * self.supply_v
                - self.motor.resistance_ohm * self.current_a
                - constant * self.rotor_rad_per_s;
            self.current_a += STEP_S * across_v / INDUCTANCE_H;
            // A chopper cuts it off.
            if truth.current_limit_a > 0.0 {
                self.current_a = self.current_a.clamp(-truth.current_limit_a, truth.current_limit_a);
            }
        } else {
            // The driver's bridge is open.
            self.current_a = 0.0;
        }
        let sagged_v = self.motor.supply_v - truth.supply_resistance_ohm * self.duty * self.current_a;
        self.supply_v += (sagged_v - self.supply_v) * STEP_S / SUPPLY_LAG_S;

        let gear_nm = self.gear_nm();
        let motor_nm = constant * self.current_a + truth.ripple_nm * (14.0 * self.rotor_rad).sin();
        let gravity_nm = (1.0 + truth.gravity) * MASS_KG * GRAVITY_M_PER_S2 * LENGTH_M * self.joint_rad.sin();
        let friction_nm = self.friction_nm(gear_nm);
        let rotor = ROTOR_KG_M2 + truth.inertia_kg_m2;
        self.rotor_rad_per_s += STEP_S * (motor_nm - friction_nm - gear_nm) / rotor;
        self.joint_rad_per_s +=
            STEP_S * (gear_nm - gravity_nm + truth.constant_torque_nm) / (MASS_KG * LENGTH_M * LENGTH_M);
        self.rotor_rad += STEP_S * self.rotor_rad_per_s;
        self.joint_rad += STEP_S * self.joint_rad_per_s;
        self.time_s += STEP_S;
    }

    /// Torque of the gear on the joint: a damped spring outside the play, nothing within.
    fn gear_nm(&self) -> f64 {
        let twist_rad = self.rotor_rad - self.joint_rad;
        let half_rad = 0.5 * self.truth.play_rad;
        let pressed_rad = twist_rad - twist_rad.clamp(-half_rad, half_rad);
        if pressed_rad == 0.0 && half_rad > 0.0 {
            return 0.0;
        }
        // A loose coupling is a spring in series; damped to the same degree.
        let softened = 1.0 / (1.0 + GEAR_NM_PER_RAD * self.truth.coupling_rad_per_nm);
        let torque_nm = GEAR_NM_PER_RAD * softened * pressed_rad
            + GEAR_NM_S_PER_RAD * softened.sqrt() * (self.rotor_rad_per_s - self.joint_rad_per_s);
        // Flanks push, they do not stick.
        if half_rad > 0.0 && torque_nm * pressed_rad < 0.0 { 0.0 } else { torque_nm }
    }

    /// Friction at the rotor: a bristle that bends until it slides.
    fn friction_nm(&mut self, gear_nm: f64) -> f64 {
        let truth = self.truth;
        let speed = self.rotor_rad_per_s;
        let on_spot = (0.2..0.35).contains(&self.rotor_rad);
        let sliding_nm = truth.coulomb_nm
            + truth.stribeck_nm * (-(speed / 0.3).powi(2)).exp()
            + truth.load_friction * gear_nm.abs()
            + if on_spot { truth.spot_nm } else { 0.0 }
            + if speed > 0.0 { truth.one_sided_nm } else { 0.0 };
        let viscous_nm = truth.viscous_nm_s_per_rad * speed;
        if sliding_nm < 1e-6 {
            self.bristle_rad = 0.0;
            return viscous_nm;
        }
        let bent_rad = sliding_nm / BRISTLE_NM_PER_RAD;
        // Exactly integrated over the step, so that a fast rotor cannot overshoot a stiff bristle.
        let before_rad = self.bristle_rad;
        let turned_rad = speed * STEP_S;
        let towards_rad = bent_rad * turned_rad.signum();
        self.bristle_rad = towards_rad + (before_rad - towards_rad) * (-turned_rad.abs() / bent_rad).exp();
        let bending = (self.bristle_rad - before_rad) / STEP_S;
        BRISTLE_NM_PER_RAD * self.bristle_rad + BRISTLE_NM_S_PER_RAD * bending + viscous_nm
    }
}

/// A normal deviate.
fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (TAU * rng.random::<f64>()).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn same_seed_gives_the_same_logs_and_another_does_not() {
        let truth = ServoTruth { coulomb_nm: 0.02, play_rad: 0.02, ..ServoTruth::default() };
        let logs = record_servo(&truth, 3);
        assert_eq!(logs, record_servo(&truth, 3));
        assert_ne!(logs, record_servo(&truth, 4));
        assert_eq!(logs.len(), GAINS.len() * Motion::ALL.len());
        for log in &logs {
            assert!((900..1300).contains(&log.times_s.len()), "{}: {}", log.id, log.times_s.len());
            assert!(log.positions_rad.iter().all(|position| position.abs() < 3.0), "{} is stable", log.id);
        }
    }

    #[test]
    fn dry_friction_holds_the_joint_off_centre_and_without_it_the_swing_goes_on() {
        let last_spread = |truth: &ServoTruth| {
            let logs = record_servo(truth, 1);
            let log = logs.iter().find(|log| log.id.contains("lift_and_drop")).expect("a drop");
            let tail = &log.positions_rad[log.positions_rad.len() - 200..];
            tail.iter().fold(f64::MIN, |a, b| a.max(*b)) - tail.iter().fold(f64::MAX, |a, b| a.min(*b))
        };
        assert!(last_spread(&ServoTruth { coulomb_nm: 0.02, ..ServoTruth::default() }) < 0.002);
        assert!(last_spread(&ServoTruth::default()) > 0.1);
    }

    #[test]
    fn only_a_truth_that_wraps_stores_large_readings() {
        let largest = |wraps: bool| {
            let logs = record_servo(&ServoTruth { wraps, ..ServoTruth::default() }, 1);
            logs.iter().flat_map(|log| log.pwm_register.clone()).fold(f64::MIN, f64::max)
        };
        assert!(largest(false) <= RegisterUnits::default().full_pwm);
        assert!(largest(true) > 65_536.0 - RegisterUnits::default().full_pwm - 1.0);
    }
}
