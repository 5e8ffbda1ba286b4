//! Primitives: the motions of a calibration session, as data.

use serde::{Deserialize, Serialize};

use crate::truth::{not_negative, positive};

/// One kind of touch, read from `assets/primitives`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Primitive {
    /// Version of the format; 1.
    pub(crate) format: u32,
    /// Name for people.
    pub(crate) label: String,
    /// What happens in contact.
    pub(crate) motion: Motion,
    /// Distance from the object before and after each repetition, m.
    pub(crate) clearance_m: f64,
    /// How far the deepest point of the patch goes in, m.
    pub(crate) depth_m: f64,
    /// Time at depth, before and after any traverse, s.
    pub(crate) dwell_s: f64,
    /// Time away from the object between repetitions, s.
    pub(crate) gap_s: f64,
    /// Half the traverse: m for a slide, rad for a roll; absent for a press.
    #[serde(default)]
    pub(crate) reach: f64,
    /// Repetitions at each speed.
    pub(crate) repetitions: usize,
    /// Whether a touch goes through every speed, or takes turns with the other touches of the take.
    pub(crate) speeds_in_turn: bool,
    /// Whether each touch is made twice, with the flexing joints settled from one side and then from the other.
    #[serde(default)]
    pub(crate) both_sides: bool,
    /// What presses: touches take turns.
    pub(crate) pressed_by: Vec<Actuator>,
    /// Speeds, slow first.
    #[serde(rename = "speed")]
    pub(crate) speeds: Vec<Speed>,
}

/// What happens in contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Motion {
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
pub(crate) enum Actuator {
    /// The joints that carry the hand.
    Carrier,
    /// The joints of the touching limb, where it has any.
    Limb,
}

/// A speed of a primitive.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Speed {
    /// Name for labels.
    pub(crate) id: String,
    /// Mean speed of pressing and releasing, m/s.
    pub(crate) press_m_per_s: f64,
    /// Mean speed of the traverse, m/s or rad/s; absent for a press.
    #[serde(default)]
    pub(crate) traverse_per_s: f64,
}

impl Primitive {
    /// `(place, problem)` of the first value that cannot be.
    pub(crate) fn check(&self) -> Result<(), (String, String)> {
        if self.format != 1 {
            return Err(("format".into(), format!("is {}, expected 1", self.format)));
        }
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
