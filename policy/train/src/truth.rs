//! The emulated station's sense of touch in the grasp world, as its firmware or a contact map makes events of it.

use std::path::Path;
use std::sync::Arc;

use nalgebra::Isometry3;
use palpate_calibration::contact_map::{ContactMap, LiveMap};
use palpate_grasp::GraspError;
use palpate_grasp::touch::{FixedBody, Sense, Touch, TouchScene};
use palpate_robot_model::{ObjectModel, Station};
use palpate_sim::tactile::Readings;
use palpate_truth::{EmulationError, TruthSense, TruthTouch};

/// The touch of a truth file.
pub(crate) struct Emulated {
    sense: TruthSense,
    /// What makes events of readings, in place of the firmware's thresholds.
    map: Option<Arc<ContactMap>>,
}

impl Emulated {
    pub(crate) fn read(path: &Path, map: Option<ContactMap>) -> Result<Self, EmulationError> {
        Ok(Self { sense: TruthSense::read(path)?, map: map.map(Arc::new) })
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
        let own = self.sense.station();
        if names(own) != names(station) {
            return Err(GraspError::Sense(format!(
                "the truth's station is {:?}, whose joints and channels are not those of {:?}",
                own.id, station.id
            )));
        }
        let map = self.map.as_ref().map(|map| LiveMap::new(Arc::clone(map), own));
        let map = map.transpose().map_err(|err| GraspError::Sense(err.to_string()))?;
        let scene =
            EmulatedScene { sense: self.sense.clone(), object: object.clone(), fixed: fixed.to_vec(), map };
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
    map: Option<LiveMap>,
}

impl TouchScene for EmulatedScene {
    fn touch(self: Arc<Self>) -> Result<Box<dyn Touch>, GraspError> {
        let touch = self.sense.touch(&self.object, &self.fixed).map_err(error)?;
        Ok(Box::new(EmulatedTouch { touch, map: self.map.clone() }))
    }

    fn reads_raw_units(&self) -> bool {
        true
    }
}

struct EmulatedTouch {
    touch: TruthTouch,
    map: Option<LiveMap>,
}

impl std::fmt::Debug for EmulatedTouch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("EmulatedTouch").field(&self.touch.active()).finish()
    }
}

impl Touch for EmulatedTouch {
    fn restart(&mut self, seed: u64) -> Result<(), GraspError> {
        if let Some(map) = &mut self.map {
            map.restart();
        }
        self.touch.restart(seed).map_err(error)
    }

    fn feel(
        &mut self,
        time_s: f64,
        positions: &[f64],
        base_from_object: &Isometry3<f64>,
    ) -> Result<Readings, GraspError> {
        self.touch.feel(time_s, positions, base_from_object);
        let (raw, mut active) = (self.touch.raw().to_vec(), self.touch.active().to_vec());
        if let Some(map) = &mut self.map {
            let above_reference: Vec<f64> = self.touch.above_reference().collect();
            map.read(time_s, &above_reference, &mut active);
        }
        Ok(Readings { num_frames: 1, num_channels: active.len(), raw, active })
    }
}
