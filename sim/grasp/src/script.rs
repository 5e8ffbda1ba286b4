//! A motion without senses: key positions over time, as data.

use std::collections::BTreeMap;

use palpate_robot_model::Robot;
use serde::{Deserialize, Serialize};

use crate::{GraspConfig, GraspError};

/// Targets over time, linear between keys.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    keys: Vec<ScriptKey>,
    /// `(time in s, target of every degree of freedom in the robot's order)`, times increasing: the start, then the keys.
    targets: Vec<(f64, Vec<f64>)>,
}

/// Where some joints are at a time.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ScriptKey {
    /// Time since the episode began, s.
    pub at_s: f64,
    /// Positions by name, rad or m; joints that are not named stay where they are.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub joints: BTreeMap<String, f64>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct ScriptText {
    key: Vec<ScriptKey>,
}

impl Script {
    /// Reads a script that begins at the start positions of `config`. `file` names it in errors.
    ///
    /// Refused, naming the key: times that do not increase, unknown joints, positions beyond the joint's limits.
    ///
    /// ```
    /// # use palpate_robot_model::Robot;
    /// # use palpate_grasp::{GraspConfig, Script};
    /// # fn example(robot: &Robot, config: &GraspConfig) -> Result<(), palpate_grasp::GraspError> {
    /// let script = Script::from_toml("close.toml", r#"
    ///     key = [{ at_s = 1.0 }, { at_s = 2.0, joints = { index_pip = 1.0, thumb_ip = 0.8 } }]
    /// "#, robot, config)?;
    /// let half_closed = script.targets_at(1.5);
    /// # Ok(())
    /// # }
    /// ```
    pub fn from_toml(
        file: &str,
        text: &str,
        robot: &Robot,
        config: &GraspConfig,
    ) -> Result<Self, GraspError> {
        let error = |problem: String| GraspError::Config { file: file.to_owned(), problem };
        let script: ScriptText = toml::from_str(text).map_err(|err| error(err.to_string()))?;
        Self::new(script.key, robot, config).map_err(error)
    }

    /// The text that [`Self::from_toml`] reads.
    pub fn to_toml(&self) -> Result<String, GraspError> {
        let error = |err: toml::ser::Error| GraspError::Config {
            file: "script".to_owned(),
            problem: format!("it has no text form: {err}"),
        };
        toml::to_string(&ScriptText { key: self.keys.clone() }).map_err(error)
    }

    /// A script of these keys; what is wrong with them is said as by [`Self::from_toml`].
    pub fn new(keys: Vec<ScriptKey>, robot: &Robot, config: &GraspConfig) -> Result<Self, String> {
        let mut all = vec![(0.0, config.start_positions(robot))];
        for (idx, key) in keys.iter().enumerate() {
            let at_key = |problem: String| format!("key {}: {problem}", idx + 1);
            let (before_s, mut targets) = all[idx].clone();
            if !(key.at_s > before_s && key.at_s.is_finite()) {
                return Err(at_key(format!("at_s is {}, expected a time after {before_s} s", key.at_s)));
            }
            for (name, &target) in &key.joints {
                let Some((dof, joint)) = robot.dofs().enumerate().find(|(_, joint)| joint.name == *name)
                else {
                    return Err(at_key(format!("there is no joint {name:?}")));
                };
                let within =
                    joint.limits.is_none_or(|limits| (limits.lower..=limits.upper).contains(&target));
                if !(target.is_finite() && within) {
                    return Err(at_key(format!(
                        "joint {name:?} is sent to {target}, which is beyond its limits"
                    )));
                }
                targets[dof] = target;
            }
            all.push((key.at_s, targets));
        }
        Ok(Self { keys, targets: all })
    }

    /// Its keys.
    pub fn keys(&self) -> &[ScriptKey] {
        &self.keys
    }

    /// Targets at key `idx` (from 0), one per degree of freedom.
    ///
    /// # Panics
    /// If there is no such key: a caller's bug.
    pub fn targets_at_key(&self, idx: usize) -> &[f64] {
        &self.targets[idx + 1].1
    }

    /// Time of the last key, s.
    pub fn end_s(&self) -> f64 {
        self.targets[self.targets.len() - 1].0
    }

    /// Targets at `time_s`, one per degree of freedom; the last key holds for ever.
    pub fn targets_at(&self, time_s: f64) -> Vec<f64> {
        let after = self.targets.partition_point(|(at_s, _)| *at_s <= time_s);
        let (from_s, from) = &self.targets[after.saturating_sub(1)];
        let Some((to_s, to)) = self.targets.get(after) else { return from.clone() };
        let share = ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
        from.iter().zip(to).map(|(from, to)| from + share * (to - from)).collect()
    }
}
