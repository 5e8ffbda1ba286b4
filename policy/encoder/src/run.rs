//! A pretraining in a folder: configuration, checkpoint and metrics as files.

use std::{collections::BTreeMap, ops::ControlFlow, path::Path};

use palpate_training::{Finish, Judgement, Learner, Progress, Start};

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

/// A trainer with its samples.
struct Pretraining<'a> {
    trainer: Trainer,
    train: &'a dyn Dataset,
    held_out: &'a dyn Dataset,
}

impl Learner for Pretraining<'_> {
    type Error = EncoderError;
    type Losses = LossTerms;
    type Terms = BTreeMap<&'static str, f64>;

    fn updates(&self) -> u64 {
        self.trainer.updates()
    }

    fn num_updates(&self) -> u64 {
        self.trainer.num_updates()
    }

    fn updates_per_epoch(&self) -> Option<u64> {
        Some(self.trainer.updates_per_epoch())
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

    fn update(&mut self, losses: &mut LossTerms) -> Result<f64, EncoderError> {
        let (terms, norm) = self.trainer.update(self.train)?;
        losses.add(&terms);
        Ok(norm)
    }

    fn judge(&mut self, losses: &LossTerms, _: u64) -> Result<Judgement<Self::Terms>, EncoderError> {
        let held_out = self.trainer.predict(self.held_out, &mut |_, _| ())?;
        let terms = [named(losses), named(&held_out)];
        Ok(Judgement { terms, losses: [losses.total(), held_out.total()] })
    }

    fn to_checkpoint(&self) -> Vec<u8> {
        self.trainer.to_checkpoint()
    }
}

/// Trains in `folder` until the configuration's epochs are made or `watch`, which sees every update, wants no more.
///
/// # Errors
/// Whatever [`Trainer`] refuses, nothing held out, folders that cannot be written, that another run uses, or that hold
/// another run.
pub fn train(
    folder: &Path,
    start: Start,
    config: EncoderConfig,
    data: Data<'_>,
    watch: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
) -> Result<(Trainer, Finish), EncoderError> {
    config.validate()?;
    let Data { train, held_out, sources } = data;
    if held_out.is_empty() {
        return Err(EncoderError::Shape("none is held out to judge by".to_owned()));
    }
    let learner = |checkpoint: Option<(&Path, &[u8])>| {
        let trainer = match checkpoint {
            Some((path, bytes)) => Trainer::from_checkpoint(config, train, sources, path, bytes)?,
            None => Trainer::new(config, train, sources)?,
        };
        Ok(Pretraining { trainer, train, held_out })
    };
    let to_toml = |learner: &Pretraining<'_>| learner.trainer.config().to_toml();
    let (learner, finish) = palpate_training::run(folder, start, CONFIG_FILE, learner, to_toml, watch)?;
    Ok((learner.trainer, finish))
}

/// Every term that some sample was for, before its weight, and the objective.
fn named(terms: &LossTerms) -> BTreeMap<&'static str, f64> {
    let means = TERMS.into_iter().zip(terms.means()).filter_map(|(name, mean)| Some((name, mean?)));
    means.chain([("total", terms.total())]).collect()
}
