//! The sensor model file: theta, the effects beyond it, and where its numbers came from.

mod read;

use std::collections::BTreeMap;

use palpate_robot_model::{Place, SensorKind, Station, TactileLayout};
use serde::Serialize;

use crate::effects::{self, Chain, Effect, Sensed, TakeScene};
use crate::replay::{ContactTrace, ReplayError};
use crate::response::Response;
use crate::tactile::{self, Readings};
use crate::theta::{StreamTheta, Theta, Thetas, misfit};

/// A sensor model as stored in TOML. Replay, live twin and training load this same file.
///
/// ```
/// use palpate_sim::SensorModel;
///
/// let model = SensorModel::from_toml("pad.toml", r#"
///     format = 2
///     name = "pad, diagnosed"
///     theta = { lambda_con_m = 0.001, alpha_per_m = 300.0, lambda_pre_pa = 1500.0 }
///     response = { off_fractions = { pad = 0.75 } }
///
///     [[effect]]
///     id = "latency"
///     where = { stream = "pad" }
///     parameters = { delay_s = 0.062 }
///     interval = { delay_s = [0.055, 0.069] }
///     takes = ["take-01", "take-02"]
/// "#)?;
/// assert_eq!(model.effects[0].parameter("delay_s"), 0.062);
/// assert_eq!(SensorModel::from_toml("again.toml", &model.to_toml())?, model);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SensorModel {
    /// Version of the format that it was read from: 1, or 2 which adds `response` and `effect`, or 3 which adds `stream`. A
    /// model is written in the lowest that holds it, so that what has no effects still opens with software that knows none.
    pub format: u32,
    /// Name for people.
    pub name: String,
    /// The three parameters of the paper.
    pub theta: Theta,
    /// By stream id, what streams have of theta for themselves.
    #[serde(rename = "stream", skip_serializing_if = "BTreeMap::is_empty")]
    pub streams: BTreeMap<String, StreamTheta>,
    /// Where the numbers came from: free text lines such as session, held-out takes, software version.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub provenance: Vec<String>,
    /// What is known of the sensors beyond theta.
    #[serde(skip_serializing_if = "Response::is_default")]
    pub response: Response,
    /// Effects of the sensing chain.
    #[serde(rename = "effect", skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<Effect>,
}

/// A sensor model that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct SensorModelError {
    /// Which file was being read.
    pub file: String,
    /// What is wrong and what was expected.
    pub problem: String,
}

impl SensorModel {
    /// A model of theta alone.
    pub fn plain(name: impl Into<String>, theta: Theta) -> Self {
        Self {
            format: 1,
            name: name.into(),
            theta,
            streams: BTreeMap::new(),
            provenance: Vec::new(),
            response: Response::default(),
            effects: Vec::new(),
        }
    }

    /// theta of every stream.
    pub fn thetas(&self) -> Thetas<'_> {
        Thetas::new(self.theta, &self.streams)
    }

    /// Whether theta alone decides what it reads: no effects, no hysteresis, no soft pads.
    pub fn is_plain(&self) -> bool {
        self.effects.is_empty()
            && self.response.pad_softness_m == 0.0
            && self.response.off_fractions.values().all(|&fraction| fraction == 1.0)
    }

    /// The file's text.
    pub fn to_toml(&self) -> String {
        let mut model = self.clone();
        model.streams.retain(|_, theta| !theta.is_empty());
        model.format = match (model.streams.is_empty(), self.effects.is_empty() && self.response.is_default())
        {
            (false, _) => 3,
            (true, false) => 2,
            (true, true) => 1,
        };
        toml::to_string_pretty(&model).expect("numbers, texts and lists of them have a TOML form")
    }

    /// Whether `station` has what the model speaks of: streams, places of effects, and exactly the parameters of each
    /// effect there, within their bounds. Problems name the effect and its place.
    pub fn check_for(&self, station: &Station) -> Result<(), SensorModelError> {
        let problem = |problem| SensorModelError { file: format!("sensor model {:?}", self.name), problem };
        self.check_streams(&station.layout)?;
        for stream in self.response.off_fractions.keys() {
            if station.layout.stream_index(stream).is_none() {
                let known = station.layout.streams.iter().map(|stream| stream.id.as_str());
                return Err(problem(format!(
                    "response.off_fractions names stream {stream:?}, which station {:?} does not have (it has {})",
                    station.id,
                    known.collect::<Vec<_>>().join(", ")
                )));
            }
        }
        for (idx, effect) in self.effects.iter().enumerate() {
            check_effect(effect, station).map_err(|fault| {
                problem(format!("effect {} ({}, {}): {fault}", idx + 1, effect.id, place_text(&effect.place)))
            })?;
        }
        Ok(())
    }

    /// Whether `layout` has the streams that have parameters of their own, each of a kind that uses them.
    pub fn check_streams(&self, layout: &TactileLayout) -> Result<(), SensorModelError> {
        match misfit(&self.streams, layout) {
            Some(problem) => Err(SensorModelError { file: format!("sensor model {:?}", self.name), problem }),
            None => Ok(()),
        }
    }

    /// What the hardware would have read in `scene` if the model were right. A model that does not fit the station is
    /// refused.
    pub fn sense(&self, scene: &TakeScene<'_>) -> Result<Sensed, ReplayError> {
        self.check_for(scene.station).map_err(|err| ReplayError::Model(err.to_string()))?;
        self.chain().sense(scene)
    }

    /// [`tactile::readings`], with the effects of the model where it has any. `contact` is the trace of the scene as it
    /// is said to be; effects that move things make their own.
    ///
    /// Proximity channels with effects read no further than [`Response::reach_m`].
    pub fn readings(&self, scene: &TakeScene<'_>, contact: &ContactTrace) -> Result<Readings, ReplayError> {
        let layout = &scene.station.layout;
        if self.is_plain() {
            self.check_streams(layout).map_err(|err| ReplayError::Model(err.to_string()))?;
            return Ok(tactile::readings(layout, contact, &self.thetas()));
        }
        let sensed = self.sense(scene)?;
        Ok(self.readings_of(layout, sensed.num_channels, sensed.load, &sensed.activation))
    }

    /// What loads and activations (frame-major) are as readings.
    pub(crate) fn readings_of(
        &self,
        layout: &TactileLayout,
        num_channels: usize,
        loads: Vec<f64>,
        activation: &[f64],
    ) -> Readings {
        let mut raw = loads;
        self.loads_as_readings(layout, &mut raw);
        let active = activation.iter().map(|&activation| activation > 0.5).collect();
        Readings { num_frames: raw.len() / num_channels.max(1), num_channels, raw, active }
    }

    /// Turns loads (frame-major) into raw readings.
    pub(crate) fn loads_as_readings(&self, layout: &TactileLayout, values: &mut [f64]) {
        let thetas = self.thetas().by_stream(layout);
        let reaches_m: Vec<f64> = thetas.iter().map(|theta| self.response.reach_m(theta)).collect();
        for frame in values.chunks_exact_mut(layout.num_channels().max(1)) {
            for (channel, value) in layout.channels.iter().zip(frame) {
                if layout.streams[channel.stream].kind == SensorKind::Proximity {
                    *value = reaches_m[channel.stream] - *value;
                }
            }
        }
    }

    /// Its sensing chain, switching hard.
    pub(crate) fn chain(&self) -> Chain<'_> {
        Chain::new(self.thetas(), &self.response, &self.effects, &[])
    }
}

/// What is wrong with `effect` on `station`.
fn check_effect(effect: &Effect, station: &Station) -> Result<(), String> {
    let kind = effects::tactile(&effect.id).ok_or_else(|| unknown_effect(&effect.id))?;
    if !kind.places(station).iter().any(|place| same(place, &effect.place)) {
        return Err(format!(
            "it cannot act there on station {:?}; {}",
            station.id,
            hint(&effect.place, station)
        ));
    }
    let parameters = kind.parameters(&effect.place, station);
    if let Some(unknown) = effect.parameters.keys().find(|name| parameters.iter().all(|p| p.name != **name)) {
        let known: Vec<&str> = parameters.iter().map(|parameter| parameter.name.as_str()).collect();
        return Err(format!("it has no parameter {unknown:?} there, expected {}", known.join(", ")));
    }
    for parameter in &parameters {
        let Some(&value) = effect.parameters.get(&parameter.name) else {
            return Err(format!("parameter {:?} is missing", parameter.name));
        };
        if !(parameter.lower..=parameter.upper).contains(&value) {
            return Err(format!(
                "parameter {:?} is {value}, expected {} to {}",
                parameter.name, parameter.lower, parameter.upper
            ));
        }
    }
    Ok(())
}

/// Whether two places are the same but for the order of their parts.
fn same(one: &Place, other: &Place) -> bool {
    let sorted = |place: &Place| {
        let mut place = place.clone();
        if let Place::Channels(ids) | Place::Groups(ids) = &mut place {
            ids.sort_unstable();
        }
        place
    };
    sorted(one) == sorted(other)
}

fn unknown_effect(id: &str) -> String {
    let known: Vec<&str> = effects::TACTILE.iter().map(|kind| kind.id()).collect();
    format!("there is no effect {id:?}, expected one of {}", known.join(", "))
}

/// What places of this kind the station has.
fn hint(place: &Place, station: &Station) -> String {
    let layout = &station.layout;
    let list = |ids: &mut dyn Iterator<Item = &str>| ids.collect::<Vec<_>>().join(", ");
    let groups = || {
        let mut groups: Vec<&str> = layout.patches.iter().map(|patch| patch.group.as_str()).collect();
        groups.sort_unstable();
        groups.dedup();
        groups.join(", ")
    };
    match place {
        Place::Stream(_) => {
            format!("its streams: {}", list(&mut layout.streams.iter().map(|s| s.id.as_str())))
        }
        Place::Patch(_) => {
            format!("its patches: {}", list(&mut layout.patches.iter().map(|p| p.id.as_str())))
        }
        Place::Channel(_) | Place::Channels(_) => {
            format!("its channels: {}", list(&mut layout.channels.iter().map(|channel| channel.id.as_str())))
        }
        Place::Joint(_) => {
            format!("its joints: {}", list(&mut station.robot.dofs().map(|joint| joint.name.as_str())))
        }
        Place::Group(_) | Place::Groups(_) => format!("its groups: {}", groups()),
        Place::Object(_) => format!("its objects: {}", list(&mut station.objects.keys().map(String::as_str))),
    }
}

/// A place as its file has it.
fn place_text(place: &Place) -> String {
    let (kind, ids): (&str, &[String]) = match place {
        Place::Stream(id) => ("stream", std::slice::from_ref(id)),
        Place::Patch(id) => ("patch", std::slice::from_ref(id)),
        Place::Channel(id) => ("channel", std::slice::from_ref(id)),
        Place::Channels(ids) => ("channels", ids),
        Place::Joint(id) => ("joint", std::slice::from_ref(id)),
        Place::Group(id) => ("group", std::slice::from_ref(id)),
        Place::Groups(ids) => ("groups", ids),
        Place::Object(id) => ("object", std::slice::from_ref(id)),
    };
    format!("{kind} {}", ids.iter().map(|id| format!("{id:?}")).collect::<Vec<_>>().join(" and "))
}

#[cfg(test)]
mod tests;
