//! Scores a policy.

pub(crate) mod args;

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::bail;
use palpate_grasp::learn::{Conditions, LearnEnv};
use palpate_grasp::trial::{Outcome, Score};
use palpate_sim::job::Progress as _;
use palpate_terminal::Bar;
use rayon::prelude::*;

pub(crate) use self::args::EvaluateArgs;
use crate::policy::Policy;
use crate::task;
use crate::{compare, script};

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
