//! A distribution over shape and place of the object.

use super::experience::{CELL_M, Experience};
use super::{Felt, Skill};

/// Standard deviation by which every try blurs the places, cells: closings are samples, about one a cell.
const BLUR_CELLS: f64 = 0.8;
/// Mass below which a cell is passed over.
const NOTHING: f64 = 1e-9;
/// Likelihood below which what was felt is impossible by all that was simulated, so that nothing is learned from it. Smaller
/// numbers have too few digits to divide by.
const IMPOSSIBLE: f64 = f64::MIN_POSITIVE;

/// Masses of cells of 1 cm, by shape, that sum to 1 with that of objects which have left the grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Belief {
    /// Cells to either side of the middle of the region.
    steps: i32,
    /// By shape, then x, then y.
    mass: Vec<f64>,
    /// Beyond the grid.
    gone: f64,
}

/// How far a try has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// The hand has begun to close.
    Glanced,
    /// It has closed.
    Closed,
    /// It has lifted.
    Lifted,
}

/// A try, weighed by what it felt like: closings that it may have been one of, and places that it did not reach.
#[derive(Clone, Debug)]
pub struct Attempt {
    place_m: [f64; 2],
    /// Probability of each closing.
    weights: Vec<f64>,
    /// Of objects that lie beyond the window about the hand.
    far: Belief,
}

impl Belief {
    /// Evenly over a square of `half_width_m` about the middle of the region and over the shapes of `experience`, or with all
    /// mass on one `shape`; on a grid that reaches `beyond_m` further.
    ///
    /// # Panics
    /// If there is no such shape: a caller's bug.
    pub fn even(experience: &Experience, half_width_m: f64, beyond_m: f64, shape: Option<usize>) -> Self {
        assert!(shape.is_none_or(|shape| shape < experience.num_shapes), "a shape of the experience");
        let steps = ((half_width_m + beyond_m) / CELL_M).ceil() as i32;
        let mut belief = Self { steps, mass: Vec::new(), gone: 0.0 };
        // Of each cell the share that lies in the square.
        let share = |cell: i32| {
            let (low, high) = ((f64::from(cell) - 0.5) * CELL_M, (f64::from(cell) + 0.5) * CELL_M);
            ((high.min(half_width_m) - low.max(-half_width_m)) / CELL_M).max(0.0)
        };
        for of_shape in 0..experience.num_shapes {
            let has_mass = shape.is_none_or(|shape| shape == of_shape);
            for x in -steps..=steps {
                for y in -steps..=steps {
                    let at_point = if (x, y) == (0, 0) { 1e-12 } else { 0.0 };
                    let even = share(x) * share(y) + at_point;
                    belief.mass.push(if has_mass { even } else { 0.0 });
                }
            }
        }
        belief.normalised()
    }

    /// All mass at one place, evenly over the shapes that `self` holds possible.
    pub fn told(&self, at_m: [f64; 2]) -> Self {
        let mut told = Self { mass: vec![0.0; self.mass.len()], ..self.clone() };
        let num_cells = self.num_cells();
        for shape in 0..self.mass.len() / num_cells {
            let of_shape: f64 = self.mass[shape * num_cells..(shape + 1) * num_cells].iter().sum();
            told.add(shape, at_m, of_shape);
        }
        told.gone = 0.0;
        told.normalised()
    }

    /// Probability that the object has left the grid.
    pub fn gone(&self) -> f64 {
        self.gone
    }

    /// Probability of each shape, of an object that is on the grid or not.
    pub fn shapes(&self) -> Vec<f64> {
        self.mass.chunks(self.num_cells()).map(|of_shape| of_shape.iter().sum()).collect()
    }

    /// Mean place, m from the middle of the region; the middle when nothing is on the grid.
    pub fn mean_m(&self) -> [f64; 2] {
        let (mut sum, mut all) = ([0.0; 2], 0.0);
        for (_, x, y, mass) in self.cells() {
            sum[0] += f64::from(x) * CELL_M * mass;
            sum[1] += f64::from(y) * CELL_M * mass;
            all += mass;
        }
        if all > 0.0 { [sum[0] / all, sum[1] / all] } else { [0.0; 2] }
    }

    /// Probability of each cell that has some, with its middle, m from the middle of the region, whatever the shape; and the
    /// edge length of a cell, m.
    pub fn places(&self) -> (Vec<([f64; 2], f64)>, f64) {
        let mut cells = std::collections::BTreeMap::new();
        for (_, x, y, mass) in self.cells() {
            *cells.entry((x, y)).or_insert(0.0) += mass;
        }
        let at_m = |(x, y): (i32, i32)| [f64::from(x) * CELL_M, f64::from(y) * CELL_M];
        (cells.into_iter().map(|(cell, mass)| (at_m(cell), mass)).collect(), CELL_M)
    }

    /// Probability that the object lies within `radius_m` of `at_m`.
    pub fn within(&self, at_m: [f64; 2], radius_m: f64) -> f64 {
        let off = |x: i32, y: i32| (f64::from(x) * CELL_M - at_m[0]).hypot(f64::from(y) * CELL_M - at_m[1]);
        self.cells().filter(|(_, x, y, _)| off(*x, *y) <= radius_m).map(|(.., mass)| mass).sum()
    }

    /// Chance that a try at `place_m` holds the object.
    pub fn success(&self, experience: &Experience, place_m: [f64; 2]) -> f64 {
        let [x0, y0] = place_m.map(|at_m| (at_m / CELL_M).round() as i32);
        self.cells().map(|(shape, x, y, mass)| mass * experience.success(shape, x - x0, y - y0)).sum()
    }

    /// The place of `skill` at which that is greatest, and the chance there; of equal places the first.
    pub fn best_place(&self, experience: &Experience, skill: &Skill) -> (usize, f64) {
        let cells: Vec<_> = self.cells().collect();
        let mut best = (0, -1.0);
        for (idx, place) in skill.places().iter().enumerate() {
            let [x0, y0] = place.at_m.map(|at_m| (at_m / CELL_M).round() as i32);
            let success: f64 = cells
                .iter()
                .map(|&(shape, x, y, mass)| mass * experience.success(shape, x - x0, y - y0))
                .sum();
            if success > best.1 {
                best = (idx, success);
            }
        }
        best
    }

    /// A try at `place_m` that felt like this up to the glance.
    pub fn glance(&self, experience: &Experience, place_m: [f64; 2], felt: &Felt) -> Attempt {
        self.attempt_alike(experience, place_m, &experience.alike_glance(felt))
    }

    /// A try at `place_m` that felt like this while the hand closed: Bayes' rule with every simulated closing as a sample of
    /// p(felt, place afterwards, success | place before).
    pub fn attempt(&self, experience: &Experience, place_m: [f64; 2], felt: &Felt) -> Attempt {
        self.attempt_alike(experience, place_m, &experience.alike_closing(felt))
    }

    /// A try at `place_m` that was `alike` each closing.
    fn attempt_alike(&self, experience: &Experience, place_m: [f64; 2], alike: &[f64]) -> Attempt {
        let closings = &experience.closings;
        let window_cells = (2.0 * closings.window_m / CELL_M).powi(2);
        let mut weights: Vec<f64> = closings
            .closings
            .iter()
            .zip(alike)
            .map(|(closing, alike)| {
                let at = moved(place_m, closing.start_m);
                let each = window_cells / experience.of_shape[closing.shape] as f64;
                self.at(closing.shape, at) * alike * each
            })
            .collect();
        // Beyond the window it is as at its edge: nothing happens.
        let edge = &experience.at_edge;
        let alike_far = if edge.is_empty() {
            0.0
        } else {
            edge.iter().map(|&idx| alike[idx]).sum::<f64>() / edge.len() as f64
        };
        let mut far = self.clone();
        let cell = |x: i32, at_m: f64| (f64::from(x) * CELL_M - at_m).abs() <= closings.window_m;
        far.for_each(|x, y, mass| {
            *mass *= if cell(x, place_m[0]) && cell(y, place_m[1]) { 0.0 } else { alike_far };
        });
        far.gone *= alike_far;
        let sum = weights.iter().sum::<f64>() + far.sum();
        if sum < IMPOSSIBLE {
            return Attempt { place_m, weights: vec![0.0; weights.len()], far: self.clone() };
        }
        weights.iter_mut().for_each(|weight| *weight /= sum);
        far.scale(1.0 / sum);
        Attempt { place_m, weights, far }
    }

    fn normalised(mut self) -> Self {
        let sum = self.sum();
        if sum > 0.0 {
            self.scale(1.0 / sum);
        } else {
            self.gone = 1.0;
        }
        self
    }

    /// Of everything, 1 but for rounding.
    pub(super) fn sum(&self) -> f64 {
        self.mass.iter().sum::<f64>() + self.gone
    }

    fn scale(&mut self, factor: f64) {
        self.mass.iter_mut().for_each(|mass| *mass *= factor);
        self.gone *= factor;
    }

    fn edge(&self) -> i32 {
        2 * self.steps + 1
    }

    fn num_cells(&self) -> usize {
        (self.edge() * self.edge()) as usize
    }

    fn cell_of(&self, idx: usize) -> (usize, i32, i32) {
        let in_shape = (idx % self.num_cells()) as i32;
        (idx / self.num_cells(), in_shape / self.edge() - self.steps, in_shape % self.edge() - self.steps)
    }

    fn cells(&self) -> impl Iterator<Item = (usize, i32, i32, f64)> + '_ {
        let with_mass = self.mass.iter().enumerate().filter(|(_, mass)| **mass > NOTHING);
        with_mass.map(|(idx, mass)| {
            let (shape, x, y) = self.cell_of(idx);
            (shape, x, y, *mass)
        })
    }

    fn for_each(&mut self, mut change: impl FnMut(i32, i32, &mut f64)) {
        for idx in 0..self.mass.len() {
            let (_, x, y) = self.cell_of(idx);
            change(x, y, &mut self.mass[idx]);
        }
    }

    fn index(&self, shape: usize, x: i32, y: i32) -> Option<usize> {
        let is_in = x.abs() <= self.steps && y.abs() <= self.steps;
        is_in.then(|| {
            let in_shape = (x + self.steps) * self.edge() + y + self.steps;
            shape * self.num_cells() + in_shape as usize
        })
    }

    /// The four cells about `at_m`, with shares that sum to 1.
    fn about(at_m: [f64; 2]) -> [(i32, i32, f64); 4] {
        let [x, y] = at_m.map(|at_m| (at_m / CELL_M).clamp(-1e6, 1e6));
        let (x0, y0) = (x.floor(), y.floor());
        let (u, v) = (x - x0, y - y0);
        let (x0, y0) = (x0 as i32, y0 as i32);
        [
            (x0, y0, (1.0 - u) * (1.0 - v)),
            (x0, y0 + 1, (1.0 - u) * v),
            (x0 + 1, y0, u * (1.0 - v)),
            (x0 + 1, y0 + 1, u * v),
        ]
    }

    /// Mass of a cell about `at_m`, linear between the middles of cells.
    fn at(&self, shape: usize, at_m: [f64; 2]) -> f64 {
        let mass = |(x, y, share)| self.index(shape, x, y).map_or(0.0, |idx| share * self.mass[idx]);
        Self::about(at_m).into_iter().map(mass).sum()
    }

    fn add(&mut self, shape: usize, at_m: [f64; 2], mass: f64) {
        for (x, y, share) in Self::about(at_m) {
            match self.index(shape, x, y) {
                Some(idx) => self.mass[idx] += share * mass,
                None => self.gone += share * mass,
            }
        }
    }

    /// Convolves with a normal distribution; what falls off the grid is gone.
    fn blurred(&self) -> Self {
        let radius = (3.0 * BLUR_CELLS).ceil() as i32;
        let weights: Vec<f64> =
            (-radius..=radius).map(|off| (-0.5 * (f64::from(off) / BLUR_CELLS).powi(2)).exp()).collect();
        let sum: f64 = weights.iter().sum();
        let mut from = self.clone();
        for along_x in [true, false] {
            let mut to = Self { mass: vec![0.0; self.mass.len()], ..from.clone() };
            for (shape, x, y, mass) in from.cells() {
                for (off, weight) in (-radius..=radius).zip(&weights) {
                    let (x, y) = if along_x { (x + off, y) } else { (x, y + off) };
                    match to.index(shape, x, y) {
                        Some(idx) => to.mass[idx] += mass * weight / sum,
                        None => to.gone += mass * weight / sum,
                    }
                }
            }
            from = to;
        }
        from
    }
}

fn moved(place_m: [f64; 2], by_m: [f32; 2]) -> [f64; 2] {
    [place_m[0] + f64::from(by_m[0]), place_m[1] + f64::from(by_m[1])]
}

impl Attempt {
    /// Probability that the hand holds the object: that a lift wins.
    pub fn held(&self, experience: &Experience) -> f64 {
        let closings = experience.closings.closings.iter().zip(&self.weights);
        closings.filter(|(closing, _)| closing.won).map(|(_, weight)| weight).sum()
    }

    /// The same try, after a lift that felt like this.
    pub fn lifted(&self, experience: &Experience, felt: &Felt) -> Self {
        let alike = experience.alike_lifting(felt);
        let edge = &experience.at_edge;
        let alike_far = if edge.is_empty() {
            0.0
        } else {
            edge.iter().map(|&idx| alike[idx]).sum::<f64>() / edge.len() as f64
        };
        let mut lifted = self.clone();
        lifted.weights.iter_mut().zip(&alike).for_each(|(weight, alike)| *weight *= alike);
        lifted.far.scale(alike_far);
        lifted.normalised_or(self)
    }

    /// The same try, of which it is known that it did not hold the object.
    pub fn lost(&self, experience: &Experience) -> Self {
        let mut lost = self.clone();
        let closings = experience.closings.closings.iter().zip(&mut lost.weights);
        closings.filter(|(closing, _)| closing.won).for_each(|(_, weight)| *weight = 0.0);
        lost.normalised_or(self)
    }

    /// Where the object is at that `moment` of the try.
    pub fn belief(&self, experience: &Experience, moment: Moment) -> Belief {
        let mut near = Belief { mass: vec![0.0; self.far.mass.len()], gone: 0.0, ..self.far.clone() };
        for (closing, weight) in experience.closings.closings.iter().zip(&self.weights) {
            if *weight > NOTHING {
                let by_m = match moment {
                    Moment::Glanced => closing.glanced_m,
                    Moment::Closed => closing.closed_m,
                    Moment::Lifted => closing.end_m,
                };
                near.add(closing.shape, moved(self.place_m, by_m), *weight);
            }
        }
        let mut belief = near.blurred();
        belief.mass.iter_mut().zip(&self.far.mass).for_each(|(mass, far)| *mass += far);
        belief.gone += self.far.gone;
        belief.normalised()
    }

    fn normalised_or(mut self, other: &Self) -> Self {
        let sum = self.weights.iter().sum::<f64>() + self.far.sum();
        if sum < IMPOSSIBLE {
            return other.clone();
        }
        self.weights.iter_mut().for_each(|weight| *weight /= sum);
        self.far.scale(1.0 / sum);
        self
    }
}
