//! Joint paths: segments between rests, each along its own waypoints.

/// A motion from rest to rest along waypoints that are evenly spaced in progress.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Segment {
    /// Duration, s.
    pub(crate) duration_s: f64,
    /// Joint positions passed through, in order; a single one stands still.
    pub(crate) waypoints: Vec<Vec<f64>>,
}

/// Segments one after another; before the first and after the last the robot stands still.
#[derive(Clone, Debug, Default)]
pub(crate) struct JointPath {
    segments: Vec<Segment>,
    /// End time of each segment, s.
    ends_s: Vec<f64>,
}

impl Segment {
    /// Stands still.
    pub(crate) fn still(positions: &[f64], duration_s: f64) -> Self {
        Self { duration_s, waypoints: vec![positions.to_vec()] }
    }

    /// The last position.
    pub(crate) fn end(&self) -> &[f64] {
        self.waypoints.last().map_or(&[], Vec::as_slice)
    }

    /// The same way back.
    pub(crate) fn reversed(&self) -> Self {
        Self { duration_s: self.duration_s, waypoints: self.waypoints.iter().rev().cloned().collect() }
    }

    /// Position at `progress` in 0..=1, by Catmull-Rom splines through the waypoints.
    fn at(&self, progress: f64, positions: &mut [f64]) {
        let waypoints = &self.waypoints;
        let last = waypoints.len() - 1;
        if last == 0 {
            positions.copy_from_slice(&waypoints[0]);
            return;
        }
        let scaled = progress.clamp(0.0, 1.0) * last as f64;
        let start = (scaled as usize).min(last - 1);
        let u = scaled - start as f64;
        let before = &waypoints[start.saturating_sub(1)];
        let (from, to) = (&waypoints[start], &waypoints[start + 1]);
        let after = &waypoints[(start + 2).min(last)];
        for dof in 0..positions.len() {
            // Tangents by central differences; one-sided at the ends, so that two waypoints give a straight line.
            let at_from = if start == 0 { to[dof] - from[dof] } else { 0.5 * (to[dof] - before[dof]) };
            let at_to = if start + 1 == last { to[dof] - from[dof] } else { 0.5 * (after[dof] - from[dof]) };
            let (u2, u3) = (u * u, u * u * u);
            positions[dof] = (2.0 * u3 - 3.0 * u2 + 1.0) * from[dof]
                + (u3 - 2.0 * u2 + u) * at_from
                + (3.0 * u2 - 2.0 * u3) * to[dof]
                + (u3 - u2) * at_to;
        }
    }
}

impl JointPath {
    /// Adds a segment; it must start where the path ends.
    pub(crate) fn push(&mut self, segment: Segment) {
        if segment.duration_s > 0.0 {
            self.ends_s.push(self.duration_s() + segment.duration_s);
            self.segments.push(segment);
        }
    }

    /// Duration, s.
    pub(crate) fn duration_s(&self) -> f64 {
        self.ends_s.last().copied().unwrap_or(0.0)
    }

    /// Positions at `time_s` since the start.
    pub(crate) fn at(&self, time_s: f64, positions: &mut [f64]) {
        let idx = self.ends_s.partition_point(|&end| end <= time_s).min(self.segments.len() - 1);
        let segment = &self.segments[idx];
        let start_s = self.ends_s[idx] - segment.duration_s;
        segment.at(minimum_jerk((time_s - start_s) / segment.duration_s), positions);
    }
}

/// Progress along the smoothest motion from rest to rest: no jumps in acceleration.
fn minimum_jerk(fraction: f64) -> f64 {
    let t = fraction.clamp(0.0, 1.0);
    t * t * t * (10.0 + t * (6.0 * t - 15.0))
}

/// Largest speed of [`minimum_jerk`] over its mean.
pub(crate) const PEAK_OVER_MEAN: f64 = 1.875;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_continuous_and_rest_at_both_ends() {
        let mut path = JointPath::default();
        path.push(Segment {
            duration_s: 0.7,
            waypoints: vec![vec![0.0, 1.0], vec![0.3, 0.9], vec![1.0, 0.0]],
        });
        path.push(Segment::still(&[1.0, 0.0], 0.2));
        path.push(Segment { duration_s: 0.5, waypoints: vec![vec![1.0, 0.0], vec![0.0, 1.0]] });
        let mut last = vec![0.0, 1.0];
        let mut now = vec![0.0; 2];
        for step in -10..1500 {
            path.at(f64::from(step) * 1e-3, &mut now);
            for (a, b) in now.iter().zip(&last) {
                assert!((a - b).abs() < PEAK_OVER_MEAN * 1.6 / 0.5 * 1e-3, "jump at {step} ms");
            }
            last.clone_from(&now);
        }
        assert_eq!(now, vec![0.0, 1.0]);
        path.at(0.7, &mut now);
        assert_eq!(now, vec![1.0, 0.0]);
    }
}
