//! A pretraining in a folder: configuration, checkpoint and metrics as files.

use std::{collections::BTreeMap, ops::ControlFlow, path::Path, time::Instant};

use palpate_training::{CHECKPOINT_FILE, MetricsLog, Start, TrainingError, file_error, write_in_one_move};
use serde::Serialize;

use crate::{Dataset, EncoderConfig, EncoderError, LossTerms, TERMS, Trainer};

/// The configuration with every field.
pub const CONFIG_FILE: &str = "encoder.toml";

/// What is learned from, and what is left out of that.
pub struct Data<'a> {
    /// Samples to learn from.
    pub train: &'a dyn Dataset,
    /// Samples to judge by.
    pub held_out: &'a dyn Dataset,
    /// What both were made from ([`Trainer::new`]).
    pub sources: BTreeMap<String, String>,
}

/// Why a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// It made the configuration's epochs.
    Epochs,
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
    /// Objective of the updates since the last checkpoint and of held-out samples, after an update that ends with one.
    pub losses: Option<[f64; 2]>,
}

/// One line of the metrics file.
#[derive(Serialize)]
struct MetricsLine {
    update: u64,
    epochs: f64,
    learning_rate: f64,
    gradient_norm: f64,
    samples_per_s: f64,
    train: BTreeMap<&'static str, f64>,
    held_out: BTreeMap<&'static str, f64>,
}

/// Trains in `folder` until the configuration's epochs are made or `watch`, which sees every update, wants no more.
///
/// Checkpoints replace one another in one move, so that a run that is killed at any moment goes on from the last one, to
/// the bits that it would have had.
///
/// # Errors
/// Whatever [`Trainer`] refuses, nothing held out, folders that cannot be written, that another run uses, or that hold
/// another run.
pub fn train(
    folder: &Path,
    start: Start,
    config: EncoderConfig,
    data: Data,
    watch: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<(Trainer, Finish), EncoderError> {
    config.validate()?;
    if data.held_out.is_empty() {
        return Err(EncoderError::Shape("none is held out to judge by".to_owned()));
    }
    std::fs::create_dir_all(folder).map_err(file_error("create", folder))?;
    let mut log = MetricsLog::open(folder)?;
    let checkpoint = folder.join(CHECKPOINT_FILE);
    let mut trainer = match (start, checkpoint.exists()) {
        (Start::Fresh, true) => return Err(TrainingError::RunExists(folder.to_owned()).into()),
        (Start::Resume, true) => {
            let bytes = std::fs::read(&checkpoint).map_err(file_error("read", &checkpoint))?;
            Trainer::from_checkpoint(config, data.train, data.sources, &checkpoint, &bytes)?
        }
        (_, false) => Trainer::new(config, data.train, data.sources)?,
    };
    write_in_one_move(&folder.join(CONFIG_FILE), trainer.config().to_toml().as_bytes())?;
    log.keep_up_to(trainer.updates())?;

    let (began, first, all) = (Instant::now(), trainer.updates(), trainer.num_updates());
    let (mut terms, mut norms, mut since, mut last) = (LossTerms::default(), 0.0, Instant::now(), first);
    while trainer.updates() < all {
        let (of_batch, norm) = trainer.update(data.train)?;
        terms.add(&of_batch);
        norms += norm;
        let update = trainer.updates();
        let mut losses = None;
        if update.is_multiple_of(trainer.config().checkpoint_updates) || update == all {
            let held_out = trainer.predict(data.held_out, &mut |_, _| ())?;
            let updates = (update - last) as f64;
            log.append(&MetricsLine {
                update,
                epochs: update as f64 / trainer.updates_per_epoch() as f64,
                learning_rate: trainer.learning_rate(),
                gradient_norm: norms / updates,
                samples_per_s: updates * trainer.config().batch_size as f64 / since.elapsed().as_secs_f64(),
                train: named(&terms),
                held_out: named(&held_out),
            })?;
            log.sync()?;
            write_in_one_move(&checkpoint, &trainer.to_checkpoint())?;
            losses = Some([terms.total(), held_out.total()]);
            (terms, norms, since, last) = (LossTerms::default(), 0.0, Instant::now(), update);
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
    Ok((trainer, Finish::Epochs))
}

/// Every term that some sample was for, before its weight, and the objective.
fn named(terms: &LossTerms) -> BTreeMap<&'static str, f64> {
    let means = TERMS.into_iter().zip(terms.means()).filter_map(|(name, mean)| Some((name, mean?)));
    means.chain([("total", terms.total())]).collect()
}
