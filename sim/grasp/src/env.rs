//! An environment for policies: targets in, joints and touch out, at the control rate.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use palpate_robot_model::{ObjectModel, ObjectShape, Station};
use palpate_sim::body::{MassProperties, RestPose, Solid};
use palpate_sim::tactile::Readings;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::scene::{links_of_hand, mjcf, mjcf_driven};
use crate::touch::{Sense, Touch, TouchScene};
use crate::{GraspConfig, GraspError, Randomisation, Sensed, World};

/// A robot with its sense of touch, and an object: what environments share.
#[derive(Debug)]
pub struct GraspScene {
    station: Arc<Station>,
    config: GraspConfig,
    object: ObjectModel,
    mass: MassProperties,
    solid: Solid,
    rest_poses: Vec<RestPose>,
    touch: Arc<dyn TouchScene>,
    start: Vec<f64>,
    /// By degree of freedom, whether it is one of the hand's.
    in_hand: Vec<bool>,
}

impl GraspScene {
    /// Prepares `object` to be grasped by the station's robot, felt by `sense`, such as a sensor model. The table is felt too.
    ///
    /// Refuses objects without a density, without convex parts or without a stable pose, and a sense that does not fit
    /// the station.
    pub fn new(
        station: Arc<Station>,
        config: GraspConfig,
        object: &ObjectModel,
        sense: &dyn Sense,
    ) -> Result<Self, GraspError> {
        let mass = MassProperties::of(object).map_err(GraspError::Scene)?;
        let solid = Solid::new(&object.shape).map_err(GraspError::Scene)?;
        let rest_poses = solid.rest_poses().map_err(GraspError::Scene)?;
        let table = &config.table;
        let center_m =
            Translation3::new(table.center_m[0], table.center_m[1], table.top_m - 0.5 * table.size_m[2]);
        let fixed = [(Isometry3::from(center_m), ObjectShape::Box { size_m: table.size_m })];
        let touch = sense.prepare(&station, object, &fixed)?;
        let start = config.start_positions(&station.robot);
        let link_in_hand = links_of_hand(&station.robot, &config);
        let in_hand = station.robot.dofs().map(|joint| link_in_hand[joint.child_link]).collect();
        Ok(Self { object: object.clone(), mass, solid, rest_poses, touch, start, in_hand, station, config })
    }

    /// Its station.
    pub fn station(&self) -> &Arc<Station> {
        &self.station
    }

    /// Its file.
    pub fn config(&self) -> &GraspConfig {
        &self.config
    }

    /// The object.
    pub fn object(&self) -> &ObjectModel {
        &self.object
    }

    /// Whether raw readings are those of the station's devices, in their units, and not distances and pressures.
    pub fn reads_raw_units(&self) -> bool {
        self.touch.reads_raw_units()
    }

    /// Mass, centre of mass and inertia of the object.
    pub fn mass(&self) -> &MassProperties {
        &self.mass
    }

    /// The text that MuJoCo loads.
    pub fn mjcf(&self, randomisation: &Randomisation) -> Result<String, GraspError> {
        mjcf(&self.station.robot, &self.config, &self.object, &self.mass, randomisation)
    }

    /// A world at `start`, its object at rest.
    pub fn world(&self, start: &Start) -> Result<World, GraspError> {
        let mut world = World::new(&self.mjcf(&start.randomisation)?, &self.station.robot, &self.config)?;
        self.place(&mut world, start)?;
        Ok(world)
    }

    /// A world whose object begins where it rests in [`Self::world`] at the same start, and whose hand is driven by torques
    /// ([`scene::mjcf_driven`](crate::scene::mjcf_driven)) in physics steps of `timestep_s`. [`World::set_targets`] takes N m
    /// for the hand's joints; a step of it is a physics step.
    pub fn driven_world(&self, start: &Start, timestep_s: f64) -> Result<World, GraspError> {
        let settled = self.world(start)?;
        let robot = &self.station.robot;
        let text =
            mjcf_driven(robot, &self.config, &self.object, &self.mass, &start.randomisation, timestep_s)?;
        let mut config = self.config.clone();
        (config.physics.timestep_s, config.control_rate_hz) = (timestep_s, 1.0 / timestep_s);
        let mut world = World::new(&text, robot, &config)?;
        world.reset(&start.positions, &settled.base_from_object());
        // Targets are torques now.
        let targets: Vec<f64> = start
            .positions
            .iter()
            .zip(&self.in_hand)
            .map(|(&at, &hand)| if hand { 0.0 } else { at })
            .collect();
        world.set_targets(&targets);
        Ok(world)
    }

    /// Begins an episode in `world`, which has the randomisation of `start`.
    fn place(&self, world: &mut World, start: &Start) -> Result<(), GraspError> {
        world.reset(&start.positions, &start.base_from_object);
        world.settle(&start.positions, self.config.task.settle_s)
    }

    /// Where the robot waits, one position per degree of freedom.
    pub fn start_positions(&self) -> &[f64] {
        &self.start
    }

    /// By degree of freedom, whether it is one of the hand's.
    pub fn dofs_in_hand(&self) -> &[bool] {
        &self.in_hand
    }

    /// Length of [`GraspEnv::observe`].
    pub fn num_observations(&self) -> usize {
        2 * self.start.len() + self.station.layout.num_channels()
    }
}

/// How an episode begins.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// The world's parameters.
    pub randomisation: Randomisation,
    /// Positions of every degree of freedom.
    pub positions: Vec<f64>,
    /// The object on the table.
    pub base_from_object: Isometry3<f64>,
}

impl Start {
    /// The nominal world: start positions as they are, the object in its likeliest stable pose in the middle.
    pub fn nominal(scene: &GraspScene) -> Self {
        Self {
            randomisation: Randomisation::none(),
            positions: scene.start.clone(),
            base_from_object: on_table(scene, 0.0, [0.0, 0.0], 0.0),
        }
    }

    /// The nominal world with the object on the stable side that `side` (0 to 1, by how likely the sides are) falls on,
    /// `offset_m` from the middle of the region and turned by `yaw_rad`.
    pub fn placed(scene: &GraspScene, side: f64, offset_m: [f64; 2], yaw_rad: f64) -> Self {
        Self { base_from_object: on_table(scene, side, offset_m, yaw_rad), ..Self::nominal(scene) }
    }

    /// The start of trial number `trial` of those with `seed`, as [`crate::trial`] has it where the region of starts has this
    /// half width.
    pub fn of_trial(scene: &GraspScene, half_width_m: f64, seed: u64, trial: u64) -> Self {
        Self::draw_within(scene, half_width_m, false, &mut stream(seed, trial))
    }

    /// As the task has it (paper, appendix "Evaluation Protocol" and table "Domain Randomization Parameters"): the object
    /// within the region, on any stable side, turned anyhow; noise on the hand's joints; randomised physics.
    pub fn draw(scene: &GraspScene, rng: &mut ChaCha8Rng) -> Self {
        Self::draw_within(scene, scene.config.task.half_width_m, false, rng)
    }

    /// The same in a region of another half width. With `any_orientation` the object is turned anyhow in space, as the
    /// experts' episodes have it, with its lowest point on the table, and finds its side when the world settles.
    pub fn draw_within(
        scene: &GraspScene,
        half_width_m: f64,
        any_orientation: bool,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let task = &scene.config.task;
        let randomisation = Randomisation::draw(&scene.config.randomisation, rng);
        let mut around = |reach: f64| reach * (2.0 * rng.random::<f64>() - 1.0);
        let offset_m = [around(half_width_m), around(half_width_m)];
        let positions = scene
            .station
            .robot
            .dofs()
            .zip(&scene.start)
            .zip(&scene.in_hand)
            .map(|((joint, &start), &in_hand)| {
                let noisy = if in_hand { start + around(task.start_noise_rad) } else { start };
                joint.limits.map_or(noisy, |limits| noisy.clamp(limits.lower, limits.upper))
            })
            .collect();
        let (side, yaw_rad) = (rng.random::<f64>(), TAU * rng.random::<f64>());
        let mut base_from_object = on_table(scene, side, offset_m, yaw_rad);
        if any_orientation {
            base_from_object.rotation = any_rotation(rng);
            let down_in_object = base_from_object.rotation.inverse() * -Vector3::z();
            base_from_object.translation.z =
                scene.config.table.top_m + scene.solid.farthest_along(&down_in_object);
        }
        Self { randomisation, positions, base_from_object }
    }

    /// Seed of what is random in touch. No two drawn starts agree in where the object lies.
    fn touch_seed(&self) -> u64 {
        let at = &self.base_from_object.translation;
        at.x.to_bits() ^ at.y.to_bits().rotate_left(u64::BITS / 2)
    }
}

/// A uniformly distributed rotation (Shoemake, "Uniform random rotations", 1992).
fn any_rotation(rng: &mut ChaCha8Rng) -> UnitQuaternion<f64> {
    let [u, v, w] = [rng.random::<f64>(), TAU * rng.random::<f64>(), TAU * rng.random::<f64>()];
    let (one, other) = ((1.0 - u).sqrt(), u.sqrt());
    UnitQuaternion::from_quaternion(Quaternion::new(
        other * w.cos(),
        one * v.sin(),
        one * v.cos(),
        other * w.sin(),
    ))
}

fn on_table(scene: &GraspScene, side: f64, offset_m: [f64; 2], yaw_rad: f64) -> Isometry3<f64> {
    scene.config.on_table(&scene.rest_poses, side, offset_m, yaw_rad)
}

/// Random numbers of environment or trial number `idx` of those that share `seed`.
pub(crate) fn stream(seed: u64, idx: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(idx);
    rng
}

/// One environment. Its random numbers are its own: what it does depends on its seed and the targets it gets, on nothing
/// else.
#[derive(Debug)]
pub struct GraspEnv {
    scene: Arc<GraspScene>,
    world: World,
    /// What the world was made with.
    randomisation: Randomisation,
    touch: Box<dyn Touch>,
    rng: ChaCha8Rng,
    num_steps: u64,
    positions: Vec<f64>,
    targets: Vec<f64>,
    readings: Readings,
}

impl GraspEnv {
    /// Environment number `env_idx` of those that share `seed`, at the nominal start.
    pub fn new(scene: Arc<GraspScene>, seed: u64, env_idx: u64) -> Result<Self, GraspError> {
        let start = Start::nominal(&scene);
        Self::at(scene, &start, stream(seed, env_idx))
    }

    /// An environment at `start` that draws from `rng`.
    pub(crate) fn at(scene: Arc<GraspScene>, start: &Start, rng: ChaCha8Rng) -> Result<Self, GraspError> {
        let world = scene.world(start)?;
        let mut touch = Arc::clone(&scene.touch).touch()?;
        touch.restart(start.touch_seed())?;
        let readings = touch.feel(0.0, &start.positions, &world.base_from_object())?;
        Ok(Self {
            world,
            randomisation: start.randomisation.clone(),
            touch,
            rng,
            num_steps: 0,
            positions: start.positions.clone(),
            targets: start.positions.clone(),
            readings,
            scene,
        })
    }

    /// Begins a new episode with a drawn start, which it returns.
    pub fn reset(&mut self) -> Result<Start, GraspError> {
        let start = Start::draw(&self.scene, &mut self.rng);
        self.begin(&start)?;
        Ok(start)
    }

    /// Begins a new episode at `start`.
    pub fn begin(&mut self, start: &Start) -> Result<(), GraspError> {
        let scene = &self.scene;
        if self.randomisation == start.randomisation {
            scene.place(&mut self.world, start)?;
        } else {
            self.world = scene.world(start)?;
            self.randomisation = start.randomisation.clone();
        }
        self.touch.restart(start.touch_seed())?;
        self.num_steps = 0;
        self.positions.copy_from_slice(&start.positions);
        self.targets.copy_from_slice(&start.positions);
        self.readings = self.touch.feel(0.0, &self.positions, &self.world.base_from_object())?;
        Ok(())
    }

    /// Pushes the object with `force_n` at its centre of mass, along the axes of the base, until told otherwise; a new episode
    /// begins without a push.
    pub fn push(&mut self, force_n: &Vector3<f64>) {
        self.world.set_push(force_n);
    }

    /// One control step towards `targets`, one per degree of freedom, rad or m.
    ///
    /// # Panics
    /// If `targets` has the wrong length: a caller's bug.
    pub fn step(&mut self, targets: &[f64]) -> Result<(), GraspError> {
        self.targets.copy_from_slice(targets);
        self.world.set_targets(targets);
        self.world.step()?;
        self.num_steps += 1;
        self.world.positions_into(&mut self.positions);
        let time_s = self.num_steps as f64 / self.scene.config.control_rate_hz;
        self.readings = self.touch.feel(time_s, &self.positions, &self.world.base_from_object())?;
        Ok(())
    }

    /// What a policy may know: positions, targets (rad or m, in the robot's order) and touch (0 or 1, in channel order),
    /// one after the other.
    ///
    /// # Panics
    /// If `into` is not [`GraspScene::num_observations`] long: a caller's bug.
    pub fn observe(&self, into: &mut [f32]) {
        assert_eq!(into.len(), self.scene.num_observations(), "one number per observation");
        let touch = self.readings.active.iter().map(|&on| f32::from(u8::from(on)));
        let joints = self.positions.iter().chain(&self.targets).map(|&value| value as f32);
        into.iter_mut().zip(joints.chain(touch)).for_each(|(into, value)| *into = value);
    }

    /// The physics, for rewards and verdicts.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// What it shares with others.
    pub fn scene(&self) -> &Arc<GraspScene> {
        &self.scene
    }

    /// Readings after the last step.
    pub fn readings(&self) -> &Readings {
        &self.readings
    }

    /// How strongly each channel is touched, from 0 to 1; nothing where that cannot be told.
    pub fn strengths(&self) -> Option<Vec<f32>> {
        self.scene.touch.strengths(&self.readings.raw)
    }

    /// Targets of the last step; the start positions before the first.
    pub fn targets(&self) -> &[f64] {
        &self.targets
    }

    /// Positions after the last step.
    pub fn positions(&self) -> &[f64] {
        &self.positions
    }

    /// What a script may know now.
    pub fn sensed(&self) -> Sensed<'_> {
        Sensed { time_s: self.time_s(), positions: &self.positions, active: &self.readings.active }
    }

    /// Time in the episode, s.
    pub fn time_s(&self) -> f64 {
        self.num_steps as f64 / self.scene.config.control_rate_hz
    }
}
