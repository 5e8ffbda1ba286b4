//! A cloning in a folder: configuration, checkpoint and metrics as files.

use std::{collections::BTreeMap, ops::ControlFlow, path::Path, time::Instant};

use palpate_training::{CHECKPOINT_FILE, MetricsLog, Start, TrainingError, file_error, write_in_one_move};
use serde::Serialize;

use crate::cloned::Robot;
use crate::{CloneConfig, CloneError, Episodes, Trainer};

/// The configuration with every field.
pub const CONFIG_FILE: &str = "cloning.toml";

/// What is learned from, and what is left out of that.
pub struct Data<'a> {
    /// The robot of the episodes.
    pub robot: Robot,
    /// Episodes to learn from.
    pub train: &'a Episodes,
    /// Episodes to judge by.
    pub held_out: &'a Episodes,
    /// What both were made from ([`Trainer::new`]).
    pub sources: BTreeMap<String, String>,
}

/// Why a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// It made the configuration's updates.
    Updates,
    /// Whoever watched wanted no more. The checkpoint is the last one before.
    Cancelled,
}

/// How far a training is.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// Updates done.
    pub update: u64,
    /// Share of the configuration's updates that are done, in 0..=1.
    pub fraction: f64,
    /// Time until they are all done, as fast as since this run began or resumed, s.
    pub eta_s: f64,
    /// Mean loss of the updates since the last checkpoint, and of held-out episodes, after an update that ends with
    /// one.
    pub losses: Option<[f64; 2]>,
}

/// One line of the metrics file.
#[derive(Serialize)]
struct MetricsLine {
    update: u64,
    learning_rate: f64,
    gradient_norm: f64,
    samples_per_s: f64,
    train: f64,
    held_out: f64,
}

/// Learns in `folder`, where configuration, metrics and checkpoints are kept; `watch` sees each update and may end it.
///
/// # Errors
/// A folder that cannot be written, that another run uses, or that holds another training; a training that ran away.
pub fn train(
    folder: &Path,
    start: Start,
    config: CloneConfig,
    data: Data<'_>,
    watch: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<(Trainer, Finish), CloneError> {
    std::fs::create_dir_all(folder).map_err(file_error("create", folder))?;
    let mut log = MetricsLog::open(folder)?;
    let checkpoint = folder.join(CHECKPOINT_FILE);
    let mut trainer = match (start, checkpoint.exists()) {
        (Start::Fresh, true) => return Err(TrainingError::RunExists(folder.to_owned()).into()),
        (Start::Resume, true) => {
            let bytes = std::fs::read(&checkpoint).map_err(file_error("read", &checkpoint))?;
            Trainer::from_checkpoint(config, data.robot, data.train, data.sources, &checkpoint, &bytes)?
        }
        _ => Trainer::new(config, data.robot, data.train, data.sources)?,
    };
    write_in_one_move(&folder.join(CONFIG_FILE), trainer.config().to_toml().as_bytes())?;
    log.keep_up_to(trainer.updates())?;

    let (began, first, all) = (Instant::now(), trainer.updates(), trainer.config().updates);
    let (mut losses_sum, mut norms, mut since, mut last) = (0.0, 0.0, Instant::now(), first);
    while trainer.updates() < all {
        let (loss, norm) = trainer.update(data.train)?;
        losses_sum += loss;
        norms += norm;
        let update = trainer.updates();
        let mut losses = None;
        if update.is_multiple_of(trainer.config().checkpoint_updates) || update == all {
            let updates = (update - last) as f64;
            let [train, held_out] = [losses_sum / updates, trainer.judge(data.held_out)?];
            log.append(&MetricsLine {
                update,
                learning_rate: trainer.learning_rate(),
                gradient_norm: norms / updates,
                samples_per_s: updates * trainer.config().batch_size as f64 / since.elapsed().as_secs_f64(),
                train,
                held_out,
            })?;
            log.sync()?;
            write_in_one_move(&checkpoint, &trainer.to_checkpoint())?;
            losses = Some([train, held_out]);
            (losses_sum, norms, since, last) = (0.0, 0.0, Instant::now(), update);
        }
        let secs_per_update = began.elapsed().as_secs_f64() / (update - first) as f64;
        let progress = Progress {
            update,
            fraction: update as f64 / all as f64,
            eta_s: secs_per_update * (all - update) as f64,
            losses,
        };
        if watch(&progress).is_break() && update < all {
            return Ok((trainer, Finish::Cancelled));
        }
    }
    Ok((trainer, Finish::Updates))
}
