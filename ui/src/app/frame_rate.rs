//! Measures how many frames a second this page draws.

use std::collections::VecDeque;

/// Frames of the last so many seconds count.
const WINDOW_S: f64 = 3.0;
/// Nothing is said before so many seconds were seen.
const MIN_SPAN_S: f64 = 2.0;
/// Whoever holds control sees a robot that may move: fewer frames a second show it too late to react.
pub(super) const MIN_PER_SECOND: f64 = 5.0;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct FrameRate {
    times_s: VecDeque<f64>,
}

impl FrameRate {
    /// A frame is drawn at `now_s`. Frames that do not `count`, because none need to be drawn, start the count anew.
    pub(super) fn frame(&mut self, now_s: f64, count: bool) {
        if !count {
            self.times_s.clear();
            return;
        }
        self.times_s.push_back(now_s);
        // One frame from before the window stays: the time since then was without any.
        while self.times_s.get(1).is_some_and(|&time_s| time_s <= now_s - WINDOW_S) {
            self.times_s.pop_front();
        }
    }

    /// Frames a second over the last seconds; `None` while too few seconds were seen.
    pub(super) fn per_second(&self) -> Option<f64> {
        let span_s = self.times_s.back()? - self.times_s.front()?;
        (span_s >= MIN_SPAN_S).then(|| (self.times_s.len() - 1) as f64 / span_s)
    }

    /// What to tell about a page that draws too slowly; `None` if it does not.
    pub(super) fn complaint(&self) -> Option<String> {
        let rate = self.per_second().filter(|&rate| rate < MIN_PER_SECOND)?;
        let (number, s) = match (rate < 0.95, rate.round()) {
            (true, _) => (format!("{rate:.1}"), "s"),
            (false, 1.0) => ("1".to_owned(), ""),
            (false, whole) => (format!("{whole:.0}"), "s"),
        };
        Some(format!(
            "This browser draws {number} frame{s} a second, too slow to hold control. Close other programs and pages, \
             or give control to another computer."
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(every_s: f64, frames: u32) -> FrameRate {
        let mut rate = FrameRate::default();
        for frame in 0..frames {
            rate.frame(f64::from(frame) * every_s, true);
        }
        rate
    }

    #[test]
    fn slow_pages_are_told_how_slow_and_fast_ones_nothing() {
        assert_eq!(drawn(0.05, 200).complaint(), None);
        assert_eq!(drawn(0.5, 3).complaint(), None, "one second says little");
        let slow = drawn(0.5, 20).complaint().expect("two a second are too few");
        assert!(
            slow.starts_with("This browser draws 2 frames a second, too slow to hold control."),
            "{slow}"
        );
        assert!(drawn(1.0, 5).complaint().expect("slow").contains("draws 1 frame a second"));
        assert!(drawn(2.0, 5).complaint().expect("slow").contains("draws 0.5 frames a second"));
    }

    #[test]
    fn page_that_recovers_is_not_blamed_for_long() {
        let mut rate = drawn(1.0, 5);
        for frame in 1..=70 {
            rate.frame(4.0 + f64::from(frame) * 0.05, true);
        }
        assert_eq!(rate.complaint(), None);
        rate.frame(100.0, false);
        assert_eq!(rate.per_second(), None);
    }
}
