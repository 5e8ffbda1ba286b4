//! A cloning in a folder: configuration, checkpoint and metrics as files.

use std::{collections::BTreeMap, ops::ControlFlow, path::Path};

use palpate_training::{Finish, Judgement, Learner, Progress, Start};

use crate::cloned::Robot;
use crate::device::OnCard;
use crate::{CloneConfig, CloneError, Episodes, Trainer, TrainingDevice};

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

/// A trainer with its episodes.
struct Cloning<'a> {
    trainer: Trainer,
    /// The training's newest numbers, where they are not in `trainer` itself.
    card: Option<OnCard>,
    train: &'a Episodes,
    held_out: &'a Episodes,
}

impl Learner for Cloning<'_> {
    type Error = CloneError;
    type Losses = f64;
    type Terms = f64;

    fn updates(&self) -> u64 {
        self.trainer.updates()
    }

    fn num_updates(&self) -> u64 {
        self.trainer.config().updates
    }

    fn updates_per_epoch(&self) -> Option<u64> {
        None
    }

    fn checkpoint_updates(&self) -> u64 {
        self.trainer.config().checkpoint_updates
    }

    fn batch_size(&self) -> usize {
        self.trainer.config().batch_size
    }

    fn learning_rate(&self) -> f64 {
        self.trainer.learning_rate()
    }

    fn update(&mut self, losses: &mut f64) -> Result<f64, CloneError> {
        let (loss, norm) = match &mut self.card {
            None => self.trainer.update(self.train)?,
            Some(card) => card.update(&mut self.trainer, self.train)?,
        };
        *losses += loss;
        Ok(norm)
    }

    fn judge(&mut self, losses: &f64, num_updates: u64) -> Result<Judgement<f64>, CloneError> {
        let held_out = match &self.card {
            None => self.trainer.judge(self.held_out)?,
            Some(card) => {
                card.store(&mut self.trainer);
                card.judge(&self.trainer, self.held_out)?
            }
        };
        let losses = [losses / num_updates as f64, held_out];
        Ok(Judgement { terms: losses, losses })
    }

    fn to_checkpoint(&self) -> Vec<u8> {
        self.trainer.to_checkpoint()
    }
}

/// Learns on `device` in `folder`, where configuration, metrics and checkpoints are kept; `watch` sees each update and may
/// end it. A training may go on from a checkpoint on another device than the one that wrote it.
///
/// # Errors
/// A folder that cannot be written, that another run uses, or that holds another training; a training that ran away.
pub fn train(
    folder: &Path,
    start: Start,
    config: CloneConfig,
    data: Data<'_>,
    device: &TrainingDevice,
    watch: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<(Trainer, Finish), CloneError> {
    let Data { robot, train, held_out, sources } = data;
    let learner = |checkpoint: Option<(&Path, &[u8])>| {
        let trainer = match checkpoint {
            Some((path, bytes)) => Trainer::from_checkpoint(config, robot, train, sources, path, bytes)?,
            None => Trainer::new(config, robot, train, sources)?,
        };
        let card = device.card.clone().map(|device| OnCard::new(&trainer, device));
        Ok(Cloning { trainer, card, train, held_out })
    };
    let to_toml = |learner: &Cloning<'_>| learner.trainer.config().to_toml();
    let (learner, finish) = palpate_training::run(folder, start, CONFIG_FILE, learner, to_toml, watch)?;
    Ok((learner.trainer, finish))
}
