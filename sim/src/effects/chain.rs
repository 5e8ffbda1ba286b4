//! Runs a take through the sensing chain, with any set of effects.

use std::borrow::Cow;

use nalgebra::Isometry3;
use palpate_robot_model::{ObjectModel, SensorKind, Station, TactileLayout};

use super::{Effect, EffectKind, TACTILE};
use crate::geometry::SignedDistance;
use crate::parallel::map_chunks;
use crate::replay::{ContactTrace, PatchTrace, ReplayError, contact_trace};
use crate::tactile::propagate_patches;
use crate::{Response, Theta};

/// What was recorded of a take, as far as the simulation of its touch needs it.
#[derive(Clone, Copy, Debug)]
pub struct TakeScene<'a> {
    /// Robot, layout and objects.
    pub station: &'a Station,
    /// The object that is touched.
    pub object: &'a ObjectModel,
    /// Where it is said to be.
    pub base_from_object: &'a Isometry3<f64>,
    /// Host time of each joint frame since the take's start, s.
    pub frame_times_s: &'a [f64],
    /// Measured joint positions, `num_frames x num_dofs`, row-major, rad or m.
    pub positions: &'a [f64],
    /// Per stream, host time at which the reading in effect at each frame had arrived, s; empty: at the frame itself.
    pub arrival_times_s: &'a [Vec<f64>],
    /// Per stream, for how long the reading in effect at each frame had been repeated to the bit when it arrived, s; 0
    /// for one that is new. Empty where nobody can tell.
    pub frozen_for_s: &'a [Vec<f64>],
}

/// Where joints, object and patches really are.
#[derive(Clone, Debug)]
pub struct Kinematics {
    /// True joint positions, as in [`TakeScene::positions`].
    pub positions: Vec<f64>,
    /// True pose of the object.
    pub base_from_object: Isometry3<f64>,
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
    /// Nodes and taxels, with mounting errors.
    pub layout: &'a TactileLayout,
    /// Per patch, decay of pressure along the elastomer, 1/m.
    pub alpha_per_m: Vec<f64>,
    /// True joint positions, as in [`Kinematics::positions`].
    pub positions: &'a [f64],
}

/// Load of every channel over time, as its sensor reports it.
#[derive(Clone, Debug)]
pub struct Load {
    /// Number of channels.
    pub num_channels: usize,
    /// Time of each frame, s.
    pub times_s: Vec<f64>,
    /// `[frame * num_channels + channel]`; pressure in Pa, or for proximity channels how far the patch has come into
    /// the sensor's reach ([`Response::reach_m`]) in m. Zero without touch.
    pub values: Vec<f64>,
    /// Per channel, the load at which it switches on. Effects size additive errors by it.
    pub on_loads: Vec<f64>,
}

/// How load becomes an event.
#[derive(Clone, Debug)]
pub struct Switching {
    /// Per channel, the load at which it switches on; `INFINITY` for one that never does, `NEG_INFINITY` always.
    pub on_loads: Vec<f64>,
    /// Per channel, the load below which it switches off, over `on_loads`; 1 without hysteresis.
    pub off_fractions: Vec<f64>,
    /// Per channel, how long a load must be above `on_loads` before the event is reported, s.
    pub min_on_s: Vec<f64>,
    /// Per channel, activation that is there without any load, 0..=1, such as of a value that wraps around zero. A
    /// channel that switches hard is on in that share of frames.
    pub idle_activation: Vec<f64>,
    /// Per channel, the share of its activation that is passed on, 0..=1: 0 for a dead channel.
    pub passed_shares: Vec<f64>,
    /// Per channel, width of the switching curve in units of load; 0 switches hard. At the lower threshold the curve is
    /// narrower as far as the threshold is lower, so that no touch leaves a rest of activation without any load.
    pub widths: Vec<f64>,
}

/// Which moment each reading shows.
#[derive(Clone, Debug)]
pub struct Transport {
    /// Per stream and frame, the time (on the joints' clock, s) at which the reading in effect was sampled.
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

/// Readings of every channel at the frames of a take.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensed {
    /// Number of frames.
    pub num_frames: usize,
    /// Number of channels.
    pub num_channels: usize,
    /// As [`Load::values`], at the moments that the host sees.
    pub load: Vec<f64>,
    /// Activation, 0 or 1; in between where [`Switching::widths`] are not zero, and for an effect that is there in part.
    /// Same indexing.
    pub activation: Vec<f64>,
}

/// A sensor model with effects, ready to run takes through.
#[derive(Clone, Debug)]
pub struct Chain<'a> {
    /// The paper's parameters.
    pub theta: Theta,
    /// What the model knows of sensors beyond theta.
    pub response: &'a Response,
    /// Effects, in any order: they act in the order of [`TACTILE`], the same kind in the order given.
    pub effects: &'a [Effect],
    /// Per stream, width of the switching curve in units of the load at which it switches; empty switches hard.
    pub soft_widths: &'a [f64],
}

impl Chain<'_> {
    /// Runs `scene` through the whole chain.
    pub fn sense(&self, scene: &TakeScene<'_>) -> Result<Sensed, ReplayError> {
        Ok(self.sense_contact(scene, &self.geometry(scene)?))
    }

    /// The costly first part: where everything is, and what touches. It depends on the kinematic effects only.
    pub fn geometry(&self, scene: &TakeScene<'_>) -> Result<Geometry, ReplayError> {
        let kinematics = self.kinematics(scene);
        let layout = moved(&scene.station.layout, &kinematics.patch_offsets);
        let shape = scene.object.shape.scaled(kinematics.object_scale);
        let distance = SignedDistance::new(&shape).map_err(ReplayError::Object)?;
        let trace = contact_trace(
            &scene.station.robot,
            &layout,
            &distance,
            &kinematics.base_from_object,
            &kinematics.positions,
        )?;
        Ok(Geometry { trace, layout, positions: kinematics.positions })
    }

    /// Where joints, object and patches really are.
    pub(crate) fn kinematics(&self, scene: &TakeScene<'_>) -> Kinematics {
        let mut kinematics = Kinematics {
            positions: scene.positions.to_vec(),
            base_from_object: *scene.base_from_object,
            object_scale: 1.0,
            patch_offsets: vec![Isometry3::identity(); scene.station.layout.patches.len()],
        };
        self.each(|kind, effect| kind.kinematics(effect, scene, &mut kinematics));
        kinematics
    }

    /// The rest of the chain.
    pub fn sense_contact(&self, scene: &TakeScene<'_>, geometry: &Geometry) -> Sensed {
        let nominal = &scene.station.layout;
        let mut contact = Contact {
            trace: Cow::Borrowed(&geometry.trace),
            layout: &geometry.layout,
            alpha_per_m: vec![self.theta.alpha_per_m; nominal.patches.len()],
            positions: &geometry.positions,
        };
        self.each(|kind, effect| kind.contact(effect, scene, &mut contact));

        let on_loads: Vec<f64> = nominal
            .channels
            .iter()
            .map(|channel| match nominal.streams[channel.stream].kind {
                // As far as the reach is from the threshold, and not the band itself, so that rounding is the same.
                SensorKind::Proximity => self.response.reach_m(&self.theta) - self.theta.lambda_con_m,
                SensorKind::Pressure => self.theta.lambda_pre_pa,
            })
            .collect();
        let mut load = Load {
            num_channels: nominal.num_channels(),
            times_s: scene.frame_times_s.to_vec(),
            values: loads(&contact, self.response.reach_m(&self.theta)),
            on_loads: on_loads.clone(),
        };
        self.each(|kind, effect| kind.load(effect, scene, &mut load));

        let mut transport = Transport {
            device_times_s: (0..nominal.streams.len())
                .map(|stream| {
                    scene.arrival_times_s.get(stream).map_or_else(|| scene.frame_times_s.to_vec(), Vec::clone)
                })
                .collect(),
            holds: vec![None; nominal.streams.len()],
        };
        self.each(|kind, effect| kind.transport(effect, scene, &mut transport));

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

        let soft = self.soft_widths.iter().any(|width| *width > 0.0);
        if !soft {
            transport.freeze();
        }
        let present = arrive(&load, &transport, nominal);
        let activation = switching.activations(&present, scene.frame_times_s);
        let mut sensed = Sensed {
            num_frames: scene.frame_times_s.len(),
            num_channels: nominal.num_channels(),
            load: present,
            activation,
        };
        if soft && transport.holds.iter().any(Option::is_some) {
            let past = transport.past().map(|transport| {
                let loads = arrive(&load, &transport, nominal);
                let activations = switching.activations(&loads, scene.frame_times_s);
                (loads, activations)
            });
            sensed.blend(&transport.holds, &past.collect::<Vec<_>>(), nominal);
        }
        sensed
    }

    fn each(&self, mut visit: impl FnMut(&dyn EffectKind, &Effect)) {
        if self.effects.is_empty() {
            return;
        }
        for kind in TACTILE {
            for effect in self.effects.iter().filter(|effect| effect.id == kind.id()) {
                visit(*kind, effect);
            }
        }
    }
}

/// What touches what, given where everything really is.
#[derive(Clone, Debug)]
pub struct Geometry {
    pub(crate) trace: ContactTrace,
    pub(crate) layout: TactileLayout,
    pub(crate) positions: Vec<f64>,
}

/// `layout` with the nodes and taxels of its patches moved.
pub(crate) fn moved(layout: &TactileLayout, offsets: &[Isometry3<f64>]) -> TactileLayout {
    let mut layout = layout.clone();
    for (patch, offset) in layout.patches.iter_mut().zip(offsets) {
        if *offset == Isometry3::identity() {
            continue;
        }
        for node in &mut patch.nodes {
            node.pos_in_link = offset * node.pos_in_link;
            node.normal_in_link = offset * node.normal_in_link;
        }
        for taxel in &mut patch.taxels_in_link {
            *taxel = offset * *taxel;
        }
    }
    layout
}

/// As [`Load::values`].
fn loads(contact: &Contact<'_>, reach_m: f64) -> Vec<f64> {
    let mut values = propagate_patches(contact.layout, &contact.trace, &contact.alpha_per_m);
    let num_channels = contact.layout.num_channels();
    for (patch, trace) in contact.layout.patches.iter().zip(&contact.trace.patches) {
        if let PatchTrace::Proximity { .. } = trace {
            for frame in values.chunks_exact_mut(num_channels) {
                for value in &mut frame[patch.channels.clone()] {
                    *value = (reach_m - *value).max(0.0);
                }
            }
        }
    }
    values
}

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

    /// The moments that frozen streams may show instead of the present, equally likely.
    fn past(&self) -> impl Iterator<Item = Self> + '_ {
        let all_seen = self.holds.iter().flatten().all(|hold| !hold.seen_for_s.is_empty());
        let num_moments = if all_seen { 1 } else { NUM_MOMENTS };
        (0..num_moments).map(move |moment| {
            let mut past = self.clone();
            let share = (moment as f64 + 0.5) / num_moments as f64;
            for (times_s, hold) in past.device_times_s.iter_mut().zip(&self.holds) {
                let Some(hold) = hold else { continue };
                for (frame, time_s) in times_s.iter_mut().enumerate() {
                    *time_s -= hold.seen_for_s.get(frame).copied().unwrap_or(share * hold.span_s);
                }
            }
            past
        })
    }
}

impl Sensed {
    /// The mean over what frozen streams may show: `past` holds the loads and activations of equally likely moments.
    fn blend(&mut self, holds: &[Option<Hold>], past: &[(Vec<f64>, Vec<f64>)], layout: &TactileLayout) {
        for (stream, hold) in layout.streams.iter().zip(holds) {
            let Some(hold) = hold else { continue };
            let mean = |present: f64, sum: f64| {
                (1.0 - hold.fraction) * present + hold.fraction / past.len() as f64 * sum
            };
            for at in (0..self.num_frames).flat_map(|frame| {
                stream.channels.clone().map(move |channel| frame * layout.num_channels() + channel)
            }) {
                self.load[at] = mean(self.load[at], past.iter().map(|(loads, _)| loads[at]).sum());
                let active = mean(self.activation[at], past.iter().map(|(_, active)| active[at]).sum());
                self.activation[at] = active.clamp(0.0, 1.0);
            }
        }
    }
}

impl Load {
    /// Loads of `channel`, frame by frame.
    pub fn of_channel(&self, channel: usize) -> impl Iterator<Item = f64> + '_ {
        self.values.iter().skip(channel).step_by(self.num_channels.max(1)).copied()
    }

    /// As [`Self::of_channel`], to change them.
    pub fn of_channel_mut(&mut self, channel: usize) -> impl Iterator<Item = &mut f64> {
        self.values.iter_mut().skip(channel).step_by(self.num_channels.max(1))
    }

    /// Loads of all channels, frame by frame, to change them.
    pub fn frames_mut(&mut self) -> impl Iterator<Item = &mut [f64]> {
        self.values.chunks_exact_mut(self.num_channels.max(1))
    }
}

/// Loads at the moments that the host sees: linear between frames, held before the first and after the last.
fn arrive(load: &Load, transport: &Transport, layout: &TactileLayout) -> Vec<f64> {
    let num_frames = load.times_s.len();
    let num_channels = load.num_channels;
    let mut seen = load.values.clone();
    for (stream, times_s) in layout.streams.iter().zip(&transport.device_times_s) {
        if times_s == &load.times_s {
            continue;
        }
        let mut after = 0;
        for (frame, &time_s) in times_s.iter().enumerate() {
            // Times nearly increase: walk, in either direction.
            while after < num_frames && load.times_s[after] <= time_s {
                after += 1;
            }
            while after > 0 && load.times_s[after - 1] > time_s {
                after -= 1;
            }
            let (from, to) = (after.saturating_sub(1), after.min(num_frames - 1));
            let gap_s = load.times_s[to] - load.times_s[from];
            let share = if gap_s > 0.0 { (time_s - load.times_s[from]) / gap_s } else { 0.0 };
            for channel in stream.channels.clone() {
                let (low, high) =
                    (load.values[from * num_channels + channel], load.values[to * num_channels + channel]);
                seen[frame * num_channels + channel] = low + share * (high - low);
            }
        }
    }
    seen
}

impl Switching {
    /// Activations of `loads` (frame-major) at frames `times_s`.
    ///
    /// A soft latch: an event that is on stays on as far as the load is above the lower threshold. Where it switches
    /// hard this is the latch of a comparator with hysteresis.
    pub fn activations(&self, loads: &[f64], times_s: &[f64]) -> Vec<f64> {
        let num_channels = self.on_loads.len();
        if num_channels == 0 {
            return Vec::new();
        }
        // Channels are independent: each is a unit of work.
        let by_channel = map_chunks(num_channels, |channel| self.channel(channel, loads, times_s));
        let mut activations = vec![0.0; loads.len()];
        for (channel, values) in by_channel.iter().enumerate() {
            for (frame, value) in values.iter().enumerate() {
                activations[frame * num_channels + channel] = *value;
            }
        }
        activations
    }

    fn channel(&self, channel: usize, loads: &[f64], times_s: &[f64]) -> Vec<f64> {
        let num_channels = self.on_loads.len();
        let (on, width, idle) = (self.on_loads[channel], self.widths[channel], self.idle_activation[channel]);
        let off = on * self.off_fractions[channel];
        let above = |load: f64, threshold: f64, width: f64| {
            if width > 0.0 && threshold.is_finite() {
                1.0 / (1.0 + (-(load - threshold) / width).exp())
            } else {
                f64::from(u8::from(load > threshold))
            }
        };
        let off_width = width * self.off_fractions[channel];
        let passed = self.passed_shares[channel];
        let mut latched = 0.0_f64;
        let mut last = (f64::NAN, 0.0, 0.0);
        let mut values: Vec<f64> = times_s
            .iter()
            .enumerate()
            .map(|(frame, _)| {
                let load = loads[frame * num_channels + channel];
                // Quiet channels stay where they are, and are most of the work.
                if load != last.0 {
                    let over_on = above(load, on, width);
                    last = (load, over_on, if off == on { over_on } else { above(load, off, off_width) });
                }
                let (_, over_on, over_off) = last;
                latched = over_on.max(latched.min(over_off));
                let idle = if width > 0.0 || idle >= 1.0 { idle } else { drawn(frame, channel, idle) };
                passed * latched.max(idle)
            })
            .collect();
        let min_on_s = self.min_on_s[channel];
        if min_on_s > 0.0 {
            debounce(&mut values, times_s, min_on_s);
        }
        values
    }
}

/// One draw for a frame of a channel that is on with `probability`: always the same, and without any pattern over
/// frames (the finaliser of SplitMix64, Steele et al., "Fast Splittable Pseudorandom Number Generators", 2014).
fn drawn(frame: usize, channel: usize, probability: f64) -> f64 {
    if probability <= 0.0 {
        return 0.0;
    }
    let mut bits =
        ((channel as u64) << 32 | frame as u64).wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    let uniform = ((bits ^ (bits >> 31)) >> 11) as f64 / (1_u64 << 53) as f64;
    f64::from(u8::from(uniform < probability))
}

/// Reports an activation only once it has lasted `min_on_s`: the smallest over that time back, frames being held until
/// the next one.
fn debounce(values: &mut [f64], times_s: &[f64], min_on_s: f64) {
    let raw = values.to_vec();
    for frame in 0..raw.len() {
        let since_s = times_s[frame] - min_on_s;
        let mut first = frame;
        while first > 0 && times_s[first] > since_s {
            first -= 1;
        }
        let mut smallest = raw[first + 1..=frame].iter().copied().fold(raw[frame], f64::min);
        if first < frame {
            // Linear between frames, so that a delay of part of a frame counts in part.
            let share = (since_s - times_s[first]) / (times_s[first + 1] - times_s[first]);
            let at_start = raw[first] + share.clamp(0.0, 1.0) * (raw[first + 1] - raw[first]);
            smallest = smallest.min(at_start);
        }
        values[frame] = smallest;
    }
}
