//! A training in a folder: configuration, checkpoint and metrics as files.

use std::{ops::ControlFlow, path::Path, time::Instant};

use palpate_training::{CHECKPOINT_FILE, MetricsLog, Start, TrainingError, file_error, write_in_one_move};
use serde::Serialize;

use crate::{Metrics, PpoConfig, PpoError, Trainer, VectorEnv};

/// The configuration with every field, as it was when the run began or resumed.
pub const CONFIG_FILE: &str = "ppo.toml";
/// Why a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// It made the configuration's steps.
    Steps,
    /// The configuration's `stop` was reached.
    Success,
    /// Whoever watched wanted no more. The checkpoint is the last one before.
    Cancelled,
}

/// How far a training is.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// What the update told.
    pub metrics: Metrics,
    /// Share of the configuration's steps that are done, in 0..=1.
    pub fraction: f64,
    /// Steps of all environments a second, in this update.
    pub steps_per_s: f64,
    /// Time until the configuration's steps are done, as fast as since this run began or resumed.
    pub eta_s: f64,
}

#[derive(Serialize)]
struct MetricsLine<'a> {
    #[serde(flatten)]
    metrics: &'a Metrics,
    steps_per_s: f64,
}

/// Trains in `folder` until the configuration's steps are made, its `stop` is reached or `watch`, which sees every update,
/// wants no more.
///
/// Checkpoints replace one another in one move, so that a run that is killed at any moment goes on from the last one.
///
/// # Errors
/// Whatever [`Trainer`] refuses, folders that cannot be written, that another run uses, or that hold another run.
pub fn train<E: VectorEnv + ?Sized>(
    folder: &Path,
    start: Start,
    config: PpoConfig,
    env: &mut E,
    watch: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<(Trainer, Finish), PpoError> {
    config.validate()?;
    std::fs::create_dir_all(folder).map_err(file_error("create", folder))?;
    let mut log = MetricsLog::open(folder)?;
    let checkpoint = folder.join(CHECKPOINT_FILE);
    let mut trainer = match (start, checkpoint.exists()) {
        (Start::Fresh, true) => return Err(TrainingError::RunExists(folder.to_owned()).into()),
        (Start::Resume, true) => {
            let bytes = std::fs::read(&checkpoint).map_err(file_error("read", &checkpoint))?;
            Trainer::from_checkpoint(config, env, &checkpoint, &bytes)?
        }
        (_, false) => Trainer::new(config, env)?,
    };
    write_in_one_move(&folder.join(CONFIG_FILE), trainer.config().to_toml().as_bytes())?;
    log.keep_up_to(trainer.updates())?;

    let began = Instant::now();
    let first_update = trainer.updates();
    loop {
        if let Some(finish) = finish(&trainer) {
            return Ok((trainer, finish));
        }
        let update_began = Instant::now();
        let steps_before = trainer.steps();
        let metrics = trainer.update(env)?;
        let steps_per_s = (trainer.steps() - steps_before) as f64 / update_began.elapsed().as_secs_f64();
        log.append(&MetricsLine { metrics: &metrics, steps_per_s })?;
        if finish(&trainer).is_some() {
            trainer.begin_new_episodes();
        }
        if trainer.is_between_episodes() {
            log.sync()?;
            write_in_one_move(&checkpoint, &trainer.to_checkpoint())?;
        }
        let (done, all) = (trainer.updates(), trainer.config().num_updates());
        let secs_per_update = began.elapsed().as_secs_f64() / (done - first_update) as f64;
        let progress = Progress {
            metrics,
            fraction: done as f64 / all as f64,
            steps_per_s,
            eta_s: secs_per_update * (all - done) as f64,
        };
        if watch(&progress).is_break() && finish(&trainer).is_none() {
            return Ok((trainer, Finish::Cancelled));
        }
    }
}

fn finish(trainer: &Trainer) -> Option<Finish> {
    let config = trainer.config();
    let reached = |rate: f64| config.stop.as_ref().is_some_and(|stop| rate >= stop.success_rate);
    if trainer.recent_success_rate().is_some_and(reached) {
        return Some(Finish::Success);
    }
    (trainer.updates() >= config.num_updates()).then_some(Finish::Steps)
}
