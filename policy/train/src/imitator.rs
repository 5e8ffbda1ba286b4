//! A policy that imitates an expert, as what moves the robot in a trial.

use std::path::Path;
use std::sync::Arc;

use anyhow::Context as _;
use palpate_cloning::{Cloned, Moment, Plan, Run, Touch};
use palpate_grasp::GraspConfig;
use palpate_grasp::controller::{Command, Controller, Observation};
use palpate_robot_model::Station;
use palpate_rollout::features::{FeatureRun, Features};
use palpate_rollout::task::robot;

use crate::files::{self, Source};

/// A policy that imitates an expert, and what makes the features that it sees.
pub(crate) struct Imitation {
    policy: Arc<Cloned>,
    /// Nothing if it sees none.
    features: Option<Arc<Features>>,
}

/// The policy of a training's folder or of a file, if it is for the robot of `station` in `world`; and its file.
pub(crate) fn open(
    path: &Path,
    station: &Arc<Station>,
    world: &GraspConfig,
) -> anyhow::Result<(Imitation, Source)> {
    let (file, bytes, policy) = Cloned::read(path)?;
    let source =
        Source { role: "policy".to_owned(), path: files::shown(&file), sha256: files::sha256(&bytes) };
    policy.robot().check(&robot(station, world)).with_context(|| format!("{file:?} does not fit"))?;
    let features = Features::of_policy(&policy, station, world);
    let features = features.with_context(|| format!("{file:?} does not fit"))?;
    Ok((Imitation { policy: Arc::new(policy), features }, source))
}

/// What is observed, as a policy that imitates and episodes to learn from have it: with events, without features.
pub(crate) fn moment<'a>(now: &Observation<'a>) -> Moment<'a> {
    let &Observation { time_s, positions, commands, active, strengths: _, told_place_m: _ } = now;
    Moment { time_s, positions, commands, touch: Touch::Events(active), features: &[] }
}

/// A policy as what moves the robot in a trial.
pub(crate) struct Imitator {
    run: Run,
    sees_strengths: bool,
    features: Option<FeatureRun>,
    station: Arc<Station>,
    /// Why it stopped, if it did: a controller cannot fail.
    pub(crate) problem: Option<anyhow::Error>,
}

impl Imitator {
    /// In a trial whose object begins within `half_width_m` of the middle, along both axes.
    pub(crate) fn new(
        imitation: &Imitation,
        station: Arc<Station>,
        trial: u64,
        half_width_m: f64,
    ) -> anyhow::Result<Self> {
        let run = Run::new(Arc::clone(&imitation.policy), trial, Some(half_width_m))?;
        let sees_strengths = imitation.policy.config().observation.strengths;
        Ok(Self {
            run,
            sees_strengths,
            features: imitation.features.clone().map(FeatureRun::new),
            station,
            problem: None,
        })
    }

    fn plan(&mut self, now: &Observation<'_>) -> anyhow::Result<Plan> {
        let mut moment = moment(now);
        if self.sees_strengths {
            moment.touch = Touch::Strengths(now.strengths.context(
                "the policy sees how strongly channels are touched (observation.strengths), which a sensor model tells and a \
                 truth file does not",
            )?);
        }
        let features = match &mut self.features {
            Some(features) => features.see(&moment)?,
            None => Vec::new(),
        };
        Ok(self.run.next(&Moment { features: &features, ..moment })?)
    }
}

impl Controller for Imitator {
    fn control(&mut self, now: &Observation<'_>) -> Command {
        match self.plan(now) {
            Ok(plan) => {
                let joints = plan.targets.into_iter().zip(self.station.robot.dofs());
                let within = joints.map(|(target, joint)| match joint.limits {
                    Some(limits) => target.clamp(limits.lower, limits.upper),
                    None => target,
                });
                Command { targets: within.collect(), claims_held: plan.claims_held }
            }
            Err(err) => {
                self.problem.get_or_insert(err);
                Command { targets: now.commands.to_vec(), claims_held: false }
            }
        }
    }
}
