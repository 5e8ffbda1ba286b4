//! The plant in motion.

use super::Plant;

/// Acceleration of free fall, m/s^2.
const GRAVITY_M_PER_S2: f64 = 9.81;
/// Longest step, s: the loop's fastest mode (some 15 rad/s) turns by 0.02 rad in it.
const STEP_S: f64 = 1.5e-3;
/// PWM readings within which its sign is uncertain, in shares of full duty (two counts of 885).
const SIGN_WIDTH: f64 = 2.0 / 885.0;

/// What an actuator was told, and what it carried: the samples of one log.
#[derive(Clone, Copy, Debug)]
pub struct Drive<'a> {
    /// Time of each sample, s, increasing.
    pub times_s: &'a [f64],
    /// Goal sent at each sample, rad, held until the next.
    pub goals_rad: &'a [f64],
    /// Whether the torque is on from each sample on.
    pub torque_on: &'a [bool],
    /// Duty per position error, 1/rad, as the firmware's register states it.
    pub gain_per_rad: f64,
    /// Supply voltage at rest, V.
    pub supply_v: f64,
    /// Mass at the end of the pendulum, kg; 0 for a joint whose load is unknown.
    pub mass_kg: f64,
    /// Its length, m.
    pub length_m: f64,
}

/// Where a rollout starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Index of the sample.
    pub sample: usize,
    /// Position, rad.
    pub position_rad: f64,
    /// Speed, rad/s.
    pub speed_rad_per_s: f64,
    /// Acceleration, rad/s^2: which flank of the gear carries the load.
    pub acceleration_rad_per_s2: f64,
}

/// What would be logged at a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sensed {
    /// Joint position, rad.
    pub position_rad: f64,
    /// Duty of the driver, -1..=1.
    pub duty: f64,
    /// Voltage of the supply, V.
    pub supply_v: f64,
    /// Share of readings that exceed the signed range, 0..=1.
    pub carry: f64,
}

/// Drives `plant` from `start` through `num_samples` samples, the first of them the start itself.
///
/// Semi-implicit: forces at the middle of the step's path, damping at its end, and dry friction as the impulse that
/// takes away speed down to zero and no further, so that sticking is exact and does not chatter.
pub fn rollout(plant: &Plant, drive: &Drive<'_>, start: Start, num_samples: usize) -> Vec<Sensed> {
    let end = (start.sample + num_samples).min(drive.times_s.len());
    let mut sensed = Vec::with_capacity(num_samples);
    let mut state = State::new(plant, drive, start);
    for sample in start.sample..end {
        if sample > start.sample {
            let (from_s, to_s) = (drive.times_s[sample - 1], drive.times_s[sample]);
            let num_steps = ((to_s - from_s) / STEP_S).ceil().max(1.0);
            let step_s = (to_s - from_s) / num_steps;
            for step in 0..num_steps as usize {
                state.step(plant, drive, from_s + step as f64 * step_s, step_s);
            }
        }
        sensed.push(state.sense(plant, drive, drive.times_s[sample]));
    }
    sensed
}

/// Where the rotor is in the play.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Gear {
    /// It carries the joint: 1 in the direction of positive torque, -1 against it.
    Engaged(f64),
    /// It does not: angle from the negative flank, rad, and its own speed, rad/s.
    Free { gap_rad: f64, speed_rad_per_s: f64 },
}

struct State {
    position_rad: f64,
    speed_rad_per_s: f64,
    gear: Gear,
    /// Newest sample whose goal has arrived.
    arrived: usize,
}

impl State {
    fn new(plant: &Plant, drive: &Drive<'_>, start: Start) -> Self {
        let carried = load_kg_m2(plant, drive) * start.acceleration_rad_per_s2
            - gravity_nm(plant, drive, start.position_rad);
        Self {
            position_rad: start.position_rad,
            speed_rad_per_s: start.speed_rad_per_s,
            gear: Gear::Engaged(if carried < 0.0 { -1.0 } else { 1.0 }),
            arrived: 0,
        }
    }

    /// Mean goal over the time from `from_s` to `from_s + step_s` as it has arrived, and whether the torque is on.
    fn goal(&mut self, plant: &Plant, drive: &Drive<'_>, from_s: f64, step_s: f64) -> (f64, bool) {
        let from_s = from_s - plant.latency_s;
        let (times_s, goals_rad) = (drive.times_s, drive.goals_rad);
        // Only the first look-up is far.
        if self.arrived == 0 {
            self.arrived = times_s.partition_point(|&time_s| time_s <= from_s).saturating_sub(1);
        }
        while times_s.get(self.arrived + 1).is_some_and(|&time_s| time_s <= from_s) {
            self.arrived += 1;
        }
        let now = goals_rad[self.arrived];
        let on = drive.torque_on[self.arrived];
        match times_s.get(self.arrived + 1) {
            Some(&next_s) if next_s < from_s + step_s => {
                let share = (from_s + step_s - next_s) / step_s;
                (now + share * (goals_rad[self.arrived + 1] - now), on)
            }
            _ => (now, on),
        }
    }

    /// Duty at this position; the speed is that of the joint.
    fn duty(&self, plant: &Plant, drive: &Drive<'_>, goal_rad: f64, position_rad: f64) -> f64 {
        let error_rad = goal_rad - position_rad - plant.derivative_s * self.speed_rad_per_s;
        (plant.gain_factor * drive.gain_per_rad * error_rad).clamp(-1.0, 1.0)
    }

    fn step(&mut self, plant: &Plant, drive: &Drive<'_>, from_s: f64, step_s: f64) {
        let (goal_rad, on) = self.goal(plant, drive, from_s, step_s);
        let middle_rad = self.position_rad + 0.5 * step_s * self.speed_rad_per_s;
        let duty = if on { self.duty(plant, drive, goal_rad, middle_rad) } else { 0.0 };
        // i = (duty V - kt w) / (R + r duty^2), for the supply's own voltage V0 - r duty i drives the winding.
        let (kt, loop_ohm) = (
            plant.torque_constant_nm_per_a,
            plant.resistance_ohm + plant.supply_resistance_ohm * duty * duty,
        );
        let rotor_rad_per_s = self.rotor_rad_per_s();
        let (drive_nm, emf_nm_s) = if on {
            let (free_a, emf_a_s) = (duty * drive.supply_v * plant.supply_factor / loop_ohm, kt / loop_ohm);
            let limited_a = limited(plant, free_a - emf_a_s * rotor_rad_per_s);
            // A driver at its limit gives that current, whatever the speed.
            limited_a.map_or((kt * free_a, kt * emf_a_s), |limited_a| (kt * limited_a, 0.0))
        } else {
            (0.0, 0.0)
        };
        let damping = emf_nm_s + plant.viscous_nm_s_per_rad;
        let gravity_nm = gravity_nm(plant, drive, middle_rad);
        let load_kg_m2 = load_kg_m2(plant, drive);
        let before = self.speed_rad_per_s;
        match self.gear {
            Gear::Engaged(flank) => {
                let inertia = load_kg_m2 + plant.armature_kg_m2;
                let motor_nm = drive_nm - emf_nm_s * before;
                // Mean of what motor and gravity ask of the gear; counting the load's inertia too explains measured
                // logs of an XL330 worse.
                let transmitted_nm = 0.5 * (motor_nm - gravity_nm).abs();
                let friction_nm = friction_nm(plant, before, transmitted_nm);
                let torque_nm = drive_nm + gravity_nm;
                let after = braked(before, torque_nm, damping, friction_nm, inertia, step_s);
                self.speed_rad_per_s = after;
                self.position_rad += 0.5 * step_s * (before + after);
                let carried_nm = load_kg_m2 * (after - before) / step_s - gravity_nm;
                if plant.play_rad > 0.0 && flank * carried_nm < 0.0 {
                    // The flank would have to pull: the load goes on by itself.
                    let gap_rad = if flank > 0.0 { plant.play_rad } else { 0.0 };
                    self.gear = Gear::Free { gap_rad, speed_rad_per_s: after };
                }
            }
            Gear::Free { gap_rad, speed_rad_per_s } => {
                let rotor_kg_m2 = plant.armature_kg_m2.max(1e-6);
                let friction_nm = friction_nm(plant, speed_rad_per_s, 0.0);
                let rotor = braked(speed_rad_per_s, drive_nm, damping, friction_nm, rotor_kg_m2, step_s);
                let after = before + step_s * gravity_nm / load_kg_m2.max(1e-9);
                self.position_rad += 0.5 * step_s * (before + after);
                let gap_rad = gap_rad + 0.5 * step_s * (rotor + speed_rad_per_s - before - after);
                let touched = if gap_rad >= plant.play_rad {
                    Some(1.0)
                } else if gap_rad <= 0.0 {
                    Some(-1.0)
                } else {
                    None
                };
                (self.gear, self.speed_rad_per_s) = match touched {
                    // They go on together, with the momentum of both.
                    Some(flank) => (
                        Gear::Engaged(flank),
                        (rotor_kg_m2 * rotor + load_kg_m2 * after) / (rotor_kg_m2 + load_kg_m2),
                    ),
                    None => (Gear::Free { gap_rad, speed_rad_per_s: rotor }, after),
                };
            }
        }
    }

    fn rotor_rad_per_s(&self) -> f64 {
        match self.gear {
            Gear::Engaged(_) => self.speed_rad_per_s,
            Gear::Free { speed_rad_per_s, .. } => speed_rad_per_s,
        }
    }

    fn sense(&mut self, plant: &Plant, drive: &Drive<'_>, time_s: f64) -> Sensed {
        let (goal_rad, on) = self.goal(plant, drive, time_s, 1e-9);
        let duty = if on { self.duty(plant, drive, goal_rad, self.position_rad) } else { 0.0 };
        let rest_v = drive.supply_v * plant.supply_factor;
        let current_a = (duty * rest_v - plant.torque_constant_nm_per_a * self.rotor_rad_per_s())
            / (plant.resistance_ohm + plant.supply_resistance_ohm * duty * duty);
        let current_a = limited(plant, current_a).unwrap_or(current_a);
        Sensed {
            position_rad: self.position_rad,
            duty,
            supply_v: rest_v - plant.supply_resistance_ohm * duty * current_a,
            carry: plant.wrap * (if on { 1.0 / (1.0 + (duty / SIGN_WIDTH).exp()) } else { 0.0 }),
        }
    }
}

/// The current at the driver's limit, A, if it would be beyond it.
fn limited(plant: &Plant, current_a: f64) -> Option<f64> {
    let is_beyond = current_a.abs() * plant.inverse_current_limit_per_a > 1.0;
    is_beyond.then(|| current_a.signum() / plant.inverse_current_limit_per_a)
}

/// Torque of gravity, and of what is always there, at a measured position, N m.
fn gravity_nm(plant: &Plant, drive: &Drive<'_>, position_rad: f64) -> f64 {
    let full_nm = plant.gravity_factor * drive.mass_kg * GRAVITY_M_PER_S2 * drive.length_m;
    let [sine_nm, cosine_nm] = plant.unstated_nm;
    let (sine, cosine) = (position_rad - plant.encoder_offset_rad).sin_cos();
    plant.constant_torque_nm - (full_nm + sine_nm) * sine - cosine_nm * cosine
}

/// Inertia of what the joint carries, kg m^2.
fn load_kg_m2(plant: &Plant, drive: &Drive<'_>) -> f64 {
    drive.mass_kg * drive.length_m.powi(2) + plant.unstated_kg_m2
}

/// Largest torque of dry friction, N m (Stribeck's curve, and the load's share).
fn friction_nm(plant: &Plant, speed_rad_per_s: f64, transmitted_nm: f64) -> f64 {
    let fade = (-(speed_rad_per_s / plant.stribeck_speed_rad_per_s).powi(2)).exp();
    plant.coulomb_nm + plant.stribeck_nm * fade + plant.load_friction * transmitted_nm
}

/// Speed after a step under `torque_nm`, damping (at the end of the step) and dry friction, which only ever brakes.
fn braked(speed: f64, torque_nm: f64, damping: f64, friction_nm: f64, inertia: f64, step_s: f64) -> f64 {
    let softened = inertia + step_s * damping;
    let free = (inertia * speed + step_s * torque_nm) / softened;
    let lost = step_s * friction_nm / softened;
    free.signum() * (free.abs() - lost).max(0.0)
}
