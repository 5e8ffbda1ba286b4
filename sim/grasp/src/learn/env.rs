//! One environment of a learning task.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{ActorState, Facts, LearnTask, REWARD_TERMS};
use crate::env::stream;
use crate::trial::{Judge, Outcome};
use crate::{Contacts, GraspEnv, GraspError, Start};

/// An environment in which actions, each within -1 to 1, move the hand's joints and the hand as a whole.
///
/// An action changes an offset, by at most a step of [`super::Bounds`]; offsets are added to the script's targets (or to the
/// start position) and stay within the reach. The joints that carry the hand follow it.
#[derive(Debug)]
pub struct LearnEnv {
    task: Arc<LearnTask>,
    env: GraspEnv,
    rng: ChaCha8Rng,
    judge: Judge,
    actor: ActorState,
    /// Joint positions as the actor reads them.
    read_positions: Vec<f64>,
    /// Whether they are where the joints were sent instead.
    tracking_hidden: bool,
    push: Push,
    /// Whether pushes begin.
    is_pushed: bool,
    privileged: Privileged,
    terms: [f64; REWARD_TERMS.len()],
}

/// What a trial of a policy is like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Conditions {
    /// That of [`crate::trial`]: the object begins on a stable side, and nothing pushes it.
    Evaluation,
    /// That of training: orientations and pushes are those of [`super::LearnConfig`].
    Training,
}

/// A force that lasts.
#[derive(Clone, Debug, Default)]
struct Push {
    force_n: Vector3<f64>,
    left_s: f64,
}

/// What only a simulator knows.
#[derive(Clone, Debug, Default)]
struct Privileged {
    contacts: Contacts,
    velocities: Vec<f64>,
    base_from_object: Isometry3<f64>,
    hand_pos_in_base: Point3<f64>,
    object_velocity: [Vector3<f64>; 2],
    lift_m: f64,
    tips_in_object: Vec<Point3<f64>>,
    tip_distances_m: Vec<f64>,
}

impl LearnEnv {
    /// An environment at the nominal start that draws from `rng`.
    pub(super) fn new(task: Arc<LearnTask>, rng: ChaCha8Rng) -> Result<Self, GraspError> {
        let env = GraspEnv::new(Arc::clone(&task.scene), 0, 0)?;
        let judge = Judge::new(env.world(), task.scene.config().task.episode_s);
        let num_dofs = env.positions().len();
        let mut this = Self {
            judge,
            rng,
            actor: ActorState::begin(&task.actor, env.targets()),
            read_positions: vec![0.0; num_dofs],
            tracking_hidden: false,
            push: Push::default(),
            is_pushed: true,
            privileged: Privileged { velocities: vec![0.0; num_dofs], ..Privileged::default() },
            terms: [0.0; REWARD_TERMS.len()],
            env,
            task,
        };
        this.forget();
        Ok(this)
    }

    /// An environment for trials, which has not begun yet: [`Self::begin_trial`] comes first.
    pub fn for_trials(task: Arc<LearnTask>) -> Result<Self, GraspError> {
        Self::new(task, stream(0, 0))
    }

    /// Begins trial number `trial` of those with `seed`, whatever happened before. The region of starts is that of the grasp
    /// world's task. Under [`Conditions::Evaluation`] it is the world in which [`crate::trial::run`] tries a script.
    pub fn begin_trial(&mut self, seed: u64, trial: u64, conditions: Conditions) -> Result<(), GraspError> {
        let task = Arc::clone(&self.task);
        let half_width_m = task.scene.config().task.half_width_m;
        self.rng = stream(seed, trial);
        self.is_pushed = conditions == Conditions::Training;
        let any_orientation = self.is_pushed && task.config().start.any_orientation;
        let start = Start::draw_within(&task.scene, half_width_m, any_orientation, &mut self.rng);
        self.begin(&start)
    }

    /// Whether from the next episode on every joint seems to be where it was sent, so that tracking errors tell the actor
    /// nothing.
    pub fn hide_tracking(&mut self, hidden: bool) {
        self.tracking_hidden = hidden;
    }

    /// Draws from `rng` from now on.
    pub(super) fn set_rng(&mut self, rng: ChaCha8Rng) {
        self.rng = rng;
    }

    /// Begins a new episode with a drawn start, within `half_width_m` of the middle of the region.
    pub fn reset(&mut self, half_width_m: f64) -> Result<(), GraspError> {
        let any_orientation = self.task.config().start.any_orientation;
        let start = Start::draw_within(&self.task.scene, half_width_m, any_orientation, &mut self.rng);
        self.begin(&start)
    }

    /// Begins a new episode at `start`.
    pub fn begin(&mut self, start: &Start) -> Result<(), GraspError> {
        self.env.begin(start)?;
        self.forget();
        Ok(())
    }

    /// An episode begins where the environment is.
    fn forget(&mut self) {
        self.judge = Judge::new(self.env.world(), self.task.scene.config().task.episode_s);
        self.actor = ActorState::begin(&self.task.actor, self.env.targets());
        self.push = Push::default();
        self.terms = [0.0; REWARD_TERMS.len()];
        self.look();
    }

    /// One control step with `action`, one number per [`super::ObservationLayout::action`]; beyond -1 to 1 they count as the
    /// nearest of the two. How the episode ended, if it did. A simulation that diverges ends it with an emergency stop.
    ///
    /// # Panics
    /// If `action` has the wrong length: a caller's bug.
    pub fn step(&mut self, action: &[f32]) -> Result<Option<Outcome>, GraspError> {
        self.actor.act(&self.task.actor, action, self.env.sensed());
        self.disturb();
        let outcome = match self.env.step(self.actor.targets()) {
            Err(GraspError::Diverged { .. }) => Some(Outcome::EmergencyStop),
            other => {
                other?;
                self.look();
                self.judge.look(self.task.scene.config(), self.env.world(), &self.privileged.contacts)
            }
        };
        let seen = &self.privileged;
        self.terms = self.task.config().reward.terms(&Facts {
            tip_distances_m: &seen.tip_distances_m,
            grasped: self.task.grasps(seen.contacts.digits),
            lift_m: seen.lift_m,
            action: self.actor.action(),
            on_table: seen.contacts.robot_table_n > 0.0,
            success: outcome == Some(Outcome::Success),
            stopped: outcome == Some(Outcome::EmergencyStop),
        });
        Ok(outcome)
    }

    /// Begins and ends pushes.
    fn disturb(&mut self) {
        if !self.is_pushed {
            return;
        }
        let config = &self.task.config().push;
        if self.push.left_s > 0.0 {
            self.push.left_s -= 1.0 / self.task.scene.config().control_rate_hz;
        } else {
            let (begins, rng) = (self.rng.random::<f64>() < config.probability, &mut self.rng);
            let force_n = Vector3::from_fn(|_, _| config.force_n * (2.0 * rng.random::<f64>() - 1.0));
            self.push = if begins { Push { force_n, left_s: config.duration_s } } else { Push::default() };
        }
        self.env.push(&self.push.force_n);
    }

    /// Reads everything that observations and rewards are made of.
    fn look(&mut self) {
        let task = Arc::clone(&self.task);
        let noise = task.config().observation.position_noise;
        for (read, &position) in self.read_positions.iter_mut().zip(self.env.positions()) {
            *read = position + noise * (2.0 * self.rng.random::<f64>() - 1.0);
        }
        if self.tracking_hidden {
            self.read_positions.copy_from_slice(self.env.targets());
        }
        let world = self.env.world();
        let mut frames = Vec::new();
        task.scene.station().robot.forward_kinematics(self.env.positions(), &mut frames);
        let seen = &mut self.privileged;
        seen.contacts = world.contacts();
        world.velocities_into(&mut seen.velocities);
        seen.base_from_object = world.base_from_object();
        seen.hand_pos_in_base = frames[task.actor.hand_root].translation.vector.into();
        seen.object_velocity = world.object_velocity().into();
        seen.lift_m = self.judge.lift_m(world);
        let object_from_base = seen.base_from_object.inverse();
        let in_object = |&link: &usize| object_from_base * Point3::from(frames[link].translation.vector);
        seen.tips_in_object = task.actor.tips.iter().map(in_object).collect();
        seen.tip_distances_m = seen.tips_in_object.iter().map(|tip| task.object.distance_m(tip)).collect();
    }

    /// The actor's observation into `actor` and the critic's into `critic`, laid out as [`LearnTask::layout`] says.
    ///
    /// # Panics
    /// If either has the wrong length: a caller's bug.
    pub fn observe(&self, actor: &mut [f32], critic: &mut [f32]) {
        let layout = self.task.layout();
        assert_eq!(critic.len(), layout.critic_dim(), "room for the critic");
        let on = |on: bool| f64::from(u8::from(on));
        let active = &self.env.readings().active;
        self.actor.observe(&self.task.actor, &self.read_positions, active, self.env.time_s(), actor);

        let (shared, privileged) = critic.split_at_mut(actor.len());
        shared.copy_from_slice(actor);
        let seen = &self.privileged;
        let rotation = seen.base_from_object.rotation.to_rotation_matrix();
        let from_hand = seen.base_from_object.translation.vector - seen.hand_pos_in_base.coords;
        let contacts = &seen.contacts;
        let of_critic = self
            .env
            .positions()
            .iter()
            .chain(&seen.velocities)
            .chain(from_hand.iter())
            .chain(rotation.matrix().iter().take(6))
            .chain(seen.object_velocity.iter().flatten())
            .copied()
            .chain([seen.lift_m])
            .chain(seen.tips_in_object.iter().flat_map(|tip| [tip.x, tip.y, tip.z]))
            .chain(seen.tip_distances_m.iter().copied())
            .chain((0..self.task.actor.tips.len()).map(|digit| on(contacts.digits >> digit & 1 == 1)))
            .chain([contacts.robot_object_n, contacts.robot_table_n, contacts.object_table_n])
            .chain(self.push.force_n.iter().copied());
        privileged.iter_mut().zip(of_critic).for_each(|(into, value)| *into = value as f32);
    }

    /// Terms of the last step's reward, as [`REWARD_TERMS`] names them.
    pub fn terms(&self) -> &[f64; REWARD_TERMS.len()] {
        &self.terms
    }

    /// How far each target moved in the last step, rad or m: what demonstrations record as the action.
    pub fn target_increments(&self) -> Vec<f64> {
        self.actor.target_increments()
    }

    /// The last action, each number within -1 to 1; zeros before the first.
    pub fn action(&self) -> &[f64] {
        self.actor.action()
    }

    /// Joint positions as the actor reads them, with noise, rad or m.
    pub fn read_positions(&self) -> &[f64] {
        &self.read_positions
    }

    /// The grasp environment inside.
    pub fn grasp(&self) -> &GraspEnv {
        &self.env
    }
}
