//! Motor, gear train and joint of one servo, stepped at 1 kHz.

/// Torque constant at the horn as identified on this hand (armature and friction below too), N m/A.
const TORQUE_NM_PER_A: f64 = 0.333;
/// Inertia at the horn: rotor through the gear train, and the link, kg m2.
const INERTIA_KG_M2: f64 = 0.0048;
/// Friction that does not depend on speed, N m.
const COULOMB_NM: f64 = 0.006;
/// Friction in proportion to speed, N m s.
const VISCOUS_NM_S: f64 = 0.001;
/// The vendor's stall current of the XC330 at 5 V, A: supply over winding resistance.
const STALL_CURRENT_A: f64 = 1.8;
const NOMINAL_V: f64 = 5.0;
const WINDING_OHM: f64 = NOMINAL_V / STALL_CURRENT_A;
/// Speed without load at 5 V, rad/s (81 turns a minute).
const NO_LOAD_RAD_PER_SEC: f64 = 8.48;
const BACK_EMF_V_S: f64 = NOMINAL_V / NO_LOAD_RAD_PER_SEC;
/// Warming per dissipated power, K/W, and how long that takes, s. The vendor gives neither: at stall (9 W) the limit of
/// 70 degrees is reached after about two minutes, in normal use never.
const WARMING_K_PER_W: f64 = 6.5;
const WARMING_S: f64 = 150.0;
const AMBIENT_C: f64 = 25.0;
/// The electronics alone, W.
const IDLE_W: f64 = 0.5;

/// What the controller wants of the motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Demand {
    /// The bridge is open.
    Off,
    /// A share of the supply, -1..=1.
    Pwm(f64),
    /// A current with at most this share of the supply.
    Current {
        /// A.
        current_a: f64,
        /// 0..=1.
        most_pwm: f64,
    },
}

/// The motor and the joint that it moves. Angles are the encoder's, rad.
#[derive(Clone, Debug)]
pub(crate) struct Motor {
    pub(crate) angle_rad: f64,
    pub(crate) velocity_rad_per_sec: f64,
    pub(crate) current_a: f64,
    /// Share of the supply on the winding.
    pub(crate) pwm: f64,
    pub(crate) temperature_c: f64,
    /// What pushes the joint from outside, N m.
    pub(crate) outside_nm: f64,
    /// Inertia that stands for what gives way and damps within a step, kg m2.
    pub(crate) outside_kg_m2: f64,
    /// The joint's stops.
    stops_rad: (f64, f64),
}

impl Motor {
    pub(crate) fn new(angle_rad: f64, stops_rad: (f64, f64)) -> Self {
        Self {
            angle_rad,
            velocity_rad_per_sec: 0.0,
            current_a: 0.0,
            pwm: 0.0,
            temperature_c: AMBIENT_C + IDLE_W * WARMING_K_PER_W,
            outside_nm: 0.0,
            outside_kg_m2: 0.0,
            stops_rad,
        }
    }

    /// One step of `dt_s`. `blocked` holds the joint whatever the motor does.
    #[cfg(test)]
    pub(crate) fn step(&mut self, dt_s: f64, demand: Demand, supply_v: f64, blocked: bool) {
        self.drive(demand, supply_v);
        self.turn(dt_s, blocked);
        self.warm(dt_s);
    }

    /// The electrical side: the current that flows as the joint is.
    pub(crate) fn drive(&mut self, demand: Demand, supply_v: f64) {
        let back_emf_v = BACK_EMF_V_S * self.velocity_rad_per_sec;
        let current_at = |pwm: f64| (pwm * supply_v - back_emf_v) / WINDING_OHM;
        (self.current_a, self.pwm) = match demand {
            Demand::Off => (0.0, 0.0),
            Demand::Pwm(pwm) => (current_at(pwm.clamp(-1.0, 1.0)), pwm.clamp(-1.0, 1.0)),
            Demand::Current { current_a, most_pwm } => {
                let most_pwm = most_pwm.clamp(0.0, 1.0);
                // The current loop is much faster than the joint: only the supply limits it.
                let current_a = current_a.clamp(current_at(-most_pwm), current_at(most_pwm));
                let volts = current_a * WINDING_OHM + back_emf_v;
                (current_a, if supply_v > 0.0 { volts / supply_v } else { 0.0 })
            }
        };
    }

    /// Torque of the present current at the horn, N m, friction not taken off.
    pub(crate) fn torque_nm(&self) -> f64 {
        TORQUE_NM_PER_A * self.current_a
    }

    /// The mechanical side: where the joint goes in `dt_s`.
    pub(crate) fn turn(&mut self, dt_s: f64, blocked: bool) {
        let torque_nm = self.torque_nm() - VISCOUS_NM_S * self.velocity_rad_per_sec + self.outside_nm;
        let inertia_kg_m2 = INERTIA_KG_M2 + self.outside_kg_m2;
        let pushed = self.velocity_rad_per_sec + torque_nm / inertia_kg_m2 * dt_s;
        // Dry friction takes speed away and never gives any.
        let slowed = (pushed.abs() - COULOMB_NM / inertia_kg_m2 * dt_s).max(0.0);
        self.velocity_rad_per_sec = if blocked { 0.0 } else { slowed.copysign(pushed) };
        self.angle_rad += self.velocity_rad_per_sec * dt_s;
        let (lower, upper) = self.stops_rad;
        if self.angle_rad < lower || self.angle_rad > upper {
            self.angle_rad = self.angle_rad.clamp(lower, upper);
            self.velocity_rad_per_sec = 0.0;
        }
    }

    /// What the losses of `dt_s` do.
    pub(crate) fn warm(&mut self, dt_s: f64) {
        let heat_w = self.current_a * self.current_a * WINDING_OHM + IDLE_W;
        let rise_k = self.temperature_c - AMBIENT_C;
        self.temperature_c += dt_s * (heat_w * WARMING_K_PER_W - rise_k) / WARMING_S;
    }

    /// Whether it works hard and gets nowhere.
    pub(crate) fn is_overloaded(&self) -> bool {
        self.current_a.abs() > 0.6 * STALL_CURRENT_A && self.velocity_rad_per_sec.abs() < 0.05
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 1e-3;

    #[test]
    fn full_supply_gives_the_vendors_speed_and_stall_current() {
        let mut motor = Motor::new(0.0, (f64::NEG_INFINITY, f64::INFINITY));
        for _ in 0..2000 {
            motor.step(DT_S, Demand::Pwm(1.0), NOMINAL_V, false);
        }
        assert!((motor.velocity_rad_per_sec / NO_LOAD_RAD_PER_SEC - 1.0).abs() < 0.05, "{motor:?}");
        motor.step(DT_S, Demand::Pwm(1.0), NOMINAL_V, true);
        motor.step(DT_S, Demand::Pwm(1.0), NOMINAL_V, true);
        assert!((motor.current_a - STALL_CURRENT_A).abs() < 1e-9 && motor.is_overloaded(), "{motor:?}");
    }

    #[test]
    fn dry_friction_holds_a_joint_against_a_small_current() {
        let mut motor = Motor::new(1.0, (0.0, 2.0));
        let too_little = 0.9 * COULOMB_NM / TORQUE_NM_PER_A;
        for _ in 0..1000 {
            motor.step(DT_S, Demand::Current { current_a: too_little, most_pwm: 1.0 }, NOMINAL_V, false);
        }
        assert_eq!(motor.angle_rad, 1.0);
        for _ in 0..3000 {
            motor.step(
                DT_S,
                Demand::Current { current_a: 3.0 * too_little, most_pwm: 1.0 },
                NOMINAL_V,
                false,
            );
        }
        assert_eq!((motor.angle_rad, motor.velocity_rad_per_sec), (2.0, 0.0), "it rests at the stop");
    }

    #[test]
    fn stalling_heats_and_resting_cools() {
        let mut motor = Motor::new(0.0, (0.0, 1.0));
        let rest_c = motor.temperature_c;
        for _ in 0..200_000 {
            motor.step(DT_S, Demand::Pwm(1.0), NOMINAL_V, true);
        }
        let hot_c = motor.temperature_c;
        assert!(hot_c > 65.0 && hot_c < 100.0, "{hot_c}");
        for _ in 0..1_000_000 {
            motor.step(DT_S, Demand::Off, NOMINAL_V, false);
        }
        assert!((motor.temperature_c - rest_c).abs() < 0.2, "{}", motor.temperature_c);
    }
}
