//! The moments of a take at which its touch is simulated.

/// Joint frames are cut into parts of at most this length near contact, s: touch begins and ends between two frames, and
/// filters and latches are faster than they are.
const LONGEST_PART_S: f64 = 0.025;
/// Near contact: this long before and after anything is felt, s.
const NEAR_CONTACT_S: f64 = 0.5;
/// Room for rounding in a length of time, in parts.
const ROUNDING: f64 = 1e-9;

/// Moments of a take, increasing: those of its joint frames and, near contact, more between them.
#[derive(Clone, Debug)]
pub(crate) struct Moments {
    times_s: Vec<f64>,
    /// Which of them each joint frame is.
    frames: Vec<usize>,
}

impl Moments {
    /// Of a take with joint frames at `frame_times_s` (increasing) in which something is felt at the times `felt_s`, in
    /// any order.
    pub(crate) fn new(frame_times_s: &[f64], felt_s: &[f64]) -> Self {
        let mut near = vec![false; frame_times_s.len()];
        for felt_s in felt_s {
            let first = frame_times_s.partition_point(|frame_s| *frame_s < felt_s - NEAR_CONTACT_S);
            let end = frame_times_s.partition_point(|frame_s| *frame_s <= felt_s + NEAR_CONTACT_S);
            near[first.min(end)..end].fill(true);
        }
        let mut moments = Self { times_s: Vec::new(), frames: Vec::with_capacity(frame_times_s.len()) };
        for (frame, &time_s) in frame_times_s.iter().enumerate() {
            moments.frames.push(moments.times_s.len());
            moments.times_s.push(time_s);
            let Some(next_s) = frame_times_s.get(frame + 1).filter(|_| near[frame]) else { continue };
            let num_parts = ((next_s - time_s) / LONGEST_PART_S - ROUNDING).ceil().max(1.0);
            let part_s = (next_s - time_s) / num_parts;
            moments.times_s.extend((1..num_parts as usize).map(|part| time_s + part as f64 * part_s));
        }
        moments
    }

    /// When they are, s.
    pub(crate) fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Which of them each joint frame is.
    pub(crate) fn frames(&self) -> &[usize] {
        &self.frames
    }

    /// Rows of `width` values at the joint frames, at the moments: cubic between frames (Catmull and Rom), because joints
    /// speed up and slow down within a frame.
    pub(crate) fn interpolated(&self, of_frames: &[f64], width: usize) -> Vec<f64> {
        let rows: Vec<&[f64]> = of_frames.chunks_exact(width.max(1)).collect();
        let time_s = |frame: usize| self.times_s[self.frames[frame]];
        // Slope of column `idx` at a frame.
        let slope = |frame: usize, idx: usize| {
            let (before, after) = (frame.saturating_sub(1), (frame + 1).min(rows.len() - 1));
            (rows[after][idx] - rows[before][idx]) / (time_s(after) - time_s(before))
        };
        let mut values = Vec::with_capacity(self.times_s.len() * width);
        for (frame, row) in rows.iter().enumerate() {
            values.extend_from_slice(row);
            let (Some(next), Some(&end)) = (rows.get(frame + 1), self.frames.get(frame + 1)) else {
                continue;
            };
            let start = self.frames[frame];
            let length_s = time_s(frame + 1) - time_s(frame);
            for moment in start + 1..end {
                let share = (self.times_s[moment] - time_s(frame)) / length_s;
                let rest = 1.0 - share;
                values.extend((0..width).map(|idx| {
                    let (from, to) = (row[idx], next[idx]);
                    let straight = from + share * (to - from);
                    let (at_start, at_end) = (
                        slope(frame, idx) * length_s - (to - from),
                        slope(frame + 1, idx) * length_s - (to - from),
                    );
                    straight + share * rest * (rest * at_start - share * at_end)
                }));
            }
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn frames_keep_their_times_and_contact_is_looked_at_closely(
            gaps_s in prop::collection::vec(0.01..0.3, 1..60),
            felt_s in prop::collection::vec(0.0..6.0, 0..4),
        ) {
            let mut time_s = 0.0;
            let frame_times_s: Vec<f64> = gaps_s.iter().map(|gap_s| { time_s += gap_s; time_s }).collect();
            let moments = Moments::new(&frame_times_s, &felt_s);
            let at_frames: Vec<f64> = moments.frames().iter().map(|&at| moments.times_s()[at]).collect();
            prop_assert_eq!(at_frames, frame_times_s);
            for pair in moments.times_s().windows(2) {
                prop_assert!(pair[0] < pair[1]);
                let near = felt_s.iter().any(|felt_s| (felt_s - pair[0]).abs() < NEAR_CONTACT_S - 0.3);
                prop_assert!(!near || pair[1] - pair[0] < LONGEST_PART_S + 1e-6, "{pair:?}");
            }
        }
    }

    #[test]
    fn a_steady_acceleration_is_met_between_frames() {
        let frame_times_s: Vec<f64> = (0..20).map(|frame| f64::from(frame) * 0.1).collect();
        let moments = Moments::new(&frame_times_s, &[1.0]);
        assert!(moments.times_s().len() > 40, "{}", moments.times_s().len());
        let position = |time_s: f64| [0.3 + 0.2 * time_s * time_s, -time_s];
        let of_frames: Vec<f64> = frame_times_s.iter().flat_map(|&time_s| position(time_s)).collect();
        let found = moments.interpolated(&of_frames, 2);
        for (&time_s, found) in moments.times_s().iter().zip(found.chunks_exact(2)) {
            let wanted = position(time_s);
            assert!((found[0] - wanted[0]).abs() < 1e-9 && (found[1] - wanted[1]).abs() < 1e-9, "{time_s} s");
        }
    }
}
