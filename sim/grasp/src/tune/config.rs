//! What may change in a script, and what a trial is worth.

use std::collections::BTreeMap;

use palpate_robot_model::Robot;
use serde::Deserialize;

use crate::hand::{HandMove, carrier_dofs};
use crate::{Again, GraspConfig, GraspError, Script};

/// Positions of a tuned script are whole multiples of one over this, rad or m, so that its file has all their digits.
const POSITIONS_PER_UNIT: f64 = 1e4;
/// Times likewise, s.
const TIMES_PER_S: f64 = 1e3;
/// Shortest time between two keys, s.
const SHORTEST_S: f64 = 0.05;

/// What a search may change, as read from TOML.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct TuningConfig {
    /// What a trial is worth.
    pub score: ScoreConfig,
    /// Tries that a script without any is given before the search begins.
    #[serde(default)]
    pub again: Vec<Again>,
    /// The numbers that it changes, all zero for the script as it is.
    #[serde(rename = "parameter")]
    pub parameters: Vec<ParameterConfig>,
}

/// What a trial is worth: one for a success, and these.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct ScoreConfig {
    /// At the task's lift height or above; in proportion below it.
    pub lift: f64,
    /// When every digit touches the object at the end; in proportion for some.
    pub digits: f64,
    /// Taken off for each second in which the robot touches the table.
    pub table_per_s: f64,
    /// Taken off when the robot is stopped.
    pub stop: f64,
}

/// One number.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct ParameterConfig {
    /// Its name.
    pub name: String,
    /// What it is added to.
    pub acts_on: ActsOn,
    /// At which keys of the script, counted from 1; none where it acts on tries.
    #[serde(default)]
    pub keys: Vec<usize>,
    /// At which of its further tries, counted from 1; none where it acts on keys.
    #[serde(default)]
    pub again: Vec<usize>,
    /// With [`ActsOn::Joints`]: which joints, each with a factor on the number.
    #[serde(default)]
    pub joints: BTreeMap<String, f64>,
    /// Standard deviation that a search begins with, in the unit of what it acts on.
    pub spread: f64,
}

/// What a number is added to.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum ActsOn {
    /// Positions of joints, rad or m.
    Joints,
    /// Position of the hand's root along x of the base, m; the joints before it follow.
    HandX,
    /// Along y.
    HandY,
    /// Along z.
    HandZ,
    /// The hand turns by it about the vertical through the middle of the region, rad.
    HandYaw,
    /// Natural logarithm of a factor on the time between a key and the one before.
    Duration,
    /// [`Again::unfelt_m`] along x, m.
    UnfeltX,
    /// Along y.
    UnfeltY,
    /// [`Again::felt_m`] along x, m.
    FeltX,
    /// Along y.
    FeltY,
    /// [`Again::towards`] along x.
    TowardsX,
    /// Along y.
    TowardsY,
    /// [`Again::channels`], rounded.
    Channels,
}

impl ActsOn {
    /// Whether it is a part of [`Again`].
    fn is_of_tries(self) -> bool {
        use ActsOn::{Channels, FeltX, FeltY, TowardsX, TowardsY, UnfeltX, UnfeltY};
        matches!(self, UnfeltX | UnfeltY | FeltX | FeltY | TowardsX | TowardsY | Channels)
    }

    /// Adds `value` to its part of `again`.
    fn change_try(self, again: &mut Again, value: f64) {
        let add = |to: &mut f64| *to = on_grid(*to + value, POSITIONS_PER_UNIT);
        match self {
            Self::UnfeltX => add(&mut again.unfelt_m[0]),
            Self::UnfeltY => add(&mut again.unfelt_m[1]),
            Self::FeltX => add(&mut again.felt_m[0]),
            Self::FeltY => add(&mut again.felt_m[1]),
            Self::TowardsX => add(&mut again.towards[0]),
            Self::TowardsY => add(&mut again.towards[1]),
            // Negative counts end at zero.
            Self::Channels => again.channels = (f64::from(again.channels) + value).round() as u32,
            _ => (),
        }
    }
}

impl TuningConfig {
    /// Reads a file for `script`; `file` names it in errors.
    ///
    /// Refused, naming parameter and key: no parameters, unknown joints, joints where none belong or are missing, keys and
    /// tries that the script does not have, spreads that are not above zero, scores below zero.
    pub fn from_toml(file: &str, text: &str, robot: &Robot, script: &Script) -> Result<Self, GraspError> {
        let error = |problem: String| GraspError::Config { file: file.to_owned(), problem };
        let config: Self = toml::from_str(text).map_err(|err| error(err.to_string()))?;
        config.check(robot, script).map_err(error)?;
        Ok(config)
    }

    fn check(&self, robot: &Robot, script: &Script) -> Result<(), String> {
        let num_keys = script.keys().len();
        for (idx, again) in self.again.iter().enumerate() {
            again.check(num_keys).map_err(|problem| format!("again {}: {problem}", idx + 1))?;
        }
        let num_again = self.again_of(script).len();
        let score = &self.score;
        let weights = [
            ("lift", score.lift),
            ("digits", score.digits),
            ("table_per_s", score.table_per_s),
            ("stop", score.stop),
        ];
        if let Some((name, value)) = weights.iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0)) {
            return Err(format!("score.{name} is {value}, expected a finite number, not negative"));
        }
        if self.parameters.is_empty() {
            return Err("there is no [[parameter]], expected at least one".to_owned());
        }
        for parameter in &self.parameters {
            let at = |problem: String| Err(format!("parameter {:?}: {problem}", parameter.name));
            if !(parameter.spread.is_finite() && parameter.spread > 0.0) {
                return at(format!("spread is {}, expected a number above zero", parameter.spread));
            }
            let (own, own_name, most, other, other_name) = if parameter.acts_on.is_of_tries() {
                (&parameter.again, "again", num_again, &parameter.keys, "keys")
            } else {
                (&parameter.keys, "keys", num_keys, &parameter.again, "again")
            };
            if own.is_empty() {
                return at(format!("{own_name} is empty, expected some numbers from 1 to {most}"));
            }
            if let Some(number) = own.iter().find(|number| !(1..=most).contains(*number)) {
                return at(format!("{own_name} holds {number}, expected 1 to {most}"));
            }
            if !other.is_empty() {
                return at(format!("{other_name} has no place beside what it acts on"));
            }
            if parameter.joints.is_empty() == (parameter.acts_on == ActsOn::Joints) {
                return at("joints belong to acts_on = \"joints\", and only there".to_owned());
            }
            for (name, factor) in &parameter.joints {
                if robot.dofs().all(|joint| joint.name != *name) {
                    return at(format!("there is no joint {name:?}"));
                }
                if !factor.is_finite() {
                    return at(format!("the factor of joint {name:?} is {factor}, expected a finite number"));
                }
            }
        }
        Ok(())
    }

    /// The tries of `script`, or those that it is given.
    fn again_of<'a>(&'a self, script: &'a Script) -> &'a [Again] {
        if script.feels() { script.again() } else { &self.again }
    }

    /// `script` with `values`, one per parameter, added; `None` where the arm does not reach. Joints stop at their limits.
    ///
    /// # Panics
    /// If there is not one value per parameter, or this was read for a script with more keys or tries: a caller's bug.
    pub fn apply(
        &self,
        values: &[f64],
        script: &Script,
        robot: &Robot,
        config: &GraspConfig,
    ) -> Option<Script> {
        assert_eq!(values.len(), self.parameters.len(), "one value per parameter");
        let num_keys = script.keys().len();
        let mut keys = script.keys().to_vec();
        let mut again = self.again_of(script).to_vec();
        let mut stretch = vec![0.0; num_keys];
        let mut moves = vec![HandMove::default(); num_keys];
        let mut joints: BTreeMap<(usize, &str), f64> = BTreeMap::new();
        for (parameter, &value) in self.parameters.iter().zip(values) {
            for one in &parameter.again {
                parameter.acts_on.change_try(&mut again[one - 1], value);
            }
            for key in parameter.keys.iter().map(|key| key - 1) {
                match parameter.acts_on {
                    ActsOn::Joints => {
                        for (name, factor) in &parameter.joints {
                            *joints.entry((key, name)).or_default() += factor * value;
                        }
                    }
                    ActsOn::HandX => moves[key].offset_m.x += value,
                    ActsOn::HandY => moves[key].offset_m.y += value,
                    ActsOn::HandZ => moves[key].offset_m.z += value,
                    ActsOn::HandYaw => moves[key].yaw_rad += value,
                    ActsOn::Duration => stretch[key] += value,
                    _ => (),
                }
            }
        }
        let mut set = |key: usize, dof: usize, position: f64| {
            let Some(joint) = robot.dofs().nth(dof) else { return };
            let rounded = on_grid(position, POSITIONS_PER_UNIT);
            let within = joint.limits.map_or(rounded, |limits| rounded.clamp(limits.lower, limits.upper));
            keys[key].joints.insert(joint.name.clone(), within);
        };
        for ((key, name), change) in joints {
            let dof = robot.dofs().position(|joint| joint.name == name)?;
            set(key, dof, script.targets_at_key(key)[dof] + change);
        }
        let carriers = carrier_dofs(robot, config);
        for (key, hand_move) in moves.iter().enumerate().filter(|(_, hand)| **hand != HandMove::default()) {
            let mut positions = script.targets_at_key(key).to_vec();
            if !hand_move.reach(robot, config, &mut positions) {
                return None;
            }
            carriers.iter().for_each(|&dof| set(key, dof, positions[dof]));
        }
        let (mut before_s, mut after_s) = (0.0, 0.0);
        for (key, stretch) in keys.iter_mut().zip(stretch) {
            let span_s = ((key.at_s - before_s) * stretch.exp()).max(SHORTEST_S);
            before_s = key.at_s;
            after_s = on_grid(after_s + span_s, TIMES_PER_S);
            key.at_s = after_s;
        }
        Script::new(keys, again, robot, config).ok()
    }
}

/// The nearest whole multiple of `1 / per_unit`; never negative zero.
fn on_grid(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit + 0.0
}
