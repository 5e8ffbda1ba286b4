//! The actor's side of the task, the same on a robot as in simulation: from actions to targets, from readings to
//! observations.

use std::sync::Arc;

use palpate_robot_model::Station;

use super::{Bounds, LearnConfig, ObservationLayout};
use crate::hand::{HandMove, bring, carrier_dofs};
use crate::scene::{digits, links_of_hand};
use crate::{GraspConfig, Script, ScriptRun, Sensed};

/// What an actor needs to know of the task: robot, world file, script, how far actions reach. No physics is part of it.
#[derive(Debug)]
pub struct ActorTask {
    pub(super) station: Arc<Station>,
    pub(super) world: GraspConfig,
    pub(super) script: Option<Script>,
    pub(super) config: LearnConfig,
    pub(super) layout: ObservationLayout,
    pub(super) hand_root: usize,
    pub(super) hand_dofs: Vec<usize>,
    pub(super) carrier_dofs: Vec<usize>,
    /// Of every degree of freedom, unbounded without limits.
    pub(super) limits: Vec<(f64, f64)>,
    /// The last link of each digit, for critics.
    #[cfg(feature = "mujoco")]
    pub(super) tips: Vec<usize>,
}

impl ActorTask {
    /// With a script, actions are residuals on it; without, they start from where the robot waits.
    pub fn new(
        station: Arc<Station>,
        world: GraspConfig,
        script: Option<Script>,
        config: LearnConfig,
    ) -> Self {
        let robot = &station.robot;
        let of_links = digits(robot, &world);
        let num_digits = of_links.iter().flatten().max().map_or(0, |last| last + 1);
        let tips: Vec<usize> = (0..num_digits)
            .filter_map(|digit| of_links.iter().rposition(|of_link| *of_link == Some(digit)))
            .collect();
        let names: Vec<String> = tips.iter().map(|&link| robot.links[link].name.clone()).collect();
        let link_in_hand = links_of_hand(robot, &world);
        let joints = robot.dofs().enumerate();
        let hand_dofs: Vec<usize> =
            joints.filter(|(_, joint)| link_in_hand[joint.child_link]).map(|(dof, _)| dof).collect();
        let limits = robot.dofs().map(|joint| {
            joint.limits.map_or((f64::NEG_INFINITY, f64::INFINITY), |limits| (limits.lower, limits.upper))
        });
        Self {
            layout: ObservationLayout::new(&station, &hand_dofs, &names),
            hand_root: robot.link_index(&world.hand_root).unwrap_or(0),
            carrier_dofs: carrier_dofs(robot, &world),
            limits: limits.collect(),
            #[cfg(feature = "mujoco")]
            tips,
            hand_dofs,
            config,
            script,
            world,
            station,
        }
    }

    /// Its station.
    pub fn station(&self) -> &Arc<Station> {
        &self.station
    }

    /// Its world file.
    pub fn world(&self) -> &GraspConfig {
        &self.world
    }

    /// Which number of an observation or action is what.
    pub fn layout(&self) -> &ObservationLayout {
        &self.layout
    }

    /// How far actions reach.
    pub fn bounds(&self) -> &Bounds {
        match self.script {
            Some(_) => &self.config.action.residual,
            None => &self.config.action.free,
        }
    }

    /// Targets that actions are added to, as `run` of the script has them now.
    fn base_targets(&self, run: &mut Option<ScriptRun>, now: Sensed<'_>) -> Vec<f64> {
        match (&self.script, run) {
            (Some(script), Some(run)) => run.targets(script, &self.station, &self.world, now),
            _ => self.world.start_positions(&self.station.robot),
        }
    }
}

/// What an actor remembers of an episode: where its actions have brought it, what it commanded, what it has touched.
#[derive(Clone, Debug)]
pub struct ActorState {
    script: Option<ScriptRun>,
    /// Of each hand joint, rad.
    offsets: Vec<f64>,
    hand: HandMove,
    targets: Vec<f64>,
    /// Targets before the last step.
    targets_before: Vec<f64>,
    action: Vec<f64>,
    /// What is left of touches before the current one, 0 to 1.
    past_touch: Vec<f64>,
}

impl ActorState {
    /// An episode begins with the robot told to be at `positions`.
    ///
    /// # Panics
    /// If `positions` has the wrong length: a caller's bug.
    pub fn begin(task: &ActorTask, positions: &[f64]) -> Self {
        assert_eq!(positions.len(), task.limits.len(), "one position per degree of freedom");
        Self {
            script: task.script.as_ref().map(ScriptRun::new),
            offsets: vec![0.0; task.hand_dofs.len()],
            hand: HandMove::default(),
            targets: positions.to_vec(),
            targets_before: positions.to_vec(),
            action: vec![0.0; task.layout.action_dim()],
            past_touch: vec![0.0; task.station.layout.num_channels()],
        }
    }

    /// Takes `action` (one number per [`ObservationLayout::action`]; beyond -1 to 1 they count as the nearest of the two) at
    /// the moment `now`; gives the targets of the control step that begins, one per degree of freedom, rad or m.
    ///
    /// # Panics
    /// If `action` has the wrong length: a caller's bug.
    pub fn act(&mut self, task: &ActorTask, action: &[f32], now: Sensed<'_>) -> &[f64] {
        assert_eq!(action.len(), self.action.len(), "one number per action");
        for (past, &on) in self.past_touch.iter_mut().zip(now.active) {
            *past = task.config.observation.touch_memory * past.max(f64::from(u8::from(on)));
        }
        self.action.iter_mut().zip(action).for_each(|(own, given)| *own = f64::from(*given).clamp(-1.0, 1.0));
        let targets = self.next_targets(task, now);
        self.targets_before = std::mem::replace(&mut self.targets, targets);
        &self.targets
    }

    /// Offsets after the action, and the targets that they give.
    fn next_targets(&mut self, task: &ActorTask, now: Sensed<'_>) -> Vec<f64> {
        let bounds = task.bounds();
        let (of_hand, of_root) = self.action.split_at(task.hand_dofs.len());
        let mut targets = task.base_targets(&mut self.script, now);
        for ((offset, &dof), action) in self.offsets.iter_mut().zip(&task.hand_dofs).zip(of_hand) {
            let moved = *offset + bounds.hand_step_rad * action;
            *offset = moved.clamp(-bounds.hand_reach_rad, bounds.hand_reach_rad);
            let (lower, upper) = task.limits[dof];
            targets[dof] = (targets[dof] + *offset).clamp(lower, upper);
        }
        let mut hand = self.hand.clone();
        for (axis, action) in of_root.iter().take(3).enumerate() {
            let reach_m = bounds.arm_reach_m[axis];
            hand.offset_m[axis] = (hand.offset_m[axis] + bounds.arm_step_m * action).clamp(-reach_m, reach_m);
        }
        let turned = hand.yaw_rad + bounds.yaw_step_rad * of_root.last().copied().unwrap_or_default();
        hand.yaw_rad = turned.clamp(-bounds.yaw_reach_rad, bounds.yaw_reach_rad);
        if hand == HandMove::default() {
            self.hand = hand;
            return targets;
        }
        let robot = &task.station.robot;
        let mut frames = Vec::new();
        robot.forward_kinematics(&targets, &mut frames);
        let base_from_hand = hand.pose(&task.world, &frames[task.hand_root]);
        // From where the carriers were sent last, so that they stay in the same posture.
        let mut reached = targets.clone();
        for &dof in &task.carrier_dofs {
            reached[dof] = self.targets[dof];
        }
        if bring(robot, task.hand_root, &base_from_hand, &mut reached, &mut frames) {
            self.hand = hand;
            return reached;
        }
        // Out of reach: the carriers stay, and the offset does not run away.
        for &dof in &task.carrier_dofs {
            targets[dof] = self.targets[dof];
        }
        targets
    }

    /// The actor's observation into `into`, laid out as [`ActorTask::layout`] says, with the joints read at `positions`
    /// (rad or m), channels that are `active`, and `time_s` since the episode began.
    ///
    /// # Panics
    /// If `into` has the wrong length: a caller's bug.
    pub fn observe(
        &self,
        task: &ActorTask,
        positions: &[f64],
        active: &[bool],
        time_s: f64,
        into: &mut [f32],
    ) {
        assert_eq!(into.len(), task.layout.actor_dim(), "room for the actor");
        let errors = self.targets.iter().zip(positions).map(|(command, read)| command - read);
        let values = positions
            .iter()
            .copied()
            .chain(self.targets.iter().copied())
            .chain(errors)
            .chain(active.iter().map(|&active| f64::from(u8::from(active))))
            .chain(self.past_touch.iter().copied())
            .chain(self.action.iter().copied())
            .chain([(time_s / task.world.task.episode_s).clamp(0.0, 1.0)]);
        into.iter_mut().zip(values).for_each(|(into, value)| *into = value as f32);
    }

    /// Targets of the last step; where the episode began before the first.
    pub fn targets(&self) -> &[f64] {
        &self.targets
    }

    /// How far each target moved in the last step, rad or m.
    pub fn target_increments(&self) -> Vec<f64> {
        self.targets.iter().zip(&self.targets_before).map(|(now, before)| now - before).collect()
    }

    /// The last action, each number within -1 to 1; zeros before the first.
    pub fn action(&self) -> &[f64] {
        &self.action
    }
}
