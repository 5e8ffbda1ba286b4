//! The truth world: soft layers, sensors and electronics around a moving robot, stepped at 1 kHz.

mod cabling;
mod device;
mod elastomer;
mod front_end;
mod linkage;
mod resistance;
mod self_contact;
mod spans;
mod touch;

use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use palpate_robot_model::{JointKind, ObjectModel, Station};
use palpate_sim::geometry::SignedDistance;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::EmulationError;
use crate::noise::gaussian;
use crate::truth::Emulation;
use cabling::Cabling;
pub use device::Arrival;
use device::Device;
use elastomer::Layer;
use front_end::Sensors;
use linkage::Linkage;
pub use resistance::Resistance;
pub use touch::{TruthSense, TruthTouch};

/// Steps of the soft layers, s.
const STEP_S: f64 = 1e-3;
/// Steps between two evaluations of the geometry, which moves much less in that time.
const STEPS_PER_BLOCK: i64 = 5;
/// The devices are powered this long before a take starts.
const PRE_ROLL_BLOCKS: i64 = 240;
/// Joint positions are read in steps of one turn over this.
const ENCODER_STEPS_PER_TURN: f64 = 65_536.0;
/// Part of a take's noise that the phase of the mains comes from.
const HUM_PART: u64 = 0xffff;

/// The world behind the emulated sensors, for one take.
///
/// [`TruthWorld::advance`] moves it along a joint path; what its devices and encoders sent comes back in order of host
/// time.
pub struct TruthWorld {
    station: Arc<Station>,
    object: Option<Arc<Placed>>,
    /// What stands beside it.
    fixed: Vec<Placed>,
    layers: Vec<Layer>,
    sensors: Vec<Sensors>,
    /// Layers that press on each other.
    touching: Vec<(usize, usize)>,
    linkage: Linkage,
    cabling: Vec<Cabling>,
    devices: Vec<Device>,
    /// Measured less true position, per degree of freedom.
    joint_offsets: Vec<f64>,
    joint_noise: Vec<f64>,
    joint_steps: Vec<f64>,
    joint_rng: ChaCha8Rng,
    /// Blocks since the take's start; negative before.
    block: i64,
    num_joint_samples: u64,
    frames: Vec<Isometry3<f64>>,
    positions: Vec<f64>,
    analog_raw: Vec<f64>,
}

/// An object where it stands.
#[derive(Clone, Debug)]
pub struct Placed {
    surface: Arc<SignedDistance>,
    object_from_base: Isometry3<f64>,
}

impl Placed {
    /// `object` at `base_from_object`, of the size that it really has in the world of `emulation`.
    pub fn new(
        emulation: &Emulation,
        object: &ObjectModel,
        base_from_object: &Isometry3<f64>,
    ) -> Result<Self, EmulationError> {
        let scaled =
            emulation.secrets.object_scales.get(&object.id).map(|&factor| object.shape.scaled(factor));
        let surface = SignedDistance::new(scaled.as_ref().unwrap_or(&object.shape))
            .map_err(|problem| emulation.error(format!("object {:?}", object.id), problem))?;
        Ok(Self { surface: Arc::new(surface), object_from_base: base_from_object.inverse() })
    }

    /// The same object elsewhere.
    pub fn moved(&self, base_from_object: &Isometry3<f64>) -> Self {
        Self { surface: Arc::clone(&self.surface), object_from_base: base_from_object.inverse() }
    }
}

/// Something that reached the host.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// Measured joint positions.
    Joints {
        /// When, ns since the take's start.
        host_ns: i64,
        /// One for each degree of freedom, rad or m.
        positions: Vec<f64>,
    },
    /// A sample of a stream of the layout.
    Tactile {
        /// Index of the stream.
        stream: usize,
        /// What was read.
        sample: Arrival,
    },
}

impl Event {
    fn host_ns(&self) -> i64 {
        match self {
            Self::Joints { host_ns, .. } => *host_ns,
            Self::Tactile { sample, .. } => sample.host_ns,
        }
    }
}

impl TruthWorld {
    /// The world of `emulation` with `object` at `base_from_object`. `seed` and `take_idx` draw the noise; what differs
    /// between channels comes from the truth's own seed.
    pub fn new(
        emulation: &Emulation,
        object: &ObjectModel,
        base_from_object: &Isometry3<f64>,
        seed: u64,
        take_idx: u64,
    ) -> Result<Self, EmulationError> {
        let placed = Placed::new(emulation, object, base_from_object)?;
        let mut world = Self::empty(emulation, seed, take_idx)?;
        world.place(Some(Arc::new(placed)));
        Ok(world)
    }

    /// The same without an object.
    fn empty(emulation: &Emulation, seed: u64, take_idx: u64) -> Result<Self, EmulationError> {
        let station = Arc::clone(&emulation.station);
        let (truth, secrets) = (&emulation.truth, &emulation.secrets);
        let mut world_rng = ChaCha8Rng::seed_from_u64(truth.world_seed);
        let gains: Vec<f64> = station
            .layout
            .channels
            .iter()
            .zip(&secrets.channels)
            .map(|(channel, secret)| {
                let id = &station.layout.streams[channel.stream].id;
                let spread = truth
                    .streams
                    .iter()
                    .find(|stream| stream.id == *id)
                    .map_or(0.0, |s| s.sensitivity_spread);
                secret.gain * (spread * gaussian(&mut world_rng)).exp()
            })
            .collect();
        let mut layers = Vec::new();
        let mut sensors = Vec::new();
        for (patch, patch_secrets) in station.layout.patches.iter().zip(&secrets.patches) {
            let id = &station.layout.streams[patch.stream].id;
            let stream = truth
                .streams
                .iter()
                .find(|stream| stream.id == *id)
                .ok_or_else(|| emulation.error(format!("stream {id:?}"), "is missing"))?;
            let mut offset = Isometry3::identity();
            for mount in truth.mount_offsets.iter().filter(|mount| mount.patch == patch.id) {
                let [x, y, z] = mount.translation_m;
                let rotation = UnitQuaternion::new(Vector3::from(mount.rotation_rad));
                offset = Isometry3::from_parts(Translation3::new(x, y, z), rotation);
            }
            if let Some(mount) = patch_secrets.mount {
                offset = Isometry3::from_parts(
                    Translation3::from(offset.translation.vector + mount.translation.vector),
                    mount.rotation * offset.rotation,
                );
            }
            let hidden = &secrets.streams[patch.stream];
            let elastomer = stream.elastomer.with(hidden, patch_secrets);
            let layer = Layer::new(patch, &elastomer, &offset, STEP_S)
                .map_err(|problem| emulation.error(format!("stream {id:?}"), problem))?
                .with(patch_secrets.gap_m, hidden.viscous_s);
            let patch_gains = gains[patch.channels.clone()].to_vec();
            sensors.push(Sensors::new(
                patch,
                &layer,
                &elastomer,
                stream.front_end.slower_by(hidden.low_pass_s),
                &offset,
                patch_gains,
            ));
            layers.push(layer);
        }
        let mut noise_rng = ChaCha8Rng::seed_from_u64(seed);
        let mut next_rng = |part: u64| {
            noise_rng.set_stream((take_idx << 16) + part);
            noise_rng.clone()
        };
        let joint_rng = next_rng(0);
        let power_up_s = -((PRE_ROLL_BLOCKS * STEPS_PER_BLOCK) as f64) * STEP_S;
        let mut devices = Vec::new();
        for (stream_idx, stream) in station.layout.streams.iter().enumerate() {
            let Some(stream_truth) = truth.streams.iter().find(|truth| truth.id == stream.id) else {
                continue;
            };
            devices.push(Device::new(
                station.streams[stream_idx].clone(),
                stream_truth.clone(),
                stream.rate_hz,
                &secrets.channels[stream.channels.clone()],
                &secrets.streams[stream_idx],
                power_up_s,
                next_rng(1 + stream_idx as u64),
            ));
        }
        let cabling = (0..station.layout.streams.len())
            .map(|stream_idx| {
                let patches = station.layout.patches.iter().zip(&sensors);
                let rest_raw: Vec<f64> = patches
                    .filter(|(patch, _)| patch.stream == stream_idx)
                    .flat_map(|(_, sensors): (_, &Sensors)| sensors.analog_raw.iter().copied())
                    .collect();
                let hum_phase = next_rng(HUM_PART).random::<f64>();
                Cabling::new(&station, secrets, stream_idx, &rest_raw, hum_phase)
            })
            .collect();
        let joints: Vec<_> = station.robot.dofs().collect();
        let revolute = |joint: &palpate_robot_model::Joint| joint.kind == JointKind::Revolute;
        Ok(Self {
            object: None,
            fixed: Vec::new(),
            layers,
            sensors,
            touching: self_contact::pairs(&station.layout, &secrets.touching),
            linkage: Linkage::new(secrets.play.clone()),
            cabling,
            devices,
            joint_offsets: joints
                .iter()
                .zip(&secrets.joint_offsets)
                .map(|(j, hidden)| truth.joints.offset.get(&j.name).copied().unwrap_or(0.0) + hidden)
                .collect(),
            joint_noise: joints
                .iter()
                .map(|joint| if revolute(joint) { truth.joints.noise_rad } else { truth.joints.noise_m })
                .collect(),
            joint_steps: joints
                .iter()
                .map(
                    |joint| {
                        if revolute(joint) { std::f64::consts::TAU / ENCODER_STEPS_PER_TURN } else { 1e-6 }
                    },
                )
                .collect(),
            joint_rng,
            block: -PRE_ROLL_BLOCKS,
            num_joint_samples: 0,
            frames: Vec::new(),
            positions: vec![0.0; joints.len()],
            analog_raw: Vec::new(),
            station,
        })
    }

    /// Puts another object in the place of the present one, or none.
    pub fn place(&mut self, object: Option<Arc<Placed>>) {
        self.object = object;
    }

    /// What the object does to every joint, as of the last block.
    pub fn resistances(&self, of_dof: &mut Vec<Resistance>) {
        of_dof.clear();
        of_dof.resize(self.station.robot.num_dofs(), Resistance::default());
        if let Some(object) = &self.object
            && !self.frames.is_empty()
        {
            resistance::add_up(&self.station, &self.frames, &self.layers, object, of_dof);
        }
    }

    /// Time since the take's start, s; negative while the devices are warming up.
    pub fn time_s(&self) -> f64 {
        (self.block * STEPS_PER_BLOCK) as f64 * STEP_S
    }

    /// Steps until `end_s` since the take's start, with the joints where `path` puts them (time in s, positions to be
    /// filled in), and hands over what arrived at the host since, in order.
    pub fn advance(
        &mut self,
        end_s: f64,
        path: impl Fn(f64, &mut [f64]),
        sink: &mut dyn FnMut(Event) -> Result<(), EmulationError>,
    ) -> Result<(), EmulationError> {
        let period_s = 1.0 / self.station.joint_rate_hz;
        let mut positions = std::mem::take(&mut self.positions);
        let mut events: Vec<Event> = Vec::new();
        let end_block = (end_s / STEP_S / STEPS_PER_BLOCK as f64 + 1e-6).floor() as i64;
        while self.block < end_block {
            let block_end_s = ((self.block + 1) * STEPS_PER_BLOCK) as f64 * STEP_S;
            path(block_end_s, &mut positions);
            self.station.robot.follow(&mut positions);
            self.step_block(&positions);
            let block_end_ns = (block_end_s * 1e9).round() as i64;
            for (stream, device) in self.devices.iter_mut().enumerate() {
                while let Some(sample) = device.arrived(block_end_ns) {
                    // What was sent before the take began has been and gone.
                    if sample.host_ns >= 0 {
                        events.push(Event::Tactile { stream, sample });
                    }
                }
            }
            // Times come from the count, so that they do not drift.
            let mut due_s = self.num_joint_samples as f64 * period_s;
            while due_s < block_end_s - 1e-9 {
                path(due_s, &mut positions);
                self.station.robot.follow(&mut positions);
                events.push(Event::Joints {
                    host_ns: (due_s * 1e9).round() as i64,
                    positions: self.measured(&positions),
                });
                self.num_joint_samples += 1;
                due_s = self.num_joint_samples as f64 * period_s;
            }
            events.sort_by_key(Event::host_ns);
            for event in events.drain(..) {
                sink(event)?;
            }
        }
        self.positions = positions;
        Ok(())
    }

    /// Steps the layers, sensors and devices through one block that ends with the motors at `positions`.
    fn step_block(&mut self, positions: &[f64]) {
        let block_s = STEPS_PER_BLOCK as f64 * STEP_S;
        self.linkage.turn(positions, block_s);
        self.station.robot.forward_kinematics(self.linkage.links(), &mut self.frames);
        for cabling in &mut self.cabling {
            cabling.bend(self.linkage.links(), self.linkage.speeds(), block_s);
        }
        for layer in &mut self.layers {
            match self.object.as_deref() {
                Some(Placed { surface, object_from_base }) => {
                    layer.approach(surface, &(object_from_base * self.frames[layer.link]));
                }
                None => layer.recede(),
            }
            for Placed { surface, object_from_base } in &self.fixed {
                layer.approach_also(surface, &(object_from_base * self.frames[layer.link]));
            }
        }
        self_contact::press(&mut self.layers, &self.touching, &self.frames);
        for step in 1..=STEPS_PER_BLOCK {
            let [from, to] = [step - 1, step].map(|step| step as f64 / STEPS_PER_BLOCK as f64);
            for (layer, sensors) in self.layers.iter_mut().zip(&mut self.sensors) {
                layer.step(STEP_S, from, to);
                sensors.step(layer, STEP_S);
            }
            let now_s = (self.block * STEPS_PER_BLOCK + step) as f64 * STEP_S;
            for (stream_idx, device) in self.devices.iter_mut().enumerate() {
                if !device.due(now_s) {
                    continue;
                }
                self.analog_raw.clear();
                for (patch, sensors) in self.station.layout.patches.iter().zip(&self.sensors) {
                    if patch.stream == stream_idx {
                        self.analog_raw.extend_from_slice(&sensors.analog_raw);
                    }
                }
                self.cabling[stream_idx].conduct(now_s, &mut self.analog_raw);
                device.sample(now_s, &self.analog_raw);
            }
        }
        self.block += 1;
    }

    fn measured(&mut self, positions: &[f64]) -> Vec<f64> {
        let mut measured = Vec::with_capacity(positions.len());
        for (dof, position) in positions.iter().enumerate() {
            let noise = self.joint_noise[dof] * gaussian(&mut self.joint_rng);
            let step = self.joint_steps[dof];
            measured.push(((position + self.joint_offsets[dof] + noise) / step).round() * step);
        }
        measured
    }
}
