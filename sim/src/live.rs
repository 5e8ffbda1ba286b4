//! Touch frame by frame, while robot and object move: what [`crate::replay`] and [`SensorModel::readings`] give for a
//! whole take, told as it unfolds.
//!
//! [`LiveScene`] is what many episodes share, prepared once; [`LiveTouch`] is one of them. Geometry is computed for the
//! newest frame only. A model without effects then needs nothing else; with effects the rest of the chain runs over all
//! frames since the start, because effects remember (drift, backlash, slow releases), so a frame then costs in proportion
//! to their number.

use std::sync::Arc;

use nalgebra::Isometry3;
use palpate_robot_model::{ObjectModel, ObjectShape, Station};

use crate::SensorModel;
use crate::effects::{Geometry, TakeScene, moved};
use crate::geometry::SignedDistance;
use crate::replay::{self, ContactTrace, PatchTrace, Probe, ReplayError};
use crate::tactile::{self, Propagation, Readings};

/// A robot, an object that may move, things that stand still, and how the robot's skin feels them.
#[derive(Debug)]
pub struct LiveScene {
    station: Arc<Station>,
    object: ObjectModel,
    model: SensorModel,
    object_distance: SignedDistance,
    /// Things that stand still, with their poses in the base.
    fixed: Vec<(SignedDistance, Isometry3<f64>)>,
    /// Nodes and taxels with mounting errors.
    layout: palpate_robot_model::TactileLayout,
    probes: Vec<Probe>,
    /// Weights and thresholds of a model that theta alone decides.
    plain: Option<(Vec<Propagation>, Vec<f64>)>,
}

impl LiveScene {
    /// Prepares `object` and `fixed` (base_from_body and shape, such as a table) to be felt as `model` says.
    ///
    /// Effects that move the object or change its size act on `object` alone. Refuses shapes without an inside and a
    /// model that does not fit the station.
    pub fn new(
        station: Arc<Station>,
        object: &ObjectModel,
        model: &SensorModel,
        fixed: &[(Isometry3<f64>, ObjectShape)],
    ) -> Result<Self, ReplayError> {
        model.check_for(&station).map_err(|err| ReplayError::Model(err.to_string()))?;
        let (at_zero, origin) = (vec![0.0; station.robot.num_dofs()], Isometry3::identity());
        // What these effects do to sizes and mountings depends on nothing that changes.
        let kinematics = model.chain().kinematics(&TakeScene {
            station: &station,
            object,
            base_from_object: &origin,
            frame_times_s: &[0.0],
            positions: &at_zero,
            arrival_times_s: &[],
            frozen_for_s: &[],
        });
        let prepare = |shape: &ObjectShape| SignedDistance::new(shape).map_err(ReplayError::Object);
        let object_distance = prepare(&object.shape.scaled(kinematics.object_scale))?;
        let fixed =
            fixed.iter().map(|(pose, shape)| Ok((prepare(shape)?, *pose))).collect::<Result<_, _>>()?;
        let layout =
            moved(&station.layout, &kinematics.patch_offsets).unwrap_or_else(|| station.layout.clone());
        let plain = model.is_plain().then(|| {
            let propagation = tactile::propagation(&layout, model.theta.alpha_per_m);
            (propagation, tactile::thresholds(&layout, &model.theta))
        });
        Ok(Self {
            object: object.clone(),
            model: model.clone(),
            object_distance,
            fixed,
            probes: replay::probes(&layout, model.chain().gaps_below_m(&layout)),
            layout,
            plain,
            station,
        })
    }

    /// Its station.
    pub fn station(&self) -> &Arc<Station> {
        &self.station
    }
}

/// The touch of one episode.
///
/// # Example
/// ```
/// # use std::sync::Arc;
/// use nalgebra::Isometry3;
/// use palpate_sim::{SensorModel, live::{LiveScene, LiveTouch}};
/// # fn example(station: palpate_robot_model::Station, model: SensorModel) -> Result<(), Box<dyn std::error::Error>> {
/// let object = station.objects["sphere_50mm"].clone();
/// let home = vec![0.0; station.robot.num_dofs()];
/// let scene = Arc::new(LiveScene::new(Arc::new(station), &object, &model, &[])?);
/// let mut touch = LiveTouch::new(scene);
/// for frame in 0..20 {
///     let fallen = Isometry3::translation(0.4, 0.0, 1.0 - 0.02 * f64::from(frame));
///     let readings = touch.feel(0.05 * f64::from(frame), &home, &fallen)?;
///     println!("{} channels on", readings.active.iter().filter(|on| **on).count());
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct LiveTouch {
    scene: Arc<LiveScene>,
    /// Of the frames felt so far; a plain model keeps the last one only.
    times_s: Vec<f64>,
    positions: Vec<f64>,
    geometry: Geometry,
}

impl LiveTouch {
    /// An episode in which nothing has happened yet.
    pub fn new(scene: Arc<LiveScene>) -> Self {
        let geometry = Geometry {
            trace: ContactTrace::empty(&scene.layout, 0),
            moved: Some(scene.layout.clone()),
            joints: Some(Vec::new()),
            made: None,
        };
        Self { scene, times_s: Vec::new(), positions: Vec::new(), geometry }
    }

    /// Forgets everything: a new episode begins.
    pub fn restart(&mut self) {
        self.times_s.clear();
        self.positions.clear();
        self.geometry.joints = Some(Vec::new());
        self.geometry.trace = ContactTrace::empty(&self.scene.layout, 0);
    }

    /// Readings of the frame at `time_s`, one frame of `num_channels`, with the robot at `positions` (one per degree of
    /// freedom, rad or m) and the object at `base_from_object`.
    ///
    /// While the object stands still they are, to the bit, those of the last frame of a replay of all frames so far.
    /// Two effects look at a frame's successor in a longer replay, which nobody knows yet here: `rate_dependence` and
    /// `motion_artifact` take the change since the frame before instead. Refuses a time that is not after the last one,
    /// a wrong number of positions, and anything NaN or infinite.
    pub fn feel(
        &mut self,
        time_s: f64,
        positions: &[f64],
        base_from_object: &Isometry3<f64>,
    ) -> Result<Readings, ReplayError> {
        let scene = Arc::clone(&self.scene);
        let robot = &scene.station.robot;
        if replay::check(robot, base_from_object, positions)? != 1 {
            let (num_values, num_dofs) = (positions.len(), robot.num_dofs());
            return Err(ReplayError::RaggedPath { num_values, num_dofs });
        }
        let before_s = self.times_s.last().copied().unwrap_or(f64::NEG_INFINITY);
        if !(time_s > before_s && time_s.is_finite()) {
            return Err(ReplayError::TimeNotIncreasing { time_s, before_s });
        }
        if scene.plain.is_some() {
            self.restart();
        }
        self.times_s.push(time_s);
        self.positions.extend_from_slice(positions);
        let take = TakeScene {
            station: &scene.station,
            object: &scene.object,
            base_from_object,
            frame_times_s: &self.times_s,
            positions: &self.positions,
            arrival_times_s: &[],
            frozen_for_s: &[],
        };
        let chain = scene.model.chain();
        let kinematics = chain.kinematics(&take);
        let newest = &kinematics.positions[kinematics.positions.len() - robot.num_dofs()..];
        let object = (&scene.object_distance, kinematics.base_from_object);
        let bodies = std::iter::once(object).chain(scene.fixed.iter().map(|(shape, pose)| (shape, *pose)));
        replay::feel_frame(robot, &scene.probes, bodies, newest, &mut self.geometry.trace);
        self.geometry.joints.get_or_insert_default().extend_from_slice(newest);
        if let Some((propagation, thresholds)) = &scene.plain {
            return Ok(scene.plain_readings(&self.geometry.trace, propagation, thresholds));
        }
        let sensed = chain.sense_contact(&take, &self.geometry);
        let from = sensed.load.len() - sensed.num_channels;
        let loads = sensed.load[from..].to_vec();
        let activation = &sensed.activation[from..];
        Ok(scene.model.readings_of(&scene.layout, sensed.num_channels, loads, activation))
    }
}

impl LiveScene {
    /// [`tactile::readings`] of a trace of one frame, without computing its weights again.
    fn plain_readings(
        &self,
        trace: &ContactTrace,
        propagation: &[Propagation],
        thresholds: &[f64],
    ) -> Readings {
        let num_channels = self.layout.num_channels();
        let mut raw = vec![0.0; num_channels];
        for ((patch, trace), propagation) in self.layout.patches.iter().zip(&trace.patches).zip(propagation) {
            let taxels = &mut raw[patch.channels.clone()];
            match &**trace {
                PatchTrace::Proximity { min_distance_m, .. } => taxels.fill(min_distance_m[0]),
                PatchTrace::Pressure { entries, .. } => {
                    tactile::propagate(&propagation.weights, entries, taxels);
                }
            }
        }
        let channels = self.layout.channels.iter().zip(&raw).zip(thresholds);
        let active = channels
            .map(|((channel, &raw), &threshold)| {
                tactile::is_active(self.layout.streams[channel.stream].kind, raw, threshold)
            })
            .collect();
        Readings { num_frames: 1, num_channels, raw, active }
    }
}
