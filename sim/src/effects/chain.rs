//! Runs a take through the sensing chain, with any set of effects.

mod by_frame;
mod load;
mod made;
mod moments;
mod switching;

use std::borrow::Cow;
use std::sync::Arc;

use nalgebra::Isometry3;
use palpate_robot_model::{
    FixedBox, KnownPoses, LinkPoses, ObjectModel, ObjectPath, Station, Stream, TactileLayout, Tare,
};

use super::{Effect, EffectKind, FingerTouches, TACTILE, places};
use crate::geometry::SignedDistance;
use crate::parallel::map_chunks;
use crate::replay::{Bodies, ContactTrace, Gaps, PatchTrace, ReplayError, trace_of};
use crate::{Response, Thetas};
pub(crate) use by_frame::{FrameChain, FrameMemory, FrameScene};
pub use load::Load;
use made::Made;
use moments::Moments;
pub use switching::Switching;

/// What was recorded of a take, as far as the simulation of its touch needs it.
#[derive(Clone, Copy, Debug)]
pub struct TakeScene<'a> {
    /// Robot, layout and objects.
    pub station: &'a Station,
    /// The object that is touched.
    pub object: &'a ObjectModel,
    /// Where it is said to be at the frames.
    pub base_from_object: &'a ObjectPath,
    /// What else can be touched and stands still; no effect moves it.
    pub surroundings: &'a [FixedBox],
    /// Host time of each joint frame since the take's start, s.
    pub frame_times_s: &'a [f64],
    /// Measured joint positions, `num_frames x num_dofs`, row-major, rad or m.
    pub positions: &'a [f64],
    /// Per stream, host time at which the reading in effect at each frame had arrived, s; empty: at the frame itself.
    pub arrival_times_s: &'a [Vec<f64>],
    /// Per stream, for how long the reading in effect at each frame had been repeated to the bit when it arrived, s; 0
    /// for one that is new. Empty where nobody can tell.
    pub frozen_for_s: &'a [Vec<f64>],
    /// When readings were referred to what they were then, by time; the first reference, at the take's start, is none
    /// of these. Empty where it counts for the whole take.
    pub tares: &'a [Tare],
}

/// Where joints, object and patches really are.
#[derive(Clone, Debug)]
pub struct Kinematics<'a> {
    /// True joint positions, as in [`TakeScene::positions`].
    pub positions: Cow<'a, [f64]>,
    /// Where the object truly is at the frames.
    pub base_from_object: ObjectPath,
    /// True size of the object over its nominal size.
    pub object_scale: f64,
    /// Per patch, motion of its nodes and taxels in the frame of its link.
    pub patch_offsets: Vec<Isometry3<f64>>,
}

/// How the skin is loaded.
#[derive(Clone, Debug)]
pub struct Contact<'a> {
    /// Distances and node pressures.
    pub trace: Cow<'a, ContactTrace>,
    /// Per patch, whether anybody needs what it feels: what is made of others is lost.
    pub needed: &'a [bool],
    /// Nodes and taxels, with mounting errors.
    pub layout: &'a TactileLayout,
    /// Per patch, decay of pressure along the elastomer, 1/m.
    pub alpha_per_m: Vec<f64>,
    /// True joint positions, as in [`Kinematics::positions`].
    pub positions: &'a [f64],
    /// What fingers feel of each other at these positions, as far as it is known.
    pub touches: Option<&'a FingerTouches>,
}

/// Which moment each reading shows.
#[derive(Clone, Debug)]
pub struct Transport {
    /// Per stream and frame, the time (on the joints' clock, s) at which the reading in effect was sampled. A stream that
    /// nobody needs has no frames.
    pub device_times_s: Vec<Vec<f64>>,
    /// Per stream, how it freezes.
    pub holds: Vec<Option<Hold>>,
}

/// A stream that freezes for a `span_s` at a time, a `fraction` of the time.
///
/// A chain that switches hard freezes regularly from the start of the take: after `span_s * (1 / fraction - 1)` of the
/// present come `span_s` of its last moment. A soft chain does not know when the spans begin and gives the mean over
/// all of them: `(1 - fraction)` of the present and `fraction` of the mean over the last `span_s`.
#[derive(Clone, Debug, PartialEq)]
pub struct Hold {
    /// Share of the time that is frozen, above 0, below 1; or, where the spans are seen, how much of them counts.
    pub fraction: f64,
    /// Length of a frozen span, s.
    pub span_s: f64,
    /// Per frame, for how long the stream is seen to be frozen, s, as in [`TakeScene::frozen_for_s`]; empty where it is
    /// not known. A chain that switches hard freezes for just that long, a soft one blends the present with it.
    pub seen_for_s: Vec<f64>,
}

/// What arrives of the load of one channel, frame by frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Arrived {
    /// As one of [`Load::values`], at the moments that the host sees.
    pub present: Arc<[f64]>,
    /// The same at the moments that a frozen stream may show instead, equally likely; none unless it freezes and the
    /// chain is soft.
    pub past: Vec<Arc<[f64]>>,
    /// Whether nothing ever presses, as [`Load::is_silent`] has it: all of it is zero then.
    pub is_silent: bool,
    /// Share of the past, see [`Hold::fraction`].
    pub past_share: f64,
}

/// Readings of every channel at the frames of a take.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensed {
    /// Number of frames.
    pub num_frames: usize,
    /// Number of channels.
    pub num_channels: usize,
    /// As [`Load::values`], at the moments that the host sees, `[frame * num_channels + channel]`.
    pub load: Vec<f64>,
    /// Activation, 0 or 1; in between where [`Switching::widths`] are not zero, and for an effect that is there in part.
    /// Same indexing.
    pub activation: Vec<f64>,
}

/// A sensor model with effects, ready to run takes through.
#[derive(Clone, Debug)]
pub struct Chain<'a> {
    /// The paper's parameters, of every stream.
    thetas: Thetas<'a>,
    /// What the model knows of sensors beyond theta.
    response: &'a Response,
    /// Effects in the order in which they act, each with its index in [`TACTILE`].
    effects: Vec<(usize, &'a Effect)>,
    /// Per stream, width of the switching curve in units of the load at which it switches; empty switches hard.
    soft_widths: &'a [f64],
}

impl<'a> Chain<'a> {
    /// A chain with `effects` in any order: they act in the order of [`TACTILE`], the same kind in the order given.
    ///
    /// `soft_widths`: per stream, width of the switching curve in units of the load at which it switches; empty switches hard.
    pub fn new(
        thetas: impl Into<Thetas<'a>>,
        response: &'a Response,
        effects: impl IntoIterator<Item = &'a Effect>,
        soft_widths: &'a [f64],
    ) -> Self {
        let index = |effect: &Effect| TACTILE.iter().position(|kind| kind.id() == effect.id);
        let mut effects: Vec<(usize, &Effect)> =
            effects.into_iter().filter_map(|effect| Some((index(effect)?, effect))).collect();
        effects.sort_by_key(|(kind, _)| *kind);
        Self { thetas: thetas.into(), response, effects, soft_widths }
    }

    /// Runs `scene` through the whole chain.
    pub fn sense(&self, scene: &TakeScene<'_>) -> Result<Sensed, ReplayError> {
        Ok(self.sense_contact(scene, &self.geometry(scene)?))
    }

    /// The costly first part: where everything is, and what touches. It depends on the kinematic effects only.
    pub fn geometry(&self, scene: &TakeScene<'_>) -> Result<Geometry, ReplayError> {
        self.geometry_of(scene, None, &vec![true; scene.station.layout.patches.len()])
    }

    /// [`Self::geometry`] of the patches in `wanted`; all others feel nothing, for no frame. `measured` may have poses of links
    /// along [`TakeScene::positions`], which then need not be computed for joints that are where they were measured.
    pub fn geometry_of(
        &self,
        scene: &TakeScene<'_>,
        measured: Option<&LinkPoses>,
        wanted: &[bool],
    ) -> Result<Geometry, ReplayError> {
        let robot = &scene.station.robot;
        let kinematics = self.kinematics(scene);
        let moved = moved(&scene.station.layout, &kinematics.patch_offsets);
        let layout = moved.as_ref().unwrap_or(&scene.station.layout);
        let shape = scene.object.shape.scaled(kinematics.object_scale);
        let distance = SignedDistance::new(&shape).map_err(ReplayError::Object)?;
        let known =
            measured.map(|poses| KnownPoses::new(robot, poses, scene.positions, &kinematics.positions));
        let trace = trace_of(
            robot,
            layout,
            self.gaps_below_m(layout),
            &Bodies {
                object: &distance,
                base_from_object: &kinematics.base_from_object,
                surroundings: scene.surroundings,
            },
            &kinematics.positions,
            known.as_ref(),
            wanted,
        )?;
        let joints = match kinematics.positions {
            Cow::Borrowed(_) => None,
            Cow::Owned(positions) => Some(positions),
        };
        Ok(Geometry { trace, moved, joints, made: Some(Made::default()) })
    }

    /// The nearest nodes of a soft pad that are below this, m, matter together with their neighbours
    /// ([`Response::pad_softness_m`]): with room for what effects add to distances, in coarse steps, so that a geometry
    /// serves many models. Nothing is below it where pads are hard.
    pub fn gaps_below_m(&self, layout: &TactileLayout) -> f64 {
        let softness_m = self.response.pad_softness_m;
        if softness_m == 0.0 {
            return f64::NEG_INFINITY;
        }
        let nodes = layout.patches.iter().map(|patch| patch.nodes.len()).max().unwrap_or(1);
        let farthest_m = self.reaches_m(layout).into_iter().fold(f64::NEG_INFINITY, f64::max);
        let felt_below_m = farthest_m + softness_m * (nodes as f64).ln();
        GAPS_STEP_M * ((felt_below_m / GAPS_STEP_M).floor() + 2.0)
    }

    /// Where joints, object and patches really are.
    pub(crate) fn kinematics<'s>(&self, scene: &TakeScene<'s>) -> Kinematics<'s> {
        let mut kinematics = Kinematics {
            positions: Cow::Borrowed(scene.positions),
            base_from_object: scene.base_from_object.clone(),
            object_scale: 1.0,
            patch_offsets: vec![Isometry3::identity(); scene.station.layout.patches.len()],
        };
        self.each(|kind, effect| kind.kinematics(effect, scene, &mut kinematics));
        kinematics
    }

    /// The rest of the chain.
    pub fn sense_contact(&self, scene: &TakeScene<'_>, geometry: &Geometry) -> Sensed {
        let (num_frames, num_channels) = (scene.frame_times_s.len(), scene.station.layout.num_channels());
        let arrived = self.arrive(scene, geometry, &vec![true; num_channels]);
        let switching = self.switching(scene);
        // Channels are independent: each is a unit of work.
        let by_channel = map_chunks(num_channels, |channel| {
            let arrived = arrived[channel].as_ref()?;
            let activation = switching.activation(channel, arrived, scene.frame_times_s, None);
            Some((arrived.load().into_owned(), activation))
        });
        let mut sensed = Sensed {
            num_frames,
            num_channels,
            load: vec![0.0; num_frames * num_channels],
            activation: vec![0.0; num_frames * num_channels],
        };
        for (channel, of_channel) in by_channel.into_iter().enumerate() {
            let Some((load, activation)) = of_channel else { continue };
            for (frame, (load, activation)) in load.into_iter().zip(activation).enumerate() {
                sensed.load[frame * num_channels + channel] = load;
                sensed.activation[frame * num_channels + channel] = activation;
            }
        }
        sensed
    }

    /// Which channels those in `wanted` depend on, themselves among them.
    pub fn inputs(&self, station: &Station, wanted: &[bool]) -> Vec<bool> {
        let mut needed = wanted.to_vec();
        // Each effect may want what another one mixes in.
        loop {
            let before = needed.clone();
            self.each(|kind, effect| {
                if kind.mixes_channels() && reaches(effect, station, &needed) {
                    let mixed = places::channels_of(&effect.place, &station.layout);
                    mixed.into_iter().for_each(|channel| needed[channel] = true);
                }
            });
            if needed == before {
                return needed;
            }
        }
    }

    /// What arrives of the loads of the channels in `wanted`, `None` for all others. `geometry` must hold the patches of
    /// their [`Self::inputs`].
    pub fn arrive(
        &self,
        scene: &TakeScene<'_>,
        geometry: &Geometry,
        wanted: &[bool],
    ) -> Vec<Option<Arrived>> {
        let nominal = &scene.station.layout;
        let needed = self.inputs(scene.station, wanted);
        let needed_patches: Vec<bool> =
            nominal.patches.iter().map(|patch| needed[patch.channels.clone()].contains(&true)).collect();
        let mut contact = Contact {
            trace: self.softened(geometry, &needed_patches),
            needed: &needed_patches,
            layout: geometry.moved.as_ref().unwrap_or(nominal),
            alpha_per_m: self.thetas.alphas_per_m(nominal),
            positions: geometry.joints.as_deref().unwrap_or(scene.positions),
            touches: geometry.made.as_ref().map(|made| &made.touches),
        };
        let reaching: Vec<bool> =
            self.effects.iter().map(|(_, effect)| reaches(effect, scene.station, &needed)).collect();
        self.each_of(|idx| reaching[idx], |kind, effect| kind.contact(effect, scene, &mut contact));
        let mut load = Load::new(
            &contact,
            geometry,
            &self.reaches_m(nominal),
            needed.clone(),
            self.on_loads(nominal),
            scene.frame_times_s.len(),
        );
        self.each_of(
            |idx| reaching[idx],
            |kind, effect| {
                if !kind.acts_on_forces() {
                    load.take_as_loads();
                }
                kind.load(effect, scene, &mut load);
            },
        );
        load.take_as_loads();

        let device_times_s = |(idx, stream): (usize, &Stream)| {
            if !wanted[stream.channels.clone()].contains(&true) {
                return Vec::new();
            }
            scene.arrival_times_s.get(idx).map_or(scene.frame_times_s, |times_s| times_s).to_vec()
        };
        let mut transport = Transport {
            device_times_s: nominal.streams.iter().enumerate().map(device_times_s).collect(),
            holds: vec![None; nominal.streams.len()],
        };
        self.each(|kind, effect| kind.transport(effect, scene, &mut transport));
        let soft = self.soft_widths.iter().any(|width| *width > 0.0);
        if !soft {
            transport.freeze();
        }
        let moments: Vec<(Moments, Vec<Moments>)> = (0..nominal.streams.len())
            .map(|stream| {
                let past = if soft { transport.past(stream) } else { Vec::new() };
                let at = |times_s: &Vec<f64>| Moments::new(scene.frame_times_s, times_s);
                (at(&transport.device_times_s[stream]), past.iter().map(at).collect())
            })
            .collect();
        map_chunks(nominal.num_channels(), |channel| {
            let stream = nominal.channels[channel].stream;
            wanted[channel].then(|| {
                let (present, past) = &moments[stream];
                let is_silent = load.is_silent(channel);
                let load = load.of_channel(channel);
                // Nothing is nothing at any moment.
                let at = |moments: &Moments| if is_silent { Arc::clone(load) } else { moments.of(load) };
                Arrived {
                    present: at(present),
                    past: past.iter().map(at).collect(),
                    is_silent,
                    past_share: transport.holds[stream].as_ref().map_or(0.0, |hold| hold.fraction),
                }
            })
        })
    }

    /// The trace of `geometry` as soft pads feel it.
    fn softened<'t>(&self, geometry: &'t Geometry, needed: &[bool]) -> Cow<'t, ContactTrace> {
        let softness_m = self.response.pad_softness_m;
        let trace = &geometry.trace;
        let mut softened = Cow::Borrowed(trace);
        if softness_m == 0.0 {
            return softened;
        }
        let soft = map_chunks(trace.patches.len(), |idx| match &*trace.patches[idx] {
            PatchTrace::Proximity { min_distance_m, gaps } if needed[idx] => {
                let soft = || {
                    let min_distance_m = gaps.soft_distances_m(min_distance_m, softness_m);
                    Arc::new(PatchTrace::Proximity { min_distance_m, gaps: Gaps::default() })
                };
                Some(match &geometry.made {
                    Some(made) => made.softened.of(idx, softness_m, soft),
                    None => soft(),
                })
            }
            _ => None,
        });
        for (idx, soft) in soft.into_iter().enumerate() {
            if let Some(soft) = soft {
                softened.to_mut().patches[idx] = soft;
            }
        }
        softened
    }

    /// How the loads of channels become events.
    pub fn switching(&self, scene: &TakeScene<'_>) -> Switching {
        let nominal = &scene.station.layout;
        let on_loads = self.on_loads(nominal);
        let of_stream = |of: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
            nominal.channels.iter().enumerate().map(|(idx, channel)| of(idx, channel.stream)).collect()
        };
        let mut switching = Switching {
            off_fractions: of_stream(&|_, stream| self.response.off_fraction(&nominal.streams[stream].id)),
            min_on_s: vec![0.0; on_loads.len()],
            idle_activation: vec![0.0; on_loads.len()],
            passed_shares: vec![1.0; on_loads.len()],
            widths: of_stream(&|channel, stream| {
                self.soft_widths.get(stream).map_or(0.0, |width| width * on_loads[channel])
            }),
            on_loads,
        };
        self.each(|kind, effect| kind.switching(effect, scene, &mut switching));
        switching
    }

    /// Per channel, the load at which it switches on without effects.
    fn on_loads(&self, layout: &TactileLayout) -> Vec<f64> {
        let on_load = |stream: &Stream| {
            let theta = self.thetas.of(&stream.id);
            self.response.on_load(stream.kind, &theta)
        };
        let of_streams: Vec<f64> = layout.streams.iter().map(on_load).collect();
        layout.channels.iter().map(|channel| of_streams[channel.stream]).collect()
    }

    /// Per patch, signed distance at which its sensors begin to read, m ([`Response::reach_m`]).
    fn reaches_m(&self, layout: &TactileLayout) -> Vec<f64> {
        let thetas = self.thetas.by_stream(layout);
        layout.patches.iter().map(|patch| self.response.reach_m(&thetas[patch.stream])).collect()
    }

    fn each(&self, visit: impl FnMut(&dyn EffectKind, &Effect)) {
        self.each_of(|_| true, visit);
    }

    /// Calls `visit` with each effect, numbered in the order in which they act, that `acts`.
    fn each_of(&self, acts: impl Fn(usize) -> bool, mut visit: impl FnMut(&dyn EffectKind, &Effect)) {
        for (idx, (kind, effect)) in self.effects.iter().enumerate() {
            if acts(idx) {
                visit(TACTILE[*kind], effect);
            }
        }
    }
}

/// Whether `effect` acts on one of the `channels` beyond their kinematics.
fn reaches(effect: &Effect, station: &Station, channels: &[bool]) -> bool {
    places::channels_of(&effect.place, &station.layout).iter().any(|&channel| channels[channel])
}

/// What touches what, given where everything really is.
#[derive(Clone, Debug)]
pub struct Geometry {
    pub(crate) trace: ContactTrace,
    /// The layout, where any of its patches are moved.
    pub(crate) moved: Option<TactileLayout>,
    /// True joint positions, where they are not those that were measured.
    pub(crate) joints: Option<Vec<f64>>,
    /// What has been made of the trace; `None` for one that grows.
    pub(crate) made: Option<Made>,
}

/// What touches one patch.
#[derive(Clone, Debug)]
pub struct PatchGeometry(Arc<PatchTrace>);

impl PatchGeometry {
    /// What it takes in memory, bytes.
    pub fn num_bytes(&self) -> usize {
        self.0.num_bytes()
    }
}

impl Geometry {
    /// Its patch `idx`.
    pub fn patch(&self, idx: usize) -> PatchGeometry {
        PatchGeometry(Arc::clone(&self.trace.patches[idx]))
    }

    /// Takes over `patches`, by index, from geometries of models that move them, and what they touch, in the same way.
    pub fn adopt<'p>(&mut self, patches: impl Iterator<Item = (usize, &'p PatchGeometry)>) {
        for (idx, PatchGeometry(trace)) in patches {
            self.trace.patches[idx] = Arc::clone(trace);
        }
        self.made = Some(Made::default());
    }

    /// Remembers what fingers feel of each other in `touches`, from geometries in which joints and patches are as they are here.
    pub fn share(&mut self, touches: &FingerTouches) {
        self.made.get_or_insert_default().touches = touches.clone();
    }
}

/// `layout` with the nodes and taxels of its patches moved; `None` where all stay.
pub(crate) fn moved(layout: &TactileLayout, offsets: &[Isometry3<f64>]) -> Option<TactileLayout> {
    let is_moved = |offset: &Isometry3<f64>| *offset != Isometry3::identity();
    if !offsets.iter().any(is_moved) {
        return None;
    }
    let mut layout = layout.clone();
    for (patch, offset) in layout.patches.iter_mut().zip(offsets).filter(|(_, offset)| is_moved(offset)) {
        for node in &mut patch.nodes {
            node.pos_in_link = offset * node.pos_in_link;
            node.normal_in_link = offset * node.normal_in_link;
        }
        for taxel in &mut patch.taxels_in_link {
            *taxel = offset * *taxel;
        }
    }
    Some(layout)
}

/// Steps of [`Chain::gaps_below_m`], m.
const GAPS_STEP_M: f64 = 4e-3;

/// Moments over the span of a [`Hold`] at which a soft chain looks.
const NUM_MOMENTS: usize = 6;

impl Transport {
    /// Freezes the streams that do, regularly.
    fn freeze(&mut self) {
        for (times_s, hold) in self.device_times_s.iter_mut().zip(&self.holds) {
            let (Some(hold), Some(&start_s)) = (hold, times_s.first()) else { continue };
            if !hold.seen_for_s.is_empty() {
                times_s.iter_mut().zip(&hold.seen_for_s).for_each(|(time_s, age_s)| *time_s -= age_s);
                continue;
            }
            let period_s = hold.span_s / hold.fraction;
            for time_s in times_s {
                let into_period_s = (*time_s - start_s).rem_euclid(period_s);
                *time_s -= (into_period_s - (period_s - hold.span_s)).max(0.0);
            }
        }
    }

    /// The times that `stream` may show instead of the present where it is frozen, equally likely; none if it never is.
    fn past(&self, stream: usize) -> Vec<Vec<f64>> {
        let Some(hold) = &self.holds[stream] else { return Vec::new() };
        let num_moments = if hold.seen_for_s.is_empty() { NUM_MOMENTS } else { 1 };
        (0..num_moments)
            .map(|moment| {
                let share = (moment as f64 + 0.5) / num_moments as f64;
                let times_s = self.device_times_s[stream].iter().enumerate();
                times_s
                    .map(|(frame, time_s)| {
                        time_s - hold.seen_for_s.get(frame).copied().unwrap_or(share * hold.span_s)
                    })
                    .collect()
            })
            .collect()
    }
}

impl Arrived {
    /// Load as the host sees it: the mean over the present and the past.
    pub fn load(&self) -> Cow<'_, [f64]> {
        let mut load = Cow::Borrowed(&self.present[..]);
        if !self.past.is_empty() {
            let past: Vec<&[f64]> = self.past.iter().map(|past| &**past).collect();
            self.blend(load.to_mut(), &past);
        }
        load
    }

    fn blend(&self, present: &mut [f64], past: &[&[f64]]) {
        for (frame, value) in present.iter_mut().enumerate() {
            let sum: f64 = past.iter().map(|values| values[frame]).sum();
            *value = (1.0 - self.past_share) * *value + self.past_share / past.len() as f64 * sum;
        }
    }
}
