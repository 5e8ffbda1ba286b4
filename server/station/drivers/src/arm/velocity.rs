//! Velocities from positions, for reports that have none.

use std::collections::VecDeque;

/// Reports that a velocity is taken from.
const NUM_REPORTS: usize = 5;
/// Reports closer together than this say nothing: a stall ended and they all came at once, ns.
const SHORTEST_NS: u64 = 15_000_000;

/// The slope of the line of least squares through the last few positions.
#[derive(Clone, Debug)]
pub(crate) struct VelocityEstimate {
    /// Time and positions, oldest first.
    recent: VecDeque<(u64, Vec<f64>)>,
    rad_per_sec: Vec<f64>,
}

impl VelocityEstimate {
    /// Of joints that stand still until two positions are known.
    pub(crate) fn new(num_joints: usize) -> Self {
        Self { recent: VecDeque::new(), rad_per_sec: vec![0.0; num_joints] }
    }

    /// Takes the positions of a time and gives the velocities.
    pub(crate) fn add(&mut self, at_ns: u64, positions_rad: &[f64]) -> Vec<f64> {
        self.recent.push_back((at_ns, positions_rad.to_vec()));
        if self.recent.len() > NUM_REPORTS {
            self.recent.pop_front();
        }
        let Some(&(first_ns, _)) = self.recent.front() else { return self.rad_per_sec.clone() };
        if at_ns.saturating_sub(first_ns) < SHORTEST_NS {
            return self.rad_per_sec.clone();
        }
        let times_s: Vec<f64> =
            self.recent.iter().map(|(at_ns, _)| at_ns.saturating_sub(first_ns) as f64 * 1e-9).collect();
        let mean_s = times_s.iter().sum::<f64>() / times_s.len() as f64;
        let spread: f64 = times_s.iter().map(|time_s| (time_s - mean_s).powi(2)).sum();
        for (joint, velocity) in self.rad_per_sec.iter_mut().enumerate() {
            let moved = self.recent.iter().zip(&times_s);
            // Any constant may be taken off the positions; the last keeps the sum exact for joints that stand still.
            let slope: f64 = moved
                .map(|((_, at_rad), time_s)| (time_s - mean_s) * (at_rad[joint] - positions_rad[joint]))
                .sum();
            *velocity = slope / spread;
        }
        self.rad_per_sec.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn a_steady_motion_has_its_velocity_and_a_joint_at_rest_none() {
        let mut estimate = VelocityEstimate::new(2);
        let mut last = Vec::new();
        for ms in (0..100).step_by(10) {
            last = estimate.add(ms * MS, &[0.3 * ms as f64 * 1e-3, 1.7]);
        }
        assert!((last[0] - 0.3).abs() < 1e-9, "{last:?}");
        assert_eq!(last[1].to_bits(), 0.0_f64.to_bits());
    }

    #[test]
    fn reports_that_a_stall_held_up_do_not_make_a_joint_fast() {
        let mut estimate = VelocityEstimate::new(1);
        let at_rad = |ms: u64| [0.5 * ms as f64 * 1e-3];
        let mut fastest = 0.0_f64;
        for ms in (0..400).step_by(10) {
            // Nothing arrives between 100 and 290 ms, then everything does.
            let received_ns = if (100..290).contains(&ms) { 290 * MS + ms * 1000 } else { ms * MS };
            fastest = estimate.add(received_ns, &at_rad(ms)).into_iter().fold(fastest, f64::max);
        }
        assert!(fastest < 2.5, "{fastest} rad/s");
        let settled = estimate.add(400 * MS, &at_rad(400));
        assert!((settled[0] - 0.5).abs() < 1e-6, "{settled:?}");
    }
}
