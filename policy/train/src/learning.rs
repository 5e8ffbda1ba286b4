//! How trainings are configured, and what those that learn from files tell while they learn.

use std::ops::ControlFlow;
use std::path::PathBuf;

use palpate_encoder::Progress;
use palpate_sim::job::{Cancel, Progress as _};
use palpate_terminal::{Bar, events};
use serde_json::json;

use crate::files;

#[derive(clap::Args)]
pub(crate) struct ConfigArgs {
    /// How to learn: `quick` or `paper`
    #[arg(long, default_value = "quick", conflicts_with = "config")]
    preset: String,
    /// How to learn: a file instead of a preset (docs/learning.md)
    #[arg(long)]
    config: Option<PathBuf>,
}

impl ConfigArgs {
    /// The configuration: `from_toml` reads a file's text, `preset` knows the presets.
    pub(crate) fn read<C, E: std::error::Error + Send + Sync + 'static>(
        &self,
        from_toml: fn(&str, &str) -> Result<C, E>,
        preset: fn(&str) -> Result<C, E>,
    ) -> anyhow::Result<C> {
        Ok(match &self.config {
            Some(path) => from_toml(&files::shown(path), &files::text(path)?)?,
            None => preset(&self.preset)?,
        })
    }
}

/// Tells how far a training is, and ends it if somebody asks for that.
pub(crate) fn tell(progress: &Progress, bar: &Bar, cancel: &Cancel) -> ControlFlow<()> {
    bar.report(progress.fraction, "learning");
    if let Some([train, held_out]) = progress.losses {
        events::metrics(progress.update, &json!({ "loss": train, "held_out_loss": held_out }));
        bar.line(&format!(
            "{} updates: loss {train:.4}, held out {held_out:.4}, about {:.0} s left",
            progress.update, progress.eta_s
        ));
    }
    match cancel.is_cancelled() {
        true => ControlFlow::Break(()),
        false => ControlFlow::Continue(()),
    }
}
