//! A picture of what is on the screen, to keep.

use std::sync::{Arc, Mutex, PoisonError};

use super::StudioApp;

/// A picture that was taken: the name of its file, and the screen without the bars around it.
type Taken = (String, egui::ColorImage);

/// Where a picture of the screen stands.
#[derive(Debug, Default)]
pub(super) struct PictureState {
    /// Somebody asked for it; what they asked with, a menu or a palette, is still being drawn.
    is_wanted: bool,
    /// Pictures come in when a frame has been painted.
    taken: Arc<Mutex<Vec<Taken>>>,
    /// Why the last one was not kept.
    problem: Option<&'static str>,
}

impl PictureState {
    /// Whether a picture of the next frame is wanted.
    pub(super) fn is_wanted(&self) -> bool {
        self.is_wanted
    }
}

impl StudioApp {
    /// Asks for a picture of the next frame.
    pub(super) fn want_picture(&mut self, ctx: &egui::Context) {
        self.picture.is_wanted = true;
        self.picture.problem = None;
        ctx.request_repaint();
    }

    /// Has this frame, whose screen was drawn in `rect`, kept as a picture if it `takes` one; hands over those that are
    /// there.
    pub(super) fn picture_ui(&mut self, ctx: &egui::Context, rect: egui::Rect, takes: bool) {
        if takes {
            self.picture.is_wanted = false;
            let (name, pixels_per_point) = (self.picture_name(), ctx.pixels_per_point());
            let (taken, repaint) = (Arc::clone(&self.picture.taken), ctx.clone());
            ctx.request_screenshot(move |image| {
                let screen = image.region(&rect, Some(pixels_per_point));
                taken.lock().unwrap_or_else(PoisonError::into_inner).push((name, screen));
                repaint.request_repaint();
            });
        }
        let taken = std::mem::take(&mut *self.picture.taken.lock().unwrap_or_else(PoisonError::into_inner));
        for (name, picture) in taken {
            if !self.platform.save_picture(&name, &picture) {
                self.picture.problem = Some("This browser does not let the page keep pictures.");
            }
        }
    }

    /// What went wrong with the last picture.
    pub(super) fn picture_problem(&self) -> Option<&'static str> {
        self.picture.problem
    }

    /// `timelines-demo-take-01.png`.
    fn picture_name(&self) -> String {
        let screen = self.route.screen.label().to_lowercase();
        let shown = [self.playback.session.as_deref(), self.playback.take.as_deref()];
        let words: Vec<&str> = [Some(screen.as_str())].into_iter().chain(shown).flatten().collect();
        let plain = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '-' };
        format!("{}.png", words.join("-").chars().map(plain).collect::<String>())
    }
}
