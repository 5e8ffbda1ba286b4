//! How finely, and in which frames, the 3-D picture is drawn: without a graphics card it takes most of a frame's time, and
//! touch, the flat map and STOP must not wait for it.
//!
//! While the picture changes, the time from frame to frame is followed. Frames that are slow make the picture coarser, step
//! by step, for as long as that makes them quicker; frames that are quick again make it finer. A picture that stands still is
//! drawn once more as finely as the page.

use std::{collections::VecDeque, sync::Arc, time::Duration};

use super::renderer::{Drawing, Scene};

/// Frames that take longer than this, s, are slow.
const SLOW_S: f64 = 0.060;
/// Frames that take less than this, s, leave room for a finer picture.
const QUICK_S: f64 = 0.040;
/// Frames of which the mean counts; the longest and the shortest of them are left out.
const NUM_FRAMES: usize = 10;
/// Frames after a change of step that say nothing yet: what was asked for before is still being drawn.
const NUM_SETTLING: usize = 3;
/// A coarser picture has to make frames quicker by this share, or it is not worth its looks.
const WORTH: f64 = 0.08;
/// A change that was of no use is not tried again for so long, s; doubled each time, up to the second number.
const WAIT_S: [f64; 2] = [4.0, 64.0];
/// So long, s, does a coarse picture stay as it is before a finer one is tried.
const STAYS_S: f64 = 2.0;
/// A picture that has not changed for so long, s, stands still.
const STILL_S: f64 = 0.3;
/// A longer time from frame to frame, s, says that nothing had to be drawn, and not that drawing took long.
const MAX_FRAME_S: f64 = 1.0;

/// How a moving picture is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Step {
    /// Pixels for one of the page, along each edge.
    share: f32,
    /// Drawn in one of so many frames.
    every: u32,
}

const STEPS: [Step; 5] = [
    Step { share: 1.0, every: 1 },
    Step { share: 0.7, every: 1 },
    Step { share: 0.5, every: 1 },
    Step { share: 0.5, every: 2 },
    Step { share: 0.4, every: 3 },
];

/// The picture of a view, and how finely it can be drawn.
#[derive(Debug, Default)]
pub(super) struct Detail {
    last: Option<Arc<Drawing>>,
    pace: Pace,
}

impl Detail {
    /// What to draw of `scene` in this frame: it, or once more the picture of before.
    pub(super) fn drawing(&mut self, ctx: &egui::Context, scene: Scene) -> Arc<Drawing> {
        let now_s = ctx.input(|input| input.time);
        let moves = self.last.as_ref().is_some_and(|last| last.scene != scene);
        let drawing = match (self.pace.frame(now_s, moves), &self.last) {
            (None, Some(last)) => Arc::clone(last),
            (share, _) => Arc::new(Drawing { scene, share: share.unwrap_or(1.0) }),
        };
        // What moves is drawn again as soon as it does. Once it stands still, it is to be seen finely, and where it is.
        if moves || drawing.share < 1.0 {
            ctx.request_repaint_after(Duration::from_secs_f64(STILL_S));
        }
        self.last = Some(Arc::clone(&drawing));
        drawing
    }
}

/// Decides from the times of frames alone.
#[derive(Debug, Default)]
struct Pace {
    /// Index into [`STEPS`].
    step: usize,
    /// How it came to be: what the frames after it are looked at for.
    change: Change,
    changed_s: f64,
    coarser: Attempts,
    finer: Attempts,
    /// Share of the newest picture, and the frames since.
    newest: Option<(f32, u32)>,
    /// The newest frame, and whether the picture moved in it.
    frame_s: f64,
    moves: bool,
    moved_s: f64,
    frames_s: VecDeque<f64>,
    num_settling: usize,
}

/// The last change of step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Change {
    #[default]
    None,
    /// To a coarser picture, from frames that took this long, s.
    Coarser { before_s: f64 },
    /// To a finer one.
    Finer,
}

/// When a change that failed may be tried again.
#[derive(Debug)]
struct Attempts {
    not_before_s: f64,
    wait_s: f64,
}

impl Default for Attempts {
    fn default() -> Self {
        Self { not_before_s: f64::NEG_INFINITY, wait_s: WAIT_S[0] }
    }
}

impl Attempts {
    fn failed(&mut self, now_s: f64) {
        self.not_before_s = now_s + self.wait_s;
        self.wait_s = (self.wait_s * 2.0).min(WAIT_S[1]);
    }
}

impl Pace {
    /// A frame at `now_s`, whose scene is another than that of the newest picture, or not: the share of pixels to draw it
    /// with, or `None` for the picture of before.
    fn frame(&mut self, now_s: f64, moves: bool) -> Option<f32> {
        let took_s = now_s - self.frame_s;
        self.frame_s = now_s;
        let Some((share, num_frames)) = self.newest else { return Some(self.draw(1.0)) };
        let moved = std::mem::replace(&mut self.moves, moves);
        if !moves {
            let is_still = now_s - self.moved_s >= STILL_S;
            return (share < 1.0 && is_still).then(|| self.draw(1.0));
        }
        self.moved_s = now_s;
        if moved && took_s < MAX_FRAME_S {
            self.took(took_s);
        }
        self.newest = Some((share, num_frames + 1));
        let step = STEPS[self.step];
        (num_frames + 1 >= step.every).then(|| self.draw(step.share))
    }

    fn draw(&mut self, share: f32) -> f32 {
        self.newest = Some((share, 0));
        share
    }

    /// A frame of a moving picture took `took_s`.
    fn took(&mut self, took_s: f64) {
        if self.num_settling > 0 {
            self.num_settling -= 1;
            return;
        }
        self.frames_s.push_back(took_s);
        if self.frames_s.len() < NUM_FRAMES {
            return;
        }
        let mean_s = trimmed_mean(&self.frames_s);
        self.frames_s.pop_front();
        let now_s = self.frame_s;
        let stayed_s = now_s - self.changed_s;
        if let Change::Coarser { before_s } = self.change {
            self.change = Change::None;
            if mean_s > before_s * (1.0 - WORTH) {
                // Something else takes the time.
                self.coarser.failed(now_s);
                return self.go_to(self.step - 1);
            }
            self.coarser = Attempts::default();
        }
        if mean_s > SLOW_S && self.step + 1 < STEPS.len() && now_s >= self.coarser.not_before_s {
            if self.change == Change::Finer && stayed_s < WAIT_S[1] {
                self.finer.failed(now_s);
            } else {
                self.finer = Attempts::default();
            }
            self.change = Change::Coarser { before_s: mean_s };
            self.go_to(self.step + 1);
        } else if mean_s < QUICK_S && self.step > 0 && stayed_s >= STAYS_S && now_s >= self.finer.not_before_s
        {
            self.change = Change::Finer;
            self.go_to(self.step - 1);
        }
    }

    fn go_to(&mut self, step: usize) {
        (self.step, self.changed_s, self.num_settling) = (step, self.frame_s, NUM_SETTLING);
        self.frames_s.clear();
    }
}

/// The mean without the longest and the shortest.
fn trimmed_mean(values: &VecDeque<f64>) -> f64 {
    let sum: f64 = values.iter().sum();
    let (least, most) = values
        .iter()
        .fold((f64::INFINITY, 0.0_f64), |(least, most), &value| (least.min(value), most.max(value)));
    (sum - least - most) / (values.len() as f64 - 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A computer: what a frame costs without the picture, and what the picture costs at full resolution, s. The part of
    /// that cost which does not depend on the number of pixels is a tenth.
    #[derive(Clone, Copy)]
    struct Computer {
        page_s: f64,
        picture_s: f64,
    }

    /// Frames of a stream, 30 a second at most.
    struct Page {
        pace: Pace,
        now_s: f64,
        frames_s: Vec<f64>,
        shares: Vec<Option<f32>>,
    }

    impl Page {
        fn new() -> Self {
            Self { pace: Pace::default(), now_s: 100.0, frames_s: Vec::new(), shares: Vec::new() }
        }

        fn moves_for(&mut self, seconds: f64, computer: Computer) -> &mut Self {
            let end_s = self.now_s + seconds;
            (self.frames_s, self.shares) = (Vec::new(), Vec::new());
            while self.now_s < end_s {
                let share = self.pace.frame(self.now_s, true);
                let picture_s =
                    share.map_or(0.0, |share| computer.picture_s * (0.1 + 0.9 * f64::from(share * share)));
                let frame_s = (computer.page_s + picture_s).max(1.0 / 30.0);
                self.now_s += frame_s;
                self.frames_s.push(frame_s);
                self.shares.push(share);
            }
            self
        }

        /// Mean time of the last frames, s.
        fn mean_s(&self) -> f64 {
            let last = &self.frames_s[self.frames_s.len().saturating_sub(20)..];
            last.iter().sum::<f64>() / last.len() as f64
        }

        fn drawn_finely(&self) -> f64 {
            let fine = self.shares.iter().filter(|share| **share == Some(1.0)).count();
            fine as f64 / self.shares.len() as f64
        }
    }

    #[test]
    fn with_a_graphics_card_every_picture_is_fine() {
        let mut page = Page::new();
        page.moves_for(60.0, Computer { page_s: 0.004, picture_s: 0.004 });
        assert_eq!(page.drawn_finely(), 1.0);
    }

    #[test]
    fn a_picture_that_takes_most_of_the_time_becomes_coarse_and_frames_quick() {
        let mut page = Page::new();
        page.moves_for(6.0, Computer { page_s: 0.05, picture_s: 0.07 });
        page.moves_for(10.0, Computer { page_s: 0.05, picture_s: 0.07 });
        assert!(page.mean_s() < SLOW_S, "{}", page.mean_s());
        assert!(page.drawn_finely() < 0.1, "{:?}", page.shares);
    }

    #[test]
    fn a_page_that_is_slow_for_other_reasons_keeps_its_picture() {
        let mut page = Page::new();
        page.moves_for(300.0, Computer { page_s: 0.2, picture_s: 0.005 });
        // Now and then it is tried whether something has changed.
        assert!(page.drawn_finely() > 0.8, "{}", page.drawn_finely());
    }

    #[test]
    fn what_was_coarse_for_a_busy_while_becomes_fine_again() {
        let mut page = Page::new();
        page.moves_for(20.0, Computer { page_s: 0.05, picture_s: 0.1 });
        assert!(page.pace.step > 0);
        page.moves_for(60.0, Computer { page_s: 0.005, picture_s: 0.005 });
        page.moves_for(10.0, Computer { page_s: 0.005, picture_s: 0.005 });
        assert_eq!(page.drawn_finely(), 1.0);
    }

    #[test]
    fn a_finer_picture_that_is_too_slow_is_tried_less_and_less_often() {
        // Coarse 37 ms, the next finer one more than 60.
        let computer = Computer { page_s: 0.033, picture_s: 0.06 };
        let mut page = Page::new();
        page.moves_for(20.0, computer);
        page.moves_for(300.0, computer);
        let slow = page.frames_s.iter().filter(|&&frame_s| frame_s > SLOW_S).count();
        assert!(slow < page.frames_s.len() / 20, "{slow} of {}", page.frames_s.len());
    }

    #[test]
    fn a_picture_that_stands_still_is_drawn_finely_once() {
        let mut page = Page::new();
        page.moves_for(10.0, Computer { page_s: 0.05, picture_s: 0.1 });
        let last_s = page.now_s;
        let shares: Vec<_> =
            (0..20).map(|frame| page.pace.frame(last_s + 0.05 * f64::from(frame), false)).collect();
        assert_eq!(shares.iter().flatten().collect::<Vec<_>>(), [&1.0], "{shares:?}");
        // It had moved until then, so what is drawn next is coarse at once.
        assert!(page.pace.frame(last_s + 2.0, true).is_none_or(|share| share < 1.0));
    }

    #[test]
    fn frames_that_come_seldom_are_not_slow() {
        let mut pace = Pace::default();
        for frame in 0..200 {
            assert_eq!(pace.frame(f64::from(frame) * 2.0, true), Some(1.0));
        }
    }
}
