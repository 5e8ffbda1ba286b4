//! Logs of different rates on one clock.
//!
//! Frame `k` lies at `start + k / fps`, in whole ns, and holds of every log its newest sample at or before that time:
//! nothing is interpolated and nothing comes from the future. The clock starts when every log has a sample and ends with
//! the log that ends first, so that no value is invented at either end.

/// ns of a time in s.
pub fn ns_from_secs(time_s: f64) -> u64 {
    (time_s * 1e9).round() as u64
}

/// The frames of one episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clock {
    /// Time of the first frame, ns since the recording's start.
    pub start_ns: u64,
    /// Number of frames.
    pub num_frames: usize,
    /// Frames per second.
    pub fps: u32,
}

impl Clock {
    /// The clock on which all `logs` have values; each is the increasing times of its samples, ns. `None` where they do not
    /// overlap, or one is empty.
    pub fn common(logs: &[&[u64]], fps: u32) -> Option<Self> {
        let start_ns = logs
            .iter()
            .map(|log| log.first().copied())
            .try_fold(0, |start, first| Some(start.max(first?)))?;
        let end_ns = logs
            .iter()
            .map(|log| log.last().copied())
            .try_fold(u64::MAX, |end, last| Some(end.min(last?)))?;
        let span_ns = end_ns.checked_sub(start_ns).filter(|_| fps > 0)?;
        let mut num_frames = (u128::from(span_ns) * u128::from(fps) / NANOS_PER_SEC) as usize + 1;
        // Times of frames are rounded, so one more may lie within.
        while offset_ns(num_frames, fps) <= span_ns {
            num_frames += 1;
        }
        while num_frames > 1 && offset_ns(num_frames - 1, fps) > span_ns {
            num_frames -= 1;
        }
        Some(Self { start_ns, num_frames, fps })
    }

    /// Times of the frames, ns since the recording's start.
    pub fn times_ns(&self) -> impl Iterator<Item = u64> + '_ {
        (0..self.num_frames).map(|frame| self.start_ns + offset_ns(frame, self.fps))
    }

    /// For each frame, the index of the newest of the samples at `times_ns` (increasing) at or before it; `None` before the
    /// first.
    pub fn newest<'a>(&'a self, times_ns: &'a [u64]) -> impl Iterator<Item = Option<usize>> + 'a {
        let mut num_arrived = 0;
        self.times_ns().map(move |now_ns| {
            while times_ns.get(num_arrived).is_some_and(|&time_ns| time_ns <= now_ns) {
                num_arrived += 1;
            }
            num_arrived.checked_sub(1)
        })
    }

    /// The greatest age of a value at any frame, s; `None` where a frame has none.
    pub fn longest_age_s(&self, times_ns: &[u64]) -> Option<f64> {
        let mut ages = self
            .times_ns()
            .zip(self.newest(times_ns))
            .map(|(now_ns, sample)| Some(now_ns - times_ns[sample?]));
        let longest_ns = ages.try_fold(0, |longest, age| Some(u64::max(longest, age?)))?;
        Some(longest_ns as f64 / NANOS_PER_SEC as f64)
    }
}

const NANOS_PER_SEC: u128 = 1_000_000_000;

/// Time of a frame after the first, ns.
fn offset_ns(frame: usize, fps: u32) -> u64 {
    let fps = u128::from(fps);
    ((frame as u128 * NANOS_PER_SEC + fps / 2) / fps) as u64
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Increasing times with pauses of up to a second.
    fn times() -> impl Strategy<Value = Vec<u64>> {
        let pauses = prop::collection::vec(1..1_000_000_000_u64, 1..60);
        (0..2_000_000_000_u64, pauses).prop_map(|(first, pauses)| {
            let mut now = first;
            let later = pauses.into_iter().map(|pause| {
                now += pause;
                now
            });
            later.collect()
        })
    }

    proptest! {
        #[test]
        fn a_frame_holds_the_newest_value_at_or_before_it(first in times(), second in times(), fps in 1..400_u32) {
            let Some(clock) = Clock::common(&[&first, &second], fps) else {
                let overlap = first[0].max(second[0]) <= first[first.len() - 1].min(second[second.len() - 1]);
                prop_assert!(!overlap);
                return Ok(());
            };
            prop_assert_eq!(clock.start_ns, first[0].max(second[0]));
            let end_ns = first[first.len() - 1].min(second[second.len() - 1]);
            let frame_times: Vec<u64> = clock.times_ns().collect();
            prop_assert_eq!(frame_times.len(), clock.num_frames);
            prop_assert!(frame_times[frame_times.len() - 1] <= end_ns);
            prop_assert!(clock.start_ns + offset_ns(clock.num_frames, fps) > end_ns, "a frame is missing");
            for log in [&first, &second] {
                let mut longest = 0;
                for (now, sample) in frame_times.iter().zip(clock.newest(log)) {
                    let sample = sample.expect("every log has begun");
                    prop_assert!(log[sample] <= *now);
                    prop_assert!(log.get(sample + 1).is_none_or(|next| next > now));
                    longest = longest.max(now - log[sample]);
                }
                prop_assert_eq!(clock.longest_age_s(log), Some(longest as f64 / 1e9));
            }
        }
    }

    #[test]
    fn samples_on_the_clock_are_met_exactly() {
        // 30 frames a second are no whole ns apart; every third one lies on a sample of a log of 10 Hz all the same.
        let log: Vec<u64> = (0..50).map(|sample| ns_from_secs(0.7 + 0.1 * f64::from(sample))).collect();
        let clock = Clock::common(&[&log], 30).expect("one log overlaps with itself");
        assert_eq!(clock.num_frames, 148);
        let samples: Vec<Option<usize>> = clock.newest(&log).collect();
        for (frame, sample) in samples.into_iter().enumerate() {
            assert_eq!(sample, Some(frame / 3));
        }
    }

    #[test]
    fn logs_that_do_not_overlap_have_no_clock() {
        assert_eq!(Clock::common(&[&[0, 5], &[6, 9]], 10), None);
        assert_eq!(Clock::common(&[&[0, 5], &[]], 10), None);
        assert_eq!(Clock::common(&[&[5], &[0, 9]], 10).map(|clock| clock.num_frames), Some(1));
    }
}
