//! Effects that a sensing chain may have and the paper's three parameters do not express.
//!
//! joint state -> kinematics -> contact -> sensor -> electronics -> transport
//!
//! An [`Effect`] is data: which one, where, with which parameters. What it does is its [`EffectKind`], one module each,
//! listed in [`TACTILE`]. [`Chain`] runs a take through all of them: an effect changes the state of its stage and knows
//! nothing of the others, so that any set of them composes in the order of physics.

mod chain;
mod joint_offset;
mod latency;

use std::collections::BTreeMap;

pub use chain::{Chain, Contact, Geometry, Kinematics, Load, Sensed, Switching, TakeScene, Transport};
use palpate_robot_model::{JointKind, Place, Station, TactileLayout};
use serde::{Deserialize, Serialize};

/// Every effect of the tactile sensing chain, in the order of the chain. An effect is added by its module and its line
/// here.
pub const TACTILE: &[&dyn EffectKind] = &[&joint_offset::JointOffset, &latency::Latency];

/// The effect called `id`.
pub fn tactile(id: &str) -> Option<&'static dyn EffectKind> {
    TACTILE.iter().copied().find(|kind| kind.id() == id)
}

/// An effect at a place, with its parameters: an entry of a sensor model file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Effect {
    /// Id in the library.
    pub id: String,
    /// Where it acts.
    #[serde(rename = "where")]
    pub place: Place,
    /// Every parameter of the effect by name.
    pub parameters: BTreeMap<String, f64>,
    /// 95 % intervals by parameter name, where they were fitted.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub interval: BTreeMap<String, [f64; 2]>,
    /// Takes that they were fitted to.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub takes: Vec<String>,
}

impl Effect {
    /// The parameter called `name`.
    ///
    /// # Panics
    /// If the effect has none: files are checked when they are read, so this is a caller's bug.
    pub fn parameter(&self, name: &str) -> f64 {
        self.parameters[name]
    }
}

/// A parameter of an effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Its name, with its unit.
    pub name: String,
    /// Lowest value that makes sense.
    pub lower: f64,
    /// Highest value that makes sense.
    pub upper: f64,
    /// Value at which the effect is absent. Effects that are there or not (a dead channel) have one parameter from 0
    /// (absent) to 1.
    pub neutral: f64,
    /// Distance from `neutral` below which the effect does not matter.
    pub smallest: f64,
    /// Distance from `neutral` of the standard dose with which effects are screened; its sign is the likelier one.
    pub dose: f64,
}

/// Where in the sensing chain an effect acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Between the joints' true positions and the geometry of contact.
    Kinematics,
    /// How the skin is loaded.
    Contact,
    /// How a sensor follows its load.
    Sensor,
    /// What the electronics make of it.
    Electronics,
    /// How it gets to the host.
    Transport,
}

/// What an effect is and does.
///
/// Each of the stage methods is called in the order of the chain with the effect's data; an effect overrides those of
/// the stage (or stages) that it acts on and leaves the rest.
pub trait EffectKind: Sync {
    /// Stable id, as in files and reports.
    fn id(&self) -> &'static str;

    /// Where it acts.
    fn stage(&self) -> Stage;

    /// What it is, in one sentence for an operator that starts with `subject` and says the size: "The FSR stream
    /// arrives 62 ms late."
    fn explain(&self, effect: &Effect, station: &Station) -> String;

    /// What sets it apart from its rivals.
    fn signature(&self) -> &'static str;

    /// Its parameters at `place`.
    fn parameters(&self, place: &Place, station: &Station) -> Vec<Parameter>;

    /// Everywhere it could act on `station` (objects: those of the station).
    fn places(&self, station: &Station) -> Vec<Place>;

    /// Changes true joint positions, the object or the mounting of patches.
    fn kinematics(&self, _effect: &Effect, _scene: &TakeScene<'_>, _state: &mut Kinematics) {}

    /// Changes what the skin feels.
    fn contact(&self, _effect: &Effect, _scene: &TakeScene<'_>, _state: &mut Contact) {}

    /// Changes how the load of channels develops.
    fn load(&self, _effect: &Effect, _scene: &TakeScene<'_>, _state: &mut Load) {}

    /// Changes how a load becomes an event.
    fn switching(&self, _effect: &Effect, _scene: &TakeScene<'_>, _state: &mut Switching) {}

    /// Changes which moment a reading at the host shows.
    fn transport(&self, _effect: &Effect, _scene: &TakeScene<'_>, _state: &mut Transport) {}
}

/// Indices of the streams that `place` names.
fn streams_of<'a>(place: &'a Place, layout: &'a TactileLayout) -> impl Iterator<Item = usize> + 'a {
    let named = move |id: &String| matches!(place, Place::Stream(stream) if stream == id);
    layout.streams.iter().enumerate().filter(move |(_, stream)| named(&stream.id)).map(|(idx, _)| idx)
}

/// Name for people of the stream that `place` names.
fn stream_label(place: &Place, station: &Station) -> String {
    streams_of(place, &station.layout)
        .next()
        .map_or_else(String::new, |stream| station.layout.streams[stream].label.clone())
}

/// Name of the joint that `place` names.
fn joint_name(place: &Place) -> &str {
    if let Place::Joint(name) = place { name } else { "" }
}

/// Degree of freedom that `place` names.
fn dof_of(place: &Place, station: &Station) -> Option<usize> {
    station.robot.dofs().position(|joint| joint.name == joint_name(place))
}

/// Names of the joints that turn.
fn revolute_joints(station: &Station) -> impl Iterator<Item = String> + '_ {
    station.robot.dofs().filter(|joint| joint.kind == JointKind::Revolute).map(|joint| joint.name.clone())
}
