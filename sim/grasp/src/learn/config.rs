//! The file of a learning task.

use palpate_robot_model::Robot;
use serde::Deserialize;

use crate::GraspError;

/// What is learned, as read from TOML. Units are in the names.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct LearnConfig {
    /// Name of a link of the digit that opposes the others: a grasp needs it and two more.
    pub opposing_link: String,
    /// What actions do.
    pub action: ActionConfig,
    /// What the actor sees.
    pub observation: ObservationConfig,
    /// What is worth how much.
    pub reward: RewardConfig,
    /// Where objects start.
    pub start: StartConfig,
    /// What disturbs.
    pub push: PushConfig,
}

/// How far actions reach.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct ActionConfig {
    /// On top of a script.
    pub residual: Bounds,
    /// Without one, from the start position.
    pub free: Bounds,
}

/// What an action of one changes in a step, and how far all steps together may get.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Bounds {
    /// Of a hand joint, a step.
    pub hand_step_rad: f64,
    /// Of a hand joint, in all.
    pub hand_reach_rad: f64,
    /// Of the hand's root along each axis of the base, a step.
    pub arm_step_m: f64,
    /// Along each axis, in all.
    pub arm_reach_m: [f64; 3],
    /// Of the hand's root about the vertical, a step.
    pub yaw_step_rad: f64,
    /// In all.
    pub yaw_reach_rad: f64,
}

/// What the actor sees.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct ObservationConfig {
    /// Largest error of a joint reading, uniform, rad or m.
    pub position_noise: f64,
    /// What is left of a past touch after a step, 0 to 1.
    pub touch_memory: f64,
}

/// Weights of the terms of [`crate::learn::REWARD_TERMS`], before `scale`.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct RewardConfig {
    /// On everything.
    pub scale: f64,
    /// Digit tips near the object, a step.
    pub tips: f64,
    /// Distance at which a tip counts for 1/e, m.
    pub tip_distance_m: f64,
    /// The opposing digit and two others touch, a step.
    pub grasp: f64,
    /// Lifted to `lift_at_m`, a step; in proportion below.
    pub lift: f64,
    /// Height that counts in full, m.
    pub lift_at_m: f64,
    /// Share of `lift` that counts without a grasp.
    pub lift_without_grasp: f64,
    /// Taken off for the mean square of the action, a step.
    pub action: f64,
    /// Taken off while the robot touches the table, a step.
    pub table: f64,
    /// Once, for a success.
    pub success: f64,
    /// Taken off once, for an emergency stop.
    pub stop: f64,
}

/// Where objects start: a square that widens as success allows.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct StartConfig {
    /// Half its edge length at first, and at last, m.
    pub half_width_m: [f64; 2],
    /// By how much it widens, m.
    pub widen_m: f64,
    /// Share of successes at which it does.
    pub widen_at: f64,
    /// Episodes over which that share is taken.
    pub window: usize,
    /// Whether objects start in any orientation and come to rest from there, or on a side drawn by its likelihood.
    pub any_orientation: bool,
}

/// Forces on the object that nobody announces.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct PushConfig {
    /// Probability that one begins in a step.
    pub probability: f64,
    /// Largest force along each axis, N.
    pub force_n: f64,
    /// How long it lasts, s.
    pub duration_s: f64,
}

impl LearnConfig {
    /// Reads a task for `robot`; `file` names it in errors.
    ///
    /// Refused by name: unknown keys and links, numbers out of their range.
    pub fn from_toml(file: &str, text: &str, robot: &Robot) -> Result<Self, GraspError> {
        let error = |problem: String| GraspError::Config { file: file.to_owned(), problem };
        let config: Self = toml::from_str(text).map_err(|err| error(err.to_string()))?;
        config.check(robot).map_err(error)?;
        Ok(config)
    }

    fn check(&self, robot: &Robot) -> Result<(), String> {
        if robot.link_index(&self.opposing_link).is_none() {
            return Err(format!(
                "opposing_link names link {:?}, which the robot does not have",
                self.opposing_link
            ));
        }
        let reward = &self.reward;
        let mut not_negative = vec![
            ("observation.position_noise", self.observation.position_noise),
            ("reward.tips", reward.tips),
            ("reward.grasp", reward.grasp),
            ("reward.lift", reward.lift),
            ("reward.action", reward.action),
            ("reward.table", reward.table),
            ("reward.success", reward.success),
            ("reward.stop", reward.stop),
            ("start.half_width_m", self.start.half_width_m[0]),
            ("push.force_n", self.push.force_n),
        ];
        for bounds in [&self.action.residual, &self.action.free] {
            not_negative.extend([
                ("action: hand_step_rad", bounds.hand_step_rad),
                ("action: hand_reach_rad", bounds.hand_reach_rad),
                ("action: arm_step_m", bounds.arm_step_m),
                ("action: yaw_step_rad", bounds.yaw_step_rad),
                ("action: yaw_reach_rad", bounds.yaw_reach_rad),
            ]);
            not_negative.extend(bounds.arm_reach_m.map(|reach_m| ("action: arm_reach_m", reach_m)));
        }
        if let Some((name, value)) =
            not_negative.iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0))
        {
            return Err(format!("{name} is {value}, expected a finite number, not negative"));
        }
        let positive = [
            ("reward.scale", reward.scale),
            ("reward.tip_distance_m", reward.tip_distance_m),
            ("reward.lift_at_m", reward.lift_at_m),
            ("start.widen_m", self.start.widen_m),
            ("push.duration_s", self.push.duration_s),
        ];
        if let Some((name, value)) = positive.iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
            return Err(format!("{name} is {value}, expected a finite number above zero"));
        }
        let shares = [
            ("observation.touch_memory", self.observation.touch_memory),
            ("reward.lift_without_grasp", reward.lift_without_grasp),
            ("start.widen_at", self.start.widen_at),
            ("push.probability", self.push.probability),
        ];
        if let Some((name, value)) = shares.iter().find(|(_, value)| !(0.0..=1.0).contains(value)) {
            return Err(format!("{name} is {value}, expected 0 to 1"));
        }
        let [first_m, last_m] = self.start.half_width_m;
        if !(last_m >= first_m && last_m.is_finite()) {
            return Err(format!(
                "start.half_width_m is [{first_m}, {last_m}], expected the smaller one first"
            ));
        }
        if self.start.window == 0 {
            return Err("start.window is 0, expected at least 1 episode".to_owned());
        }
        Ok(())
    }
}
