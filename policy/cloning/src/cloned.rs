//! The policy that comes out.

use std::{collections::BTreeMap, sync::Arc};

use burn_tensor::{Device, Tensor, TensorData};
use palpate_training::{fill_normal, generator};

use crate::episodes::EncoderFile;
use crate::network::Network;
use crate::pass::values;
use crate::scaling::Scaling;
use crate::schedule::Schedule;
use crate::{CloneConfig, CloneError, Head, History, JointValues, Moment, Shape};

/// What noise is for: chunks that are drawn.
const DRAWN: u64 = 6;
/// The claim that the object is held, 0 or 1, counts from here on.
const CLAIM: f64 = 0.5;

/// The robot that a policy is for, by the names of its parts.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Degrees of freedom, in the order of positions and commands.
    pub joints: Vec<String>,
    /// Touch channels, in their order.
    pub channels: Vec<String>,
    /// Control steps a second, Hz: a step of a chunk lasts as long.
    pub control_rate_hz: f64,
}

impl Robot {
    /// Its sizes, without the features of an encoder.
    pub fn shape(&self) -> Shape {
        Shape { dofs: self.joints.len(), channels: self.channels.len(), features: 0 }
    }

    /// Whether `other` has the same joints and channels in the same order, and is controlled as often.
    ///
    /// # Errors
    /// The first that is another.
    pub fn check(&self, other: &Self) -> Result<(), CloneError> {
        for (what, own, theirs) in
            [("joint", &self.joints, &other.joints), ("channel", &self.channels, &other.channels)]
        {
            if own.len() != theirs.len() {
                return Err(CloneError::Shape(format!(
                    "the policy knows {} {what}s, the robot has {}",
                    own.len(),
                    theirs.len()
                )));
            }
            if let Some((own, theirs)) = own.iter().zip(theirs).find(|(own, theirs)| own != theirs) {
                return Err(CloneError::Shape(format!(
                    "the policy was made for the {what} {own:?} where the robot has {theirs:?}"
                )));
            }
        }
        if self.control_rate_hz != other.control_rate_hz {
            return Err(CloneError::Shape(format!(
                "the policy was made for {} control steps a second, the robot has {}",
                self.control_rate_hz, other.control_rate_hz
            )));
        }
        Ok(())
    }
}

/// One step of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Where each joint goes, rad or m.
    pub targets: Vec<f64>,
    /// Whether the policy says that it holds the object.
    pub claims_held: bool,
}

/// A policy that imitates an expert.
#[derive(Clone, Debug)]
pub struct Cloned {
    pub(crate) config: CloneConfig,
    pub(crate) robot: Robot,
    pub(crate) inputs: Scaling,
    pub(crate) chunks: Scaling,
    pub(crate) network: Network,
    pub(crate) updates: u64,
    pub(crate) sources: BTreeMap<String, String>,
    pub(crate) encoder: Option<Arc<EncoderFile>>,
    tensors: Vec<Tensor<2>>,
    schedule: Schedule,
}

impl Cloned {
    pub(crate) fn new(
        config: CloneConfig,
        robot: Robot,
        [inputs, chunks]: [Scaling; 2],
        network: Network,
        updates: u64,
        sources: BTreeMap<String, String>,
        encoder: Option<Arc<EncoderFile>>,
    ) -> Self {
        let tensors = network.tensors(&Device::flex());
        let schedule = Schedule::cosine(config.diffusion.steps);
        Self { config, robot, inputs, chunks, network, updates, sources, encoder, tensors, schedule }
    }

    /// How it was trained.
    pub fn config(&self) -> &CloneConfig {
        &self.config
    }

    /// The robot that it is for.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// Updates that it was trained for.
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// What its episodes were made from, by name.
    pub fn sources(&self) -> &BTreeMap<String, String> {
        &self.sources
    }

    /// What makes the features that it wants in each [`Moment`]; nothing if it wants none.
    pub fn encoder(&self) -> Option<&Arc<EncoderFile>> {
        self.encoder.as_ref()
    }

    /// Sizes of what it sees.
    pub fn shape(&self) -> Shape {
        let encoded = self.encoder.as_ref().map_or(0, |encoder| encoder.num_features);
        self.robot.shape().seen(&self.config.observation, encoded)
    }

    /// A window in which nothing has been seen yet, in a trial whose object begins within `half_width_m` of the middle, along
    /// both axes, m; `None` where nobody knows.
    ///
    /// # Errors
    /// A policy that sees the region, and a region that is unknown or no length.
    pub fn history(&self, half_width_m: Option<f64>) -> Result<History, CloneError> {
        let problem = match half_width_m {
            _ if !self.config.observation.region => None,
            None => Some("nobody says how wide that is".to_owned()),
            Some(half_width_m) => (!(half_width_m.is_finite() && half_width_m >= 0.0)).then(|| {
                format!("its half-width is {half_width_m} m, expected a finite number, not negative")
            }),
        };
        if let Some(problem) = problem {
            return Err(CloneError::Shape(format!(
                "the policy sees the region that the object begins in (observation.region), but {problem}"
            )));
        }
        let half_width_m = half_width_m.map(|half_width_m| half_width_m as f32);
        Ok(History::new(self.config.observation.clone(), self.shape(), half_width_m))
    }

    /// The whole chunk (`predicted` steps) from what was seen, with the robot sent to `commands` last (rad or m).
    /// Diffusion draws it: `draw` are two numbers, such as a trial and a step, that say which draw; the same numbers
    /// give the same chunk.
    ///
    /// # Errors
    /// Predictions that are no numbers.
    pub fn plan(&self, seen: &History, commands: &[f64], draw: [u64; 2]) -> Result<Vec<Plan>, CloneError> {
        let device = Device::flex();
        let row = |values: Vec<f32>| {
            let len = values.len();
            Tensor::<2>::from_data(TensorData::new(values, [1, len]), &device)
        };
        let input = self.inputs.apply(&seen.observation()).collect();
        let input = row(input);
        let features = self.network.trunk(&self.tensors, input.clone());
        let chunk = match self.network.head() {
            Head::Regression => values(self.network.regress(&self.tensors, features)),
            Head::Act => {
                let style = self.network.usual_style(1, &device);
                values(self.network.chunks_in_style(&self.tensors, features, input, style))
            }
            Head::Diffusion => {
                let mut chunk = vec![0.0; self.network.chunk_len()];
                fill_normal(&mut generator(self.config.seed, DRAWN, draw[0], draw[1]), &mut chunk);
                let predicts = self.config.diffusion.predicts();
                let steps = self.schedule.sampled(self.config.diffusion.sampled_steps, predicts);
                for (idx, &step) in steps.iter().enumerate() {
                    let noisy = row(chunk.clone());
                    let predicted = self.network.of_noisy(&self.tensors, features.clone(), noisy, &[step]);
                    let next = steps.get(idx + 1).copied();
                    self.schedule.denoise(&mut chunk, &values(predicted), predicts, step, next);
                }
                chunk
            }
        };
        let chunk: Vec<f64> = self.chunks.undo(&chunk).collect();
        if let Some(value) = chunk.iter().find(|value| !value.is_finite()) {
            return Err(CloneError::Shape(format!("the policy predicts {value}, expected finite numbers")));
        }
        let from: Vec<f64> = match self.config.relative_to {
            JointValues::Commands => commands.to_vec(),
            JointValues::Positions => {
                let tracking = seen.tracking().iter().map(|&tracking| f64::from(tracking));
                commands.iter().zip(tracking).map(|(command, tracking)| command - tracking).collect()
            }
        };
        let step = |action: &[f64]| Plan {
            targets: action.iter().zip(&from).map(|(off, from)| from + off).collect(),
            claims_held: action.last().is_some_and(|&claim| claim > CLAIM),
        };
        Ok(chunk.chunks_exact(self.robot.shape().action_len()).map(step).collect())
    }
}

/// A policy at work in one trial: it carries out a few steps of a chunk, then looks again.
#[derive(Clone, Debug)]
pub struct Run {
    policy: Arc<Cloned>,
    history: History,
    /// What is left of the chunk, the next step last.
    plan: Vec<Plan>,
    trial: u64,
    step: u64,
}

impl Run {
    /// A trial begins, in a region of `half_width_m` ([`Cloned::history`]). Diffusion draws other chunks in a trial with
    /// another number.
    ///
    /// # Errors
    /// See [`Cloned::history`].
    pub fn new(policy: Arc<Cloned>, trial: u64, half_width_m: Option<f64>) -> Result<Self, CloneError> {
        Ok(Self { history: policy.history(half_width_m)?, policy, plan: Vec::new(), trial, step: 0 })
    }

    /// What the robot does in the control step that begins now. Each step has to be asked for.
    ///
    /// # Errors
    /// Predictions that are no numbers.
    pub fn next(&mut self, now: &Moment<'_>) -> Result<Plan, CloneError> {
        self.history.see(now);
        let step = self.step;
        self.step += 1;
        if let Some(next) = self.plan.pop() {
            return Ok(next);
        }
        let mut chunk = self.policy.plan(&self.history, now.commands, [self.trial, step])?;
        chunk.truncate(self.policy.config.executed);
        chunk.reverse();
        let next = chunk.pop();
        self.plan = chunk;
        next.ok_or_else(|| CloneError::Shape("the policy predicts no step".to_owned()))
    }
}
