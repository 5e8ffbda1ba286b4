//! A motion as data: key positions over time, and what to do where too little is felt on the way.

mod run;

pub use run::{ScriptRun, Sensed};

use std::collections::BTreeMap;

use palpate_robot_model::Robot;
use serde::{Deserialize, Serialize};

use crate::{GraspConfig, GraspError};

/// Targets over time, linear between keys. With tries ([`Again`]) it depends on touch: [`ScriptRun`] follows it.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    keys: Vec<ScriptKey>,
    again: Vec<Again>,
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

/// Another try, for when the hand closed on nothing: where too little is felt at one key, the hand goes back to an earlier one,
/// somewhere else, and on from there.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Again {
    /// The key, counted from 1, at which touch decides.
    pub at_key: usize,
    /// With as many channels that feel something at that moment, the script goes on.
    pub channels: u32,
    /// Otherwise the hand goes back to this key.
    pub to_key: usize,
    /// For which it has this long, s: a third each to let go and rise, to move, and to come down.
    pub within_s: f64,
    /// How far it rises meanwhile, m.
    pub raise_m: f64,
    /// Where the whole hand is from then on, along x and y of the base and seen from the script's own positions, when nothing
    /// was felt in the try before, m.
    pub unfelt_m: [f64; 2],
    /// The same when something was felt, m; `towards` comes on top.
    pub felt_m: [f64; 2],
    /// Share of the way from the middle of the region that objects start in to the middle of where channels first felt
    /// something.
    pub towards: [f64; 2],
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct ScriptText {
    key: Vec<ScriptKey>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    again: Vec<Again>,
}

impl Script {
    /// Reads a script that begins at the start positions of `config`. `file` names it in errors.
    ///
    /// Refused, naming the key or try: times that do not increase, unknown joints, positions beyond the joint's limits; tries
    /// that do not go back, or to no key.
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
        Self::new(script.key, script.again, robot, config).map_err(error)
    }

    /// The text that [`Self::from_toml`] reads.
    pub fn to_toml(&self) -> Result<String, GraspError> {
        let error = |err: toml::ser::Error| GraspError::Config {
            file: "script".to_owned(),
            problem: format!("it has no text form: {err}"),
        };
        toml::to_string(&ScriptText { key: self.keys.clone(), again: self.again.clone() }).map_err(error)
    }

    /// A script of these keys and tries; what is wrong with them is said as by [`Self::from_toml`].
    pub fn new(
        keys: Vec<ScriptKey>,
        again: Vec<Again>,
        robot: &Robot,
        config: &GraspConfig,
    ) -> Result<Self, String> {
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
        for (idx, again) in again.iter().enumerate() {
            again.check(keys.len()).map_err(|problem| format!("again {}: {problem}", idx + 1))?;
        }
        Ok(Self { keys, again, targets: all })
    }

    /// Its keys.
    pub fn keys(&self) -> &[ScriptKey] {
        &self.keys
    }

    /// Its further tries, in the order in which they are made.
    pub fn again(&self) -> &[Again] {
        &self.again
    }

    /// Whether what it does depends on touch.
    pub fn feels(&self) -> bool {
        !self.again.is_empty()
    }

    /// Targets at key `idx` (from 0), one per degree of freedom.
    ///
    /// # Panics
    /// If there is no such key: a caller's bug.
    pub fn targets_at_key(&self, idx: usize) -> &[f64] {
        &self.targets[idx + 1].1
    }

    /// Time of the last key when all tries are made, s.
    pub fn end_s(&self) -> f64 {
        let at_s = |key: usize| self.targets[key].0;
        let tries = self.again.iter().map(|again| at_s(again.at_key) - at_s(again.to_key) + again.within_s);
        at_s(self.keys.len()) + tries.sum::<f64>()
    }

    /// Targets at `time_s` without further tries, one per degree of freedom; the last key holds for ever.
    pub fn targets_at(&self, time_s: f64) -> Vec<f64> {
        between(&self.targets, time_s)
    }
}

impl Again {
    /// What is wrong with it in a script of `num_keys` keys.
    pub(crate) fn check(&self, num_keys: usize) -> Result<(), String> {
        let Self { at_key, to_key, within_s, .. } = *self;
        if !(1..=num_keys).contains(&at_key) {
            return Err(format!("at_key is {at_key}, expected 1 to {num_keys}"));
        }
        if !(1..at_key).contains(&to_key) {
            return Err(format!("to_key is {to_key}, expected an earlier key than at_key, {at_key}"));
        }
        if !(within_s.is_finite() && within_s > 0.0) {
            return Err(format!("within_s is {within_s}, expected a time above zero"));
        }
        for (name, values) in [
            ("raise_m", [self.raise_m; 2]),
            ("unfelt_m", self.unfelt_m),
            ("felt_m", self.felt_m),
            ("towards", self.towards),
        ] {
            if let Some(value) = values.iter().find(|value| !value.is_finite()) {
                return Err(format!("{name} holds {value}, expected finite numbers"));
            }
        }
        Ok(())
    }
}

/// Targets of `timeline` at `time_s`, linear in between; the last hold for ever.
pub(crate) fn between(timeline: &[(f64, Vec<f64>)], time_s: f64) -> Vec<f64> {
    let after = timeline.partition_point(|(at_s, _)| *at_s <= time_s);
    let (from_s, from) = &timeline[after.saturating_sub(1)];
    let Some((to_s, to)) = timeline.get(after) else { return from.clone() };
    let share = ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0);
    from.iter().zip(to).map(|(from, to)| from + share * (to - from)).collect()
}
