//! Demonstrations as bytes: a safetensors file, compressed as a whole by zstd, that other programs read as well.
//!
//! Steps of all demonstrations of a file follow one another; `first_steps` says where each begins, and ends with the number
//! of steps. A row is what held when the policy looked, and what it did then.

use anyhow::{Context as _, bail};
use palpate_grasp::learn::{LearnEnv, LearnTask, Segment};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};

use crate::policy::Watch;

const ZSTD_LEVEL: i32 = 9;
const FIRST_STEPS: &str = "first_steps";
const TRIALS: &str = "trials";

/// A tensor of a file, `[steps, columns]` unless it has no columns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Tensor {
    name: String,
    dtype: String,
    meaning: String,
    segments: Vec<Columned>,
}

/// Columns that belong together: `first..first + columns.len()`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Columned {
    name: String,
    unit: String,
    first: usize,
    columns: Vec<String>,
}

/// All tensors of a file.
pub(crate) struct Columns {
    tensors: Vec<Tensor>,
    /// Columns of each of [`STEP_TENSORS`].
    widths: [usize; STEP_TENSORS.len()],
}

/// What there is of every step.
const STEP_TENSORS: [(&str, &str); 6] = [
    ("actor_observations", "what the policy sees: what hardware has too"),
    ("actions", "what the policy does, each number within -1 to 1"),
    ("joint_increments", "commands after the step less commands before it: what follows from the action"),
    ("touch", "which channels are active; also the contact labels"),
    (
        "object_poses",
        "base_from_object: the object's points in the base frame follow from it and the object's file",
    ),
    (
        "privileged",
        "what only a simulator knows; the hand's points follow from exact_joint_positions and the station's robot file",
    ),
];

impl Columns {
    pub(crate) fn of(task: &LearnTask) -> Self {
        let layout = task.layout();
        let station = task.scene().station();
        let joints: Vec<String> = station.robot.dofs().map(|joint| joint.name.clone()).collect();
        let channels = station.layout.channels.iter().map(|channel| channel.id.to_string()).collect();
        let one = |name: &str, unit: &str, columns: Vec<String>| {
            vec![Columned { name: name.to_owned(), unit: unit.to_owned(), first: 0, columns }]
        };
        let of_layout = |segments: &[Segment]| {
            let begin = segments.first().map_or(0, |segment| segment.range.start);
            let columned = |segment: &Segment| Columned {
                name: segment.name.to_owned(),
                unit: segment.unit.to_owned(),
                first: segment.range.start - begin,
                columns: segment.entries.clone(),
            };
            segments.iter().map(columned).collect()
        };
        let pose = ["x", "y", "z", "qw", "qx", "qy", "qz"].map(str::to_owned).to_vec();
        let segments: [Vec<Columned>; STEP_TENSORS.len()] = [
            of_layout(&layout.actor),
            one("actions", "-1 to 1", layout.action.clone()),
            one("joint_increments", "rad or m", joints),
            one("touch", "0 or 1", channels),
            one("object_poses", "m, unit quaternion", pose),
            of_layout(&layout.privileged),
        ];
        let widths = segments.each_ref().map(|of| of.iter().map(|segment| segment.columns.len()).sum());
        let of_steps = STEP_TENSORS.iter().zip(segments).map(|((name, meaning), segments)| Tensor {
            name: (*name).to_owned(),
            dtype: "float32".to_owned(),
            meaning: (*meaning).to_owned(),
            segments,
        });
        let of_demos = [
            (FIRST_STEPS, "row at which each demonstration begins, and the number of rows"),
            (TRIALS, "number of the trial that each demonstration is; with the seed it says all about it"),
        ];
        let of_demos = of_demos.map(|(name, meaning)| Tensor {
            name: name.to_owned(),
            dtype: "int64".to_owned(),
            meaning: meaning.to_owned(),
            segments: Vec::new(),
        });
        Self { tensors: of_steps.chain(of_demos).collect(), widths }
    }

    /// Those that a manifest tells of.
    pub(crate) fn of_tensors(tensors: Vec<Tensor>) -> anyhow::Result<Self> {
        let mut widths = [0; STEP_TENSORS.len()];
        for (width, (name, _)) in widths.iter_mut().zip(STEP_TENSORS) {
            let tensor = tensors.iter().find(|tensor| tensor.name == name);
            let tensor = tensor.with_context(|| format!("it tells of no tensor {name}"))?;
            *width = tensor.segments.iter().map(|segment| segment.columns.len()).sum();
        }
        Ok(Self { tensors, widths })
    }

    pub(crate) fn tensors(&self) -> &[Tensor] {
        &self.tensors
    }

    /// The columns called `segment` of the tensor of steps called `tensor`.
    pub(crate) fn segment(&self, tensor: &'static str, segment: &str) -> anyhow::Result<Segmented<'_>> {
        let found = self
            .tensors
            .iter()
            .find(|one| one.name == tensor)
            .and_then(|tensor| tensor.segments.iter().find(|one| one.name == segment));
        let found = found.with_context(|| format!("tensor {tensor} has no columns {segment}"))?;
        let tensor =
            STEP_TENSORS.iter().position(|(name, _)| *name == tensor).context("a tensor of steps")?;
        Ok(Segmented { tensor, width: self.widths[tensor], columned: found })
    }
}

/// One trial, step by step.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Demonstration {
    pub(crate) trial: u64,
    pub(crate) num_steps: usize,
    /// Of each of [`STEP_TENSORS`], `[num_steps, columns]`.
    values: [Vec<f32>; STEP_TENSORS.len()],
}

/// Columns of a tensor of steps.
pub(crate) struct Segmented<'a> {
    /// Index in [`STEP_TENSORS`].
    tensor: usize,
    /// Columns of the tensor.
    width: usize,
    columned: &'a Columned,
}

impl Segmented<'_> {
    /// Names of the columns.
    pub(crate) fn columns(&self) -> &[String] {
        &self.columned.columns
    }

    /// These columns of all steps of `demonstration`, row by row.
    pub(crate) fn of(&self, demonstration: &Demonstration) -> Vec<f32> {
        let range = self.columned.first..self.columned.first + self.columned.columns.len();
        let rows = demonstration.values[self.tensor].chunks_exact(self.width);
        rows.flat_map(|row| &row[range.clone()]).copied().collect()
    }
}

/// Makes a demonstration of a trial under way.
pub(crate) struct Recorder {
    actor_dim: usize,
    demonstration: Demonstration,
}

impl Recorder {
    pub(crate) fn new(trial: u64, columns: &Columns) -> Self {
        Self {
            actor_dim: columns.widths[0],
            demonstration: Demonstration { trial, ..Demonstration::default() },
        }
    }

    pub(crate) fn into_demonstration(self) -> Demonstration {
        self.demonstration
    }
}

impl Watch for Recorder {
    fn before(&mut self, env: &LearnEnv, actor: &[f32], critic: &[f32]) {
        let [observations, _, _, touch, poses, privileged] = &mut self.demonstration.values;
        observations.extend(actor);
        touch.extend(env.grasp().readings().active.iter().map(|&active| f32::from(u8::from(active))));
        let pose = env.grasp().world().base_from_object();
        let (t, q) = (pose.translation.vector, pose.rotation);
        poses.extend([t.x, t.y, t.z, q.w, q.i, q.j, q.k].map(|value| value as f32));
        privileged.extend(&critic[self.actor_dim..]);
        self.demonstration.num_steps += 1;
    }

    fn after(&mut self, env: &LearnEnv) {
        let [_, actions, increments, ..] = &mut self.demonstration.values;
        actions.extend(env.action().iter().map(|&value| value as f32));
        increments.extend(env.target_increments().iter().map(|&value| value as f32));
    }
}

/// The bytes of a file.
pub(crate) fn encode(columns: &Columns, demonstrations: &[Demonstration]) -> anyhow::Result<Vec<u8>> {
    let num_steps: usize = demonstrations.iter().map(|one| one.num_steps).sum();
    let mut tensors = Vec::new();
    for (idx, (name, _)) in STEP_TENSORS.iter().enumerate() {
        let values = demonstrations.iter().flat_map(|one| &one.values[idx]);
        let bytes: Vec<u8> = values.flat_map(|value| value.to_le_bytes()).collect();
        tensors.push((*name, Dtype::F32, vec![num_steps, columns.widths[idx]], bytes));
    }
    let mut first_steps = vec![0_i64];
    for one in demonstrations {
        first_steps.push(first_steps[first_steps.len() - 1] + one.num_steps as i64);
    }
    let trials: Vec<i64> = demonstrations.iter().map(|one| one.trial as i64).collect();
    for (name, values) in [(FIRST_STEPS, first_steps), (TRIALS, trials)] {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        tensors.push((name, Dtype::I64, vec![values.len()], bytes));
    }
    let views = tensors
        .iter()
        .map(|(name, dtype, shape, bytes)| Ok((*name, TensorView::new(*dtype, shape.clone(), bytes)?)))
        .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()?;
    Ok(zstd::bulk::compress(&safetensors::serialize(views, None)?, ZSTD_LEVEL)?)
}

/// The demonstrations of a file.
pub(crate) fn decode(columns: &Columns, bytes: &[u8]) -> anyhow::Result<Vec<Demonstration>> {
    let bytes = zstd::decode_all(bytes).context("it is not compressed by zstd")?;
    let file = SafeTensors::deserialize(&bytes).context("it holds no safetensors")?;
    let numbers = |name: &str| -> anyhow::Result<Vec<i64>> {
        let view = file.tensor(name).with_context(|| format!("tensor {name}"))?;
        if view.dtype() != Dtype::I64 {
            bail!("tensor {name} is {:?}, expected I64", view.dtype());
        }
        Ok(view.data().as_chunks().0.iter().map(|bytes| i64::from_le_bytes(*bytes)).collect())
    };
    let (first_steps, trials) = (numbers(FIRST_STEPS)?, numbers(TRIALS)?);
    let last = usize::try_from(first_steps.last().copied().unwrap_or(0))?;
    if first_steps.len() != trials.len() + 1 || !first_steps.is_sorted() || first_steps[0] != 0 {
        bail!("{FIRST_STEPS} does not rise from 0, once for each of {} {TRIALS}", trials.len());
    }
    let mut demonstrations: Vec<Demonstration> = Vec::new();
    for (steps, trial) in first_steps.windows(2).zip(trials) {
        let num_steps = (steps[1] - steps[0]) as usize;
        demonstrations.push(Demonstration {
            trial: u64::try_from(trial)?,
            num_steps,
            ..Demonstration::default()
        });
    }
    for (idx, (name, _)) in STEP_TENSORS.iter().enumerate() {
        let view = file.tensor(name).with_context(|| format!("tensor {name}"))?;
        let (shape, width) = ([last, columns.widths[idx]], columns.widths[idx]);
        if view.dtype() != Dtype::F32 || view.shape() != shape {
            bail!("tensor {name} is {:?} {:?}, expected F32 {shape:?}", view.dtype(), view.shape());
        }
        let mut values = view.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
        for one in &mut demonstrations {
            one.values[idx] = values.by_ref().take(one.num_steps * width).collect();
        }
    }
    Ok(demonstrations)
}
