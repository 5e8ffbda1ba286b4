//! Effects that a sensing chain may have and the paper's three parameters do not express.
//!
//! joint state -> kinematics -> contact -> sensor -> electronics -> transport
//!
//! An [`Effect`] is data: which one, where, with which parameters. What it does is its [`EffectKind`], one module each,
//! listed in [`TACTILE`]. [`Chain`] runs a take through all of them: an effect changes the state of its stage and knows
//! nothing of the others, so that any set of them composes in the order of physics.

mod baseline_drift;
mod chain;
mod clock_skew;
mod creep;
mod dead_channel;
mod debounce;
mod elastic_crosstalk;
mod electrical_crosstalk;
mod force;
mod frame;
mod integer_wrap;
mod joint_backlash;
mod joint_offset;
mod latency;
mod low_pass;
mod motion_artifact;
mod object_pose_offset;
mod object_scale;
mod places;
mod preload;
mod rate_dependence;
mod sample_hold;
mod self_contact;
mod sensitivity_spread;
mod sensor_mount_offset;
mod stuck_channel;
mod swapped_channels;
mod threshold_hysteresis;
mod viscoelastic_release;

use std::collections::BTreeMap;

pub use chain::{
    Arrived, Chain, Contact, Geometry, Hold, Kinematics, Load, PatchGeometry, Sensed, Switching, TakeScene,
    Transport,
};
pub(crate) use chain::{FrameChain, FrameMemory, FrameScene, moved};
pub use force::Force;
pub use frame::{DynFrameEffect, Frame, FrameEffect};
use palpate_robot_model::{Place, Station, TactileLayout};
pub use self_contact::FingerTouches;
use serde::{Deserialize, Serialize};

/// Every effect of the tactile sensing chain, in the order of the chain. An effect is added by its module and its line
/// here.
pub const TACTILE: &[&dyn EffectKind] = &[
    &joint_offset::JointOffset,
    &joint_backlash::JointBacklash,
    &object_pose_offset::ObjectPoseOffset,
    &object_scale::ObjectScale,
    &sensor_mount_offset::SensorMountOffset,
    &self_contact::SelfContact,
    &rate_dependence::RateDependence,
    &preload::Preload,
    &elastic_crosstalk::ElasticCrosstalk,
    &sensitivity_spread::SensitivitySpread,
    &creep::Creep,
    &viscoelastic_release::ViscoelasticRelease,
    &low_pass::LowPass,
    &baseline_drift::BaselineDrift,
    &motion_artifact::MotionArtifact,
    &threshold_hysteresis::ThresholdHysteresis,
    &electrical_crosstalk::ElectricalCrosstalk,
    &swapped_channels::SwappedChannels,
    &dead_channel::DeadChannel,
    &stuck_channel::StuckChannel,
    &integer_wrap::IntegerWrap,
    &debounce::Debounce,
    &latency::Latency,
    &clock_skew::ClockSkew,
    &sample_hold::SampleHold,
];

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

    /// Indices of the streams that its place names.
    pub fn streams(&self, layout: &TactileLayout) -> Vec<usize> {
        places::streams_of(&self.place, layout).collect()
    }

    /// Indices of the patches that its place names, or that belong to the stream or group that it names.
    pub fn patches(&self, layout: &TactileLayout) -> Vec<usize> {
        places::patches_of(&self.place, layout)
    }

    /// Indices of the channels that its place names, in its order, or that belong to the patches that it names.
    pub fn channels(&self, layout: &TactileLayout) -> Vec<usize> {
        places::channels_of(&self.place, layout)
    }

    /// Channels of its place, each with each of its neighbours on the cable.
    pub fn wiring_neighbours(&self, layout: &TactileLayout) -> Vec<[usize; 2]> {
        let with_neighbours = |channel: usize| {
            places::wiring_neighbours(channel, layout).into_iter().map(move |other| [channel, other])
        };
        self.channels(layout).into_iter().flat_map(with_neighbours).collect()
    }

    /// The degree of freedom that its place names.
    pub fn dof(&self, station: &Station) -> Option<usize> {
        places::dof_of(&self.place, station)
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
    /// Distance from `neutral` below which the effect does not matter. A parameter that only shapes an effect whose size
    /// another one is (a time constant beside a fraction) has a distance that its bounds do not allow.
    pub smallest: f64,
    /// Distance from `neutral` of the standard dose with which effects are screened; its sign is the likelier one.
    pub dose: f64,
}

/// Name of the parameter of an effect that is there or not.
const PRESENCE: &str = "presence";

impl Parameter {
    fn new(
        name: &str,
        bounds: std::ops::RangeInclusive<f64>,
        neutral: f64,
        smallest: f64,
        dose: f64,
    ) -> Self {
        Self { name: name.to_owned(), lower: *bounds.start(), upper: *bounds.end(), neutral, smallest, dose }
    }

    /// Whether the parameter says how strong the effect is on a scale that might go on: it does not only shape an effect
    /// whose size another one is, nor tell an effect that is there from one that is not.
    pub fn is_size(&self) -> bool {
        self.name != PRESENCE && self.smallest < self.upper - self.lower
    }

    /// Of an effect that is there or not.
    fn presence() -> Vec<Self> {
        vec![Self::new(PRESENCE, 0.0..=1.0, 0.0, 0.5, 1.0)]
    }
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

    /// Parameters that it has got since files with it were first written, each with the value that it has in files
    /// without it.
    fn parameters_since(&self) -> &'static [(&'static str, f64)] {
        &[]
    }

    /// Everywhere it could act on `station` (objects: those of the station).
    fn places(&self, station: &Station) -> Vec<Place>;

    /// Whether what it does to one channel of its place depends on the loads of others.
    fn mixes_channels(&self) -> bool {
        false
    }

    /// Whether what it does to a load depends on the load at which the channel switches.
    fn uses_on_loads(&self) -> bool {
        false
    }

    /// Whether [`Self::load`] acts on forces ([`Load::forces_mut`]), whatever of loads it finds.
    fn acts_on_forces(&self) -> bool {
        false
    }

    /// Whether what it does to a frame depends on the frame after it. While a take goes on, the change since the frame before
    /// takes its place.
    fn looks_ahead(&self) -> bool {
        false
    }

    /// Changes true joint positions, the object or the mounting of patches.
    fn kinematics(&self, _effect: &Effect, _scene: &TakeScene<'_>, _state: &mut Kinematics<'_>) {}

    /// What [`Self::kinematics`] does to joint positions, frame by frame; `None` if that is nothing.
    fn joints_by_frame(&self, _effect: &Effect, _station: &Station) -> Option<DynFrameEffect> {
        None
    }

    /// Changes what the skin feels.
    fn contact(&self, _effect: &Effect, _scene: &TakeScene<'_>, _state: &mut Contact<'_>) {}

    /// Changes how the load of channels develops.
    fn load(&self, _effect: &Effect, _scene: &TakeScene<'_>, _state: &mut Load) {}

    /// What [`Self::load`] does, frame by frame; `None` if that is nothing. `on_loads` as [`Load::on_loads`].
    fn load_by_frame(
        &self,
        _effect: &Effect,
        _station: &Station,
        _on_loads: &[f64],
    ) -> Option<DynFrameEffect> {
        None
    }

    /// Changes how a load becomes an event.
    fn switching(&self, _effect: &Effect, _scene: &TakeScene<'_>, _state: &mut Switching) {}

    /// Changes which moment a reading at the host shows.
    fn transport(&self, _effect: &Effect, _scene: &TakeScene<'_>, _state: &mut Transport) {}
}
