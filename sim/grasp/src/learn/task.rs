//! What environments of one task share.

use std::sync::Arc;

use palpate_sim::geometry::SignedDistance;

use super::{Bounds, LearnConfig, ObservationLayout};
use crate::hand::carrier_dofs;
use crate::scene::digits;
use crate::{GraspError, GraspScene, Script, ScriptRun, Sensed};

/// A scene, what is learned in it, and the script that actions are added to.
#[derive(Debug)]
pub struct LearnTask {
    pub(super) scene: Arc<GraspScene>,
    pub(super) script: Option<Script>,
    pub(super) config: LearnConfig,
    pub(super) layout: ObservationLayout,
    pub(super) hand_root: usize,
    pub(super) hand_dofs: Vec<usize>,
    pub(super) carrier_dofs: Vec<usize>,
    /// Of every degree of freedom, unbounded without limits.
    pub(super) limits: Vec<(f64, f64)>,
    /// The last link of each digit.
    pub(super) tips: Vec<usize>,
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
        let tips: Vec<usize> = (0..num_digits)
            .filter_map(|digit| of_links.iter().rposition(|of_link| *of_link == Some(digit)))
            .collect();
        let names: Vec<String> = tips.iter().map(|&link| robot.links[link].name.clone()).collect();
        let hand_dofs: Vec<usize> = (0..robot.num_dofs()).filter(|&dof| scene.dofs_in_hand()[dof]).collect();
        let limits = robot.dofs().map(|joint| {
            joint.limits.map_or((f64::NEG_INFINITY, f64::INFINITY), |limits| (limits.lower, limits.upper))
        });
        Ok(Self {
            layout: ObservationLayout::new(station, &hand_dofs, &names),
            hand_root: robot.link_index(&scene.config().hand_root).unwrap_or(0),
            carrier_dofs: carrier_dofs(robot, scene.config()),
            limits: limits.collect(),
            opposing: 1 << opposing,
            object: SignedDistance::new(&scene.object().shape).map_err(GraspError::Scene)?,
            tips,
            hand_dofs,
            config,
            script,
            scene,
        })
    }

    /// Its scene.
    pub fn scene(&self) -> &Arc<GraspScene> {
        &self.scene
    }

    /// Its file.
    pub fn config(&self) -> &LearnConfig {
        &self.config
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

    /// The script at its beginning.
    pub(super) fn begin_script(&self) -> Option<ScriptRun> {
        self.script.as_ref().map(ScriptRun::new)
    }

    /// Targets that actions are added to, as `run` of [`Self::begin_script`] has them now.
    pub(super) fn base_targets(&self, run: &mut Option<ScriptRun>, now: Sensed<'_>) -> Vec<f64> {
        let (station, config) = (self.scene.station(), self.scene.config());
        match (&self.script, run) {
            (Some(script), Some(run)) => run.targets(script, station, config, now),
            _ => config.start_positions(&station.robot),
        }
    }

    /// Whether these digits, as [`crate::Contacts::digits`] has them, make a grasp: the opposing one and two others.
    pub(super) fn grasps(&self, digits: u64) -> bool {
        digits & self.opposing != 0 && digits.count_ones() >= 3
    }
}
