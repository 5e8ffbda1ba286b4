//! The emulated station's sense of touch in the grasp world.

use std::path::Path;
use std::sync::Arc;

use nalgebra::Isometry3;
use palpate_grasp::GraspError;
use palpate_grasp::touch::{FixedBody, Sense, Touch, TouchScene};
use palpate_robot_model::{ObjectModel, Station};
use palpate_sim::tactile::Readings;
use palpate_truth::{EmulationError, TruthSense, TruthTouch};

/// The touch of a truth file.
pub(crate) struct Emulated(TruthSense);

impl Emulated {
    pub(crate) fn read(path: &Path) -> Result<Self, EmulationError> {
        TruthSense::read(path).map(Self)
    }
}

fn error(err: EmulationError) -> GraspError {
    GraspError::Sense(err.to_string())
}

impl Sense for Emulated {
    fn prepare(
        &self,
        station: &Arc<Station>,
        object: &ObjectModel,
        fixed: &[FixedBody],
    ) -> Result<Arc<dyn TouchScene>, GraspError> {
        let own = self.0.station();
        if names(own) != names(station) {
            return Err(GraspError::Sense(format!(
                "the truth's station is {:?}, whose joints and channels are not those of {:?}",
                own.id, station.id
            )));
        }
        let scene = EmulatedScene { sense: self.0.clone(), object: object.clone(), fixed: fixed.to_vec() };
        // What cannot be felt shows here, not when an episode begins.
        scene.sense.touch(&scene.object, &scene.fixed).map_err(error)?;
        Ok(Arc::new(scene))
    }
}

/// Of everything that moves and everything that feels.
fn names(station: &Station) -> (Vec<&str>, Vec<&str>) {
    let joints = station.robot.dofs().map(|joint| joint.name.as_str());
    let channels = station.layout.channels.iter().map(|channel| channel.id.as_str());
    (joints.collect(), channels.collect())
}

#[derive(Debug)]
struct EmulatedScene {
    sense: TruthSense,
    object: ObjectModel,
    fixed: Vec<FixedBody>,
}

impl TouchScene for EmulatedScene {
    fn touch(self: Arc<Self>) -> Result<Box<dyn Touch>, GraspError> {
        let touch = self.sense.touch(&self.object, &self.fixed).map_err(error)?;
        Ok(Box::new(EmulatedTouch(touch)))
    }

    fn reads_raw_units(&self) -> bool {
        true
    }
}

struct EmulatedTouch(TruthTouch);

impl std::fmt::Debug for EmulatedTouch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("EmulatedTouch").field(&self.0.active()).finish()
    }
}

impl Touch for EmulatedTouch {
    fn restart(&mut self, seed: u64) -> Result<(), GraspError> {
        self.0.restart(seed).map_err(error)
    }

    fn feel(
        &mut self,
        time_s: f64,
        positions: &[f64],
        base_from_object: &Isometry3<f64>,
    ) -> Result<Readings, GraspError> {
        self.0.feel(time_s, positions, base_from_object);
        let (raw, active) = (self.0.raw().to_vec(), self.0.active().to_vec());
        Ok(Readings { num_frames: 1, num_channels: active.len(), raw, active })
    }
}
