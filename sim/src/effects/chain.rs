//! Runs a take through the sensing chain, with any set of effects.

use nalgebra::Isometry3;
use palpate_robot_model::{ObjectModel, SensorKind, Station, TactileLayout};

use super::{Effect, EffectKind, tactile};
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
pub struct Contact {
    /// Distances and node pressures.
    pub trace: ContactTrace,
    /// Nodes and taxels, with mounting errors.
    pub layout: TactileLayout,
    /// Per patch, decay of pressure along the elastomer, 1/m.
    pub alpha_per_m: Vec<f64>,
    /// True joint positions, as in [`Kinematics::positions`].
    pub positions: Vec<f64>,
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
    /// Per channel, activation that is there without any load, 0..=1, such as of a value that wraps around zero.
    pub idle_activation: Vec<f64>,
    /// Per channel, width of the switching curve in units of load; 0 switches hard.
    pub widths: Vec<f64>,
}

/// Which moment each reading shows.
#[derive(Clone, Debug)]
pub struct Transport {
    /// Per stream and frame, the time (on the joints' clock, s) at which the reading in effect was sampled.
    pub device_times_s: Vec<Vec<f64>>,
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
    /// Activation, 0 or 1; in between where [`Switching::widths`] are not zero. Same indexing.
    pub activation: Vec<f64>,
}

/// A sensor model with effects, ready to run takes through.
#[derive(Clone, Debug)]
pub struct Chain<'a> {
    /// The paper's parameters.
    pub theta: Theta,
    /// What the model knows of sensors beyond theta.
    pub response: &'a Response,
    /// Effects, in any order: each acts in its stage, within a stage in the order given.
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
        let mut kinematics = Kinematics {
            positions: scene.positions.to_vec(),
            base_from_object: *scene.base_from_object,
            object_scale: 1.0,
            patch_offsets: vec![Isometry3::identity(); scene.station.layout.patches.len()],
        };
        self.each(|kind, effect| kind.kinematics(effect, scene, &mut kinematics));
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

    /// The rest of the chain.
    pub fn sense_contact(&self, scene: &TakeScene<'_>, geometry: &Geometry) -> Sensed {
        let nominal = &scene.station.layout;
        let mut contact = Contact {
            trace: geometry.trace.clone(),
            layout: geometry.layout.clone(),
            alpha_per_m: vec![self.theta.alpha_per_m; nominal.patches.len()],
            positions: geometry.positions.clone(),
        };
        self.each(|kind, effect| kind.contact(effect, scene, &mut contact));

        let on_loads: Vec<f64> = nominal
            .channels
            .iter()
            .map(|channel| match nominal.streams[channel.stream].kind {
                SensorKind::Proximity => self.response.proximity_band_m,
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
        };
        self.each(|kind, effect| kind.transport(effect, scene, &mut transport));

        let of_stream = |of: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
            nominal.channels.iter().enumerate().map(|(idx, channel)| of(idx, channel.stream)).collect()
        };
        let mut switching = Switching {
            off_fractions: of_stream(&|_, stream| self.response.off_fraction(&nominal.streams[stream].id)),
            min_on_s: vec![0.0; on_loads.len()],
            idle_activation: vec![0.0; on_loads.len()],
            widths: of_stream(&|channel, stream| {
                self.soft_widths.get(stream).map_or(0.0, |width| width * on_loads[channel])
            }),
            on_loads,
        };
        self.each(|kind, effect| kind.switching(effect, scene, &mut switching));

        let load = arrive(&load, &transport, nominal);
        let activation = switching.activations(&load, scene.frame_times_s);
        Sensed {
            num_frames: scene.frame_times_s.len(),
            num_channels: nominal.num_channels(),
            load,
            activation,
        }
    }

    fn each(&self, mut visit: impl FnMut(&dyn EffectKind, &Effect)) {
        for effect in self.effects {
            if let Some(kind) = tactile(&effect.id) {
                visit(kind, effect);
            }
        }
    }
}

/// What touches what, given where everything really is.
#[derive(Clone, Debug)]
pub struct Geometry {
    trace: ContactTrace,
    layout: TactileLayout,
    positions: Vec<f64>,
}

/// `layout` with the nodes and taxels of its patches moved.
fn moved(layout: &TactileLayout, offsets: &[Isometry3<f64>]) -> TactileLayout {
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
fn loads(contact: &Contact, reach_m: f64) -> Vec<f64> {
    let mut values = propagate_patches(&contact.layout, &contact.trace, &contact.alpha_per_m);
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
        let above = |load: f64, threshold: f64| {
            if width > 0.0 && threshold.is_finite() {
                1.0 / (1.0 + (-(load - threshold) / width).exp())
            } else {
                f64::from(u8::from(load > threshold))
            }
        };
        let mut latched = 0.0_f64;
        let mut values: Vec<f64> = times_s
            .iter()
            .enumerate()
            .map(|(frame, _)| {
                let load = loads[frame * num_channels + channel];
                latched = above(load, on).max(latched.min(above(load, off)));
                latched.max(idle)
            })
            .collect();
        let min_on_s = self.min_on_s[channel];
        if min_on_s > 0.0 {
            debounce(&mut values, times_s, min_on_s);
        }
        values
    }
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
