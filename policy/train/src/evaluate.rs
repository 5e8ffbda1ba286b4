//! Scores a policy.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::bail;
use palpate_grasp::learn::{Conditions, LearnEnv};
use palpate_grasp::trial::{Outcome, Score};
use palpate_sim::job::Progress as _;
use rayon::prelude::*;

use crate::policy::Policy;
use crate::script;
use crate::task::{self, TaskArgs};
use palpate_terminal::Bar;

#[derive(clap::Args)]
pub(crate) struct EvaluateArgs {
    #[command(flatten)]
    task: TaskArgs,
    /// A training's folder, a checkpoint or an exported policy
    #[arg(long)]
    policy: PathBuf,
    /// Number of trials
    #[arg(long, allow_negative_numbers = true, default_value_t = 50)]
    trials: u64,
    /// Seed of starts, randomised physics and noise of readings
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(crate) fn run(args: &EvaluateArgs) -> anyhow::Result<()> {
    if args.trials == 0 {
        bail!("--trials is 0, expected at least 1");
    }
    let opened = task::open(&args.task)?;
    let (policy, _) = Policy::open(&args.policy, &opened)?;
    let task = &opened.task;
    let (bar, done) = (Bar::new(), AtomicU64::new(0));
    let outcomes: Vec<Outcome> = (0..args.trials)
        .into_par_iter()
        .map_init(
            || LearnEnv::for_trials(task.clone()),
            |env, trial| {
                let env = env.as_mut().map_err(|err| err.clone())?;
                env.begin_trial(args.seed, trial, Conditions::Evaluation)?;
                let outcome = policy.run(env, &mut ())?;
                let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                bar.report(done as f64 / args.trials as f64, "trials");
                Ok(outcome)
            },
        )
        .collect::<anyhow::Result<_>>()?;
    drop(bar);
    script::print(task.scene(), Score::of(&outcomes), args.task.scene.json)
}
