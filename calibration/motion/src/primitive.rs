//! Primitives: the motions of a calibration session, as data.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::PlanError;
use crate::error::{not_negative, parse, positive};

/// Primitives by id.
pub type Primitives = BTreeMap<String, Primitive>;

/// One kind of touch: a file of its own (`assets/primitives`), or a section `[primitive.ID]` of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Primitive {
    /// Version of the format, 1; within a plan the plan's own version counts.
    format: Option<u32>,
    /// Name for people.
    pub label: String,
    /// What happens in contact.
    pub motion: Motion,
    /// Distance from the object before and after each repetition, m.
    pub clearance_m: f64,
    /// How far the deepest point of the patch goes in, m.
    pub depth_m: f64,
    /// Time at depth, before and after any traverse, s.
    pub dwell_s: f64,
    /// Time away from the object between repetitions, s.
    pub gap_s: f64,
    /// Half the traverse: m for a slide, rad for a roll; absent for a press.
    #[serde(default)]
    pub reach: f64,
    /// Repetitions at each speed.
    pub repetitions: usize,
    /// Whether a touch goes through every speed, or takes turns with the other touches of the take.
    pub speeds_in_turn: bool,
    /// Whether each touch is made twice, with the flexing joints settled from one side and then from the other.
    #[serde(default)]
    pub both_sides: bool,
    /// What presses: touches take turns.
    pub pressed_by: Vec<Actuator>,
    /// Speeds, slow first.
    #[serde(rename = "speed")]
    pub speeds: Vec<Speed>,
}

/// What happens in contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// Nothing: in, wait, out.
    Press,
    /// Along the patch's longest direction and back.
    Slide,
    /// About the patch's longest direction and back.
    Roll,
}

/// What moves in to press.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Actuator {
    /// The joints that carry the hand.
    Carrier,
    /// The joints of the touching limb, where it has any.
    Limb,
}

/// A speed of a primitive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Speed {
    /// Name for labels.
    pub id: String,
    /// Mean speed of pressing and releasing, m/s.
    pub press_m_per_s: f64,
    /// Mean speed of the traverse, m/s or rad/s; absent for a press.
    #[serde(default)]
    pub traverse_per_s: f64,
}

impl Primitive {
    /// The primitive in `text`; `file` names it in errors.
    pub fn from_text(file: &str, text: &str) -> Result<Self, PlanError> {
        let primitive: Self = parse(file, text)?;
        let checked = match primitive.format {
            Some(1) => primitive.check(),
            Some(format) => Err(("format".into(), format!("is {format}, expected 1"))),
            None => Err(("format".into(), "is missing: add format = 1".into())),
        };
        checked.map_err(|(place, problem)| PlanError::new(file, place, problem))?;
        Ok(primitive)
    }

    /// Whether both are the same motion, wherever each was written.
    pub fn same_motion(&self, other: &Self) -> bool {
        *self == Self { format: self.format, ..other.clone() }
    }

    /// The speeds that a touch goes through, the one at `touch_idx` of its take.
    pub fn speeds_of(&self, touch_idx: usize) -> &[Speed] {
        if !self.speeds_in_turn || self.speeds.is_empty() {
            return &self.speeds;
        }
        let turn = touch_idx % self.speeds.len();
        &self.speeds[turn..=turn]
    }

    /// [`Self::check`] for a section of a plan.
    pub(crate) fn check_within_plan(&self) -> Result<(), (String, String)> {
        if self.format.is_some_and(|format| format != 1) {
            return Err(("format".into(), "leave it out: the plan's own counts".into()));
        }
        self.check()
    }

    /// `(place, problem)` of the first value that cannot be.
    fn check(&self) -> Result<(), (String, String)> {
        positive(
            "primitive",
            &[("clearance_m", self.clearance_m), ("depth_m", self.depth_m), ("gap_s", self.gap_s)],
        )?;
        not_negative("primitive", &[("dwell_s", self.dwell_s), ("reach", self.reach)])?;
        if self.repetitions == 0 || self.speeds.is_empty() || self.pressed_by.is_empty() {
            let problem = "repetitions, speed and pressed_by must each have at least one";
            return Err(("primitive".into(), problem.into()));
        }
        for speed in &self.speeds {
            let place = format!("speed {:?}", speed.id);
            positive(&place, &[("press_m_per_s", speed.press_m_per_s)])?;
            if self.motion != Motion::Press {
                positive(&place, &[("traverse_per_s", speed.traverse_per_s)])?;
                positive("primitive", &[("reach", self.reach)])?;
            }
        }
        Ok(())
    }
}
