//! What trainings that learn from files tell while they learn.

use std::ops::ControlFlow;

use palpate_encoder::Progress;
use palpate_sim::job::{Cancel, Progress as _};
use palpate_terminal::{Bar, events};
use serde_json::json;

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
