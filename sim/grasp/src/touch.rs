//! Where touch comes from.

use std::fmt::Debug;
use std::sync::Arc;

use nalgebra::Isometry3;
use palpate_robot_model::{ObjectModel, ObjectShape, Station};
use palpate_sim::SensorModel;
use palpate_sim::live::{LiveScene, LiveTouch};
use palpate_sim::tactile::Readings;

use crate::GraspError;

/// A body that stands still: base_from_body and its shape.
pub type FixedBody = (Isometry3<f64>, ObjectShape);

/// Senses that can be given to a robot: a sensor model of calibration, or a stand-in for hardware that knows nothing of one.
pub trait Sense {
    /// Prepares `object` and what stands still, such as the table, to be felt by the station's robot.
    ///
    /// # Errors
    /// Objects that cannot be felt, senses of another station.
    fn prepare(
        &self,
        station: &Arc<Station>,
        object: &ObjectModel,
        fixed: &[FixedBody],
    ) -> Result<Arc<dyn TouchScene>, GraspError>;
}

/// What many episodes of one sense share.
pub trait TouchScene: Debug + Send + Sync {
    /// The touch of an environment, which begins with [`Touch::restart`].
    fn touch(self: Arc<Self>) -> Result<Box<dyn Touch>, GraspError>;

    /// Whether raw readings are those of the station's devices, in their units, and not distances and pressures.
    fn reads_raw_units(&self) -> bool {
        false
    }

    /// How strongly each channel is touched, from 0 to 1, in a frame with these `raw` readings; nothing where that
    /// cannot be told.
    fn strengths(&self, _raw: &[f64]) -> Option<Vec<f32>> {
        None
    }
}

/// The touch of one environment.
pub trait Touch: Debug + Send {
    /// Forgets everything: a new episode begins. What is random in it follows from `seed`.
    ///
    /// # Errors
    /// Whatever keeps it from beginning again.
    fn restart(&mut self, seed: u64) -> Result<(), GraspError>;

    /// Readings of the station's channels, one frame, at `time_s` since the episode began, with the robot at `positions`
    /// (rad or m) and the object at `base_from_object`. Times go up within an episode, from 0.
    ///
    /// # Errors
    /// Anything NaN or infinite.
    fn feel(
        &mut self,
        time_s: f64,
        positions: &[f64],
        base_from_object: &Isometry3<f64>,
    ) -> Result<Readings, GraspError>;
}

impl Sense for SensorModel {
    fn prepare(
        &self,
        station: &Arc<Station>,
        object: &ObjectModel,
        fixed: &[FixedBody],
    ) -> Result<Arc<dyn TouchScene>, GraspError> {
        Ok(Arc::new(Modelled(Arc::new(LiveScene::new(Arc::clone(station), object, self, fixed)?))))
    }
}

/// The sense of a sensor model.
#[derive(Debug)]
struct Modelled(Arc<LiveScene>);

impl TouchScene for Modelled {
    fn touch(self: Arc<Self>) -> Result<Box<dyn Touch>, GraspError> {
        Ok(Box::new(LiveTouch::new(Arc::clone(&self.0))))
    }

    fn strengths(&self, raw: &[f64]) -> Option<Vec<f32>> {
        Some(self.0.strengths(raw))
    }
}

impl Touch for LiveTouch {
    fn restart(&mut self, _seed: u64) -> Result<(), GraspError> {
        self.restart();
        Ok(())
    }

    fn feel(
        &mut self,
        time_s: f64,
        positions: &[f64],
        base_from_object: &Isometry3<f64>,
    ) -> Result<Readings, GraspError> {
        Ok(self.feel(time_s, positions, base_from_object)?)
    }
}

/// The sense of a robot that feels nothing: what is left when touch is taken away.
#[derive(Clone, Copy, Debug)]
pub struct NoTouch;

/// Readings of a station on which nothing is active, whatever happens; raw values are zero.
#[derive(Clone, Debug)]
struct Nothing(Readings);

impl Sense for NoTouch {
    fn prepare(
        &self,
        station: &Arc<Station>,
        _object: &ObjectModel,
        _fixed: &[FixedBody],
    ) -> Result<Arc<dyn TouchScene>, GraspError> {
        let num_channels = station.layout.num_channels();
        let (raw, active) = (vec![0.0; num_channels], vec![false; num_channels]);
        Ok(Arc::new(Nothing(Readings { num_frames: 1, num_channels, raw, active })))
    }
}

impl TouchScene for Nothing {
    fn touch(self: Arc<Self>) -> Result<Box<dyn Touch>, GraspError> {
        Ok(Box::new(Self::clone(&self)))
    }

    fn strengths(&self, raw: &[f64]) -> Option<Vec<f32>> {
        Some(vec![0.0; raw.len()])
    }
}

impl Touch for Nothing {
    fn restart(&mut self, _seed: u64) -> Result<(), GraspError> {
        Ok(())
    }

    fn feel(
        &mut self,
        _time_s: f64,
        _positions: &[f64],
        _base_from_object: &Isometry3<f64>,
    ) -> Result<Readings, GraspError> {
        Ok(self.0.clone())
    }
}
