//! Motions that the station makes by itself: the way to a start pose, and the motion of a take.

use std::sync::Arc;

use palpate_motion::TakeMotion;
use palpate_safety::Lease;

/// Share of the velocity limits that the way to a start pose uses: calm enough to watch and to stop.
const CALM_SHARE: f64 = 0.35;
/// The way to a start pose takes at least this long, s.
const SHORTEST_WAY_S: f64 = 1.0;
/// Peak over mean velocity of the smooth step.
const PEAK_OVER_MEAN: f64 = 1.875;
/// Time after the end of a motion that joints have to arrive, s.
const SETTLE_S: f64 = 0.5;
/// A joint may be further from where it is told to be than it should for this long, s.
const MOST_ERROR_S: f64 = 0.4;

/// Joint positions over time.
#[derive(Clone)]
pub(crate) enum Way {
    /// Straight from one pose to another, starting and ending smoothly.
    Straight {
        from: Vec<f64>,
        to: Vec<f64>,
        duration_s: f64,
    },
    Take(Arc<TakeMotion>),
}

impl Way {
    /// From `from` to `to`, at calm shares of `velocities`, the limits of every joint.
    pub(crate) fn straight(from: &[f64], to: &[f64], velocities: &[f64]) -> Self {
        let needed_s = from
            .iter()
            .zip(to)
            .zip(velocities)
            .map(|((from, to), velocity)| PEAK_OVER_MEAN * (to - from).abs() / (CALM_SHARE * velocity));
        let duration_s = needed_s.fold(SHORTEST_WAY_S, f64::max);
        Self::Straight { from: from.to_vec(), to: to.to_vec(), duration_s }
    }

    fn duration_s(&self) -> f64 {
        match self {
            Self::Straight { duration_s, .. } => *duration_s,
            Self::Take(motion) => motion.duration_s(),
        }
    }

    fn at(&self, time_s: f64, positions: &mut [f64]) {
        match self {
            Self::Straight { from, to, duration_s } => {
                let share = (time_s / duration_s).clamp(0.0, 1.0);
                let smooth = share.powi(3) * (10.0 + share * (6.0 * share - 15.0));
                for ((position, from), to) in positions.iter_mut().zip(from).zip(to) {
                    *position = from + smooth * (to - from);
                }
            }
            Self::Take(motion) => motion.at(time_s, positions),
        }
    }
}

/// A motion that is under way.
pub(crate) struct Follow {
    way: Way,
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
    pub(crate) fn new(way: Way, now_ns: u64, lease: Lease, most_error: Vec<f64>) -> Self {
        let num_dofs = most_error.len();
        Self {
            way,
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
        let time_s = self.elapsed_s(now_ns).min(self.way.duration_s());
        self.way.at(time_s, &mut self.target);
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
        if self.elapsed_s(now_ns) >= self.way.duration_s() + SETTLE_S {
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

    fn follow(from: &[f64], to: &[f64], velocities: &[f64]) -> Follow {
        Follow::new(Way::straight(from, to, velocities), 0, Lease(1), vec![0.35; from.len()])
    }

    #[test]
    fn the_way_to_a_pose_starts_and_ends_there_and_is_calm() {
        let (from, to) = ([0.0, 1.0, -0.5], [1.2, 1.0, -2.0]);
        let velocities = [3.0, 3.0, 0.6];
        let mut follow = follow(&from, &to, &velocities);
        assert_eq!(follow.target(0), from);
        let duration_ns = (follow.way.duration_s() * 1e9) as u64;
        assert_eq!(follow.target(duration_ns + 1), to);
        let mut before = from.to_vec();
        for step in 1..=duration_ns / (5 * MS) {
            let now = follow.target(step * 5 * MS).to_vec();
            for dof in 0..3 {
                let velocity = (now[dof] - before[dof]).abs() / 0.005;
                assert!(velocity <= CALM_SHARE * velocities[dof] + 1e-6, "joint {dof}: {velocity}");
            }
            before = now;
        }
    }

    #[test]
    fn a_way_of_no_length_still_takes_its_time() {
        assert_eq!(Way::straight(&[0.3], &[0.3], &[1.0]).duration_s(), SHORTEST_WAY_S);
    }

    #[test]
    fn a_joint_that_stays_behind_is_named_and_a_short_lag_is_not() {
        let mut follow = follow(&[0.0, 0.0], &[1.0, 1.0], &[3.0, 3.0]);
        assert_eq!(follow.progress(100 * MS, &[0.5, 0.5], &[0.5, 0.1]), Progress::Moving);
        assert_eq!(follow.progress(300 * MS, &[0.5, 0.5], &[0.5, 0.4]), Progress::Moving);
        assert_eq!(follow.progress(400 * MS, &[0.6, 0.6], &[0.6, 0.1]), Progress::Moving);
        assert_eq!(follow.progress(900 * MS, &[0.6, 0.6], &[0.6, 0.1]), Progress::Lagging(1, 0.5));
        assert!((follow.worst_error() - 0.5).abs() < 1e-12);
    }

    #[test]
    fn it_has_arrived_once_its_time_is_over_and_joints_have_settled() {
        let mut follow = follow(&[0.0], &[0.1], &[3.0]);
        let end_ns = ((follow.way.duration_s() + SETTLE_S) * 1e9) as u64;
        assert_eq!(follow.progress(end_ns - MS, &[0.1], &[0.1]), Progress::Moving);
        assert_eq!(follow.progress(end_ns + MS, &[0.1], &[0.1]), Progress::Arrived);
    }
}
