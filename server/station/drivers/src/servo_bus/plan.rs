//! What the driver is told about its line, in the units that servos use, and the one place where joint angles become
//! servo angles and back.

use std::path::PathBuf;
use std::time::Duration;

use palpate_device_protocol::dynamixel::control_table::{
    BUS_WATCHDOG, GOAL_CURRENT, GOAL_POSITION, RegisterError,
};
use palpate_robot_model::hardware::{MAX_CURRENT_LIMIT_A, ServoBusConfig};

/// One line of servos.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BusPlan {
    pub(crate) path: PathBuf,
    pub(crate) baud: u32,
    pub(crate) period: Duration,
    /// Goal current of every servo, mA.
    pub(crate) current_limit_ma: i64,
    /// Bus watchdog while armed, in its steps of 20 ms.
    pub(crate) watchdog: i64,
    /// How long joints are held once setpoints have dried up, ns.
    pub(crate) hold_ns: u64,
    pub(crate) servos: Vec<ServoPlan>,
}

/// One servo.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ServoPlan {
    pub(crate) joint: String,
    /// Degree of freedom in the station's order.
    pub(crate) dof: usize,
    pub(crate) id: u8,
    /// Servo angle at which the joint is at zero.
    pub(crate) zero_rad: f64,
    /// 1, or -1 where the joint turns the other way.
    pub(crate) direction: f64,
    pub(crate) p: u16,
    pub(crate) i: u16,
    pub(crate) d: u16,
}

impl BusPlan {
    /// The plan for a line on the port at `path`, or what cannot be done, in words.
    pub(crate) fn new(config: &ServoBusConfig, path: PathBuf, hold_ns: u64) -> Result<Self, String> {
        let current_limit_a = config.current_limit_a;
        // The last place that sees it: whatever the station file lets through, no servo gets more.
        if !(current_limit_a > 0.0 && current_limit_a <= MAX_CURRENT_LIMIT_A) {
            return Err(format!(
                "current_limit_a = {current_limit_a}, expected above 0 and at most {MAX_CURRENT_LIMIT_A}"
            ));
        }
        if !(config.rate_hz > 0.0 && config.rate_hz.is_finite()) {
            return Err(format!("rate_hz = {}, expected a positive number", config.rate_hz));
        }
        let current = GOAL_CURRENT.to_raw(1e3 * current_limit_a).map_err(|error| error.to_string())?;
        let watchdog = BUS_WATCHDOG.to_raw(config.watchdog_s).map_err(|error| error.to_string())?;
        if watchdog.0 < 1 {
            return Err(format!("watchdog_s = {}, expected 0.02 to 2.54", config.watchdog_s));
        }
        let servo = |servo: &palpate_robot_model::hardware::ServoConfig| ServoPlan {
            joint: servo.joint.clone(),
            dof: servo.dof,
            id: servo.id,
            zero_rad: servo.zero_rad,
            direction: f64::from(servo.direction),
            p: servo.p,
            i: servo.i,
            d: servo.d,
        };
        Ok(Self {
            path,
            baud: config.baud,
            period: Duration::from_secs_f64(1.0 / config.rate_hz),
            current_limit_ma: current.0,
            watchdog: watchdog.0,
            hold_ns,
            servos: config.servos.iter().map(servo).collect(),
        })
    }
}

impl ServoPlan {
    pub(crate) fn joint_rad(&self, servo_rad: f64) -> f64 {
        self.direction * (servo_rad - self.zero_rad)
    }

    /// Velocities and currents only change their sign.
    pub(crate) fn along_joint(&self, along_servo: f64) -> f64 {
        self.direction * along_servo
    }

    pub(crate) fn servo_rad(&self, joint_rad: f64) -> f64 {
        self.direction * joint_rad + self.zero_rad
    }

    /// Bytes of the goal position for a joint angle; refused if it is no number.
    pub(crate) fn goal_bytes(&self, joint_rad: f64) -> Result<Vec<u8>, RegisterError> {
        GOAL_POSITION.encode(GOAL_POSITION.to_raw(self.servo_rad(joint_rad))?)
    }

    /// How the servo is called in messages.
    pub(crate) fn name(&self) -> String {
        format!("{} (servo {})", self.joint, self.id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn joint_angles_survive_the_servo_to_half_a_tick(
            joint_rad in -2.5..2.5_f64,
            zero_rad in 0.0..6.2_f64,
            reversed: bool,
        ) {
            let direction = if reversed { -1.0 } else { 1.0 };
            let servo = ServoPlan {
                joint: "index_pip".to_owned(), dof: 8, id: 2, zero_rad, direction, p: 600, i: 0, d: 200,
            };
            prop_assert!((servo.joint_rad(servo.servo_rad(joint_rad)) - joint_rad).abs() < 1e-12);
            let bytes = servo.goal_bytes(joint_rad).unwrap();
            let back = servo.joint_rad(GOAL_POSITION.to_physical(GOAL_POSITION.decode(&bytes).unwrap()));
            prop_assert!((back - joint_rad).abs() <= std::f64::consts::PI / 4096.0 + 1e-12);
            // Moving the joint forward moves the servo along its direction.
            prop_assert!(servo.along_joint(servo.servo_rad(joint_rad + 0.1) - servo.servo_rad(joint_rad)) > 0.0);
            prop_assert!(servo.goal_bytes(f64::NAN).is_err() && servo.goal_bytes(f64::INFINITY).is_err());
        }
    }
}
