//! Loads at moments between the frames of a take.

use std::sync::Arc;

/// Moments between frames.
pub(super) enum Moments {
    /// Those of the frames.
    Frames,
    /// Between which two frames each is, and which share of the way from the first to the second.
    Between(Vec<(u32, u32, f64)>),
}

impl Moments {
    /// The moments `times_s`: before the first frame is at the first, after the last at the last.
    pub(super) fn new(frame_times_s: &[f64], times_s: &[f64]) -> Self {
        if times_s == frame_times_s {
            return Self::Frames;
        }
        let num_frames = frame_times_s.len();
        let mut after = 0;
        let between = |&time_s: &f64| {
            // Times nearly increase: walk, in either direction.
            while after < num_frames && frame_times_s[after] <= time_s {
                after += 1;
            }
            while after > 0 && frame_times_s[after - 1] > time_s {
                after -= 1;
            }
            let (from, to) = (after.saturating_sub(1), after.min(num_frames - 1));
            let gap_s = frame_times_s[to] - frame_times_s[from];
            let share = if gap_s > 0.0 { (time_s - frame_times_s[from]) / gap_s } else { 0.0 };
            (from as u32, to as u32, share)
        };
        Self::Between(times_s.iter().map(between).collect())
    }

    /// `loads` (frame by frame) at these moments, linear between frames.
    pub(super) fn of(&self, loads: &Arc<[f64]>) -> Arc<[f64]> {
        let Self::Between(moments) = self else { return Arc::clone(loads) };
        let at = |&(from, to, share): &(u32, u32, f64)| {
            let (from, to) = (loads[from as usize], loads[to as usize]);
            from + share * (to - from)
        };
        moments.iter().map(at).collect()
    }
}
