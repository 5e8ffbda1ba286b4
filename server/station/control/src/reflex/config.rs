//! What a reflex goes by, as TOML.

use std::collections::BTreeMap;

use palpate_robot_model::{JointKind, Station};
use serde::Deserialize;

/// A configuration is no longer than this, bytes: it is read between two turns of the control loop.
const MAX_TEXT_BYTES: usize = 16 * 1024;
/// An offset is no larger than this, rad.
const MAX_OFFSET_RAD: f64 = 1.0;
/// Speeds of an offset are no larger than this, rad/s; the safety layer's limits hold besides.
const MAX_SPEED: f64 = 5.0;
/// Times are no longer than this, s.
const MAX_TIME_S: f64 = 10.0;

/// Times, thresholds and limits of a reflex; `assets/grasp/reflex` explains them.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Gains {
    pub(crate) confirm_s: f64,
    pub(crate) lost_s: f64,
    pub(crate) slip_share: f64,
    pub(crate) slip_within_s: f64,
    pub(crate) give_up_s: f64,
    pub(crate) let_go_rad: f64,
    pub(crate) tighten_rad: f64,
    pub(crate) tighten_rad_per_s: f64,
    pub(crate) tighten_error_rad: f64,
    pub(crate) yield_rad: f64,
    pub(crate) yield_rad_per_s: f64,
    pub(crate) yield_error_rad: f64,
    pub(crate) calm_error_rad: f64,
    pub(crate) return_rad_per_s: f64,
    pub(crate) still_rad_per_s: f64,
}

/// A digit that has a reflex.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DigitConfig {
    pub(crate) name: String,
    /// Channels that feel for it.
    pub(crate) channels: Vec<usize>,
    /// For each of these channels, the reading at which it switches on.
    pub(crate) thresholds: Vec<f64>,
    /// Joints that close it: degree of freedom, and by how much it turns for 1 rad of offset.
    pub(crate) joints: Vec<(usize, f64)>,
}

/// A reflex of a station's hand.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ReflexConfig {
    pub(crate) gains: Gains,
    pub(crate) digits: Vec<DigitConfig>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ConfigText {
    gains: Gains,
    digit: Vec<DigitText>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DigitText {
    name: String,
    groups: Vec<String>,
    closing: BTreeMap<String, f64>,
}

impl ReflexConfig {
    /// The reflex that `text` describes, for the hand of `station`.
    ///
    /// # Errors
    /// What is wrong with it: the key, the digit, the joint or the group, and what was expected.
    pub(crate) fn from_toml(text: &str, station: &Station) -> Result<Self, String> {
        if text.len() > MAX_TEXT_BYTES {
            return Err(format!("it has {} bytes, expected {MAX_TEXT_BYTES} at most", text.len()));
        }
        let parsed: ConfigText = toml::from_str(text).map_err(|err| err.to_string())?;
        parsed.gains.check()?;
        if parsed.digit.is_empty() {
            return Err("it has no [[digit]]; without one there is nothing to move".to_owned());
        }
        let mut digits: Vec<DigitConfig> = Vec::with_capacity(parsed.digit.len());
        for text in parsed.digit {
            let digit = text.resolve(station)?;
            if let Some(other) = digits.iter().find(|other| shares_joint(other, &digit)) {
                return Err(format!(
                    "digits {:?} and {:?} move the same joint; each joint belongs to one",
                    other.name, digit.name
                ));
            }
            digits.push(digit);
        }
        Ok(Self { gains: parsed.gains, digits })
    }
}

fn shares_joint(one: &DigitConfig, other: &DigitConfig) -> bool {
    one.joints.iter().any(|(dof, _)| other.joints.iter().any(|(other, _)| other == dof))
}

impl Gains {
    fn check(&self) -> Result<(), String> {
        let ranges = [
            ("confirm_s", self.confirm_s, 0.0, MAX_TIME_S),
            ("lost_s", self.lost_s, 0.0, MAX_TIME_S),
            ("slip_share", self.slip_share, 0.0, 1.0),
            ("slip_within_s", self.slip_within_s, 1e-3, MAX_TIME_S),
            ("give_up_s", self.give_up_s, 0.0, MAX_TIME_S),
            ("let_go_rad", self.let_go_rad, 0.0, MAX_OFFSET_RAD),
            ("tighten_rad", self.tighten_rad, 0.0, MAX_OFFSET_RAD),
            ("tighten_rad_per_s", self.tighten_rad_per_s, 0.0, MAX_SPEED),
            ("tighten_error_rad", self.tighten_error_rad, 0.0, MAX_OFFSET_RAD),
            ("yield_rad", self.yield_rad, 0.0, MAX_OFFSET_RAD),
            ("yield_rad_per_s", self.yield_rad_per_s, 0.0, MAX_SPEED),
            ("yield_error_rad", self.yield_error_rad, 0.0, MAX_OFFSET_RAD),
            ("calm_error_rad", self.calm_error_rad, 0.0, MAX_OFFSET_RAD),
            ("return_rad_per_s", self.return_rad_per_s, 1e-3, MAX_SPEED),
            ("still_rad_per_s", self.still_rad_per_s, 0.0, MAX_SPEED),
        ];
        for (key, value, least, most) in ranges {
            if !(least..=most).contains(&value) {
                return Err(format!("gains.{key} is {value}, expected {least} to {most}"));
            }
        }
        let errors = [self.calm_error_rad, self.tighten_error_rad, self.yield_error_rad];
        if !errors.is_sorted() {
            return Err(format!(
                "gains.calm_error_rad, tighten_error_rad and yield_error_rad are {errors:?}, expected each no smaller than \
                 the one before: otherwise it would tighten and yield by turns"
            ));
        }
        Ok(())
    }
}

impl DigitText {
    fn resolve(self, station: &Station) -> Result<DigitConfig, String> {
        let name = &self.name;
        let layout = &station.layout;
        let (mut channels, mut thresholds) = (Vec::new(), Vec::new());
        for group in &self.groups {
            let before = channels.len();
            for patch in layout.patches.iter().filter(|patch| patch.group == *group) {
                let threshold = station.streams[patch.stream].on_threshold;
                thresholds.extend(std::iter::repeat_n(threshold, patch.channels.len()));
                channels.extend(patch.channels.clone());
            }
            if channels.len() == before {
                return Err(format!("digit {name:?}: no patch of the layout is in the group {group:?}"));
            }
        }
        if channels.is_empty() {
            return Err(format!("digit {name:?}: groups is empty; without touch there is nothing to go by"));
        }
        let mut joints = Vec::with_capacity(self.closing.len());
        for (joint, weight) in &self.closing {
            let mut dofs = station.robot.dofs().enumerate();
            let Some((dof, found)) = dofs.find(|(_, found)| found.name == *joint) else {
                return Err(format!("digit {name:?}: the station has no joint {joint:?}"));
            };
            if station.carrier_dofs.contains(&dof) || found.kind == JointKind::Prismatic {
                return Err(format!(
                    "digit {name:?}: {joint:?} is no joint of a finger; a reflex moves no other"
                ));
            }
            if !(weight.is_finite() && *weight != 0.0 && weight.abs() <= 1.0) {
                return Err(format!(
                    "digit {name:?}: closing.{joint} is {weight}, expected -1 to 1 and not 0: where positive angles close, a \
                     positive number"
                ));
            }
            joints.push((dof, *weight));
        }
        if joints.is_empty() {
            return Err(format!("digit {name:?}: closing names no joint"));
        }
        Ok(DigitConfig { name: self.name, channels, thresholds, joints })
    }
}
