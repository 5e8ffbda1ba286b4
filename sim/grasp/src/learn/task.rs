//! What environments of one task share.

use std::sync::Arc;

use palpate_sim::geometry::SignedDistance;

use super::{ActorTask, Bounds, LearnConfig, ObservationLayout};
use crate::scene::digits;
use crate::{GraspError, GraspScene, Script};

/// A scene, what is learned in it, and the script that actions are added to.
#[derive(Debug)]
pub struct LearnTask {
    pub(super) scene: Arc<GraspScene>,
    pub(super) actor: ActorTask,
    /// The opposing digit in [`crate::Contacts::digits`].
    pub(super) opposing: u64,
    pub(super) object: SignedDistance,
}

impl LearnTask {
    /// With a script, actions are residuals on it; without, they start from where the robot waits.
    ///
    /// Refuses an opposing link that belongs to no digit, and hands of more than 64 digits.
    pub fn new(
        scene: Arc<GraspScene>,
        script: Option<Script>,
        config: LearnConfig,
    ) -> Result<Self, GraspError> {
        let station = scene.station();
        let robot = &station.robot;
        let of_links = digits(robot, scene.config());
        let num_digits = of_links.iter().flatten().max().map_or(0, |last| last + 1);
        if num_digits > u64::BITS as usize {
            return Err(GraspError::Scene(format!("the hand has {num_digits} digits, expected 64 at most")));
        }
        let opposing = robot.link_index(&config.opposing_link).and_then(|link| of_links[link]);
        let Some(opposing) = opposing else {
            return Err(GraspError::Scene(format!(
                "opposing_link names link {:?}, which belongs to no digit",
                config.opposing_link
            )));
        };
        Ok(Self {
            actor: ActorTask::new(Arc::clone(station), scene.config().clone(), script, config),
            opposing: 1 << opposing,
            object: SignedDistance::new(&scene.object().shape).map_err(GraspError::Scene)?,
            scene,
        })
    }

    /// Its scene.
    pub fn scene(&self) -> &Arc<GraspScene> {
        &self.scene
    }

    /// Its file.
    pub fn config(&self) -> &LearnConfig {
        &self.actor.config
    }

    /// The part of it that an actor needs, which hardware has too.
    pub fn actor(&self) -> &ActorTask {
        &self.actor
    }

    /// Which number of an observation or action is what.
    pub fn layout(&self) -> &ObservationLayout {
        &self.actor.layout
    }

    /// How far actions reach.
    pub fn bounds(&self) -> &Bounds {
        self.actor.bounds()
    }

    /// Whether these digits, as [`crate::Contacts::digits`] has them, make a grasp: the opposing one and two others.
    pub(super) fn grasps(&self, digits: u64) -> bool {
        digits & self.opposing != 0 && digits.count_ones() >= 3
    }
}
