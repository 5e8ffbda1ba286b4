//! What a part shares with others, so that it is not counted twice.

use nalgebra::Vector3;

use super::{moments::Moments, part::Part};

/// Parts that reach into each other by less than this touch.
const TOUCH_M: f64 = 1e-9;

/// Columns along each side of a cell, and so how finely curved overlaps are resolved: a ball's cap to about 1e-4 of
/// the cap.
const COLUMNS: usize = 256;

/// Integrals over what `part` has in common with the union of `others`.
///
/// Along z exactly, over x and y by the midpoint rule: on a column, every part is one interval. Cells end where the
/// bounds of a part do, so boxes along the object's axes come out exact.
pub(super) fn shared(part: &Part, others: &[Part]) -> Moments {
    let others: Vec<&Part> = others.iter().filter(|other| !are_apart(part, other)).collect();
    let bounds = |part: &Part| [part.range(&Vector3::x()), part.range(&Vector3::y())];
    let part_bounds = bounds(part);
    let other_bounds: Vec<[(f64, f64); 2]> = others.iter().map(|other| bounds(other)).collect();
    let [xs, ys] = [0, 1].map(|axis| {
        let (low, high) = part_bounds[axis];
        let ends = other_bounds.iter().flat_map(|bounds| [bounds[axis].0, bounds[axis].1]);
        let mut edges: Vec<f64> = ends.filter(|end| *end > low && *end < high).chain([low, high]).collect();
        edges.sort_by(f64::total_cmp);
        edges
    });
    let mut sum = Moments::default();
    for x in xs.windows(2) {
        for y in ys.windows(2) {
            let middle = [0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1])];
            let holds = |bounds: &[(f64, f64); 2]| {
                (0..2).all(|axis| bounds[axis].0 < middle[axis] && middle[axis] < bounds[axis].1)
            };
            let present: Vec<&Part> = others
                .iter()
                .zip(&other_bounds)
                .filter(|(_, bounds)| holds(bounds))
                .map(|(o, _)| *o)
                .collect();
            if !present.is_empty() {
                sum += shared_in_cell(part, &present, [x[0], y[0]], [x[1], y[1]]);
            }
        }
    }
    sum
}

fn shared_in_cell(part: &Part, others: &[&Part], low: [f64; 2], high: [f64; 2]) -> Moments {
    let step = [0, 1].map(|axis| (high[axis] - low[axis]) / COLUMNS as f64);
    let mut sum = Moments::default();
    let mut intervals: Vec<(f64, f64)> = Vec::with_capacity(others.len());
    for i in 0..COLUMNS {
        for j in 0..COLUMNS {
            let at = [low[0] + (i as f64 + 0.5) * step[0], low[1] + (j as f64 + 0.5) * step[1]];
            let Some((bottom, top)) = part.column(at) else { continue };
            intervals.clear();
            let clipped = others.iter().filter_map(|other| other.column(at));
            intervals.extend(
                clipped.map(|(low, high)| (low.max(bottom), high.min(top))).filter(|(low, high)| low < high),
            );
            intervals.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut covered_to = f64::NEG_INFINITY;
            for &(low, high) in &intervals {
                let low = low.max(covered_to);
                if low < high {
                    sum += Moments::of_column(at, step, low, high);
                    covered_to = high;
                }
            }
        }
    }
    sum
}

/// Whether a plane keeps the two apart. `false` may also mean that no such plane was among those tried.
fn are_apart(a: &Part, b: &Part) -> bool {
    let between = b.moments().centroid() - a.moments().centroid();
    let mut axes =
        [a.face_normals(), b.face_normals()].into_iter().flatten().chain(between.try_normalize(1e-12));
    axes.any(|axis| {
        let ((a_low, a_high), (b_low, b_high)) = (a.range(&axis), b.range(&axis));
        a_high <= b_low + TOUCH_M || b_high <= a_low + TOUCH_M
    })
}
