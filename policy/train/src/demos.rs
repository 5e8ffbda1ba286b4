//! Rolls out a policy and keeps what succeeds, as files to learn from.
//!
//! Trials are numbered from zero, and a trial follows from the seed and its number. Shards take the trials that succeed in
//! their order, so that the files are the same for any number of threads, and whether or not a run was interrupted.

pub(crate) mod manifest;
pub(crate) mod shard;

use std::collections::VecDeque;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, bail};
use palpate_grasp::learn::{Conditions, LearnEnv, LearnTask};
use palpate_grasp::trial::{Outcome, Score};
use palpate_sim::job::{Cancel, Progress as _};
use rayon::prelude::*;

use self::manifest::{MANIFEST_FILE, Manifest, Settings, ShardFile};
use self::shard::{Columns, Demonstration, Recorder};
use crate::files;
use crate::policy::Policy;
use crate::task::{self, TaskArgs};
use palpate_terminal::{Bar, cancel_on_ctrl_c, events};

/// Trials that are run together; what comes of them does not depend on it.
const BLOCK: u64 = 32;
/// Trials for each demonstration wanted, after which the policy is too bad to go on.
const MAX_TRIALS_EACH: u64 = 20;

#[derive(clap::Args)]
pub(crate) struct DemosArgs {
    #[command(flatten)]
    task: TaskArgs,
    /// A training's folder, a checkpoint or an exported policy
    #[arg(long)]
    policy: PathBuf,
    /// Number of demonstrations
    #[arg(long, allow_negative_numbers = true)]
    count: u64,
    /// Seed of starts, randomised physics, pushes and noise of readings
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Demonstrations in a file
    #[arg(long, allow_negative_numbers = true, default_value_t = 64)]
    shard_demos: u64,
    /// Folder for the files; if it holds a part of these demonstrations, the rest is made
    #[arg(long)]
    out: PathBuf,
    /// Make nothing: run the trials of the stored demonstrations again, and compare
    #[arg(long)]
    verify: bool,
}

pub(crate) fn run(args: &DemosArgs) -> anyhow::Result<()> {
    for (name, value) in [("--count", args.count), ("--shard-demos", args.shard_demos)] {
        if value == 0 {
            bail!("{name} is 0, expected at least 1");
        }
    }
    let opened = task::open(&args.task)?;
    let (policy, source) = Policy::open(&args.policy, &opened)?;
    let mut sources = opened.sources;
    sources.push(source);
    let scene = opened.task.scene();
    let settings = Settings {
        object: scene.object().id.clone(),
        seed: args.seed,
        count: args.count,
        shard_demos: args.shard_demos,
        start_half_width_m: scene.config().task.half_width_m,
        control_rate_hz: scene.config().control_rate_hz,
        with_script: !args.task.without_script,
    };
    if !args.verify {
        std::fs::create_dir_all(&args.out).with_context(|| format!("failed to create {:?}", args.out))?;
    }
    let _lock = lock(&args.out)?;
    let columns = Columns::of(&opened.task);
    let mut manifest = Manifest::new(settings, sources, &columns);
    if args.out.join(MANIFEST_FILE).exists() {
        manifest.resume(&args.out)?;
    } else if args.verify {
        bail!("--out is {:?}, which holds no {MANIFEST_FILE}", args.out);
    }
    let job = Job { task: opened.task, policy, columns, seed: args.seed, cancel: cancel_on_ctrl_c() };
    if args.verify { job.verify(&args.out, &manifest) } else { job.make(args, manifest) }
}

/// The folder, for this process alone until the file is closed.
fn lock(folder: &Path) -> anyhow::Result<File> {
    let file = File::open(folder).with_context(|| format!("failed to open {folder:?}"))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => bail!("{folder:?} is in use by another run"),
        Err(TryLockError::Error(err)) => Err(err).with_context(|| format!("failed to lock {folder:?}")),
    }
}

struct Job {
    task: Arc<LearnTask>,
    policy: Policy,
    columns: Columns,
    seed: u64,
    cancel: Arc<Cancel>,
}

impl Job {
    /// Trials with these numbers, in their order; nothing if somebody wants no more.
    fn trials(&self, numbers: &[u64]) -> anyhow::Result<Option<Vec<(Outcome, Demonstration)>>> {
        let trial = |env: &mut Result<LearnEnv, _>, &number: &u64| -> anyhow::Result<_> {
            if Cancel::is_cancelled(&self.cancel) {
                return Ok(None);
            }
            let env = env.as_mut().map_err(|err: &mut palpate_grasp::GraspError| err.clone())?;
            env.begin_trial(self.seed, number, Conditions::Training)?;
            let mut recorder = Recorder::new(number, &self.columns);
            let outcome = self.policy.run(env, &mut recorder)?;
            Ok(Some((outcome, recorder.into_demonstration())))
        };
        numbers.par_iter().map_init(|| LearnEnv::for_trials(Arc::clone(&self.task)), trial).collect()
    }

    fn make(&self, args: &DemosArgs, mut manifest: Manifest) -> anyhow::Result<()> {
        let bar = Bar::new();
        let most = args.count.saturating_mul(MAX_TRIALS_EACH);
        let mut next_trial = manifest.num_trials();
        let mut waiting: VecDeque<(Outcome, Demonstration)> = VecDeque::new();
        while manifest.num_demos() < args.count {
            let wanted = args.shard_demos.min(args.count - manifest.num_demos());
            let (mut outcomes, mut kept) = (Vec::new(), Vec::new());
            while (kept.len() as u64) < wanted {
                let done = manifest.num_demos() + kept.len() as u64;
                bar.report(done as f64 / args.count as f64, "demonstrations");
                let Some((outcome, demonstration)) = waiting.pop_front() else {
                    if next_trial >= most {
                        bail!(
                            "only {done} of {next_trial} trials succeeded, which is too few for {} demonstrations: \
                             train the policy further, or let objects start closer (--start-cm)",
                            args.count
                        );
                    }
                    let numbers: Vec<u64> = (next_trial..most.min(next_trial + BLOCK)).collect();
                    let Some(trials) = self.trials(&numbers)? else {
                        drop(bar);
                        eprintln!(
                            "stopped; {} demonstrations are in {}, the same command makes the rest",
                            manifest.num_demos(),
                            args.out.display()
                        );
                        return Ok(());
                    };
                    next_trial += numbers.len() as u64;
                    waiting.extend(trials);
                    continue;
                };
                outcomes.push(outcome);
                if outcome == Outcome::Success {
                    kept.push(demonstration);
                }
            }
            let bytes = shard::encode(&self.columns, &kept)?;
            let name = format!("shard-{:05}.safetensors.zst", manifest.files.len());
            files::write_in_one_move(&args.out.join(&name), &bytes)?;
            manifest.add(ShardFile {
                file: name,
                sha256: files::sha256(&bytes),
                bytes: bytes.len() as u64,
                demonstrations: wanted,
                steps: kept.iter().map(|kept| kept.num_steps as u64).sum(),
                trials: Score::of(&outcomes),
            });
            manifest.write(&args.out)?;
            bar.line(&format!("{} of {} demonstrations", manifest.num_demos(), args.count));
            let success_rate = manifest.num_demos() as f64 / manifest.num_trials().max(1) as f64;
            let counts = serde_json::json!({
                "demonstrations": manifest.num_demos(), "trials": manifest.num_trials(), "success_rate": success_rate,
            });
            events::metrics(manifest.files.len() as u64, &counts);
        }
        drop(bar);
        let [low, high] = manifest.trials.interval_95;
        events::report(&manifest);
        if args.task.scene.json {
            println!("{}", manifest.to_json()?);
        }
        eprintln!(
            "{} demonstrations of {} trials (95 % interval {low:.2} to {high:.2}) are in {}",
            manifest.num_demos(),
            manifest.num_trials(),
            args.out.display()
        );
        Ok(())
    }

    fn verify(&self, folder: &Path, manifest: &Manifest) -> anyhow::Result<()> {
        let bar = Bar::new();
        let (mut num_same, mut num_verified) = (0, 0);
        for file in &manifest.files {
            let path = folder.join(&file.file);
            let bytes = std::fs::read(&path).with_context(|| format!("failed to read {path:?}"))?;
            let stored = shard::decode(&self.columns, &bytes).with_context(|| format!("{path:?}"))?;
            let numbers: Vec<u64> = stored.iter().map(|stored| stored.trial).collect();
            let Some(again) = self.trials(&numbers)? else { bail!("stopped before all were verified") };
            for (stored, (outcome, again)) in stored.iter().zip(&again) {
                if *outcome != Outcome::Success {
                    bail!("{path:?}: trial {} ends with {outcome:?} now, expected a success", stored.trial);
                }
                num_same += usize::from(stored == again);
                num_verified += 1;
            }
            bar.report(num_verified as f64 / manifest.num_demos().max(1) as f64, "verified");
        }
        drop(bar);
        println!(
            "{num_verified} of {} demonstrations succeed again, {num_same} with the same bits",
            manifest.num_demos()
        );
        Ok(())
    }
}
