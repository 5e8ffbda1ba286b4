//! The chain frame by frame, while a take goes on: each frame costs the same, however many were before it.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::Isometry3;
use palpate_robot_model::{ObjectModel, ObjectPath, Station, TactileLayout};

use super::{Chain, Contact, Effect, Switching, TakeScene, Transport};
use crate::effects::{DynFrameEffect, Force, Frame, Stage, TACTILE, places};
use crate::replay::{ContactTrace, Gaps, PatchTrace};
use crate::tactile::{self, Propagation};

/// A [`Chain`] that switches hard, prepared for frames of a station: what many takes share that go on at once.
#[derive(Debug)]
pub(crate) struct FrameChain {
    /// As [`crate::Response::pad_softness_m`].
    softness_m: f64,
    /// Per patch, as [`crate::Response::reach_m`].
    reaches_m: Vec<f64>,
    joints: Vec<DynFrameEffect>,
    /// Effects on what the skin feels, each with its index in [`TACTILE`].
    contact: Vec<(usize, Effect)>,
    /// Whether any of them depends on the change since the frame before.
    looks_back: bool,
    /// Per patch, with the decay that effects leave it.
    propagation: Vec<Propagation>,
    loads: Vec<DynFrameEffect>,
    /// What is made of loads before each of those, and at the end.
    taken_as: Vec<Vec<TakenAs>>,
    /// Effects on which moment a reading shows, as `contact`.
    transport: Vec<(usize, Effect)>,
    /// Per stream, whether any of those acts on it.
    is_carried: Vec<bool>,
    switching: Switching,
}

/// What the chain remembers of one take.
#[derive(Clone, Debug)]
pub(crate) struct FrameMemory {
    num_frames: usize,
    /// Numbers of [`FrameEffect::memory_len`](crate::effects::FrameEffect::memory_len), effect by effect.
    joints: Vec<f64>,
    loads: Vec<f64>,
    /// What the skin felt in the frame before, and the true joint positions, where effects look back.
    before: Option<(ContactTrace, Vec<f64>)>,
    /// Per stream.
    past: Vec<Past>,
    /// Per channel.
    is_on: Vec<bool>,
    lasting: Vec<Lasting>,
}

/// Who touches what in a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameScene<'a> {
    pub(crate) station: &'a Station,
    pub(crate) object: &'a ObjectModel,
    pub(crate) base_from_object: &'a Isometry3<f64>,
    /// Nodes and taxels, with mounting errors.
    pub(crate) layout: &'a TactileLayout,
    pub(crate) frame: Frame<'a>,
}

impl FrameChain {
    /// `chain` on the nodes and taxels of `layout`, those of `station` with mounting errors.
    pub(crate) fn new(
        chain: &Chain<'_>,
        station: &Station,
        object: &ObjectModel,
        layout: &TactileLayout,
    ) -> Self {
        let nothing = TakeScene {
            station,
            object,
            base_from_object: &ObjectPath::Still(Isometry3::identity()),
            surroundings: &[],
            frame_times_s: &[],
            positions: &[],
            arrival_times_s: &[],
            frozen_for_s: &[],
            tares: &[],
        };
        let mut contact = Contact {
            trace: Cow::Owned(ContactTrace::empty(layout, 0)),
            needed: &vec![true; layout.patches.len()],
            layout,
            alpha_per_m: chain.thetas.alphas_per_m(layout),
            positions: &[],
            touches: None,
        };
        chain.each(|kind, effect| kind.contact(effect, &nothing, &mut contact));
        let patches = layout.patches.iter().zip(&contact.alpha_per_m);
        let propagation = patches.map(|(patch, &alpha)| tactile::patch_propagation(layout, patch, alpha));
        let on_loads = chain.on_loads(&station.layout);
        let of_stage = |stage: Stage| -> Vec<(usize, Effect)> {
            let effects = chain.effects.iter().filter(|(kind, _)| TACTILE[*kind].stage() == stage);
            effects.map(|(kind, effect)| (*kind, (*effect).clone())).collect()
        };
        let (contact, transport) = (of_stage(Stage::Contact), of_stage(Stage::Transport));
        let mut is_carried = vec![false; layout.streams.len()];
        for (_, effect) in &transport {
            places::streams_of(&effect.place, layout).for_each(|stream| is_carried[stream] = true);
        }
        let effects = || chain.effects.iter().map(|(kind, effect)| (TACTILE[*kind], *effect));
        let loads: Vec<DynFrameEffect> =
            effects().filter_map(|(kind, effect)| kind.load_by_frame(effect, station, &on_loads)).collect();
        Self {
            softness_m: chain.response.pad_softness_m,
            reaches_m: chain.reaches_m(layout),
            joints: effects().filter_map(|(kind, effect)| kind.joints_by_frame(effect, station)).collect(),
            looks_back: contact.iter().any(|(kind, _)| TACTILE[*kind].looks_ahead()),
            contact,
            propagation: propagation.collect(),
            taken_as: TakenAs::before_each(&loads, on_loads.len()),
            loads,
            transport,
            is_carried,
            switching: chain.switching(&nothing),
        }
    }

    /// Weights of each patch.
    pub(crate) fn propagation(&self) -> &[Propagation] {
        &self.propagation
    }

    /// How loads become events.
    pub(crate) fn switching(&self) -> &Switching {
        &self.switching
    }

    /// Of a take without frames.
    pub(crate) fn memory(&self) -> FrameMemory {
        let len = |effects: &[DynFrameEffect]| effects.iter().map(|effect| effect.memory_len()).sum();
        let num_channels = self.switching.on_loads.len();
        FrameMemory {
            num_frames: 0,
            joints: vec![0.0; len(&self.joints)],
            loads: vec![0.0; len(&self.loads)],
            before: None,
            past: vec![Past::default(); self.is_carried.len()],
            is_on: vec![false; num_channels],
            lasting: vec![Lasting::default(); num_channels],
        }
    }

    /// Makes true joint positions of measured ones.
    pub(crate) fn move_joints(&self, frame: &Frame<'_>, memory: &mut FrameMemory, positions: &mut [f64]) {
        step_each(&self.joints, frame, &mut memory.joints, positions, |_, _| ());
    }

    /// What hosts see of a frame in which the skin feels `trace` (of that frame alone) and joints are truly at `positions`:
    /// loads as in [`super::Sensed`] into `loads`, and whether each channel is active into `active`.
    pub(crate) fn sense(
        &self,
        scene: &FrameScene<'_>,
        trace: &ContactTrace,
        positions: &[f64],
        memory: &mut FrameMemory,
        loads: &mut [f64],
        active: &mut [bool],
    ) {
        let felt = self.feel(scene, trace, positions, memory);
        let last = felt.num_frames - 1;
        let of_patches = self.propagation.iter().zip(&self.reaches_m);
        for ((patch, trace), (propagation, reach_m)) in
            scene.layout.patches.iter().zip(&felt.patches).zip(of_patches)
        {
            let taxels = &mut loads[patch.channels.clone()];
            match &**trace {
                PatchTrace::Proximity { min_distance_m, .. } => {
                    taxels.fill((reach_m - min_distance_m[last]).max(0.0));
                }
                PatchTrace::Pressure { offsets, entries } => {
                    taxels.fill(0.0);
                    let touched = &entries[PatchTrace::entry_range(offsets, last)];
                    tactile::propagate(&propagation.weights, touched, taxels);
                }
            }
        }
        step_each(&self.loads, &scene.frame, &mut memory.loads, loads, |idx, loads| {
            self.taken_as[idx].iter().for_each(|taken| taken.make(loads));
        });
        self.carry(scene, memory, loads);
        self.switch(scene.frame.time_s, memory, loads, active);
        memory.num_frames += 1;
    }

    /// What the skin feels, with effects; the last frame counts.
    fn feel<'t>(
        &self,
        scene: &FrameScene<'_>,
        trace: &'t ContactTrace,
        positions: &[f64],
        memory: &mut FrameMemory,
    ) -> Cow<'t, ContactTrace> {
        let mut felt = Cow::Borrowed(trace);
        if self.softness_m > 0.0 {
            for patch in &mut felt.to_mut().patches {
                if let PatchTrace::Proximity { min_distance_m, gaps } = &**patch {
                    let min_distance_m = gaps.soft_distances_m(min_distance_m, self.softness_m);
                    *patch = Arc::new(PatchTrace::Proximity { min_distance_m, gaps: Gaps::default() });
                }
            }
        }
        if self.contact.is_empty() {
            return felt;
        }
        let Frame { before_s, time_s, .. } = scene.frame;
        let (mut times_s, mut path) = (vec![time_s], positions.to_vec());
        if self.looks_back {
            let now = felt.clone().into_owned();
            if let Some((before, positions_before)) = memory.before.replace((now, positions.to_vec())) {
                times_s.insert(0, before_s);
                path = [&positions_before[..], positions].concat();
                felt = Cow::Owned(before.followed_by(&felt));
            }
        }
        let take = TakeScene {
            station: scene.station,
            object: scene.object,
            base_from_object: &ObjectPath::Still(*scene.base_from_object),
            surroundings: &[],
            frame_times_s: &times_s,
            positions: &path,
            arrival_times_s: &[],
            frozen_for_s: &[],
            tares: &[],
        };
        let num_patches = scene.layout.patches.len();
        let mut contact = Contact {
            trace: Cow::Borrowed(&*felt),
            needed: &vec![true; num_patches],
            layout: scene.layout,
            alpha_per_m: vec![0.0; num_patches],
            positions: &path,
            touches: None,
        };
        for (kind, effect) in &self.contact {
            TACTILE[*kind].contact(effect, &take, &mut contact);
        }
        match contact.trace {
            Cow::Owned(changed) => Cow::Owned(changed),
            Cow::Borrowed(_) => felt,
        }
    }

    /// Puts into `loads` those of the moments that readings show.
    fn carry(&self, scene: &FrameScene<'_>, memory: &mut FrameMemory, loads: &mut [f64]) {
        if self.transport.is_empty() {
            return;
        }
        let Frame { is_first, start_s, time_s, .. } = scene.frame;
        // The times depend on no frames but these.
        let times_s = if is_first { vec![time_s] } else { vec![start_s, time_s] };
        let take = TakeScene {
            station: scene.station,
            object: scene.object,
            base_from_object: &ObjectPath::Still(*scene.base_from_object),
            surroundings: &[],
            frame_times_s: &times_s,
            positions: &[],
            arrival_times_s: &[],
            frozen_for_s: &[],
            tares: &[],
        };
        let num_streams = self.is_carried.len();
        let mut transport =
            Transport { device_times_s: vec![times_s.clone(); num_streams], holds: vec![None; num_streams] };
        for (kind, effect) in &self.transport {
            TACTILE[*kind].transport(effect, &take, &mut transport);
        }
        transport.freeze();
        let streams = scene.layout.streams.iter().zip(&self.is_carried).zip(&mut memory.past);
        for (((stream, is_carried), past), device_times_s) in streams.zip(&transport.device_times_s) {
            if let (true, Some(&device_time_s)) = (*is_carried, device_times_s.last()) {
                past.show(time_s, device_time_s, &mut loads[stream.channels.clone()]);
            }
        }
    }

    fn switch(&self, time_s: f64, memory: &mut FrameMemory, loads: &[f64], active: &mut [bool]) {
        for (channel, &load) in loads.iter().enumerate() {
            let is_on = &mut memory.is_on[channel];
            *is_on = self.switching.latches(channel, load, *is_on);
            let mut activation = self.switching.reported(memory.num_frames, channel, *is_on);
            let min_on_s = self.switching.min_on_s[channel];
            if min_on_s > 0.0 {
                activation = memory.lasting[channel].reported(time_s, activation, min_on_s);
            }
            active[channel] = activation > 0.5;
        }
    }
}

/// Steps of `effects`, each with its part of the `memory`; `before` is called with the index of each, and with their
/// number at the end.
fn step_each(
    effects: &[DynFrameEffect],
    frame: &Frame<'_>,
    mut memory: &mut [f64],
    values: &mut [f64],
    before: impl Fn(usize, &mut [f64]),
) {
    for (idx, effect) in effects.iter().enumerate() {
        before(idx, values);
        let (own, others) = memory.split_at_mut(effect.memory_len());
        effect.step(frame, own, values);
        memory = others;
    }
    before(effects.len(), values);
}

/// The value of a channel, taken as another force than before.
#[derive(Clone, Copy, Debug)]
struct TakenAs {
    channel: usize,
    before: Force,
    after: Force,
}

impl TakenAs {
    /// As [`super::Load`] has it: what acts on forces is given them, all else loads, and loads are what is left in
    /// the end.
    fn before_each(effects: &[DynFrameEffect], num_channels: usize) -> Vec<Vec<Self>> {
        let mut now = vec![Force::LOAD; num_channels];
        let take = |forces: &[(usize, Force)]| -> Vec<Self> {
            let changed = forces.iter().filter_map(|&(channel, after)| {
                let before = std::mem::replace(&mut now[channel], after);
                (before != after).then_some(Self { channel, before, after })
            });
            changed.collect()
        };
        let loads: Vec<(usize, Force)> = (0..num_channels).map(|channel| (channel, Force::LOAD)).collect();
        let wanted = effects.iter().map(|effect| effect.forces().unwrap_or(&loads));
        wanted.chain([&loads[..]]).map(take).collect()
    }

    fn make(self, values: &mut [f64]) {
        self.before.make_other(&mut values[self.channel..=self.channel], self.after);
    }
}

/// Loads of a stream that it may still show.
#[derive(Clone, Debug, Default)]
struct Past {
    times_s: VecDeque<f64>,
    /// Those of a frame one after the other.
    loads: VecDeque<f64>,
}

impl Past {
    /// Adds the `loads` of the frame at `time_s` and puts those of `device_time_s` in their place: linear between frames, as
    /// of [`super::Moments`]. Moments that are shown go forward only, so that frames before them are forgotten.
    fn show(&mut self, time_s: f64, device_time_s: f64, loads: &mut [f64]) {
        self.times_s.push_back(time_s);
        self.loads.extend(loads.iter());
        while self.times_s.len() > 1 && self.times_s[1] <= device_time_s {
            self.times_s.pop_front();
            self.loads.drain(..loads.len());
        }
        let after = self.times_s.iter().take_while(|time_s| **time_s <= device_time_s).count();
        let (from, to) = (after.saturating_sub(1), after.min(self.times_s.len() - 1));
        let gap_s = self.times_s[to] - self.times_s[from];
        let share = if gap_s > 0.0 { (device_time_s - self.times_s[from]) / gap_s } else { 0.0 };
        let num_channels = loads.len();
        for (channel, load) in loads.iter_mut().enumerate() {
            let (from, to) =
                (self.loads[from * num_channels + channel], self.loads[to * num_channels + channel]);
            *load = from + share * (to - from);
        }
    }
}

/// Activations of a channel over the time that one must have lasted to be reported.
#[derive(Clone, Debug, Default)]
struct Lasting(VecDeque<(f64, f64)>);

impl Lasting {
    /// Adds the `activation` at `time_s` and gives what is reported then, as [`Switching::activation`] has it.
    fn reported(&mut self, time_s: f64, activation: f64, min_on_s: f64) -> f64 {
        self.0.push_back((time_s, activation));
        let since_s = time_s - min_on_s;
        while self.0.len() > 1 && self.0[1].0 <= since_s {
            self.0.pop_front();
        }
        let mut smallest = self.0.iter().skip(1).map(|(_, raw)| *raw).fold(activation, f64::min);
        if self.0.len() > 1 {
            let ((first_s, first), (second_s, second)) = (self.0[0], self.0[1]);
            let share = (since_s - first_s) / (second_s - first_s);
            smallest = smallest.min(first + share.clamp(0.0, 1.0) * (second - first));
        }
        smallest
    }
}
