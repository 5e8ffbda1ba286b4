//! The file of a search.

use serde::Deserialize;

use crate::GraspError;

/// How a hand tries to grasp, as read from TOML. Postures are those of a script; its times do not count.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct SearchConfig {
    /// File of the script, seen from the folder of this one. Nothing here reads it.
    pub script: String,
    /// Key of the script, counted from 1, at which the open hand is down over the middle of the region.
    pub down_key: usize,
    /// Key at which the hand has closed.
    pub closed_key: usize,
    /// Name of a link of the digit that opposes the others.
    pub opposing_link: String,
    /// How far above its lowest place the hand is carried from place to place, m.
    pub raise_m: f64,
    /// How far the hand lifts what it holds, m.
    pub lift_m: f64,
    /// Fastest joint of those that carry the hand, rad/s or m/s.
    pub carrier_per_s: f64,
    /// Fastest joint of the hand while it opens, rad/s or m/s.
    pub opening_per_s: f64,
    /// Time in which the hand closes when nothing stops it, s.
    pub close_s: f64,
    /// Time between closed and judged by what is felt, s.
    pub squeeze_s: f64,
    /// Share of the closing at which the hand may give up what it does not expect to hold, above 0 and at most 1; without
    /// it, it closes whatever it feels.
    pub glance: Option<f64>,
    /// Longest time for which a digit that feels something waits for its opposite, s; 0 never waits.
    pub wait_s: f64,
    /// Tracking error of a joint from which on a digit counts as stopped by something, rad or m.
    pub stopped_error: f64,
    /// Probability of holding the object from which on the robot says so, where a task has one claim.
    pub claim_from: f64,
    /// Distance between neighbouring places that the hand is brought to, and half the edge length of the square that they
    /// fill, m.
    pub places: [f64; 2],
}

impl SearchConfig {
    /// Reads the file of a search. `file` names it in errors.
    ///
    /// # Errors
    /// Unknown and missing keys, numbers out of range, a hand that closes before it is down.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, GraspError> {
        let error = |problem: String| GraspError::Config { file: file.to_owned(), problem };
        let config: Self = toml::from_str(text).map_err(|err| error(err.to_string()))?;
        config.check().map_err(error)?;
        Ok(config)
    }

    fn check(&self) -> Result<(), String> {
        if !(self.down_key >= 1 && self.closed_key > self.down_key) {
            return Err(format!(
                "down_key is {} and closed_key is {}, expected keys from 1 on, the hand down before it is closed",
                self.down_key, self.closed_key
            ));
        }
        let [step_m, reach_m] = self.places;
        for (name, value) in [
            ("raise_m", self.raise_m),
            ("lift_m", self.lift_m),
            ("carrier_per_s", self.carrier_per_s),
            ("opening_per_s", self.opening_per_s),
            ("close_s", self.close_s),
            ("stopped_error", self.stopped_error),
            ("the first of places", step_m),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(format!("{name} is {value}, expected a finite number above zero"));
            }
        }
        for (name, value) in
            [("squeeze_s", self.squeeze_s), ("wait_s", self.wait_s), ("the second of places", reach_m)]
        {
            if !(value.is_finite() && value >= 0.0) {
                return Err(format!("{name} is {value}, expected a finite number, not negative"));
            }
        }
        if reach_m / step_m > 100.0 {
            return Err(format!(
                "places are {step_m} m apart within {reach_m} m, expected at most 100 steps"
            ));
        }
        if let Some(glance) = self.glance.filter(|glance| !(*glance > 0.0 && *glance <= 1.0)) {
            return Err(format!("glance is {glance}, expected a share above zero and at most 1"));
        }
        if !(self.claim_from > 0.0 && self.claim_from <= 1.0) {
            return Err(format!("claim_from is {}, expected a probability above zero", self.claim_from));
        }
        Ok(())
    }
}
