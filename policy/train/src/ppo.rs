//! Learns to grasp one object: `palpate_ppo` in the environments of `palpate_grasp`.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::Context as _;
use palpate_grasp::learn::{LearnBatch, REWARD_TERMS};
use palpate_grasp::trial::Outcome;
use palpate_ppo::{Ending, EnvError, Finish, Observations, PpoConfig, Start, StepResult, VectorEnv};
use palpate_sim::job::{Cancel, Progress as _};

use crate::task::{Memory, TaskArgs, TaskRecord};
use crate::{learning::ConfigArgs, task};
use palpate_terminal::{Bar, cancel_on_ctrl_c, events};

/// The metric of how wide the region of starts is.
pub(crate) const START_HALF_WIDTH: &str = "start_half_width_m";

#[derive(clap::Args)]
pub(crate) struct PpoArgs {
    #[command(flatten)]
    task: TaskArgs,
    #[command(flatten)]
    config: ConfigArgs,
    /// Seed of environments, weights and noise [default: the configuration's]
    #[arg(long)]
    seed: Option<u64>,
    /// Steps of all environments together [default: the configuration's]
    #[arg(long)]
    total_steps: Option<u64>,
    /// Folder for checkpoint and metrics
    #[arg(long)]
    out: PathBuf,
    /// Go on from the folder's checkpoint
    #[arg(long)]
    resume: bool,
}

pub(crate) fn run(args: &PpoArgs) -> anyhow::Result<()> {
    let mut config = args.config.read(PpoConfig::from_toml, PpoConfig::preset)?;
    config.seed = args.seed.unwrap_or(config.seed);
    config.total_steps = args.total_steps.unwrap_or(config.total_steps);
    config.validate()?;
    let opened = task::open(&args.task)?;
    let batch = LearnBatch::new(opened.task, config.num_envs, config.seed)?;
    let mut envs = GraspEnvs { batch, record: opened.record };

    let (bar, cancel) = (Bar::new(), cancel_on_ctrl_c());
    let start = if args.resume { Start::Resume } else { Start::Fresh };
    let mut failed = None;
    let mut watch = |progress: &palpate_ppo::Progress| {
        bar.report(progress.fraction, "learning");
        bar.line(&summary(progress));
        events::metrics(progress.metrics.update, &progress.metrics);
        if args.task.scene.json {
            match serde_json::to_string(&progress.metrics) {
                Ok(line) => println!("{line}"),
                Err(err) => failed = Some(err),
            }
        }
        if Cancel::is_cancelled(&cancel) || failed.is_some() {
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    };
    let result = palpate_ppo::train(&args.out, start, config, &mut envs, &mut watch);
    drop(bar);
    let (trainer, finish) = result?;
    if let Some(err) = failed {
        return Err(err).context("failed to print metrics");
    }
    let why = match finish {
        Finish::Steps => "all steps are made",
        Finish::Success => "enough episodes succeed",
        Finish::Cancelled => "stopped; `--resume` goes on from the last checkpoint",
    };
    events::report(&serde_json::json!({
        "steps": trainer.steps(),
        "updates": trainer.updates(),
        "recent_success_rate": trainer.recent_success_rate(),
        "finish": match finish {
            Finish::Steps => "steps",
            Finish::Success => "success",
            Finish::Cancelled => "cancelled",
        },
    }));
    eprintln!("{why}: {} steps; {} holds the run", trainer.steps(), args.out.display());
    Ok(())
}

/// One update on one line.
fn summary(progress: &palpate_ppo::Progress) -> String {
    let metrics = &progress.metrics;
    let shown = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
    };
    format!(
        "{} steps: return {}, success {}, kl {:.4}, spread {:.2}, {:.0} steps/s, about {:.0} s left",
        metrics.steps,
        shown(metrics.return_mean, 2),
        shown(metrics.success_rate, 2),
        metrics.kl,
        metrics.action_std,
        progress.steps_per_s,
        progress.eta_s,
    )
}

/// The environments of the grasping task, as the learner wants them.
struct GraspEnvs {
    batch: LearnBatch,
    record: TaskRecord,
}

impl VectorEnv for GraspEnvs {
    fn num_envs(&self) -> usize {
        self.batch.num_envs()
    }

    fn actor_dim(&self) -> usize {
        self.batch.actor_dim()
    }

    fn critic_dim(&self) -> usize {
        self.batch.critic_dim()
    }

    fn action_dim(&self) -> usize {
        self.batch.action_dim()
    }

    fn reward_terms(&self) -> Vec<String> {
        REWARD_TERMS.map(str::to_owned).to_vec()
    }

    fn reset(&mut self, round: u64) -> Result<Observations, EnvError> {
        let step = self.batch.reset(u32::try_from(round)?)?;
        Ok(Observations { actor: step.actor, critic: step.critic })
    }

    fn step(&mut self, actions: &[f32]) -> Result<StepResult, EnvError> {
        let step = self.batch.step(actions)?;
        let ending = |ending: palpate_grasp::learn::Ending| {
            let success = ending.outcome == Outcome::Success;
            if ending.truncated {
                Ending::Truncated { success, final_critic: ending.final_critic }
            } else {
                Ending::Terminated { success }
            }
        };
        Ok(StepResult {
            observations: Observations { actor: step.actor, critic: step.critic },
            reward_terms: step.terms,
            endings: step.endings.into_iter().map(|over| over.map(ending)).collect(),
        })
    }

    fn metrics(&self) -> BTreeMap<String, f64> {
        BTreeMap::from([(START_HALF_WIDTH.to_owned(), self.batch.curriculum().half_width_m)])
    }

    fn memory(&self) -> String {
        Memory { curriculum: self.batch.curriculum().clone(), task: self.record.clone() }.to_toml()
    }

    fn restore(&mut self, memory: &str) -> Result<(), EnvError> {
        let Memory { curriculum, task } = Memory::from_toml(memory)?;
        task.check(&self.record)?;
        self.batch.set_curriculum(curriculum);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;
    use std::path::Path;

    use palpate_grasp::learn::Curriculum;
    use palpate_ppo::{CHECKPOINT_FILE, NetworksConfig};

    use super::*;
    use crate::{RobotArgs, SceneArgs, files};

    /// Two environments that widen their starts after every episode, so that there is something to remember.
    fn envs() -> GraspEnvs {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let scene = SceneArgs {
            robot: RobotArgs {
                station: root.join("assets/stations/xarm6_leap.toml"),
                world: root.join("assets/grasp/xarm6_leap.toml"),
                model: None,
            },
            truth: None,
            contact_map: None,
            script: root.join("assets/grasp/scripts/xarm6_leap_cube.toml"),
            object: files::shown(&root.join("assets/objects/cube.toml")),
            start_cm: None,
            threads: None,
            json: false,
            silence_touch: false,
        };
        let shipped = files::text(&root.join("assets/grasp/xarm6_leap_learning.toml")).expect("a file");
        let mut changed = tempfile::NamedTempFile::new().expect("a file");
        for line in shipped.lines() {
            let line = match line.split(" = ").next() {
                Some("window") => "window = 1",
                Some("widen_at") => "widen_at = 0.0",
                Some("widen_m") => "widen_m = 0.001",
                _ => line,
            };
            writeln!(changed, "{line}").expect("room");
        }
        let learning = changed.path().to_owned();
        let opened = task::open(&TaskArgs { scene, learning, without_script: false }).expect("a task");
        let batch = LearnBatch::new(opened.task, 2, 3).expect("environments");
        GraspEnvs { batch, record: opened.record }
    }

    #[test]
    fn a_training_that_resumes_has_the_bits_of_one_that_went_on() {
        // An update is longer than an episode of 10 s at 20 Hz.
        let config = PpoConfig {
            total_steps: 3 * 2 * 210,
            num_envs: 2,
            unroll_length: 210,
            batch_size: 1,
            num_minibatches: 2,
            num_epochs: 1,
            checkpoint_updates: 1,
            networks: NetworksConfig { actor: vec![8], critic: vec![8], ..NetworksConfig::default() },
            ..PpoConfig::default()
        };
        let run = |folder: &Path, start, last: u64| {
            let mut watch = |progress: &palpate_ppo::Progress| match progress.metrics.update == last {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            };
            let mut envs = envs();
            palpate_ppo::train(folder, start, config.clone(), &mut envs, &mut watch).expect("a training");
            (std::fs::read(folder.join(CHECKPOINT_FILE)).expect("a checkpoint"), envs.memory())
        };
        let [whole, parts] = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
        let (expected, memory) = run(whole.path(), Start::Fresh, 3);
        run(parts.path(), Start::Fresh, 1);
        let (found, _) = run(parts.path(), Start::Resume, 3);
        assert!(found == expected, "other bits");
        assert_ne!(memory, envs().memory(), "the region has widened");
    }

    #[test]
    fn memory_comes_back_with_the_same_bits() {
        let (mut kept, mut restored) = (envs(), envs());
        let curriculum = Curriculum { half_width_m: 0.1 + 0.2, episodes: 7, successes: 3 };
        kept.batch.set_curriculum(curriculum.clone());
        restored.restore(&kept.memory()).expect("a memory");
        assert_eq!(restored.batch.curriculum(), &curriculum);
        assert!(restored.restore("half_width_m = 'wide'").is_err());
    }
}
