//! Motions that the station makes by itself: the way to a start pose, and the motion of a take.

use std::sync::Arc;

use palpate_motion::TakeMotion;
use palpate_safety::Lease;

/// Time after the end of a motion that joints have to arrive, s.
const SETTLE_S: f64 = 0.5;
/// A joint may be further from where it is told to be than it should for this long, s.
const MOST_ERROR_S: f64 = 0.4;

/// Joint positions over time.
pub(crate) trait Path {
    fn duration_s(&self) -> f64;
    /// Where the joints shall be `time_s` after the start.
    fn at(&self, time_s: f64, positions: &mut [f64]);
}

impl Path for Arc<TakeMotion> {
    fn duration_s(&self) -> f64 {
        TakeMotion::duration_s(self)
    }

    fn at(&self, time_s: f64, positions: &mut [f64]) {
        TakeMotion::at(self, time_s, positions);
    }
}

/// A motion that is under way.
pub(crate) struct Follow {
    path: Box<dyn Path + Send>,
    began_ns: u64,
    /// Whose lease it moves under.
    pub(crate) lease: Lease,
    target: Vec<f64>,
    /// How far each joint may be from where it is told to be, rad or m.
    most_error: Vec<f64>,
    /// Since when each joint has been too far off.
    off_since_ns: Vec<Option<u64>>,
    worst_error: f64,
}

/// Where a motion stands.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Progress {
    /// It goes on.
    Moving,
    /// It has come to its end.
    Arrived,
    /// A joint does not follow: its index, and how far it is off.
    Lagging(usize, f64),
}

impl Follow {
    pub(crate) fn new(path: Box<dyn Path + Send>, now_ns: u64, lease: Lease, most_error: Vec<f64>) -> Self {
        let num_dofs = most_error.len();
        Self {
            path,
            began_ns: now_ns,
            lease,
            target: vec![0.0; num_dofs],
            most_error,
            off_since_ns: vec![None; num_dofs],
            worst_error: 0.0,
        }
    }

    /// Time since the motion began, s.
    fn elapsed_s(&self, now_ns: u64) -> f64 {
        now_ns.saturating_sub(self.began_ns) as f64 * 1e-9
    }

    /// Furthest that any joint has been from where it was told to be, rad or m.
    pub(crate) fn worst_error(&self) -> f64 {
        self.worst_error
    }

    /// Where the joints shall be now.
    pub(crate) fn target(&mut self, now_ns: u64) -> &[f64] {
        let time_s = self.elapsed_s(now_ns).min(self.path.duration_s());
        self.path.at(time_s, &mut self.target);
        &self.target
    }

    /// Compares where the joints are told to be (`commanded`) with where they are.
    pub(crate) fn progress(&mut self, now_ns: u64, commanded: &[f64], measured: &[f64]) -> Progress {
        let errors = commanded.iter().zip(measured).map(|(commanded, measured)| (commanded - measured).abs());
        let joints = errors.zip(&self.most_error).zip(&mut self.off_since_ns);
        for (dof, ((error, most), since)) in joints.enumerate() {
            self.worst_error = self.worst_error.max(error);
            if error <= *most {
                *since = None;
                continue;
            }
            let since_ns = *since.get_or_insert(now_ns);
            if now_ns.saturating_sub(since_ns) as f64 * 1e-9 > MOST_ERROR_S {
                return Progress::Lagging(dof, error);
            }
        }
        if self.elapsed_s(now_ns) >= self.path.duration_s() + SETTLE_S {
            Progress::Arrived
        } else {
            Progress::Moving
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    /// Two joints that move at 1 rad/s for two seconds.
    struct Ramp;

    impl Path for Ramp {
        fn duration_s(&self) -> f64 {
            2.0
        }

        fn at(&self, time_s: f64, positions: &mut [f64]) {
            positions.copy_from_slice(&[time_s, -time_s]);
        }
    }

    /// Begins at 1 s.
    fn follow() -> Follow {
        Follow::new(Box::new(Ramp), 1000 * MS, Lease(1), vec![0.35, 0.05])
    }

    #[test]
    fn targets_are_where_the_path_is_and_stay_at_its_end() {
        let mut follow = follow();
        for (at_ms, position) in [(1000, 0.0), (1500, 0.5), (3000, 2.0), (9000, 2.0)] {
            assert_eq!(follow.target(at_ms * MS), [position, -position]);
        }
    }

    #[test]
    fn a_joint_that_stays_behind_is_named_and_a_short_lag_is_not() {
        let mut follow = follow();
        assert_eq!(follow.progress(1100 * MS, &[0.5, 0.5], &[0.5, 0.4]), Progress::Moving);
        assert_eq!(follow.progress(1300 * MS, &[0.5, 0.5], &[0.2, 0.48]), Progress::Moving);
        assert_eq!(follow.progress(1400 * MS, &[0.6, 0.6], &[0.6, 0.5]), Progress::Moving);
        assert_eq!(follow.progress(1900 * MS, &[0.6, 0.6], &[0.6, 0.1]), Progress::Lagging(1, 0.5));
        assert!((follow.worst_error() - 0.5).abs() < 1e-12);
    }

    #[test]
    fn it_has_arrived_once_its_time_is_over_and_joints_have_settled() {
        let mut follow = follow();
        let end_ns = 1000 * MS + ((2.0 + SETTLE_S) * 1e9) as u64;
        assert_eq!(follow.progress(end_ns - MS, &[2.0, -2.0], &[2.0, -2.0]), Progress::Moving);
        assert_eq!(follow.progress(end_ns + MS, &[2.0, -2.0], &[2.0, -2.0]), Progress::Arrived);
    }
}
