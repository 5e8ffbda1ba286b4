//! Predictions that remember: what a change of the model cannot change is not computed again.
//!
//! A channel's readings depend on some of the model's numbers only. Those make its key; a channel whose key was seen lately
//! has its series from then. Whatever is remembered has the bits that computing it again would give.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use palpate_robot_model::{Place, SensorKind};
use palpate_sim::effects::{
    self, Arrived, Chain, Effect, EffectKind, FingerTouches, Geometry, PatchGeometry, Stage, Switching,
    TakeScene,
};
use palpate_sim::{Response, StreamTheta, Theta, Thetas};

use super::reading::Curve;
use super::{Base, Signal, TactileDomain, WIDTH};
use crate::DiagnosisError;
use crate::engine::{Domain, Model, Series};

/// Numbers that something depends on, as bits.
type Key = Vec<u64>;

/// The last few values by key, the latest last.
struct Kept<T> {
    most: usize,
    entries: Vec<(Key, T)>,
}

impl<T> Kept<T> {
    fn new(most: usize) -> Self {
        Self { most, entries: Vec::new() }
    }

    fn get(&mut self, key: &Key) -> Option<&mut T> {
        let at = self.entries.iter().rposition(|(known, _)| known == key)?;
        self.latest(at)
    }

    /// The latest value that `is_it`.
    fn find(&mut self, is_it: impl Fn(&T) -> bool) -> Option<&mut T> {
        let at = self.entries.iter().rposition(|(_, value)| is_it(value))?;
        self.latest(at)
    }

    /// Makes the entry `at` the latest.
    fn latest(&mut self, at: usize) -> Option<&mut T> {
        self.entries[at..].rotate_left(1);
        self.entries.last_mut().map(|(_, value)| value)
    }

    /// The value of `key`; what `make` makes where there is none.
    fn get_or_put(&mut self, key: Key, make: impl FnOnce() -> T) -> &T {
        match self.entries.iter().rposition(|(known, _)| *known == key) {
            Some(at) => self.entries[at..].rotate_left(1),
            None => self.put(key, make()),
        }
        &self.entries[self.entries.len() - 1].1
    }

    /// Keeps `value` in place of what was there for its key.
    fn put(&mut self, key: Key, value: T) {
        if let Some(known) = self.get(&key) {
            *known = value;
            return;
        }
        if self.entries.len() == self.most {
            self.entries.remove(0);
        }
        self.entries.push((key, value));
    }
}

/// A load that arrived at a channel, and what was made of it lately: activations and readings, each by the numbers that
/// it depends on besides.
#[derive(Clone)]
struct ChannelLoad {
    arrived: Arc<Arrived>,
    /// Of its load, see [`checksum`].
    checksum: u64,
    activations: Recent<6>,
    readings: Recent<3>,
}

impl ChannelLoad {
    fn new(arrived: Arrived) -> Self {
        let (activations, readings) = (Recent(Vec::new()), Recent(Vec::new()));
        let checksum = if arrived.is_silent { 0 } else { checksum(&arrived.present) };
        Self { arrived: Arc::new(arrived), checksum, activations, readings }
    }

    /// What it takes in memory, bytes.
    fn num_bytes(&self) -> usize {
        let Arrived { present, past, .. } = &*self.arrived;
        let made = self.activations.0.iter().map(|(_, series)| series);
        let made = made.chain(self.readings.0.iter().map(|(_, series)| series));
        made.chain(past).chain([present]).map(|series| size_of_val(&series[..])).sum()
    }

    /// Whether its load has the bits of that of `other`.
    fn is(&self, other: &Self) -> bool {
        let same = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
        let (Arrived { present, past, is_silent, past_share }, other_checksum) =
            (&*self.arrived, other.checksum);
        let other = &*other.arrived;
        self.checksum == other_checksum
            && past_share.to_bits() == other.past_share.to_bits()
            && past.len() == other.past.len()
            && (*is_silent && other.is_silent
                || same(present, &other.present) && past.iter().zip(&other.past).all(|(a, b)| same(a, b)))
    }
}

/// Tells nearly all different loads apart: what they have in common is mostly that they begin without any.
fn checksum(loads: &[f64]) -> u64 {
    loads.iter().fold(0, |sum: u64, load| sum.rotate_left(1).wrapping_add(load.to_bits()))
}

/// A few series, the latest last, by `N` numbers as bits.
#[derive(Clone)]
struct Recent<const N: usize>(Vec<([u64; N], Series)>);

impl<const N: usize> Recent<N> {
    fn get(&self, key: [u64; N]) -> Option<Series> {
        self.0.iter().find(|(known, _)| *known == key).map(|(_, series)| Arc::clone(series))
    }

    fn put(&mut self, key: [u64; N], series: &Series) {
        if self.0.iter().any(|(known, _)| *known == key) {
            return;
        }
        if self.0.len() == RECENT_KEPT {
            self.0.remove(0);
        }
        self.0.push((key, Arc::clone(series)));
    }
}

/// What is remembered of a limb in a take.
pub(super) struct Memory {
    channels: Vec<Kept<Arc<ChannelLoad>>>,
    /// The most that `channels` may take, bytes.
    channels_bytes: usize,
    /// As much as `channels` take, or more, bytes.
    taken_bytes: usize,
    patches: Vec<Kept<Arc<PatchGeometry>>>,
    /// The most that `patches` may take, bytes.
    patches_bytes: usize,
    /// Per channel, [`Signal::Switched`] by what its firmware switches by.
    switched: Vec<Recent<2>>,
    /// Geometries that were put together, with the patches that each has.
    geometries: Kept<(Vec<bool>, Arc<Geometry>)>,
    /// What fingers feel of each other, by where joints and patches are.
    touches: Kept<FingerTouches>,
}

/// Loads of a channel that are remembered: those of the models that are being fitted, and their surroundings.
const LOADS_KEPT: usize = 12;
/// Series of each kind that are remembered for a load.
const RECENT_KEPT: usize = 4;
/// Whole geometries that are remembered.
const GEOMETRIES_KEPT: usize = 4;
/// Geometries of a patch that are remembered: every round moves it in the same ways to see what that would do.
const MOTIONS_KEPT: usize = 80;
/// What the geometries of patches that are remembered may take over all limbs and takes, bytes: long sessions remember fewer.
/// Eight times as much makes a session of nine takes 1 % faster.
const MOTIONS_BYTES: usize = 1 << 29;
/// The same of the loads of channels.
const LOADS_BYTES: usize = 1 << 28;

impl Memory {
    /// One of `num_memories` that share the room.
    pub(super) fn new(num_channels: usize, num_patches: usize, num_memories: usize) -> Mutex<Self> {
        Mutex::new(Self {
            channels_bytes: LOADS_BYTES / num_memories.max(1),
            taken_bytes: 0,
            patches_bytes: MOTIONS_BYTES / num_memories.max(1),
            channels: (0..num_channels).map(|_| Kept::new(LOADS_KEPT)).collect(),
            switched: vec![Recent(Vec::new()); num_channels],
            patches: (0..num_patches).map(|_| Kept::new(MOTIONS_KEPT)).collect(),
            geometries: Kept::new(GEOMETRIES_KEPT),
            touches: Kept::new(GEOMETRIES_KEPT),
        })
    }

    /// Remembers the `load` of a channel. Where loads take more than they may, it forgets the oldest ones of channels
    /// of which most are remembered, until there is room for some more.
    fn remember_load(&mut self, channel: usize, key: Key, load: Arc<ChannelLoad>) {
        self.taken_bytes += load.num_bytes();
        self.channels[channel].put(key, load);
        if self.taken_bytes > self.channels_bytes {
            self.taken_bytes = self.forget_loads();
        }
    }

    /// What loads take, once the oldest are forgotten.
    fn forget_loads(&mut self) -> usize {
        // Numbers that make no difference to a channel leave it one load under several keys.
        let of_channel = |kept: &Kept<Arc<ChannelLoad>>| -> usize {
            let is_first = |idx: usize, load: &Arc<ChannelLoad>| {
                kept.entries[..idx].iter().all(|(_, other)| !Arc::ptr_eq(other, load))
            };
            let entries = kept.entries.iter().enumerate().filter(|(idx, (_, load))| is_first(*idx, load));
            entries.map(|(_, (_, load))| load.num_bytes()).sum()
        };
        let mut num_bytes: Vec<usize> = self.channels.iter().map(of_channel).collect();
        while num_bytes.iter().sum::<usize>() > self.channels_bytes - self.channels_bytes / 8 {
            let longest = (0..num_bytes.len()).max_by_key(|&idx| self.channels[idx].entries.len());
            let Some(idx) = longest.filter(|&idx| self.channels[idx].entries.len() > 1) else { break };
            self.channels[idx].entries.remove(0);
            num_bytes[idx] = of_channel(&self.channels[idx]);
        }
        num_bytes.iter().sum()
    }

    /// Forgets the oldest geometries of patches of which most are remembered, as far as they take more than they may.
    fn forget_motions(&mut self) {
        let kept = self.patches.iter().flat_map(|kept| &kept.entries);
        let mut num_bytes: usize = kept.map(|(_, geometry)| geometry.num_bytes()).sum();
        while num_bytes > self.patches_bytes {
            let longest = self.patches.iter_mut().max_by_key(|kept| kept.entries.len());
            let Some(longest) = longest.filter(|kept| kept.entries.len() > 1) else { return };
            num_bytes -= longest.entries.remove(0).1.num_bytes();
        }
    }
}

/// What the load of a channel depends on, and what its activation and its reading depend on besides.
struct Keys {
    load: Key,
    activation: [u64; 6],
    reading: [u64; 3],
}

impl Keys {
    /// Activation and reading, as far as `load` has them.
    fn series_of(&self, load: &ChannelLoad) -> (Option<Series>, Option<Series>) {
        (load.activations.get(self.activation), load.readings.get(self.reading))
    }
}

/// An effect, and whom it concerns.
struct Reaching<'e> {
    effect: Cow<'e, Effect>,
    kind: &'static dyn EffectKind,
    /// Position in the order of the chain.
    order: u64,
    channels: Vec<bool>,
}

impl Reaching<'_> {
    fn is_kinematic(&self) -> bool {
        self.kind.stage() == Stage::Kinematics
    }

    fn add_to(&self, key: &mut Key) {
        key.push(self.order);
        add_place(key, &self.effect.place);
        key.extend(self.effect.parameters.values().map(|value| value.to_bits()));
    }
}

/// A model, ready to predict takes.
pub(super) struct Prepared<'m> {
    model: &'m Model,
    theta: Theta,
    /// By stream id, what streams have of theta for themselves.
    streams: BTreeMap<String, StreamTheta>,
    response: Response,
    /// Width of the switching curve of each stream.
    widths: Vec<f64>,
    /// Per channel, how a load reads.
    read_by: Vec<Curve>,
    /// What the model's own parameters amount to.
    own: Vec<Effect>,
    /// Effects of the model.
    reaching: Vec<Reaching<'m>>,
}

/// A model, as far as it concerns a take.
struct Concerning<'p> {
    prepared: &'p Prepared<'p>,
    chain: Chain<'p>,
    /// Effects of the model.
    reaching: Vec<&'p Reaching<'p>>,
}

impl TactileDomain<'_> {
    /// [`Domain::predict`].
    pub(super) fn forward(
        &self,
        take: usize,
        prepared: &Prepared<'_>,
    ) -> Result<Vec<Series>, DiagnosisError> {
        let Prepared { theta, streams, response, widths, own, reaching, .. } = prepared;
        let reaching: Vec<&Reaching<'_>> =
            reaching.iter().filter(|one| self.reaches_take(&one.effect, take)).collect();
        let effects = own.iter().chain(reaching.iter().map(|one| &*one.effect));
        let chain = Chain::new(Thetas::new(*theta, streams), response, effects, widths);
        let concerning = Concerning { prepared, chain, reaching };
        let mut signals: Vec<Option<Series>> = vec![None; self.num_signals()];
        for limb in 0..self.memories[take].len() {
            for (channel, of_channel) in self.forward_limb(take, limb, &concerning)? {
                for (signal, series) in signals[Signal::Event.of(channel)..].iter_mut().zip(of_channel) {
                    *signal = Some(series);
                }
            }
        }
        let every = signals.into_iter().collect::<Option<Vec<Series>>>();
        Ok(every.unwrap_or_else(|| unreachable!("every channel is on a limb")))
    }

    /// What predictions for all takes have in common.
    pub(super) fn prepared<'m>(&self, model: &'m Model) -> Prepared<'m> {
        let layout = &self.station.layout;
        let mut widths = vec![WIDTH; layout.streams.len()];
        let mut exponents = vec![1.0; layout.streams.len()];
        let mut knees = vec![0.0; layout.streams.len()];
        for (kind, &value) in self.kinds.iter().zip(&model.base) {
            match *kind {
                Base::Width(stream) => widths[stream] = value,
                Base::Exponent(stream) => exponents[stream] = value,
                Base::Knee(stream) => knees[stream] = value,
                _ => {}
            }
        }
        let (theta, streams, response) = self.theta_and_response(model);
        let thetas = Thetas::new(theta, &streams).by_stream(layout);
        let on_load = |stream: usize| match layout.streams[stream].kind {
            SensorKind::Proximity => response.proximity_band_m,
            SensorKind::Pressure => thetas[stream].lambda_pre_pa,
        };
        let channels = layout.channels.iter();
        let read_by = channels.map(|channel| {
            let stream = channel.stream;
            Curve { on_load: on_load(stream), exponent: exponents[stream], knee: knees[stream] }
        });
        let read_by = read_by.collect();
        let (own, reaching) = (self.own_effects(model), self.reaching(model));
        Prepared { model, theta, streams, response, widths, read_by, own, reaching }
    }

    /// The signals of each channel of `limb`.
    fn forward_limb(
        &self,
        take: usize,
        limb: usize,
        concerning: &Concerning<'_>,
    ) -> Result<Vec<(usize, [Series; Signal::COUNT])>, DiagnosisError> {
        let Concerning { prepared: Prepared { model, read_by, .. }, chain, reaching } = concerning;
        let observed = &self.takes[take];
        let scene = observed.scene(self.station, limb);
        let switching = chain.switching(&scene);
        // Firmware switches by readings.
        let mut by_load = switching.clone();
        for (off_fraction, curve) in by_load.off_fractions.iter_mut().zip(read_by) {
            *off_fraction = curve.load_of(*off_fraction);
        }
        let keys: Vec<(usize, Keys)> = (0..self.limb_of.len())
            .filter(|&channel| self.limb_of[channel] == limb)
            .map(|channel| {
                let keys = Keys {
                    load: self.load_key(channel, model, reaching),
                    activation: by_load.of_channel(channel).map(f64::to_bits),
                    reading: read_by[channel].key(),
                };
                (channel, keys)
            })
            .collect();
        let mut wanted = vec![false; self.limb_of.len()];
        let known: Vec<Option<Arc<ChannelLoad>>> = {
            let mut memory = self.memory(take, limb);
            let of_channel = |(channel, keys): &(usize, Keys)| {
                let known = memory.channels[*channel].get(&keys.load).map(|load| Arc::clone(load));
                wanted[*channel] = known.is_none();
                known
            };
            keys.iter().map(of_channel).collect()
        };
        let mut arrived = if wanted.contains(&true) {
            let inputs = chain.inputs(self.station, &wanted);
            let geometry = self.geometry(take, limb, chain, &scene, reaching, &inputs)?;
            chain.arrive(&scene, &geometry, &wanted)
        } else {
            vec![None; wanted.len()]
        };
        let reading = |channel: usize, arrived: &Arrived| -> Series {
            let loads = arrived.load();
            let loads: Vec<f64> = observed.frames(limb).iter().map(|&frame| loads[frame]).collect();
            // Quiet channels stay where they are, and are most of the work.
            let mut readings = loads.clone();
            readings.dedup();
            read_by[channel].read(observed.ceilings[channel], &mut readings);
            let (mut at, mut last) = (0, loads.first());
            let read = |load| {
                at += usize::from(Some(load) != last.replace(load));
                readings[at]
            };
            loads.iter().map(read).collect()
        };
        let mut signals = Vec::with_capacity(keys.len());
        for ((channel, keys), known) in keys.into_iter().zip(known) {
            let load = known.clone().or_else(|| {
                let arrived = arrived[channel].take()?;
                // What a change of the model does not reach arrives as it did before, and what was made of it still holds.
                let new = ChannelLoad::new(arrived);
                let same = self.memory(take, limb).channels[channel].find(|known| known.is(&new)).cloned();
                Some(same.unwrap_or_else(|| Arc::new(new)))
            });
            let Some(mut load) = load else { unreachable!("the chain gives every channel that is wanted") };
            let (activation, reading) = match keys.series_of(&load) {
                (Some(activation), Some(reading)) if known.is_some() => (activation, reading),
                (activation, known_reading) => {
                    let activation = activation.unwrap_or_else(|| {
                        let (times_s, frames) = (scene.frame_times_s, observed.frames(limb));
                        if observed.has_raw {
                            by_load.activation(channel, &load.arrived, times_s, Some(frames)).into()
                        } else {
                            by_load.mean_activation(channel, &load.arrived, times_s, frames).into()
                        }
                    });
                    let reading = known_reading.unwrap_or_else(|| reading(channel, &load.arrived));
                    let made = Arc::make_mut(&mut load);
                    made.activations.put(keys.activation, &activation);
                    made.readings.put(keys.reading, &reading);
                    self.memory(take, limb).remember_load(channel, keys.load, load);
                    (activation, reading)
                }
            };
            signals.push((channel, [activation, reading, self.switched(take, limb, channel, &switching)]));
        }
        Ok(signals)
    }

    /// [`Signal::Switched`] of `channel`.
    fn switched(&self, take: usize, limb: usize, channel: usize, switching: &Switching) -> Series {
        let by = [switching.off_fractions[channel], switching.min_on_s[channel]];
        let key = by.map(f64::to_bits);
        let mut memory = self.memory(take, limb);
        let known = &mut memory.switched[channel];
        known.get(key).unwrap_or_else(|| {
            let [off_fraction, min_on_s] = by;
            let switched = self.takes[take].switched(self.station, channel, off_fraction, min_on_s);
            known.put(key, &switched);
            switched
        })
    }

    fn memory(&self, take: usize, limb: usize) -> std::sync::MutexGuard<'_, Memory> {
        self.memories[take][limb].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The effects of `model`, with whom they concern.
    fn reaching<'e>(&self, model: &'e Model) -> Vec<Reaching<'e>> {
        let zeros = self.zeros(model).into_iter().map(Cow::Owned);
        let reaching = zeros.chain(model.effects.iter().map(Cow::Borrowed)).filter_map(|effect| {
            let order = effects::TACTILE.iter().position(|kind| kind.id() == effect.id)?;
            Some(Reaching {
                kind: effects::TACTILE[order],
                order: order as u64,
                channels: self.reach(&effect),
                effect,
            })
        });
        reaching.collect()
    }

    /// What the load of `channel` depends on.
    fn load_key(&self, channel: usize, model: &Model, reaching: &[&Reaching<'_>]) -> Key {
        let layout = &self.station.layout;
        let (stream, patch) = (layout.channels[channel].stream, layout.channels[channel].patch);
        let own_taxel = channel - layout.patches[patch].channels.start;
        // Effects that mix channels depend on whatever any of theirs does.
        let mixed = reaching.iter().any(|one| one.channels[channel] && one.kind.mixes_channels());
        let sized = reaching.iter().any(|one| one.channels[channel] && one.kind.uses_on_loads());
        let mut of_base = self.kinds.iter().zip(&model.base);
        let creeps =
            of_base.any(|(kind, value)| matches!(kind, Base::Creep(of, _) if *of == stream) && *value > 0.0);
        let mut load = Key::with_capacity(16);
        for (idx, (kind, value)) in self.kinds.iter().zip(&model.base).enumerate() {
            let concerns = match (*kind, layout.streams[stream].kind) {
                (Base::Band | Base::Softness, SensorKind::Proximity) => true,
                (Base::LambdaCon(_), SensorKind::Proximity) | (Base::Alpha(_), SensorKind::Pressure) => {
                    mixed || self.has_number(idx, stream)
                }
                (Base::LambdaPre(_), SensorKind::Pressure) => {
                    mixed || (sized && self.has_number(idx, stream))
                }
                (Base::Pattern(set, taxel), _) => {
                    mixed || (taxel == own_taxel && self.alike[set].contains(&patch))
                }
                (Base::Lag(slow) | Base::Creep(slow, _), _) => slow == stream,
                (Base::Exponent(curved), _) => creeps && curved == stream,
                _ => false,
            };
            if concerns {
                load.push(value.to_bits());
            }
        }
        for one in reaching.iter().filter(|one| mixed || one.channels[channel]) {
            match one.effect.parameters.get(&self.gain_names[channel]).filter(|_| !mixed) {
                // Gains of the channels of a stream concern one channel each.
                Some(gain) => load.extend([one.order, gain.to_bits()]),
                None => one.add_to(&mut load),
            }
        }
        load
    }

    /// The geometry of the patches of `channels`, at the moments of `limb`.
    fn geometry(
        &self,
        take: usize,
        limb: usize,
        chain: &Chain<'_>,
        scene: &TakeScene<'_>,
        reaching: &[&Reaching<'_>],
        channels: &[bool],
    ) -> Result<Arc<Geometry>, DiagnosisError> {
        let layout = &self.station.layout;
        let key_of = |concerns: &dyn Fn(&Reaching<'_>) -> bool| {
            let mut key = Key::new();
            let moving = reaching.iter().filter(|one| one.is_kinematic() && concerns(one));
            moving.for_each(|one| one.add_to(&mut key));
            key
        };
        let gaps = chain.gaps_below_m(layout).to_bits();
        let mut key = key_of(&|_| true);
        key.push(gaps);
        let mut wanted: Vec<bool> =
            layout.patches.iter().map(|patch| channels[patch.channels.clone()].contains(&true)).collect();
        if let Some((has, geometry)) = self.memory(take, limb).geometries.get(&key).cloned() {
            if has.iter().zip(&wanted).all(|(has, wanted)| *has || !wanted) {
                return Ok(geometry);
            }
            wanted.iter_mut().zip(has).for_each(|(wanted, has)| *wanted |= has);
        }
        let keys: Vec<Key> = layout
            .patches
            .iter()
            .map(|patch| {
                let mut key = key_of(&|one| one.channels[patch.channels.clone()].contains(&true));
                if layout.streams[patch.stream].kind == SensorKind::Proximity {
                    key.push(gaps);
                }
                key
            })
            .collect();
        let known: Vec<Option<Arc<PatchGeometry>>> = {
            let mut memory = self.memory(take, limb);
            let patches = memory.patches.iter_mut().zip(&keys).zip(&wanted);
            patches.map(|((kept, key), wanted)| wanted.then(|| kept.get(key).cloned()).flatten()).collect()
        };
        let unknown: Vec<bool> =
            wanted.iter().zip(&known).map(|(wanted, known)| *wanted && known.is_none()).collect();
        let poses = Some(self.takes[take].poses(limb));
        let mut geometry = chain.geometry_of(scene, poses, &unknown).map_err(|error| {
            DiagnosisError::Input(format!("take {:?}: {error}", self.takes[take].take.id))
        })?;
        let new = unknown.iter().enumerate().filter(|(_, unknown)| **unknown);
        let new: Vec<(usize, Arc<PatchGeometry>)> =
            new.map(|(idx, _)| (idx, Arc::new(geometry.patch(idx)))).collect();
        geometry.adopt(known.iter().enumerate().filter_map(|(idx, known)| Some((idx, &**known.as_ref()?))));
        let mut memory = self.memory(take, limb);
        // What fingers feel of each other has nothing to do with objects.
        let key_of_touches = key_of(&|one| !matches!(one.effect.place, Place::Object(_)));
        geometry.share(memory.touches.get_or_put(key_of_touches, FingerTouches::default));
        let geometry = Arc::new(geometry);
        for (idx, patch) in new {
            memory.patches[idx].put(keys[idx].clone(), patch);
        }
        memory.forget_motions();
        memory.geometries.put(key, (wanted, Arc::clone(&geometry)));
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
        let words = id.as_bytes().chunks(8);
        key.extend(words.map(|bytes| bytes.iter().fold(0, |word, byte| word << 8 | u64::from(*byte))));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Session, session};

    #[test]
    fn what_is_remembered_has_the_bits_of_what_is_new() {
        let Session { stage, takes, nominal } = session("small");
        let every_take: Vec<usize> = (0..takes.len()).collect();
        let new = || TactileDomain::new(stage.station(), &takes, &every_take, &nominal).unwrap();
        let (remembering, start) = new();
        let (forgetting, _) = new();
        for memory in forgetting.memories.iter().flatten() {
            let mut memory = memory.lock().unwrap();
            (memory.patches_bytes, memory.channels_bytes) = (0, 0);
        }
        remembering.predict(0, &start).unwrap();
        let mut models = Vec::new();
        for (idx, parameter) in remembering.base().iter().enumerate() {
            let mut model = start.clone();
            model.base[idx] += parameter.dose;
            models.push(model);
        }
        let offset = effects::tactile("joint_offset").unwrap();
        for place in offset.places(stage.station()).into_iter().rev().take(2) {
            for offset_rad in [0.01, 0.03, 0.01] {
                let effect = Effect {
                    id: offset.id().into(),
                    place: place.clone(),
                    parameters: [("offset_rad".to_owned(), offset_rad)].into(),
                    interval: [].into(),
                    takes: Vec::new(),
                };
                let mut model = start.clone();
                model.effects.push(effect);
                models.push(model);
            }
        }
        for model in models {
            let made = new().0.predict(0, &model).unwrap();
            assert!(remembering.predict(0, &model).unwrap() == made, "{model:?}");
            assert!(forgetting.predict(0, &model).unwrap() == made, "forgetting, {model:?}");
        }
        // Without room what was made last is left, of each channel and each patch.
        for memory in forgetting.memories.iter().flatten() {
            let memory = memory.lock().unwrap();
            assert!(memory.channels.iter().all(|kept| kept.entries.len() <= 1));
            assert!(memory.patches.iter().all(|kept| kept.entries.len() <= 1));
        }
    }
}
