//! What long commands share: a progress bar with the time left on standard error, where that is a terminal, Ctrl-C as a
//! request to stop, [`events`] for programs that start such a command, and [`child`] to start one.

pub mod child;
pub mod events;

use std::sync::Arc;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use palpate_sim::job::{Cancel, Progress};
use tokio::signal::unix::{SignalKind, signal};

const STEPS: u64 = 1000;

/// The bar of one command; it goes when dropped.
#[derive(Debug)]
pub struct Bar {
    bar: ProgressBar,
}

impl Bar {
    /// A bar at its beginning.
    #[expect(clippy::new_without_default, reason = "whoever makes one draws on the screen")]
    pub fn new() -> Self {
        // This target draws nothing where standard error is no terminal.
        let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr_with_hz(10));
        if let Ok(style) = ProgressStyle::with_template("{bar:30} {percent:>3} % {msg} ({eta} left)") {
            bar.set_style(style);
        }
        Self { bar }
    }

    /// Prints a line above the bar, also where standard error is no terminal.
    pub fn line(&self, line: &str) {
        self.bar.suspend(|| eprintln!("{line}"));
    }
}

impl Progress for Bar {
    fn report(&self, fraction: f64, stage: &str) {
        if self.bar.message() != stage {
            self.bar.set_message(stage.to_owned());
        }
        self.bar.set_position((fraction.clamp(0.0, 1.0) * STEPS as f64) as u64);
        events::progress(fraction, stage);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// A flag that the first Ctrl-C or SIGTERM sets, so that the job can leave the disk in order; the second one ends the
/// process.
pub fn cancel_on_ctrl_c() -> Arc<Cancel> {
    let cancel = Arc::new(Cancel::default());
    let asked = cancel.clone();
    let listen = move || {
        // Without a runtime Ctrl-C ends the process, which is what it does anyhow.
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return };
        runtime.block_on(async {
            let (Ok(mut interrupt), Ok(mut terminate)) =
                (signal(SignalKind::interrupt()), signal(SignalKind::terminate()))
            else {
                return;
            };
            loop {
                tokio::select! {
                    _ = interrupt.recv() => {}
                    _ = terminate.recv() => {}
                }
                if asked.is_cancelled() {
                    std::process::exit(1);
                }
                asked.cancel();
            }
        });
    };
    // As above, if no thread can be had.
    let _ = std::thread::Builder::new().name("ctrl-c".to_owned()).spawn(listen);
    cancel
}
