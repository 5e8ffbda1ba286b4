//! The sense of touch as a [`Domain`]: events and raw readings of every channel at every joint frame.
//!
//! Signals of a channel ([`Signal`]): the event (0 or 1); the raw reading above its reference, in units of the
//! stream's switching threshold; and the share of the device's samples since the last frame that were on, which is
//! expected of the readings that were measured, not of simulated ones: it shows what the firmware makes of
//! readings, whatever touched. The last two are NaN where a take is binary only.
//!
//! Touch is simulated at moments between the joint frames too, near contact: a first touch, a filter of 30 ms and a
//! latch know nothing of frames that are 100 ms apart. Every limb has moments of its own, since few touch at a
//! time. Every stream lags behind by up to some milliseconds, which is fitted along.
//!
//! A raw reading is taken to be `(load / on_load)^exponent`, bent towards the end of the converter's range
//! ([`reading::Curve`]), so that it crosses the threshold where the event does; the exponent of each stream is
//! fitted along and stands for everything that is not linear between skin and converter. A share of the force that
//! it makes of a load may come late, as soft skins creep.

pub(crate) mod adequacy;
pub(crate) mod find;
mod forward;
pub(crate) mod judge;
mod moments;
pub(crate) mod next;
mod observe;
mod own;
pub(crate) mod posture;
mod reading;
mod seen;
mod switched;
mod theta;
mod wander;

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Mutex;

use nalgebra::Isometry3;
use palpate_recording::Take;
use palpate_robot_model::{JointKind, Place, SensorKind, Station};
use palpate_sim::effects::{self, Effect, Parameter};
use palpate_sim::{MOST_SOFTNESS_M, SensorModel, StreamTheta, Theta};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::DiagnosisError;
use crate::engine::{BaseParameter, Domain, Model, Series};
use forward::Memory;
pub(crate) use observe::Observed;
use reading::KNEES;
use seen::Seen;
use theta::{Of, holders, shared};
use wander::Wander;

/// Which number of a model's base is what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Base {
    LambdaCon(Of),
    Alpha(Of),
    /// Logarithm of the pressure threshold in Pa: it is fitted over orders of magnitude, as calibration of takes
    /// that lack something may leave it far from where it belongs.
    LambdaPre(Of),
    Band,
    Softness,
    Width(usize),
    Exponent(usize),
    /// How far below its ceiling the reading of a stream bends ([`reading::Curve`]).
    Knee(usize),
    /// What filter and transport of a stream delay its readings by, s.
    Lag(usize),
    /// Share of a force that a stream feels late, and by which of the times it creeps with.
    Creep(usize, usize),
    /// How far a joint, by its degree of freedom, stands from where it reports, rad.
    Zero(usize),
    /// Gain of the taxel at this place, in every patch of this set of [`TactileDomain::alike`].
    Pattern(usize, usize),
}

/// Takes of one station, as a diagnosis compares them.
pub struct TactileDomain<'a> {
    station: &'a Station,
    takes: Vec<Observed<'a>>,
    kinds: Vec<Base>,
    /// theta where no number of the base says it: all streams that would use it have their own.
    shared: Theta,
    /// By stream id, which parameters streams have of their own.
    own: BTreeMap<String, StreamTheta>,
    base: Vec<BaseParameter>,
    candidates: Vec<Effect>,
    /// Sets of patches of the same make. How pressure spreads to a taxel at the rim of a patch is only roughly what the
    /// model has, but it is the same for every patch of a make: such a pattern is the model's own, no discovery.
    alike: Vec<Vec<usize>>,
    /// Per joint, by its degree of freedom: which channels it moves.
    moves: Vec<Vec<bool>>,
    /// What recordings show of effects by themselves.
    seen: Seen,
    /// Per stream, how far its readings wander.
    wander: Vec<Wander>,
    /// Per channel, its gain's name among the parameters of a stream.
    gain_names: Vec<String>,
    /// Per channel, the limb that it is on.
    limb_of: Vec<usize>,
    /// What is remembered of the latest predictions, by take and limb.
    memories: Vec<Vec<Mutex<Memory>>>,
}

/// Kinds of signals, in the order in which every channel has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Signal {
    Event,
    Reading,
    /// Share of samples that were on, by the readings that were measured.
    Switched,
}

impl Signal {
    pub(crate) const COUNT: usize = 3;

    /// The number of this signal of `channel`.
    pub(crate) fn of(self, channel: usize) -> usize {
        channel * Self::COUNT + self as usize
    }

    /// Which kind the signal of this number is.
    pub(crate) fn at(idx: usize) -> Self {
        [Self::Event, Self::Reading, Self::Switched][idx % Self::COUNT]
    }
}

/// Width of the switching curve to begin with, in units of the load at which a channel switches.
const WIDTH: f64 = 0.2;
/// Between an amplifier and a divider, to begin with.
const KNEE: f64 = 0.3;
/// A delay that is no news: the input filter of a board and its transport.
const LONGEST_LAG_S: f64 = 0.0075;
/// Thresholds of pressure that are possible, Pa.
const PRESSURES_PA: [f64; 2] = [1.0, 1e7];
/// Softness of pads to begin with, m.
const SOFTNESS_M: f64 = 2e-4;
/// Standard deviation of a joint's zero, rad. Hands and arms are zeroed to about a milliradian; neighbouring rows
/// of a touch are wrong together, so that their loss counts about ten times what as many independent rows would,
/// and what is known beforehand must count as much to hold its own.
const ZERO_DEVIATION_RAD: f64 = 3e-4;
/// No zero is fitted farther away, rad.
const MOST_ZERO_RAD: f64 = 1e-2;
/// Readings without touch vary by at least this, in units of the switching threshold.
const LEAST_NOISE: f64 = 0.01;

impl<'a> TactileDomain<'a> {
    /// Prepares `takes` of `station`. `start` gives the parameters around which the model is built. What is taken from
    /// the recordings themselves (which objects are touched, how streams freeze, whether firmware counts from a known
    /// reading) comes from the takes with the indices `fitted` alone.
    ///
    /// Refuses takes whose object the station does not know, naming both.
    pub fn new(
        station: &'a Station,
        takes: &'a [Take],
        fitted: &[usize],
        start: &SensorModel,
    ) -> Result<(Self, Model), DiagnosisError> {
        let mut takes: Vec<Observed<'a>> =
            takes.iter().map(|take| Observed::new(station, take)).collect::<Result<_, _>>()?;
        ignore_uncertain_switching(station, &mut takes, fitted);
        let has = |kind: SensorKind| station.layout.streams.iter().any(|stream| stream.kind == kind);
        let raw = takes.iter().any(|take| take.has_raw);
        let mut kinds = Vec::new();
        let mut base = Vec::new();
        let mut values = Vec::new();
        let mut add = |kind, name: String, value: f64, [lower, upper]: [f64; 2], dose| {
            kinds.push(kind);
            base.push(BaseParameter { name, lower, upper, dose });
            values.push(value.clamp(lower, upper));
        };
        if has(SensorKind::Proximity) {
            for (of, theta, name) in
                holders(station, start, SensorKind::Proximity, |own| own.lambda_con_m.is_some())
            {
                let name = format!("lambda_con_m{name}");
                add(Base::LambdaCon(of), name, theta.lambda_con_m, [-0.02, 0.02], 1e-4);
            }
            let softness_m = start.response.pad_softness_m.max(SOFTNESS_M);
            add(Base::Softness, "pad_softness_m".into(), softness_m, [2e-5, MOST_SOFTNESS_M], 5e-5);
            if raw {
                let band_m = start.response.proximity_band_m;
                add(Base::Band, "proximity_band_m".into(), band_m, [1e-4, 5e-3], 1e-4);
            }
        }
        if has(SensorKind::Pressure) {
            for (of, theta, name) in
                holders(station, start, SensorKind::Pressure, |own| own.alpha_per_m.is_some())
            {
                let (name, alpha) = (format!("alpha_per_m{name}"), theta.alpha_per_m.max(1.0));
                add(Base::Alpha(of), name, alpha, [1.0, 10.0 * alpha + 1000.0], 0.05 * alpha);
            }
            for (of, theta, name) in
                holders(station, start, SensorKind::Pressure, |own| own.lambda_pre_pa.is_some())
            {
                let (name, pre) = (format!("ln_lambda_pre{name}"), theta.lambda_pre_pa.max(1.0));
                add(Base::LambdaPre(of), name, pre.ln(), PRESSURES_PA.map(f64::ln), 0.05);
            }
        }
        for (idx, stream) in station.layout.streams.iter().enumerate() {
            add(Base::Width(idx), format!("width.{}", stream.id), WIDTH, [0.03, 1.0], 0.03);
            if raw {
                let (kind, exponent, value) = own::exponent(station, idx);
                add(kind, exponent.name, value, [exponent.lower, exponent.upper], exponent.dose);
                // A pad is a resistor, often in a divider.
                if stream.kind == SensorKind::Proximity {
                    add(Base::Knee(idx), format!("knee.{}", stream.id), KNEE, KNEES, 0.05);
                }
            }
            add(Base::Lag(idx), format!("lag_s.{}", stream.id), 0.0, [0.0, LONGEST_LAG_S], 0.002);
            for (kind, creep) in own::creeps(station, idx).filter(|_| raw) {
                add(kind, creep.name, 0.0, [creep.lower, creep.upper], creep.dose);
            }
        }
        let alike = alike(station);
        for (set, patches) in alike.iter().enumerate() {
            let first = &station.layout.patches[patches[0]];
            for taxel in 1..first.channels.len() {
                add(Base::Pattern(set, taxel), format!("gain.{}.{taxel}", first.id), 1.0, [0.2, 5.0], 0.1);
            }
        }
        let touched: Vec<&str> = fitted.iter().map(|&take| takes[take].object.id.as_str()).collect();
        let candidates = effects::TACTILE
            .iter()
            .filter(|kind| kind.id() != own::CREEP && (raw || kind.id() != seen::SAMPLE_HOLD))
            .flat_map(|kind| kind.places(station).into_iter().map(move |place| (kind, place)))
            .filter(|(_, place)| !matches!(place, Place::Object(id) if !touched.contains(&id.as_str())))
            .map(|(kind, place)| Effect {
                id: kind.id().to_owned(),
                parameters: kind
                    .parameters(&place, station)
                    .into_iter()
                    .map(|parameter| (parameter.name, parameter.neutral))
                    .collect(),
                place,
                interval: BTreeMap::new(),
                takes: Vec::new(),
            })
            .collect();
        let limbs = observe::limbs(&station.layout);
        let limb_of = station.layout.channels.iter().map(|channel| limbs[channel.patch]).collect();
        let memories = memories(station, takes.len());
        let gain_names =
            station.layout.channels.iter().map(|channel| format!("gain_{}", channel.id)).collect();
        let fitted: Vec<&Observed<'_>> = fitted.iter().map(|&take| &takes[take]).collect();
        let wander = (0..station.layout.streams.len())
            .map(|stream| Wander::of(&fitted, &station.layout, stream))
            .collect();
        let seen = Seen::of(&fitted, &station.layout);
        let moves = moves(station);
        let domain = Self {
            station,
            takes,
            kinds,
            shared: shared(station, start),
            own: start.streams.clone(),
            base,
            candidates,
            alike,
            moves,
            seen,
            wander,
            gain_names,
            limb_of,
            memories,
        };
        Ok((domain, Model { base: values, effects: start.effects.clone() }))
    }

    /// These takes as they would have been recorded if `model` were the whole truth: with noise on joints, readings
    /// and pressures, drawn from `seed`.
    pub(crate) fn simulated(&self, model: &Model, seed: u64) -> Result<Self, DiagnosisError> {
        let mut takes = Vec::with_capacity(self.takes.len());
        for (idx, take) in self.takes.iter().enumerate() {
            let predicted = self.predict(idx, model)?;
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(idx as u64);
            takes.push(take.simulated(self.station, &predicted, &self.wander, &mut rng));
        }
        Ok(Self {
            station: self.station,
            gain_names: self.gain_names.clone(),
            memories: memories(self.station, takes.len()),
            takes,
            kinds: self.kinds.clone(),
            shared: self.shared,
            own: self.own.clone(),
            base: self.base.clone(),
            candidates: self.candidates.clone(),
            alike: self.alike.clone(),
            moves: self.moves.clone(),
            seen: self.seen.clone(),
            wander: self.wander.clone(),
            limb_of: self.limb_of.clone(),
        })
    }

    /// From now on what may stand in for names is fitted along: the zero of each joint that moves channels, and of
    /// events alone how skins creep, and with which power of a load forces grow, which creep. `models` have none of it
    /// yet.
    pub(crate) fn fit_along(&mut self, models: [&mut Model; 2]) {
        let has_raw = self.num_raw_takes() > 0;
        let mut values = Vec::new();
        let mut add = |kind, parameter, value| {
            self.kinds.push(kind);
            self.base.push(parameter);
            values.push(value);
        };
        if !has_raw {
            for stream in 0..self.station.layout.streams.len() {
                let (kind, parameter, value) = own::exponent(self.station, stream);
                add(kind, parameter, value);
                own::creeps(self.station, stream).for_each(|(kind, parameter)| add(kind, parameter, 0.0));
            }
        }
        for (dof, joint) in self.station.robot.dofs().enumerate() {
            if joint.kind == JointKind::Revolute && self.moves[dof].contains(&true) {
                let name = format!("zero_rad.{}", joint.name);
                let [lower, upper] = [-MOST_ZERO_RAD, MOST_ZERO_RAD];
                add(Base::Zero(dof), BaseParameter { name, lower, upper, dose: ZERO_DEVIATION_RAD }, 0.0);
            }
        }
        models.into_iter().for_each(|model| model.base.extend(&values));
    }

    /// Number of takes with raw readings.
    pub fn num_raw_takes(&self) -> usize {
        self.takes.iter().filter(|take| take.has_raw).count()
    }

    pub(crate) fn take(&self, take: usize) -> &Observed<'a> {
        &self.takes[take]
    }

    /// Per stream.
    fn wander(&self) -> &[Wander] {
        &self.wander
    }
}

fn memories(station: &Station, num_takes: usize) -> Vec<Vec<Mutex<Memory>>> {
    let layout = &station.layout;
    let num_limbs = observe::limbs(layout).into_iter().max().map_or(0, |last| last + 1);
    let memory = |_| Memory::new(layout.num_channels(), layout.patches.len(), num_limbs * num_takes);
    let of_take = || (0..num_limbs).map(memory);
    (0..num_takes).map(|_| of_take().collect()).collect()
}

/// Readings without touch may differ by this from take to take, in units of the switching threshold, for it to be known
/// from where the firmware counts.
const STEADY: f64 = 0.03;

/// Ignores what firmware makes of readings where the takes `fitted` leave it uncertain what it takes for no touch.
fn ignore_uncertain_switching(station: &Station, takes: &mut [Observed<'_>], fitted: &[usize]) {
    for (channel, config) in station.layout.channels.iter().enumerate() {
        let references = fitted.iter().flat_map(|&take| takes[take].references(station, channel));
        let (least, most) =
            references.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
        if most - least > STEADY * station.streams[config.stream].on_threshold {
            takes.iter_mut().for_each(|take| take.ignore_switching(channel));
        }
    }
}

/// Sets of at least two patches with several taxels each that are of one make.
fn alike(station: &Station) -> Vec<Vec<usize>> {
    let layout = &station.layout;
    let mut sets: BTreeMap<(usize, usize, usize), Vec<usize>> = BTreeMap::new();
    for (idx, patch) in layout.patches.iter().enumerate() {
        if patch.channels.len() > 1 && layout.streams[patch.stream].kind == SensorKind::Pressure {
            sets.entry((patch.stream, patch.channels.len(), patch.nodes.len())).or_default().push(idx);
        }
    }
    sets.into_values().filter(|patches| patches.len() > 1).collect()
}

/// The station's own hysteresis: known, so that it is no discovery.
pub(crate) fn known_off_fractions(station: &Station) -> BTreeMap<String, f64> {
    let streams = station.layout.streams.iter().zip(&station.streams);
    streams.map(|(stream, config)| (stream.id.clone(), config.off_threshold / config.on_threshold)).collect()
}

/// Per degree of freedom, which channels it moves.
fn moves(station: &Station) -> Vec<Vec<bool>> {
    let num_dofs = station.robot.num_dofs();
    let at = |positions: &[f64]| -> Vec<Isometry3<f64>> {
        let mut frames = Vec::new();
        station.robot.forward_kinematics(positions, &mut frames);
        frames
    };
    // A posture in general position: at zero an axis may go through a link's origin.
    let positions: Vec<f64> = (0..num_dofs).map(|dof| 0.1 + 0.01 * dof as f64).collect();
    let rest = at(&positions);
    (0..num_dofs)
        .map(|dof| {
            let mut moved = positions.clone();
            moved[dof] += 0.05;
            let moved = at(&moved);
            let channels = station.layout.channels.iter();
            channels
                .map(|channel| {
                    let link = station.layout.patches[channel.patch].link;
                    (rest[link].to_homogeneous() - moved[link].to_homogeneous()).norm() > 1e-9
                })
                .collect()
        })
        .collect()
}

impl Domain for TactileDomain<'_> {
    fn num_takes(&self) -> usize {
        self.takes.len()
    }

    fn blocks(&self, take: usize) -> &[Range<usize>] {
        &self.takes[take].blocks
    }

    fn observed(&self, take: usize, signal: usize) -> &[f64] {
        &self.takes[take].signals[signal]
    }

    fn base(&self) -> &[BaseParameter] {
        &self.base
    }

    fn candidates(&self) -> Vec<Effect> {
        self.candidates.clone()
    }

    fn parameters(&self, effect: &Effect) -> Vec<Parameter> {
        let mut parameters = effects::tactile(&effect.id)
            .map_or_else(Vec::new, |kind| kind.parameters(&effect.place, self.station));
        self.seen.begin(effect, &self.station.layout, &mut parameters);
        parameters
    }

    fn num_units(&self) -> usize {
        self.station.layout.num_channels()
    }

    fn num_kinds(&self) -> usize {
        Signal::COUNT
    }

    fn prior_standard_deviation(&self, idx: usize) -> Option<f64> {
        matches!(self.kinds[idx], Base::Zero(_)).then_some(ZERO_DEVIATION_RAD)
    }

    fn base_support(&self, idx: usize) -> Vec<bool> {
        let layout = &self.station.layout;
        let of = |holds: &dyn Fn(&palpate_robot_model::Channel) -> bool| {
            layout.channels.iter().map(holds).collect()
        };
        let senses = |kind: SensorKind| of(&|channel| layout.streams[channel.stream].kind == kind);
        match self.kinds[idx] {
            Base::Band | Base::Softness => senses(SensorKind::Proximity),
            Base::LambdaCon(_) | Base::Alpha(_) | Base::LambdaPre(_) => {
                of(&|channel| self.has_number(idx, channel.stream))
            }
            Base::Width(stream)
            | Base::Exponent(stream)
            | Base::Knee(stream)
            | Base::Lag(stream)
            | Base::Creep(stream, _) => of(&|channel| channel.stream == stream),
            Base::Zero(dof) => self.moves[dof].clone(),
            Base::Pattern(set, taxel) => of(&|channel| {
                let patch = &layout.patches[channel.patch];
                self.alike[set].contains(&channel.patch)
                    && layout.channels[patch.channels.start + taxel].id == channel.id
            }),
        }
    }

    fn reaches_take(&self, effect: &Effect, take: usize) -> bool {
        !matches!(&effect.place, Place::Object(id) if self.takes[take].object.id != *id)
    }

    fn support(&self, effect: &Effect, parameter: &str) -> Vec<bool> {
        let layout = &self.station.layout;
        let of_patch = |holds: &dyn Fn(&palpate_robot_model::Patch) -> bool| -> Vec<bool> {
            layout.channels.iter().map(|channel| holds(&layout.patches[channel.patch])).collect()
        };
        let named = |ids: &[&str]| -> Vec<bool> {
            layout.channels.iter().map(|channel| ids.contains(&channel.id.as_str())).collect()
        };
        if let Some(channel) = parameter.strip_prefix("gain_") {
            return named(&[channel]);
        }
        match &effect.place {
            Place::Stream(id) => {
                layout.channels.iter().map(|channel| layout.streams[channel.stream].id == *id).collect()
            }
            Place::Patch(id) => of_patch(&|patch| patch.id == *id),
            Place::Channel(id) => named(&[id]),
            Place::Channels(ids) => named(&ids.iter().map(String::as_str).collect::<Vec<_>>()),
            Place::Group(id) => of_patch(&|patch| patch.group == *id),
            Place::Groups(ids) => of_patch(&|patch| ids.contains(&patch.group)),
            Place::Joint(name) => {
                let dof = self.station.robot.dofs().position(|joint| joint.name == *name);
                dof.map_or_else(|| vec![false; layout.num_channels()], |dof| self.moves[dof].clone())
            }
            Place::Object(_) => vec![true; layout.num_channels()],
        }
    }

    fn predict(&self, take: usize, model: &Model) -> Result<Vec<Series>, DiagnosisError> {
        self.forward(take, &self.prepared(model))
    }

    fn predict_takes(&self, takes: &[usize], model: &Model) -> Result<Vec<Vec<Series>>, DiagnosisError> {
        let prepared = self.prepared(model);
        takes.par_iter().map(|&take| self.forward(take, &prepared)).collect()
    }

    fn weights(&self, take: usize, signal: usize, prediction: &[f64]) -> Vec<f64> {
        if Signal::at(signal) == Signal::Switched {
            return vec![SWITCHED_DOUBT.recip(); prediction.len()];
        }
        if Signal::at(signal) == Signal::Event {
            let doubt = |frame: usize| prediction[frame] * (1.0 - prediction[frame]);
            let around = (0..prediction.len()).map(|frame| {
                let next = (frame + 1).min(prediction.len() - 1);
                doubt(frame.saturating_sub(1)).max(doubt(frame)).max(doubt(next))
            });
            let mut last = (f64::NAN, f64::NAN);
            let weight = |variance: f64| {
                if variance != last.0 {
                    last = (variance, (variance + LEAST_DOUBT).sqrt().recip());
                }
                last.1
            };
            return around.map(weight).collect();
        }
        // What the model may be wrong by without being wrong: noise, wander, a share of the reading, and about a
        // quarter of a millimetre of depth, which a first touch reads as a share of the threshold.
        let channel = signal / Signal::COUNT;
        let wander = self.wander[self.station.layout.channels[channel].stream];
        let noise = self.takes[take].noise[channel].max(LEAST_NOISE);
        let quiet = noise * noise + wander.variance();
        let mut last = (f64::NAN, f64::NAN);
        let weight = |&x: &f64| {
            if x != last.0 {
                let shape = SHARE * x;
                let depth = DEPTH * (x.abs() / 0.5).min(1.0);
                last = (x, (quiet + shape * shape + depth * depth).sqrt().recip());
            }
            last.1
        };
        prediction.iter().map(weight).collect()
    }
}

/// Share of a frame's samples that may be on or off by chance: readings are rounded, and the moments of samples are
/// a little uncertain.
const SWITCHED_DOUBT: f64 = 0.05;
/// Variance of an event that the model is sure of.
const LEAST_DOUBT: f64 = 0.02;
/// Share of a raw reading that the model may be wrong by.
const SHARE: f64 = 0.08;
/// Raw reading, in units of the threshold, that the depth of contact may be wrong by.
const DEPTH: f64 = 0.2;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Session, session};

    #[test]
    fn takes_that_are_kept_for_judging_change_nothing_of_what_is_fitted() {
        let Session { stage, mut takes, nominal } = session("small");
        let station = stage.station();
        takes.truncate(1);
        let mut confirm = takes[0].clone();
        confirm.id = "confirm".to_owned();
        for (stream, log) in station.layout.streams.iter().zip(&mut confirm.streams) {
            // Its readings without touch are others, and it stands still for half of the take.
            log.reference.iter_mut().for_each(|reference| *reference += 1000.0);
            let (width, half) = (stream.channels.len(), log.times_s.len() / 2);
            let first: Vec<f32> = log.raw[..width].to_vec();
            log.raw[..half * width].chunks_exact_mut(width).for_each(|sample| sample.copy_from_slice(&first));
        }
        takes.push(confirm);
        let of = |takes| TactileDomain::new(station, takes, &[0], &nominal).unwrap().0;
        let (alone, beside) = (of(&takes[..1]), of(&takes));
        let bits = |domain: &TactileDomain<'_>| -> Vec<u64> {
            domain.take(0).signals.iter().flatten().map(|value| value.to_bits()).collect()
        };
        assert!(
            bits(&alone) == bits(&beside),
            "what is expected of the firmware depends on the confirm take"
        );
        assert_eq!(alone.seen, beside.seen);
        assert_ne!(TactileDomain::new(station, &takes, &[0, 1], &nominal).unwrap().0.seen, alone.seen);
        assert_eq!(alone.candidates(), beside.candidates());
    }
}
