//! Touch frame by frame, while robot and object move: what [`crate::replay`] and [`SensorModel::readings`] give for a
//! whole take, told as it unfolds.
//!
//! [`LiveScene`] is what many episodes share, prepared once; [`LiveTouch`] is one of them. A frame costs the same however
//! many were before it: effects that remember (drift, backlash, slow releases, delays) keep what they need.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3};
use palpate_robot_model::{ObjectModel, ObjectPath, ObjectShape, SensorKind, Station, TactileLayout};

use crate::SensorModel;
use crate::effects::{Frame, FrameChain, FrameMemory, FrameScene, Switching, TakeScene, moved};
use crate::geometry::SignedDistance;
use crate::replay::{self, ContactTrace, PatchTrace, Probe, ReplayError};
use crate::tactile::{self, Propagation, Readings};

/// A pressure channel is touched with strength 1 from this multiple of its threshold on.
pub const FULL_PRESSURE: f64 = 10.0;
/// A proximity channel is touched with strength 1 from this far below its threshold on, m.
pub const FULL_DEPTH_M: f64 = 0.005;

/// A robot, an object that may move, things that stand still, and how the robot's skin feels them.
#[derive(Debug)]
pub struct LiveScene {
    station: Arc<Station>,
    object: ObjectModel,
    model: SensorModel,
    /// As effects have its size.
    object_shape: ObjectShape,
    object_distance: SignedDistance,
    /// Whether an effect moves the object.
    moves_object: bool,
    /// Things that stand still, with their poses in the base.
    fixed: Vec<(SignedDistance, Isometry3<f64>)>,
    /// Nodes and taxels with mounting errors.
    layout: TactileLayout,
    /// Of each channel, in the unit of its raw reading.
    thresholds: Vec<f64>,
    probes: Vec<Probe>,
    sensing: Sensing,
}

/// How contact becomes readings.
#[derive(Debug)]
enum Sensing {
    /// Theta alone decides, by these weights.
    Plain(Vec<Propagation>),
    Chain(Box<FrameChain>),
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
        let at_zero = vec![0.0; station.robot.num_dofs()];
        let origin = ObjectPath::Still(Isometry3::identity());
        // What these effects do to sizes and mountings depends on nothing that changes.
        let kinematics = model.chain().kinematics(&TakeScene {
            station: &station,
            object,
            base_from_object: &origin,
            surroundings: &[],
            frame_times_s: &[0.0],
            positions: &at_zero,
            arrival_times_s: &[],
            frozen_for_s: &[],
            tares: &[],
        });
        let moves_object = kinematics.base_from_object != origin;
        let prepare = |shape: &ObjectShape| SignedDistance::new(shape).map_err(ReplayError::Object);
        let object_shape = object.shape.scaled(kinematics.object_scale);
        let object_distance = prepare(&object_shape)?;
        let fixed =
            fixed.iter().map(|(pose, shape)| Ok((prepare(shape)?, *pose))).collect::<Result<_, _>>()?;
        let layout =
            moved(&station.layout, &kinematics.patch_offsets).unwrap_or_else(|| station.layout.clone());
        let thetas = model.thetas();
        let thresholds = tactile::thresholds(&layout, &thetas);
        let sensing = if model.is_plain() {
            Sensing::Plain(tactile::propagation(&layout, &thetas.alphas_per_m(&layout)))
        } else {
            Sensing::Chain(Box::new(FrameChain::new(&model.chain(), &station, object, &layout)))
        };
        Ok(Self {
            object: object.clone(),
            object_shape,
            object_distance,
            moves_object,
            fixed,
            probes: replay::probes(&layout, model.chain().gaps_below_m(&layout)),
            layout,
            thresholds,
            sensing,
            model: model.clone(),
            station,
        })
    }

    /// Its station.
    pub fn station(&self) -> &Arc<Station> {
        &self.station
    }

    /// Nodes and taxels, with the mounting errors that the model has.
    pub fn layout(&self) -> &TactileLayout {
        &self.layout
    }

    /// The object's shape, in the size that the model gives it.
    pub fn object_shape(&self) -> &ObjectShape {
        &self.object_shape
    }

    /// Per patch, centre (in its link) and radius, m, of a ball that holds its nodes. Farther away than that, a patch reads a
    /// bound on its distance ([`crate::replay::PatchTrace::Proximity`]).
    pub fn patch_balls(&self) -> impl Iterator<Item = (Point3<f64>, f64)> {
        self.probes.iter().map(|probe| (probe.center_in_link, probe.radius_m))
    }

    /// Weights of every patch, with the decay that effects leave it.
    pub fn propagation(&self) -> &[Propagation] {
        match &self.sensing {
            Sensing::Plain(propagation) => propagation,
            Sensing::Chain(chain) => chain.propagation(),
        }
    }

    /// How loads become events; `None` for a model that theta alone decides.
    pub fn switching(&self) -> Option<&Switching> {
        match &self.sensing {
            Sensing::Plain(_) => None,
            Sensing::Chain(chain) => Some(chain.switching()),
        }
    }

    /// How strongly each channel is touched, from 0 to 1, whose `raw` readings (m or Pa) are those of one frame: what a
    /// policy sees that is not told events alone.
    ///
    /// Of a pressure channel p over [`FULL_PRESSURE`] times its threshold; of a proximity channel how far its distance
    /// is below its threshold, over [`FULL_DEPTH_M`]; both cut off at 0 and 1.
    pub fn strengths(&self, raw: &[f64]) -> Vec<f32> {
        let channels = self.layout.channels.iter().zip(raw).zip(&self.thresholds);
        let strength =
            channels.map(|((channel, raw), threshold)| match self.layout.streams[channel.stream].kind {
                SensorKind::Pressure => raw / (FULL_PRESSURE * threshold),
                SensorKind::Proximity => (threshold - raw) / FULL_DEPTH_M,
            });
        // A pressure of zero at a threshold of zero is no number, and no touch.
        strength
            .map(|strength| if strength.is_nan() { 0.0 } else { strength.clamp(0.0, 1.0) as f32 })
            .collect()
    }

    /// Where the object is that is said to be at `base_from_object`.
    fn true_pose(&self, positions: &[f64], base_from_object: &Isometry3<f64>) -> Isometry3<f64> {
        if !self.moves_object {
            return *base_from_object;
        }
        let take = TakeScene {
            station: &self.station,
            object: &self.object,
            base_from_object: &ObjectPath::Still(*base_from_object),
            surroundings: &[],
            frame_times_s: &[0.0],
            positions,
            arrival_times_s: &[],
            frozen_for_s: &[],
            tares: &[],
        };
        self.model.chain().kinematics(&take).base_from_object.at(0)
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
    /// Times of the first frame and of the last, s; `None` before there is one.
    span_s: Option<(f64, f64)>,
    /// Measured in the last frame.
    positions_before: Vec<f64>,
    memory: Option<FrameMemory>,
}

impl LiveTouch {
    /// An episode in which nothing has happened yet.
    pub fn new(scene: Arc<LiveScene>) -> Self {
        let memory = match &scene.sensing {
            Sensing::Plain(_) => None,
            Sensing::Chain(chain) => Some(chain.memory()),
        };
        Self { scene, span_s: None, positions_before: Vec::new(), memory }
    }

    /// Forgets everything: a new episode begins.
    pub fn restart(&mut self) {
        *self = Self::new(Arc::clone(&self.scene));
    }

    /// Readings of the frame at `time_s`, one frame of `num_channels`, with the robot at `positions` (one per degree of
    /// freedom, rad or m) and the object at `base_from_object`.
    ///
    /// While the object stands still they are, to the bit, those of the same frame of a replay of the whole take, unless an
    /// effect of the model depends on frames that are still to come. Of `rate_dependence` and `motion_artifact` the change
    /// since the frame before counts instead; a stream that `clock_skew` puts ahead of the present shows the present.
    ///
    /// Refuses a time that is not after the last one, a wrong number of positions, and anything NaN or infinite; a frame
    /// that is refused leaves no trace.
    pub fn feel(
        &mut self,
        time_s: f64,
        positions: &[f64],
        base_from_object: &Isometry3<f64>,
    ) -> Result<Readings, ReplayError> {
        let num_channels = self.scene.layout.num_channels();
        let (mut raw, mut active) = (vec![0.0; num_channels], vec![false; num_channels]);
        self.check(time_s, positions, base_from_object)?;
        self.feel_checked(time_s, positions, base_from_object, &mut raw, &mut active);
        Ok(Readings { num_frames: 1, num_channels, raw, active })
    }

    /// Whether [`Self::feel`] would refuse this.
    pub fn check(
        &self,
        time_s: f64,
        positions: &[f64],
        base_from_object: &Isometry3<f64>,
    ) -> Result<(), ReplayError> {
        let robot = &self.scene.station.robot;
        if replay::check(robot, std::slice::from_ref(base_from_object), positions)? != 1 {
            let (num_values, num_dofs) = (positions.len(), robot.num_dofs());
            return Err(ReplayError::RaggedPath { num_values, num_dofs });
        }
        let before_s = self.span_s.map_or(f64::NEG_INFINITY, |(_, last_s)| last_s);
        if time_s > before_s && time_s.is_finite() {
            Ok(())
        } else {
            Err(ReplayError::TimeNotIncreasing { time_s, before_s })
        }
    }

    /// [`Self::feel`] into `raw` and `active`, one each per channel, of a frame that passed [`Self::check`].
    pub fn feel_checked(
        &mut self,
        time_s: f64,
        positions: &[f64],
        base_from_object: &Isometry3<f64>,
        raw: &mut [f64],
        active: &mut [bool],
    ) {
        let scene = &self.scene;
        let (start_s, before_s) = self.span_s.unwrap_or((time_s, time_s));
        let is_first = self.span_s.replace((start_s, time_s)).is_none();
        if is_first {
            self.positions_before = positions.to_vec();
        }
        let frame = Frame {
            is_first,
            start_s,
            before_s,
            time_s,
            positions,
            positions_before: &self.positions_before,
        };
        let mut true_positions = positions.to_vec();
        if let (Sensing::Chain(chain), Some(memory)) = (&scene.sensing, &mut self.memory) {
            chain.move_joints(&frame, memory, &mut true_positions);
        }
        let object = (&scene.object_distance, scene.true_pose(positions, base_from_object));
        let bodies = std::iter::once(object).chain(scene.fixed.iter().map(|(shape, pose)| (shape, *pose)));
        let mut trace = ContactTrace::empty(&scene.layout, 0);
        replay::feel_frame(&scene.station.robot, &scene.probes, bodies, &true_positions, &mut trace);
        match (&scene.sensing, &mut self.memory) {
            (Sensing::Chain(chain), Some(memory)) => {
                let frame_scene = FrameScene {
                    station: &scene.station,
                    object: &scene.object,
                    base_from_object,
                    layout: &scene.layout,
                    frame,
                };
                chain.sense(&frame_scene, &trace, &true_positions, memory, raw, active);
                scene.model.loads_as_readings(&scene.layout, raw);
            }
            (Sensing::Plain(propagation), _) => {
                scene.plain_readings(&trace, propagation, raw, active);
            }
            (Sensing::Chain(_), None) => unreachable!("a chain has a memory"),
        }
        self.positions_before.copy_from_slice(positions);
    }
}

impl LiveScene {
    /// [`tactile::readings`] of a trace of one frame, without computing its weights again.
    fn plain_readings(
        &self,
        trace: &ContactTrace,
        propagation: &[Propagation],
        raw: &mut [f64],
        active: &mut [bool],
    ) {
        for ((patch, trace), propagation) in self.layout.patches.iter().zip(&trace.patches).zip(propagation) {
            let taxels = &mut raw[patch.channels.clone()];
            match &**trace {
                PatchTrace::Proximity { min_distance_m, .. } => taxels.fill(min_distance_m[0]),
                PatchTrace::Pressure { entries, .. } => {
                    taxels.fill(0.0);
                    tactile::propagate(&propagation.weights, entries, taxels);
                }
            }
        }
        let channels = self.layout.channels.iter().zip(raw).zip(&self.thresholds);
        for (active, ((channel, raw), &threshold)) in active.iter_mut().zip(channels) {
            *active = tactile::is_active(self.layout.streams[channel.stream].kind, *raw, threshold);
        }
    }
}
