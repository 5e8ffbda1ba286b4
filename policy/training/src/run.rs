//! The loop of a training in a folder: updates, checkpoints, metrics, and word of how far it is.

use std::{ops::ControlFlow, path::Path, time::Instant};

use serde::Serialize;

use crate::{CHECKPOINT_FILE, MetricsLog, Start, TrainingError, file_error, write_in_one_move};

/// Why a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// It made the configuration's updates.
    Complete,
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
    /// Loss of the updates since the last checkpoint and of what is held out, after an update that ends with one.
    pub losses: Option<[f64; 2]>,
}

/// What the updates since the last checkpoint came to, beside what is held out.
pub struct Judgement<Terms> {
    /// Losses, as they are written down.
    pub terms: [Terms; 2],
    /// The losses that are minimised.
    pub losses: [f64; 2],
}

/// Something that learns update by update, with what it learns from.
pub trait Learner {
    /// What goes wrong.
    type Error: From<TrainingError>;
    /// The sum of the losses of some updates.
    type Losses: Default;
    /// Losses as they are written down.
    type Terms: Serialize;

    /// Updates done.
    fn updates(&self) -> u64;
    /// Updates of a whole training.
    fn num_updates(&self) -> u64;
    /// Updates of one pass over all samples, where passes are counted.
    fn updates_per_epoch(&self) -> Option<u64>;
    /// Updates from one checkpoint to the next.
    fn checkpoint_updates(&self) -> u64;
    /// Samples of an update.
    fn batch_size(&self) -> usize;
    /// Learning rate of the next update.
    fn learning_rate(&self) -> f64;
    /// Makes an update, adds its loss to `losses` and gives the norm of its gradient.
    ///
    /// # Errors
    /// A training that ran away.
    fn update(&mut self, losses: &mut Self::Losses) -> Result<f64, Self::Error>;
    /// The losses of `num_updates` updates beside those of what is held out.
    ///
    /// # Errors
    /// What is held out does not fit.
    fn judge(
        &mut self,
        losses: &Self::Losses,
        num_updates: u64,
    ) -> Result<Judgement<Self::Terms>, Self::Error>;
    /// Everything that going on needs, as bytes of a file.
    fn to_checkpoint(&self) -> Vec<u8>;
}

/// One line of the metrics file.
#[derive(Serialize)]
struct MetricsLine<Terms> {
    update: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    epochs: Option<f64>,
    learning_rate: f64,
    gradient_norm: f64,
    samples_per_s: f64,
    train: Terms,
    held_out: Terms,
}

/// Lets what `learner` makes learn in `folder` until its updates are made or `watch`, which sees each of them, wants no
/// more. `learner` gets the bytes of the checkpoint to go on from, and where they were read; `to_toml` writes its
/// configuration with every field into `config_file`.
///
/// Checkpoints replace one another in one move, so that a run that is killed at any moment goes on from the last one, to
/// the bits that it would have had.
///
/// # Errors
/// Whatever the learner refuses; folders that cannot be written, that another run uses, or that hold another run.
pub fn run<L: Learner>(
    folder: &Path,
    start: Start,
    config_file: &str,
    learner: impl FnOnce(Option<(&Path, &[u8])>) -> Result<L, L::Error>,
    to_toml: impl FnOnce(&L) -> String,
    watch: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<(L, Finish), L::Error> {
    std::fs::create_dir_all(folder).map_err(file_error("create", folder))?;
    let mut log = MetricsLog::open(folder)?;
    let checkpoint = folder.join(CHECKPOINT_FILE);
    let mut learner = match (start, checkpoint.exists()) {
        (Start::Fresh, true) => return Err(TrainingError::RunExists(folder.to_owned()).into()),
        (Start::Resume, true) => {
            let bytes = std::fs::read(&checkpoint).map_err(file_error("read", &checkpoint))?;
            learner(Some((&checkpoint, &bytes)))?
        }
        (_, false) => learner(None)?,
    };
    write_in_one_move(&folder.join(config_file), to_toml(&learner).as_bytes())?;
    log.keep_up_to(learner.updates())?;

    let (began, first, all) = (Instant::now(), learner.updates(), learner.num_updates());
    let (mut sum, mut norms, mut since, mut last) = (L::Losses::default(), 0.0, Instant::now(), first);
    while learner.updates() < all {
        norms += learner.update(&mut sum)?;
        let update = learner.updates();
        let mut losses = None;
        if update.is_multiple_of(learner.checkpoint_updates()) || update == all {
            let judgement = learner.judge(&sum, update - last)?;
            let [train, held_out] = judgement.terms;
            let num_updates = (update - last) as f64;
            log.append(&MetricsLine {
                update,
                epochs: learner.updates_per_epoch().map(|each| update as f64 / each as f64),
                learning_rate: learner.learning_rate(),
                gradient_norm: norms / num_updates,
                samples_per_s: num_updates * learner.batch_size() as f64 / since.elapsed().as_secs_f64(),
                train,
                held_out,
            })?;
            log.sync()?;
            write_in_one_move(&checkpoint, &learner.to_checkpoint())?;
            losses = Some(judgement.losses);
            (sum, norms, since, last) = (L::Losses::default(), 0.0, Instant::now(), update);
        }
        let secs_per_update = began.elapsed().as_secs_f64() / (update - first) as f64;
        let progress = Progress {
            update,
            fraction: update as f64 / all as f64,
            eta_s: secs_per_update * (all - update) as f64,
            losses,
        };
        if watch(&progress).is_break() && update < all {
            return Ok((learner, Finish::Cancelled));
        }
    }
    Ok((learner, Finish::Complete))
}
