//! Nearest points in clouds.

/// Candidates that are compared at a time.
const LANES: usize = 8;

/// A cloud laid out so that many of its points are compared at a time.
pub(crate) struct Cloud {
    /// x, y, z of every point, each filled up with points that are nearest to nothing.
    axes: [Vec<f32>; 3],
}

/// A point's nearest one in a cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Nearest {
    pub(crate) idx: usize,
    /// m.
    pub(crate) distance: f32,
}

impl Cloud {
    /// `points` is `[any, 3]`.
    pub(crate) fn new(points: &[f32]) -> Self {
        let padded = (points.len() / 3).next_multiple_of(LANES);
        let axis = |axis: usize| {
            let mut values: Vec<f32> = points.iter().skip(axis).step_by(3).copied().collect();
            values.resize(padded, f32::INFINITY);
            values
        };
        Self { axes: [axis(0), axis(1), axis(2)] }
    }

    /// The nearest to `point`, the first of equals.
    pub(crate) fn nearest(&self, point: &[f32]) -> Nearest {
        self.search(point, usize::MAX)
    }

    /// The nearest to `point` but for the one numbered `left_out`.
    pub(crate) fn nearest_other(&self, point: &[f32], left_out: usize) -> Nearest {
        self.search(point, left_out)
    }

    fn search(&self, point: &[f32], left_out: usize) -> Nearest {
        let [x, y, z] = [point[0], point[1], point[2]];
        let (mut least, mut found) = ([f32::INFINITY; LANES], [0_u32; LANES]);
        let left_out = u32::try_from(left_out).unwrap_or(u32::MAX);
        let chunks = self.axes.each_ref().map(|axis| axis.as_chunks::<LANES>().0);
        for (chunk, ((xs, ys), zs)) in chunks[0].iter().zip(chunks[1]).zip(chunks[2]).enumerate() {
            for lane in 0..LANES {
                let (dx, dy, dz) = (xs[lane] - x, ys[lane] - y, zs[lane] - z);
                let square = dx * dx + dy * dy + dz * dz;
                let idx = (chunk * LANES + lane) as u32;
                let nearer = square < least[lane] && idx != left_out;
                least[lane] = if nearer { square } else { least[lane] };
                found[lane] = if nearer { idx } else { found[lane] };
            }
        }
        let best = (0..LANES).fold(0, |best, lane| {
            let key = |lane: usize| (least[lane], found[lane]);
            if key(lane) < key(best) { lane } else { best }
        });
        Nearest { idx: found[best] as usize, distance: least[best].sqrt() }
    }
}

/// Mean distance from each of `from` to its nearest in `to`, both `[any, 3]`, m.
pub(crate) fn mean_nearest_m(from: &[f32], to: &[f32]) -> f64 {
    let cloud = Cloud::new(to);
    let points = from.as_chunks::<3>().0;
    points.iter().map(|point| f64::from(cloud.nearest(point).distance)).sum::<f64>() / points.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_is_what_a_plain_search_finds() {
        let wave = |i: usize, pace: f32| (i as f32 * pace).sin();
        for count in [1, 7, 8, 13, 64] {
            let points: Vec<f32> = (0..3 * count).map(|i| wave(i, 0.9)).collect();
            let cloud = Cloud::new(&points);
            for query in 0..20 {
                let point = [wave(query, 1.3), wave(query, 2.1), wave(query, 0.4)];
                let distance = |idx: usize| {
                    (0..3).map(|axis| (points[3 * idx + axis] - point[axis]).powi(2)).sum::<f32>().sqrt()
                };
                let least = (0..count).map(distance).fold(f32::INFINITY, f32::min);
                let found = cloud.nearest(&point);
                assert!((found.distance - least).abs() < 1e-6 && distance(found.idx) - least < 1e-6);
            }
            if count > 1 {
                let found = cloud.nearest_other(&points[3..6], 1);
                assert!(found.idx != 1 && found.distance > 0.0 && found.distance.is_finite());
            }
        }
    }
}
