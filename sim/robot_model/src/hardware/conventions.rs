//! Conventions of joints: what a servo calls a position, and in which order other software lists the joints of a hand.

use super::ServoConfig;

impl ServoConfig {
    /// Position of the joint, rad, where the servo is at `servo_rad`.
    pub fn joint_from_servo(&self, servo_rad: f64) -> f64 {
        f64::from(self.direction) * (servo_rad - self.zero_rad)
    }

    /// Position of the servo, rad, where the joint is at `joint_rad`: the inverse of
    /// [`joint_from_servo`](Self::joint_from_servo).
    pub fn servo_from_joint(&self, joint_rad: f64) -> f64 {
        self.zero_rad + f64::from(self.direction) * joint_rad
    }

    /// Speed of the joint for a speed of the servo, and the reverse: both are the same turn, rad/s.
    pub fn flip_velocity(&self, velocity_rad_per_s: f64) -> f64 {
        f64::from(self.direction) * velocity_rad_per_s
    }
}

/// For each motor id of a LEAP Hand, the index of its joint in Isaac Gym's order (LEAP_Hand_Sim, `hardware_controller.py`).
pub const LEAP_ISAAC_FROM_MOTOR: [usize; 16] = [1, 0, 2, 3, 9, 8, 10, 11, 13, 12, 14, 15, 4, 5, 6, 7];

/// For each joint of a LEAP Hand in Isaac Gym's order, its motor id (LEAP_Hand_Sim, `hardware_controller.py`).
pub const LEAP_MOTOR_FROM_ISAAC: [usize; 16] = [1, 0, 2, 3, 12, 13, 14, 15, 5, 4, 6, 7, 9, 8, 10, 11];

/// For each actuator of the LEAP Hand in MuJoCo Menagerie, its motor id.
pub const LEAP_MOTOR_FROM_MENAGERIE: [usize; 16] = [1, 0, 2, 3, 5, 4, 6, 7, 9, 8, 10, 11, 12, 13, 14, 15];

/// Values by motor id from values in Isaac Gym's order: `motors[i] = isaac[LEAP_ISAAC_FROM_MOTOR[i]]`.
pub fn leap_motors_from_isaac<T: Copy>(isaac: &[T; 16]) -> [T; 16] {
    LEAP_ISAAC_FROM_MOTOR.map(|idx| isaac[idx])
}

/// Values in Isaac Gym's order from values by motor id: `isaac[i] = motors[LEAP_MOTOR_FROM_ISAAC[i]]`.
pub fn leap_isaac_from_motors<T: Copy>(motors: &[T; 16]) -> [T; 16] {
    LEAP_MOTOR_FROM_ISAAC.map(|idx| motors[idx])
}

/// Values in the order of Menagerie's actuators from values by motor id.
pub fn leap_menagerie_from_motors<T: Copy>(motors: &[T; 16]) -> [T; 16] {
    LEAP_MOTOR_FROM_MENAGERIE.map(|idx| motors[idx])
}

/// Values by motor id from values in the order of Menagerie's actuators.
pub fn leap_motors_from_menagerie<T: Copy>(menagerie: &[T; 16]) -> [T; 16] {
    let mut motors = *menagerie;
    for (&motor, &value) in LEAP_MOTOR_FROM_MENAGERIE.iter().zip(menagerie) {
        motors[motor] = value;
    }
    motors
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use proptest::prelude::*;

    use super::*;

    fn servo(direction: i8, zero_rad: f64) -> ServoConfig {
        ServoConfig { joint: "j".to_owned(), dof: 0, id: 3, zero_rad, direction, p: 600, i: 0, d: 200 }
    }

    #[test]
    fn the_flat_open_leap_hand_is_at_pi_on_every_motor() {
        assert_eq!(servo(1, PI).joint_from_servo(PI), 0.0);
        assert_eq!(servo(1, PI).servo_from_joint(0.5), PI + 0.5, "positive closes");
        assert_eq!(servo(-1, PI).servo_from_joint(0.5), PI - 0.5);
        assert_eq!(servo(-1, PI).flip_velocity(2.0), -2.0);
    }

    #[test]
    fn the_published_permutations_are_inverse_to_each_other() {
        let names: [usize; 16] = std::array::from_fn(|i| i);
        assert_eq!(leap_motors_from_isaac(&leap_isaac_from_motors(&names)), names);
        assert_eq!(leap_isaac_from_motors(&leap_motors_from_isaac(&names)), names);
        assert_eq!(leap_motors_from_menagerie(&leap_menagerie_from_motors(&names)), names);
    }

    /// What is written down about either order: a finger's joints are MCP side, MCP forward, PIP, DIP by motor id, with
    /// the fingers in the order index, middle, ring, thumb. Isaac Gym has forward before side, and the thumb second.
    #[test]
    fn isaac_gym_lists_the_thumb_second_and_forward_before_side() {
        let motors = [
            "index side",
            "index forward",
            "index pip",
            "index dip",
            "middle side",
            "middle forward",
            "middle pip",
            "middle dip",
            "ring side",
            "ring forward",
            "ring pip",
            "ring dip",
            "thumb cmc",
            "thumb axial",
            "thumb mcp",
            "thumb ip",
        ];
        let isaac = [
            "index forward",
            "index side",
            "index pip",
            "index dip",
            "thumb cmc",
            "thumb axial",
            "thumb mcp",
            "thumb ip",
            "middle forward",
            "middle side",
            "middle pip",
            "middle dip",
            "ring forward",
            "ring side",
            "ring pip",
            "ring dip",
        ];
        assert_eq!(leap_isaac_from_motors(&motors), isaac);
        assert_eq!(leap_motors_from_isaac(&isaac), motors);
        assert_eq!(leap_menagerie_from_motors(&motors)[..4], isaac[..4]);
        assert_eq!(leap_menagerie_from_motors(&motors)[12..], motors[12..]);
    }

    proptest! {
        #[test]
        fn servo_and_joint_convert_back_and_forth(
            forward in any::<bool>(),
            zero_rad in -7.0..7.0,
            joint_rad in -4.0..4.0,
        ) {
            let servo = servo(if forward { 1 } else { -1 }, zero_rad);
            let back = servo.joint_from_servo(servo.servo_from_joint(joint_rad));
            prop_assert!((back - joint_rad).abs() < 1e-14, "{} came back as {}", joint_rad, back);
        }
    }
}
