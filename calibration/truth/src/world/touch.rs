//! The truth world's sense of touch alone, for robots and objects that another simulator moves.

use std::path::Path;
use std::sync::Arc;

use nalgebra::Isometry3;
use palpate_robot_model::{ObjectModel, ObjectShape, Station};
use palpate_sim::geometry::SignedDistance;

use super::{Placed, STEP_S, STEPS_PER_BLOCK};
use crate::truth::Emulation;
use crate::{EmulationError, TruthWorld};

/// A truth file's soft layers, sensors, electronics and ways to the host. What it hides in encoders and motions stays out:
/// whoever moves the robot knows its joints.
#[derive(Clone, Debug)]
pub struct TruthSense {
    emulation: Arc<Emulation>,
}

impl TruthSense {
    /// Reads the truth file at `truth_path`, and all that it names.
    ///
    /// # Errors
    /// Files that cannot be read or make no sense.
    pub fn read(truth_path: &Path) -> Result<Self, EmulationError> {
        Ok(Self { emulation: Arc::new(Emulation::read(truth_path)?) })
    }

    /// The station whose robot feels.
    pub fn station(&self) -> &Station {
        &self.emulation.station
    }

    /// `object` at the base frame's origin.
    pub fn placed(&self, object: &ObjectModel) -> Result<Placed, EmulationError> {
        Placed::new(&self.emulation, object, &Isometry3::identity())
    }

    /// Prepares `object` and `fixed`, which stand still (base_from_body and shape), to be felt.
    ///
    /// # Errors
    /// Shapes without an inside, and layers that cannot be simulated.
    pub fn touch(
        &self,
        object: &ObjectModel,
        fixed: &[(Isometry3<f64>, ObjectShape)],
    ) -> Result<TruthTouch, EmulationError> {
        let fixed = standing(&self.emulation, fixed)?;
        let object = self.placed(object)?;
        let num_channels = self.emulation.station.layout.num_channels();
        let mut touch = TruthTouch {
            emulation: Arc::clone(&self.emulation),
            world: TruthWorld::empty(&self.emulation, 0, 0)?,
            object,
            fixed,
            before: None,
            raw: vec![0.0; num_channels],
            active: vec![false; num_channels],
        };
        touch.restart(0)?;
        Ok(touch)
    }
}

/// What stands still.
fn standing(
    emulation: &Emulation,
    fixed: &[(Isometry3<f64>, ObjectShape)],
) -> Result<Vec<Placed>, EmulationError> {
    let placed = |(base_from_body, shape): &(Isometry3<f64>, ObjectShape)| {
        let surface = SignedDistance::new(shape).map_err(|err| emulation.error("what stands still", err))?;
        Ok(Placed { surface: Arc::new(surface), object_from_base: base_from_body.inverse() })
    };
    fixed.iter().map(placed).collect()
}

impl TruthWorld {
    /// A world without an object in which `fixed` stands.
    pub fn among(
        emulation: &Emulation,
        fixed: &[(Isometry3<f64>, ObjectShape)],
        seed: u64,
    ) -> Result<Self, EmulationError> {
        let mut world = Self::empty(emulation, seed, 0)?;
        world.fixed = standing(emulation, fixed)?;
        Ok(world)
    }
}

/// One episode of a [`TruthSense`].
pub struct TruthTouch {
    emulation: Arc<Emulation>,
    world: TruthWorld,
    object: Placed,
    fixed: Vec<Placed>,
    /// The newest frame.
    before: Option<Frame>,
    raw: Vec<f64>,
    active: Vec<bool>,
}

#[derive(Clone, Debug)]
struct Frame {
    time_s: f64,
    positions: Vec<f64>,
    base_from_object: Isometry3<f64>,
}

impl TruthTouch {
    /// Forgets everything: a new episode begins, with noise drawn from `seed`. What differs between channels comes from the
    /// truth's own seed.
    ///
    /// # Errors
    /// None after [`TruthSense::touch`] had none.
    pub fn restart(&mut self, seed: u64) -> Result<(), EmulationError> {
        self.world = TruthWorld::empty(&self.emulation, seed, 0)?;
        self.world.fixed.clone_from(&self.fixed);
        self.before = None;
        self.raw.fill(0.0);
        self.active.fill(false);
        Ok(())
    }

    /// Moves robot and object, evenly since the frame before, to `positions` (rad or m) and `base_from_object` at `time_s`
    /// since the episode began. The first frame is where the devices take their reference before the episode.
    ///
    /// # Panics
    /// If `positions` has the wrong length: a caller's bug.
    pub fn feel(&mut self, time_s: f64, positions: &[f64], base_from_object: &Isometry3<f64>) {
        assert_eq!(positions.len(), self.world.positions.len(), "one number per degree of freedom");
        let to = Frame { time_s, positions: positions.to_vec(), base_from_object: *base_from_object };
        let from = self.before.take().unwrap_or_else(|| to.clone());
        let block_s = STEPS_PER_BLOCK as f64 * STEP_S;
        let last_block = (time_s / block_s).round() as i64;
        let mut now = to.positions.clone();
        while self.world.block < last_block {
            let now_s = (self.world.block + 1) as f64 * block_s;
            let span_s = to.time_s - from.time_s;
            let share = if span_s > 0.0 { ((now_s - from.time_s) / span_s).clamp(0.0, 1.0) } else { 1.0 };
            for ((now, from), to) in now.iter_mut().zip(&from.positions).zip(&to.positions) {
                *now = from + share * (to - from);
            }
            let base_from_object = from
                .base_from_object
                .try_lerp_slerp(&to.base_from_object, share, 1e-9)
                .unwrap_or(to.base_from_object);
            self.world.place(Some(Arc::new(self.object.moved(&base_from_object))));
            self.world.step_block(&now);
            self.receive((now_s * 1e9).round() as i64);
        }
        self.before = Some(to);
    }

    /// Takes over what has arrived by `now_ns`.
    fn receive(&mut self, now_ns: i64) {
        for (stream, device) in self.world.station.layout.streams.iter().zip(&mut self.world.devices) {
            while let Some(sample) = device.arrived(now_ns) {
                let raw = sample.raw.iter().map(|&raw| f64::from(raw));
                self.raw[stream.channels.clone()].iter_mut().zip(raw).for_each(|(into, raw)| *into = raw);
                self.active[stream.channels.clone()].copy_from_slice(&sample.active);
            }
        }
    }

    /// The newest reading of each channel that has reached the host, raw units.
    pub fn raw(&self) -> &[f64] {
        &self.raw
    }

    /// How far each of [`TruthTouch::raw`] is above what its device took for no touch before the episode.
    pub fn above_reference(&self) -> impl Iterator<Item = f64> + '_ {
        let streams = self.world.station.layout.streams.iter().zip(&self.world.devices);
        let references = streams
            .flat_map(|(stream, device)| (0..stream.channels.len()).map(|column| device.reference(column)));
        self.raw.iter().zip(references).map(|(raw, reference)| raw - reference)
    }

    /// Whether each channel is active, as the newest sample that has reached the host says.
    pub fn active(&self) -> &[bool] {
        &self.active
    }
}
