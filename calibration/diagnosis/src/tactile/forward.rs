//! Predictions that remember: what a change of the model cannot change is not computed again.
//!
//! A channel's readings depend on some of the model's numbers only. Those make its key; a channel whose key was seen lately
//! has its series from then. Whatever is remembered has the bits that computing it again would give.

use std::sync::{Arc, Mutex, PoisonError};

use palpate_robot_model::{Place, SensorKind};
use palpate_sim::effects::{self, Arrived, Chain, Effect, Geometry, Stage, TakeScene};

use super::{Base, TactileDomain, WIDTH};
use crate::DiagnosisError;
use crate::engine::{Domain, Model, Series};

/// Numbers that something depends on, as bits.
type Key = Vec<u64>;

/// The last few values by key, the latest last.
struct Kept<T> {
    most: usize,
    entries: Vec<(Key, T)>,
}

impl<T: Clone> Kept<T> {
    fn new(most: usize) -> Self {
        Self { most, entries: Vec::with_capacity(most) }
    }

    fn get(&mut self, key: &Key) -> Option<T> {
        let at = self.entries.iter().rposition(|(known, _)| known == key)?;
        let entry = self.entries.remove(at);
        let value = entry.1.clone();
        self.entries.push(entry);
        Some(value)
    }

    /// Keeps `value`, if there is one and it is not there yet.
    fn put(&mut self, key: Key, value: &Option<T>) {
        let Some(value) = value else { return };
        if self.entries.iter().any(|(known, _)| *known == key) {
            return;
        }
        if self.entries.len() == self.most {
            self.entries.remove(0);
        }
        self.entries.push((key, value.clone()));
    }
}

/// What is remembered of a channel of a take.
struct ChannelMemory {
    loads: Kept<Arc<Arrived>>,
    activations: Kept<Series>,
    readings: Kept<Series>,
}

/// What is remembered of a take.
pub(super) struct Memory {
    channels: Vec<ChannelMemory>,
    /// With the patches that each has.
    geometries: Kept<(Vec<bool>, Arc<Geometry>)>,
}

/// Models whose channels are remembered: the one that is being fitted, and its surroundings.
const MODELS_KEPT: usize = 6;
/// Geometries that are remembered.
const GEOMETRIES_KEPT: usize = 6;

impl Memory {
    pub(super) fn new(num_channels: usize) -> Mutex<Self> {
        let channel = |_| ChannelMemory {
            loads: Kept::new(MODELS_KEPT),
            activations: Kept::new(MODELS_KEPT),
            readings: Kept::new(MODELS_KEPT),
        };
        Mutex::new(Self {
            channels: (0..num_channels).map(channel).collect(),
            geometries: Kept::new(GEOMETRIES_KEPT),
        })
    }
}

/// What the load, the activation and the reading of a channel depend on.
struct Keys {
    load: Key,
    activation: Key,
    reading: Key,
}

/// Load, activation and reading of a channel, as far as they are remembered.
type Known = (Option<Arc<Arrived>>, Option<Series>, Option<Series>);

/// An effect, and whom it concerns.
struct Reaching<'e> {
    effect: &'e Effect,
    kinematic: bool,
    /// Whether what it does to a channel depends on others.
    mixes: bool,
    /// Position in the order of the chain.
    order: u64,
    channels: Vec<bool>,
}

/// A model, taken apart.
struct Parts {
    widths: Vec<f64>,
    exponents: Vec<f64>,
    effects: Vec<Effect>,
}

impl TactileDomain<'_> {
    /// [`Domain::predict`].
    pub(super) fn forward(&self, take: usize, model: &Model) -> Result<Vec<Series>, DiagnosisError> {
        let (theta, response) = self.theta_and_response(model);
        let parts = self.parts(take, model);
        let layout = &self.station.layout;
        let reaching = self.reaching(&parts.effects);
        let keys: Vec<Keys> =
            (0..layout.num_channels()).map(|channel| self.keys(channel, model, &parts, &reaching)).collect();
        let lock = || self.memories[take].lock().unwrap_or_else(PoisonError::into_inner);
        let mut known: Vec<Known> = Vec::with_capacity(keys.len());
        {
            let mut memory = lock();
            for (memory, keys) in memory.channels.iter_mut().zip(&keys) {
                let (activation, reading) =
                    (memory.activations.get(&keys.activation), memory.readings.get(&keys.reading));
                let load = memory.loads.get(&keys.load);
                known.push((load, activation, reading));
            }
        }
        let all_known = |(_, activation, reading): &Known| activation.is_some() && reading.is_some();
        if known.iter().all(all_known) {
            return Ok(known.into_iter().flat_map(|(_, a, r)| [a, r]).flatten().collect());
        }
        let observed = &self.takes[take];
        let scene = observed.scene(self.station);
        let chain = Chain { theta, response: &response, effects: &parts.effects, soft_widths: &parts.widths };
        let unknown: Vec<bool> =
            known.iter().map(|channel| channel.0.is_none() && !all_known(channel)).collect();
        let mut arrived = if unknown.contains(&true) {
            let inputs = chain.inputs(self.station, &unknown);
            let geometry = self.geometry(take, &chain, &scene, &reaching, &inputs)?;
            chain.arrive(&scene, &geometry, &unknown)
        } else {
            vec![None; unknown.len()]
        };
        let switching = chain.switching(&scene);
        let new: Vec<Known> = known
            .into_iter()
            .enumerate()
            .map(|(channel, (load, activation, reading))| {
                if activation.is_some() && reading.is_some() {
                    return (load, activation, reading);
                }
                let load = load.or_else(|| arrived[channel].take().map(Arc::new));
                let Some(arrived) = &load else {
                    unreachable!("the chain gives every channel that is wanted")
                };
                let activation = activation
                    .unwrap_or_else(|| switching.activation(channel, arrived, scene.frame_times_s).into());
                let reading = reading.unwrap_or_else(|| {
                    let stream = layout.channels[channel].stream;
                    let on_load = match layout.streams[stream].kind {
                        SensorKind::Proximity => response.proximity_band_m,
                        SensorKind::Pressure => theta.lambda_pre_pa,
                    };
                    let (scale, exponent) = (1.0 / on_load, parts.exponents[stream]);
                    let ceiling = observed.ceilings[channel];
                    let loads = arrived.load();
                    loads.iter().map(|load| super::reading(load * scale, exponent).min(ceiling)).collect()
                });
                (load, Some(activation), Some(reading))
            })
            .collect();
        let mut memory = lock();
        for ((memory, keys), (load, activation, reading)) in memory.channels.iter_mut().zip(keys).zip(&new) {
            memory.loads.put(keys.load, load);
            memory.activations.put(keys.activation, activation);
            memory.readings.put(keys.reading, reading);
        }
        Ok(new.into_iter().flat_map(|(_, activation, reading)| [activation, reading]).flatten().collect())
    }

    /// `model` as `take` sees it: without effects that are of another take's object.
    fn parts(&self, take: usize, model: &Model) -> Parts {
        let num_streams = self.station.layout.streams.len();
        let mut parts = Parts {
            widths: vec![WIDTH; num_streams],
            exponents: vec![1.0; num_streams],
            effects: self.patterns(model),
        };
        let of_take = model.effects.iter().filter(|effect| self.reaches_take(effect, take));
        parts.effects.extend(of_take.cloned());
        for (kind, &value) in self.kinds.iter().zip(&model.base) {
            match *kind {
                Base::Width(stream) => parts.widths[stream] = value,
                Base::Exponent(stream) => parts.exponents[stream] = value,
                _ => {}
            }
        }
        parts
    }

    fn reaching<'e>(&self, effects: &'e [Effect]) -> Vec<Reaching<'e>> {
        let num_channels = self.num_units();
        effects
            .iter()
            .map(|effect| {
                let order = effects::TACTILE.iter().position(|kind| kind.id() == effect.id);
                let kind = order.map(|order| effects::TACTILE[order]);
                Reaching {
                    effect,
                    kinematic: kind.is_some_and(|kind| kind.stage() == Stage::Kinematics),
                    mixes: kind.is_some_and(|kind| kind.mixes_channels()),
                    order: order.unwrap_or(effects::TACTILE.len()) as u64,
                    // A parameter of no single channel: of all that the effect reaches.
                    channels: match kind {
                        Some(_) => self.support(effect, ""),
                        None => vec![false; num_channels],
                    },
                }
            })
            .collect()
    }

    fn keys(&self, channel: usize, model: &Model, parts: &Parts, reaching: &[Reaching<'_>]) -> Keys {
        let layout = &self.station.layout;
        let stream = layout.channels[channel].stream;
        let mut load = Key::new();
        for (kind, value) in self.kinds.iter().zip(&model.base) {
            let concerns = match layout.streams[stream].kind {
                SensorKind::Proximity => matches!(kind, Base::LambdaCon | Base::Band),
                SensorKind::Pressure => matches!(kind, Base::Alpha | Base::LambdaPre),
            };
            if concerns {
                load.push(value.to_bits());
            }
        }
        let own = format!("gain_{}", layout.channels[channel].id);
        // Effects that mix channels depend on whatever any of theirs does.
        let mixed = reaching.iter().any(|one| one.mixes && one.channels[channel]);
        for one in reaching.iter().filter(|one| mixed || one.channels[channel]) {
            load.push(one.order);
            add_place(&mut load, &one.effect.place);
            match one.effect.parameters.get(&own).filter(|_| !mixed) {
                // Gains of the channels of a stream concern one channel each.
                Some(gain) => load.push(gain.to_bits()),
                None => load.extend(one.effect.parameters.values().map(|value| value.to_bits())),
            }
        }
        let mut activation = load.clone();
        activation.push(parts.widths[stream].to_bits());
        let mut reading = load.clone();
        reading.push(parts.exponents[stream].to_bits());
        Keys { load, activation, reading }
    }

    /// The geometry of the patches of `channels`.
    fn geometry(
        &self,
        take: usize,
        chain: &Chain<'_>,
        scene: &TakeScene<'_>,
        reaching: &[Reaching<'_>],
        channels: &[bool],
    ) -> Result<Arc<Geometry>, DiagnosisError> {
        let layout = &self.station.layout;
        let wanted: Vec<bool> =
            layout.patches.iter().map(|patch| channels[patch.channels.clone()].contains(&true)).collect();
        let mut key = Key::new();
        for one in reaching.iter().filter(|one| one.kinematic) {
            key.push(one.order);
            add_place(&mut key, &one.effect.place);
            key.extend(one.effect.parameters.values().map(|value| value.to_bits()));
        }
        let lock = || self.memories[take].lock().unwrap_or_else(PoisonError::into_inner);
        let known = lock().geometries.get(&key);
        let has = |patches: &[bool]| patches.iter().zip(&wanted).all(|(has, wanted)| *has || !wanted);
        let mut patches = wanted.clone();
        if let Some((known_patches, geometry)) = known {
            if has(&known_patches) {
                return Ok(geometry);
            }
            patches.iter_mut().zip(known_patches).for_each(|(patch, known)| *patch |= known);
        }
        let geometry = chain.geometry_of(scene, &patches).map_err(|error| {
            DiagnosisError::Input(format!("take {:?}: {error}", self.takes[take].take.id))
        })?;
        let geometry = Arc::new(geometry);
        let mut memory = lock();
        memory.geometries.entries.retain(|(known, _)| *known != key);
        memory.geometries.put(key, &Some((patches, Arc::clone(&geometry))));
        Ok(geometry)
    }
}

/// Adds `place` to `key`: which kind it is, and its ids with their lengths.
fn add_place(key: &mut Key, place: &Place) {
    let (kind, ids): (u64, &[String]) = match place {
        Place::Stream(id) => (0, std::slice::from_ref(id)),
        Place::Patch(id) => (1, std::slice::from_ref(id)),
        Place::Channel(id) => (2, std::slice::from_ref(id)),
        Place::Channels(ids) => (3, ids),
        Place::Joint(id) => (4, std::slice::from_ref(id)),
        Place::Group(id) => (5, std::slice::from_ref(id)),
        Place::Groups(ids) => (6, ids),
        Place::Object(id) => (7, std::slice::from_ref(id)),
    };
    key.push(kind);
    for id in ids {
        key.push(id.len() as u64);
        key.extend(
            id.as_bytes()
                .chunks(8)
                .map(|bytes| bytes.iter().fold(0, |word, byte| word << 8 | u64::from(*byte))),
        );
    }
}
