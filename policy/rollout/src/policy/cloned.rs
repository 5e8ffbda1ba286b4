//! Policies that imitate an expert.

use std::collections::VecDeque;
use std::sync::Arc;

use anyhow::bail;
use palpate_cloning::{Cloned, History, Moment, Touch};
use palpate_grasp::GraspConfig;
use palpate_robot_model::Station;

use super::{Horizon, Policy, Seen, Step, newest};
use crate::features::{FeatureRun, Features};

/// A policy that imitates an expert: it plans a chunk of steps from a window of what was seen.
pub struct ClonedPolicy {
    policy: Arc<Cloned>,
    station: Arc<Station>,
    history: History,
    /// What makes the features that the policy sees, if it sees any.
    features: Option<FeatureRun>,
    /// Where the robot was sent in each step that the history has not seen yet; the last is where it was sent last.
    commands: VecDeque<Vec<f64>>,
    /// Half the edge length of the square that objects begin in, m, as far as somebody knows.
    half_width_m: Option<f64>,
    trial: u64,
    num_seen: u64,
}

impl ClonedPolicy {
    /// `policy` for the robot of `station` in `world`, where objects begin within `half_width_m` of the middle, along both
    /// axes, as far as somebody knows.
    ///
    /// # Errors
    /// A policy whose encoder is for another hand, by the name of what differs, that sees a region which nobody knows,
    /// or how strongly channels are touched, which no station tells.
    pub fn new(
        policy: Arc<Cloned>,
        station: Arc<Station>,
        world: &GraspConfig,
        half_width_m: Option<f64>,
    ) -> anyhow::Result<Self> {
        if policy.config().observation.strengths {
            bail!(
                "the policy sees how strongly channels are touched (observation.strengths), which only simulated touch tells; \
                 take a policy that sees events"
            );
        }
        let features = Features::of_policy(&policy, &station, world)?.map(FeatureRun::new);
        let history = policy.history(half_width_m)?;
        let commands = VecDeque::new();
        Ok(Self { policy, station, history, features, commands, half_width_m, trial: 0, num_seen: 0 })
    }
}

impl Policy for ClonedPolicy {
    fn horizon(&self) -> Horizon {
        let config = self.policy.config();
        Horizon { observations: config.executed, predicted: config.predicted, executed: config.executed }
    }

    fn begin(&mut self, positions: &[f64]) {
        // Refused when it was made, if at all.
        if let Ok(history) = self.policy.history(self.half_width_m) {
            self.history = history;
        }
        if let Some(features) = &mut self.features {
            features.begin();
        }
        self.commands = VecDeque::from([positions.to_vec()]);
        self.num_seen = 0;
        self.trial += 1;
    }

    fn plan(&mut self, seen: &VecDeque<Seen>) -> anyhow::Result<Vec<Step>> {
        newest(seen)?;
        // What was seen since the last plan, each beside the command that was in force; the window itself is the
        // history's.
        let num_new = self.commands.len().min(seen.len());
        let skipped = self.commands.len() - num_new;
        self.commands.drain(..skipped);
        for now in seen.iter().skip(seen.len() - num_new) {
            let commands = match self.commands.len() {
                0 | 1 => self.commands.front().cloned(),
                _ => self.commands.pop_front(),
            };
            let commands = commands.unwrap_or_else(|| now.positions.clone());
            let moment = Moment {
                time_s: now.time_s,
                positions: &now.positions,
                commands: &commands,
                touch: Touch::Events(&now.active),
                features: &[],
            };
            let features = match &mut self.features {
                Some(features) => features.see(&moment)?,
                None => Vec::new(),
            };
            self.history.see(&Moment { features: &features, ..moment });
            self.num_seen += 1;
        }
        let commands = self.commands.pop_back().unwrap_or_default();
        let chunk = self.policy.plan(&self.history, &commands, [self.trial, self.num_seen])?;
        let within = |targets: Vec<f64>| -> Vec<f64> {
            let joints = targets.into_iter().zip(&self.station.safety.joints);
            joints.map(|(target, limits)| target.clamp(limits.lower, limits.upper)).collect()
        };
        let steps: Vec<Step> = chunk
            .into_iter()
            .take(self.policy.config().executed)
            .map(|step| Step { action: Vec::new(), targets: within(step.targets) })
            .collect();
        self.commands = steps.iter().map(|step| step.targets.clone()).collect();
        Ok(steps)
    }
}
