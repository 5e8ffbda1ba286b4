//! Scores a policy.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::bail;
use palpate_grasp::learn::{Conditions, LearnEnv};
use palpate_grasp::trial::{Outcome, Score};
use palpate_sim::job::Progress as _;
use rayon::prelude::*;

use crate::policy::Policy;
use crate::task::{self, TaskArgs};
use crate::{compare, script, search};
use palpate_terminal::Bar;

#[derive(clap::Args)]
pub(crate) struct EvaluateArgs {
    #[command(flatten)]
    pub(crate) task: TaskArgs,
    /// A training's folder, a checkpoint or an exported policy; under a protocol also "search", "search:touch",
    /// "search:tracking", "search:none", "script", "repetition", "oracle", or "clone:PATH" for a policy that imitates
    /// an expert, and {object} in a path stands for the object's name
    #[arg(long)]
    pub(crate) policy: String,
    /// Number of trials [default: the protocol's, or 50]
    #[arg(long, allow_negative_numbers = true)]
    pub(crate) trials: Option<u64>,
    /// Seed of starts, randomised physics and noise of readings [default: the protocol's, or 1]
    #[arg(long)]
    pub(crate) seed: Option<u64>,
    /// Compare under a protocol: a file, or a name in `assets/grasp/protocols`
    #[arg(long)]
    pub(crate) protocol: Option<String>,
    /// Objects of a comparison: "seen", "unseen", "all", or names or files with commas between [default: --object]
    #[arg(long, requires = "protocol")]
    pub(crate) objects: Option<String>,
    /// Compare with everything that a claim has to be compared with: script, blind repetition, an oracle, the policy
    /// silenced, with tracking errors hidden, with both
    #[arg(long, requires = "protocol")]
    pub(crate) controls: bool,
    /// Compare with this policy as well; may be given several times
    #[arg(long, requires = "protocol")]
    pub(crate) beside: Vec<String>,
    /// Every joint seems to be where it was sent
    #[arg(long, requires = "protocol")]
    pub(crate) hide_tracking: bool,
    /// How the searching expert tries to grasp
    #[arg(long, default_value = search::SEARCH)]
    pub(crate) search: PathBuf,
    /// Closings that it has learned from
    #[arg(long, default_value = search::CLOSINGS)]
    pub(crate) closings: PathBuf,
    /// The searching expert and the oracle know which of the shapes in the closings they look for
    #[arg(long, requires = "protocol")]
    pub(crate) know_shape: bool,
    /// Folder for the trials, a file an object: trials that are there already are not run again
    #[arg(long, requires = "protocol")]
    pub(crate) by_object: Option<PathBuf>,
    /// Folder for pictures (SVG): of each object the first trial that the policy won and the first that it lost, from above,
    /// with what was felt; of searching experts also what they believed
    #[arg(long, requires = "protocol")]
    pub(crate) pictures: Option<PathBuf>,
    /// Folder for films of the same trials: a session of takes, which the studio plays back and `palpate session check` opens
    #[arg(long, requires = "protocol")]
    pub(crate) films: Option<PathBuf>,
    /// Write the comparison with every trial to this file
    #[arg(long, requires = "protocol")]
    pub(crate) out: Option<PathBuf>,
}

pub(crate) fn run(args: &EvaluateArgs) -> anyhow::Result<()> {
    if args.trials == Some(0) {
        bail!("--trials is 0, expected at least 1");
    }
    if args.protocol.is_some() {
        return compare::run(args);
    }
    let (trials, seed) = (args.trials.unwrap_or(50), args.seed.unwrap_or(1));
    let opened = task::open(&args.task)?;
    let (policy, _) = Policy::open(Path::new(&args.policy), &opened)?;
    let task = &opened.task;
    let (bar, done) = (Bar::new(), AtomicU64::new(0));
    let outcomes: Vec<Outcome> = (0..trials)
        .into_par_iter()
        .map_init(
            || LearnEnv::for_trials(task.clone()),
            |env, trial| {
                let env = env.as_mut().map_err(|err| err.clone())?;
                env.begin_trial(seed, trial, Conditions::Evaluation)?;
                let outcome = policy.run(env, &mut ())?;
                let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                bar.report(done as f64 / trials as f64, "trials");
                Ok(outcome)
            },
        )
        .collect::<anyhow::Result<_>>()?;
    drop(bar);
    script::print(task.scene(), Score::of(&outcomes), args.task.scene.json)
}
