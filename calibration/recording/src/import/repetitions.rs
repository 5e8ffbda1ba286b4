//! Repetitions of a motion, found in the joint path where nobody marked them.
//!
//! A stretch of the path repeats itself with lag `n` where every frame has the position of the frame `n` later, within
//! an encoder's and a trajectory's error. A stretch of at least one lag makes two repetitions, of two lags three, and
//! so on. Paths that people pace do not repeat themselves frame by frame; nothing is found in them.

/// Positions that differ by less than this share of the joint's range over the take are the same.
const SAME_SHARE: f64 = 0.03;
/// And those that differ by less than this, rad or m: noise of encoders.
const SAME_LEAST: f64 = 2e-4;
/// A motion moves some joint by at least this share of its range over the take. Less is a tremor.
const MOTION_SHARE: f64 = 0.3;
/// A joint that moves less than this over the take stands still, rad or m.
const STANDS_STILL: f64 = 2e-3;
/// Paths are thinned to at most this many frames: the work grows with their square.
const MAX_FRAMES: usize = 2000;
/// A repetition lasts at least this long, s.
const MIN_PERIOD_S: f64 = 0.5;
/// Groups of repetitions that are looked for in a take.
const MAX_GROUPS: usize = 32;

/// A found repetition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Found {
    pub(super) start_s: f64,
    pub(super) end_s: f64,
    /// Which motion: equal for repetitions of the same one.
    pub(super) group: usize,
}

/// A stretch `first..first + len` of frames each of which has the position of the frame `lag` later.
#[derive(Clone, Copy, Debug)]
struct Run {
    first: usize,
    len: usize,
    lag: usize,
    /// Mean squared difference, as a share of what counts as the same.
    error: f64,
}

impl Run {
    fn covers(&self) -> usize {
        self.len + self.lag
    }

    fn repetitions(&self) -> usize {
        self.covers() / self.lag
    }
}

/// Finds repetitions in `positions` (`num_frames x num_joints`, row-major) at `times_s`. By start.
pub(super) fn find(times_s: &[f64], positions: &[f64], num_joints: usize) -> Vec<Found> {
    let path = Path::new(times_s, positions, num_joints);
    let mut found = Vec::new();
    let mut free = Vec::new();
    free.push(0..path.num_frames());
    let mut group = 0;
    while let Some(frames) = free.pop() {
        if group == MAX_GROUPS {
            break;
        }
        let Some(run) = path.best(frames.clone()) else { continue };
        let num_repetitions = run.repetitions();
        let slack = run.covers() - num_repetitions * run.lag;
        // Where the robot moves least, a motion begins.
        let begin = (run.first..=run.first + slack).min_by(|&a, &b| path.speed(a).total_cmp(&path.speed(b)));
        let begin = begin.unwrap_or(run.first);
        for repetition in 0..num_repetitions {
            let at = |frame: usize| path.times_s[frame.min(path.num_frames() - 1)];
            let start = begin + repetition * run.lag;
            found.push(Found { start_s: at(start), end_s: at(start + run.lag), group });
        }
        group += 1;
        free.push(frames.start..begin);
        free.push(begin + num_repetitions * run.lag..frames.end);
    }
    found.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));
    // Groups in order of their first repetition.
    let mut order: Vec<usize> = Vec::new();
    for repetition in &mut found {
        let place = order.iter().position(|&group| group == repetition.group).unwrap_or_else(|| {
            order.push(repetition.group);
            order.len() - 1
        });
        repetition.group = place;
    }
    found
}

/// The moving joints of a path at even steps, each as multiples of what counts as the same position.
struct Path {
    times_s: Vec<f64>,
    values: Vec<f64>,
    width: usize,
    step_s: f64,
    /// Range of each joint over the whole path.
    ranges: Vec<f64>,
}

impl Path {
    fn new(times_s: &[f64], positions: &[f64], num_joints: usize) -> Self {
        let num_samples = times_s.len();
        let range = |joint: usize| {
            let column = || positions.iter().skip(joint).step_by(num_joints.max(1)).copied();
            column().fold(f64::NEG_INFINITY, f64::max) - column().fold(f64::INFINITY, f64::min)
        };
        let moving: Vec<(usize, f64)> = (0..num_joints)
            .map(|joint| (joint, range(joint)))
            .filter(|&(_, range)| range > STANDS_STILL && range.is_finite())
            .collect();
        let duration_s = if num_samples < 2 { 0.0 } else { times_s[num_samples - 1] - times_s[0] };
        let num_frames = if moving.is_empty() || duration_s <= 0.0 { 0 } else { num_samples.min(MAX_FRAMES) };
        let step_s = duration_s / (num_frames.max(2) - 1) as f64;
        let mut path = Self {
            times_s: Vec::with_capacity(num_frames),
            values: Vec::with_capacity(num_frames * moving.len()),
            width: moving.len(),
            step_s,
            ranges: moving.iter().map(|&(_, range)| range / (SAME_SHARE * range).max(SAME_LEAST)).collect(),
        };
        let mut before = 0;
        for frame in 0..num_frames {
            let time_s = times_s[0] + frame as f64 * step_s;
            while before + 2 < num_samples && times_s[before + 1] <= time_s {
                before += 1;
            }
            let share =
                ((time_s - times_s[before]) / (times_s[before + 1] - times_s[before])).clamp(0.0, 1.0);
            path.times_s.push(time_s);
            for &(joint, range) in &moving {
                let at = |sample: usize| positions[sample * num_joints + joint];
                let position = at(before) + share * (at(before + 1) - at(before));
                path.values.push(position / (SAME_SHARE * range).max(SAME_LEAST));
            }
        }
        path
    }

    fn num_frames(&self) -> usize {
        self.times_s.len()
    }

    fn frame(&self, frame: usize) -> &[f64] {
        &self.values[frame * self.width..(frame + 1) * self.width]
    }

    /// Largest difference of any joint between two frames.
    fn difference(&self, a: usize, b: usize) -> f64 {
        self.frame(a).iter().zip(self.frame(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    fn speed(&self, frame: usize) -> f64 {
        if self.num_frames() < 2 {
            return 0.0;
        }
        let last = self.num_frames() - 1;
        let frame = frame.min(last);
        self.difference(frame.saturating_sub(1), frame) + self.difference(frame, (frame + 1).min(last))
    }

    /// Whether some joint moves far enough within `frames` to be a motion.
    fn moves(&self, frames: std::ops::Range<usize>) -> bool {
        (0..self.width).any(|joint| {
            let column = || frames.clone().map(|frame| self.frame(frame)[joint]);
            let moved = column().fold(f64::NEG_INFINITY, f64::max) - column().fold(f64::INFINITY, f64::min);
            moved > MOTION_SHARE * self.ranges[joint]
        })
    }

    /// The run within `frames` that covers most; of those that cover about as much, the shortest lag with the least
    /// error.
    fn best(&self, frames: std::ops::Range<usize>) -> Option<Run> {
        let min_lag = ((MIN_PERIOD_S / self.step_s).ceil() as usize).max(4);
        let mut runs: Vec<Run> = Vec::new();
        for lag in min_lag..=frames.len() / 2 {
            let mut run: Option<Run> = None;
            for frame in frames.start..frames.end - lag + 1 {
                let difference = if frame + lag < frames.end {
                    self.difference(frame, frame + lag)
                } else {
                    f64::INFINITY
                };
                if difference <= 1.0 {
                    let run = run.get_or_insert(Run { first: frame, len: 0, lag, error: 0.0 });
                    run.len += 1;
                    run.error += difference * difference;
                } else if let Some(mut ended) = run.take()
                    && ended.len >= lag
                    && self.moves(ended.first..ended.first + lag)
                {
                    ended.error /= ended.len as f64;
                    runs.push(ended);
                }
            }
        }
        let most = runs.iter().map(Run::covers).max()?;
        let mut good: Vec<Run> = runs.into_iter().filter(|run| 10 * run.covers() >= 9 * most).collect();
        let shortest = good.iter().map(|run| run.lag).min()?;
        // Lags next to the true one fit nearly as well.
        good.retain(|run| 4 * run.lag <= 5 * shortest);
        good.into_iter().min_by(|a, b| a.error.total_cmp(&b.error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two joints: the first presses `presses` times for two seconds each after a second of rest, the second drifts to
    /// another place between groups.
    fn path(groups: &[(usize, f64)], rate_hz: f64, pace: impl Fn(usize) -> f64) -> (Vec<f64>, Vec<f64>) {
        let (mut times_s, mut positions) = (Vec::new(), Vec::new());
        let mut push = |a: f64, b: f64| {
            times_s.push(times_s.len() as f64 / rate_hz);
            positions.extend([a, b]);
        };
        let mut place = 0.0;
        for &(presses, to) in groups {
            let num = (1.5 * rate_hz) as usize;
            for frame in 0..num {
                push(0.0, place + (to - place) * frame as f64 / num as f64);
            }
            place = to;
            for press in 0..presses {
                let num = (2.0 * rate_hz * pace(press)) as usize;
                for frame in 0..num {
                    let phase = frame as f64 / num as f64;
                    push(0.5 * (std::f64::consts::PI * phase).sin().powi(2) * (1.0 + 0.2 * phase), place);
                }
            }
        }
        (times_s, positions)
    }

    #[test]
    fn every_group_of_equal_motions_is_found() {
        let (times_s, positions) = path(&[(3, 0.4), (2, -0.3)], 20.0, |_| 1.0);
        let found = find(&times_s, &positions, 2);
        let groups: Vec<usize> = found.iter().map(|found| found.group).collect();
        assert_eq!(groups, [0, 0, 0, 1, 1], "{found:?}");
        for (found, start_s) in found.iter().zip([1.5, 3.5, 5.5, 9.0, 11.0]) {
            assert!((found.end_s - found.start_s - 2.0).abs() < 0.11, "{found:?}");
            assert!((found.start_s - start_s).abs() < 0.3, "{found:?} should start at {start_s}");
        }
    }

    #[test]
    fn nothing_is_found_where_nothing_repeats_itself() {
        let (times_s, positions) = path(&[(1, 0.4), (1, -0.3)], 20.0, |_| 1.0);
        assert_eq!(find(&times_s, &positions, 2), []);
        // At a pace of somebody's own.
        let (times_s, positions) = path(&[(3, 0.4)], 20.0, |press| 1.0 + 0.25 * press as f64);
        assert_eq!(find(&times_s, &positions, 2), []);
        // At rest, and on the way somewhere.
        assert_eq!(find(&[0.0, 1.0, 2.0, 3.0], &[0.1; 4], 1), []);
        let ramp: Vec<f64> = (0..400).map(f64::from).collect();
        assert_eq!(find(&ramp, &ramp, 1), []);
        assert_eq!(find(&[], &[], 3), []);
        assert_eq!(find(&[0.5], &[1.0], 1), []);
    }

    #[test]
    fn long_paths_are_thinned_and_noise_is_borne() {
        let (times_s, mut positions) = path(&[(4, 0.4)], 1000.0, |_| 1.0);
        for (idx, position) in positions.iter_mut().enumerate() {
            *position += 1e-3 * ((idx * 7919) as f64).sin();
        }
        let found = find(&times_s, &positions, 2);
        assert_eq!(found.len(), 4, "{found:?}");
        assert!(found.iter().all(|found| (found.end_s - found.start_s - 2.0).abs() < 0.05), "{found:?}");
    }
}
