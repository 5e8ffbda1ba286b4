//! Joint paths: segments between rests, each along its own waypoints.

/// How finely [`Segment::peaks`] looks at a piece between two waypoints; peaks between samples are missed by less than
/// a thousandth.
const SAMPLES_PER_PIECE: usize = 48;

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
        let (from, to) = (&waypoints[start], &waypoints[start + 1]);
        for dof in 0..positions.len() {
            let (at_from, at_to) = self.tangents(start, dof);
            let (u2, u3) = (u * u, u * u * u);
            positions[dof] = (2.0 * u3 - 3.0 * u2 + 1.0) * from[dof]
                + (u3 - 2.0 * u2 + u) * at_from
                + (3.0 * u2 - 2.0 * u3) * to[dof]
                + (u3 - u2) * at_to;
        }
    }

    /// Tangents at both ends of the piece that begins at waypoint `start`: central differences, one-sided at the ends,
    /// so that two waypoints give a straight line.
    fn tangents(&self, start: usize, dof: usize) -> (f64, f64) {
        let waypoints = &self.waypoints;
        let last = waypoints.len() - 1;
        let before = &waypoints[start.saturating_sub(1)];
        let (from, to) = (&waypoints[start], &waypoints[start + 1]);
        let after = &waypoints[(start + 2).min(last)];
        let at_from = if start == 0 { to[dof] - from[dof] } else { 0.5 * (to[dof] - before[dof]) };
        let at_to = if start + 1 == last { to[dof] - from[dof] } else { 0.5 * (after[dof] - from[dof]) };
        (at_from, at_to)
    }

    /// Largest speed and acceleration of each degree of freedom if the segment lasted 1 s. Lasting T, speeds are these
    /// over T, accelerations these over T squared.
    pub(crate) fn peaks(&self) -> Vec<Peak> {
        let mut peaks = vec![Peak::default(); self.end().len()];
        let pieces = self.waypoints.len() - 1;
        for start in 0..pieces {
            // Pieces join with equal speeds and unequal accelerations, so each is looked at from end to end.
            let [from, to] = [start, start + 1].map(|knot| time_of(knot as f64 / pieces as f64));
            for sample in 0..=SAMPLES_PER_PIECE {
                let time = from + (to - from) * sample as f64 / SAMPLES_PER_PIECE as f64;
                let u = (minimum_jerk(time) * pieces as f64 - start as f64).clamp(0.0, 1.0);
                // Progress of u, per s and per s squared.
                let rate = 30.0 * (time * (1.0 - time)).powi(2) * pieces as f64;
                let change = 60.0 * time * (1.0 - time) * (1.0 - 2.0 * time) * pieces as f64;
                for (dof, peak) in peaks.iter_mut().enumerate() {
                    let (at_from, at_to) = self.tangents(start, dof);
                    let step = self.waypoints[start + 1][dof] - self.waypoints[start][dof];
                    let slope = 6.0 * u * (1.0 - u) * step
                        + (3.0 * u * u - 4.0 * u + 1.0) * at_from
                        + (3.0 * u * u - 2.0 * u) * at_to;
                    let bend =
                        6.0 * (1.0 - 2.0 * u) * step + (6.0 * u - 4.0) * at_from + (6.0 * u - 2.0) * at_to;
                    peak.velocity = peak.velocity.max((slope * rate).abs());
                    peak.acceleration = peak.acceleration.max((bend * rate * rate + slope * change).abs());
                }
            }
        }
        peaks
    }
}

/// Largest speed and acceleration of one degree of freedom along a segment that lasts 1 s.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Peak {
    /// rad/s or m/s.
    pub(crate) velocity: f64,
    /// rad/s² or m/s².
    pub(crate) acceleration: f64,
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

    /// Positions at the start.
    pub(crate) fn start(&self) -> &[f64] {
        self.segments.first().map_or(&[], |segment| &segment.waypoints[0])
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

/// The time in 0..=1 at which [`minimum_jerk`] reaches `progress`.
fn time_of(progress: f64) -> f64 {
    let (mut lower, mut upper) = (0.0, 1.0);
    for _ in 0..50 {
        let middle = 0.5 * (lower + upper);
        if minimum_jerk(middle) < progress {
            lower = middle;
        } else {
            upper = middle;
        }
    }
    0.5 * (lower + upper)
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
