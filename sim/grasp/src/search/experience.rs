//! What trying has been like: closings that were simulated, and what follows from them.

use super::Felt;
use super::skill::Skill;
use crate::GraspError;

/// One try of the hand at the middle of its own frame, and the lift after it.
#[derive(Clone, Debug, PartialEq)]
pub struct Closing {
    /// Number of the object's shape in [`Closings::objects`].
    pub shape: usize,
    /// Where the object was before, along x and y of the base, seen from the hand's place, m.
    pub start_m: [f32; 2],
    /// Where it was at the glance, when the hand had closed so far, m.
    pub glanced_m: [f32; 2],
    /// Where it was when the hand had closed, m.
    pub closed_m: [f32; 2],
    /// Where it was in the end, m.
    pub end_m: [f32; 2],
    /// Whether it was lifted and held.
    pub won: bool,
    /// What was felt up to the glance.
    pub glance: Felt,
    /// What was felt while the hand closed.
    pub closing: Felt,
    /// What was felt while it lifted.
    pub lifting: Felt,
}

/// Closings of one skill with one sense of touch.
#[derive(Clone, Debug, PartialEq)]
pub struct Closings {
    /// Names of the objects.
    pub objects: Vec<String>,
    /// Half the edge length of the square about the hand's place in which objects began, evenly, m.
    pub window_m: f64,
    /// In any order.
    pub closings: Vec<Closing>,
}

/// Which senses count. With neither, only the time and what closings do to objects are known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Senses {
    /// Channels of touch.
    pub touch: bool,
    /// Tracking errors of the hand's joints.
    pub tracking: bool,
}

impl Senses {
    /// Everything.
    pub const BOTH: Self = Self { touch: true, tracking: true };
    /// Nothing.
    pub const NONE: Self = Self { touch: false, tracking: false };
}

/// Widths of the kernel over what was felt, in standard deviations of each number times the root of how many numbers there
/// are, from which the closings themselves choose.
const BANDWIDTHS: [f64; 8] = [0.05, 0.08, 0.12, 0.18, 0.27, 0.4, 0.6, 1.0];
/// Closings that are predicted to choose a bandwidth.
const MAX_PREDICTED: usize = 1_000;
/// Standard deviation of the kernel over places, m: neighbouring closings of one shape are about a centimetre apart.
const PLACE_KERNEL_M: f64 = 0.012;
/// Distance between the points at which the chance of success is tabulated, m; also the edge of a belief's cell.
pub(super) const CELL_M: f64 = 0.01;
/// Failures that are added at every point of the table, so that a single success far from others is not certain.
const ADDED_FAILURES: f64 = 0.3;
/// Closings within this distance of the window's edge stand for those beyond it, m.
const EDGE_M: f64 = 0.02;

/// Closings, made ready for one set of senses.
#[derive(Clone, Debug)]
pub struct Experience {
    pub(super) closings: Closings,
    pub(super) senses: Senses,
    pub(super) num_shapes: usize,
    pub(super) of_shape: Vec<usize>,
    /// Closings near the edge of the window.
    pub(super) at_edge: Vec<usize>,
    /// What was felt, each number over its standard deviation, by closing and then number; of the senses that count.
    glance: Table,
    closing: Table,
    lifting: Table,
    /// Chance of success by shape, then x, then y of the object seen from the hand.
    success: Vec<f64>,
    /// The table's points to either side of the middle.
    pub(super) steps: i32,
}

/// Rows of numbers, each over its standard deviation.
#[derive(Clone, Debug)]
struct Table {
    scales: Vec<f64>,
    rows: Vec<f32>,
    num_rows: usize,
    bandwidth: f64,
}

impl Experience {
    /// Closings of `skill`, of which what the `senses` say counts.
    ///
    /// # Errors
    /// No closings, shapes without closings, numbers that are not finite, another hand's numbers.
    pub fn new(closings: Closings, skill: &Skill, senses: Senses) -> Result<Self, GraspError> {
        Self::of(closings, skill.num_felt(), senses)
    }

    /// The same for hands whose [`Felt`] has these lengths.
    pub(super) fn of(closings: Closings, num_felt: [usize; 2], senses: Senses) -> Result<Self, GraspError> {
        let error = |problem: String| GraspError::Config { file: "closings".to_owned(), problem };
        let num_shapes = closings.objects.len();
        let mut of_shape = vec![0; num_shapes];
        if num_shapes == 0 {
            return Err(error("there are no closings".to_owned()));
        }
        if !(closings.window_m.is_finite() && closings.window_m >= CELL_M) {
            return Err(error(format!(
                "window_m is {}, expected a finite number of at least {CELL_M}",
                closings.window_m
            )));
        }
        for (idx, closing) in closings.closings.iter().enumerate() {
            let Some(count) = of_shape.get_mut(closing.shape) else {
                return Err(error(format!(
                    "closing {idx} has shape {}, expected less than the {num_shapes} objects",
                    closing.shape
                )));
            };
            *count += 1;
            for felt in [&closing.glance, &closing.closing, &closing.lifting] {
                let found = [felt.touch.len(), felt.tracking.len()];
                if found != num_felt {
                    return Err(error(format!(
                        "closing {idx} has {found:?} numbers of touch and tracking, this hand's have {num_felt:?}"
                    )));
                }
            }
            let places = [closing.start_m, closing.glanced_m, closing.closed_m, closing.end_m];
            let felt = [&closing.glance, &closing.closing, &closing.lifting];
            let mut numbers = places
                .iter()
                .flatten()
                .chain(felt.iter().flat_map(|felt| felt.touch.iter().chain(&felt.tracking)));
            if let Some(number) = numbers.find(|number| !number.is_finite()) {
                return Err(error(format!("closing {idx} holds {number}, expected finite numbers")));
            }
        }
        if let Some(shape) = of_shape.iter().position(|count| *count == 0) {
            return Err(error(format!("there are no closings on {:?}", closings.objects[shape])));
        }
        let steps = (closings.window_m / CELL_M).floor() as i32;
        let edge_m = closings.window_m - EDGE_M;
        let is_at_edge =
            |closing: &Closing| closing.start_m.iter().any(|at_m| f64::from(at_m.abs()) > edge_m);
        let at_edge =
            (0..closings.closings.len()).filter(|&idx| is_at_edge(&closings.closings[idx])).collect();
        let mut this = Self {
            glance: Table::of(&closings.closings, senses, |closing| &closing.glance),
            closing: Table::of(&closings.closings, senses, |closing| &closing.closing),
            lifting: Table::of(&closings.closings, senses, |closing| &closing.lifting),
            success: success(&closings, num_shapes, steps),
            closings,
            senses,
            num_shapes,
            of_shape,
            at_edge,
            steps,
        };
        this.glance.bandwidth = this.best_bandwidth(&this.glance, |closing| closing.glanced_m);
        this.closing.bandwidth = this.best_bandwidth(&this.closing, |closing| closing.closed_m);
        this.lifting.bandwidth = this.best_bandwidth(&this.lifting, |closing| closing.end_m);
        Ok(this)
    }

    /// Names of the shapes.
    pub fn objects(&self) -> &[String] {
        &self.closings.objects
    }

    /// Bandwidths of the kernels over what is felt up to the glance, while the hand closes, and while it lifts.
    pub fn bandwidths(&self) -> [f64; 3] {
        [self.glance.bandwidth, self.closing.bandwidth, self.lifting.bandwidth]
    }

    /// The chance that a try holds an object of `shape` that lies (x, y) cells from the hand's place; 0 beyond the window.
    pub fn success(&self, shape: usize, x: i32, y: i32) -> f64 {
        if x.abs() > self.steps || y.abs() > self.steps {
            return 0.0;
        }
        let edge = 2 * self.steps + 1;
        let at = (x + self.steps) * edge + y + self.steps;
        self.success[shape * (edge * edge) as usize + at as usize]
    }

    /// The area in which a try holds an object of `shape`, m2.
    pub fn area_won_m2(&self, shape: usize) -> f64 {
        let won = self.closings.closings.iter().filter(|closing| closing.shape == shape && closing.won);
        (2.0 * self.closings.window_m).powi(2) * won.count() as f64 / self.of_shape[shape] as f64
    }

    /// How alike each closing is to what was `felt` up to the glance, the most alike 1.
    pub(super) fn alike_glance(&self, felt: &Felt) -> Vec<f64> {
        self.glance.alike(self.senses, felt)
    }

    /// The same while the hand closed.
    pub(super) fn alike_closing(&self, felt: &Felt) -> Vec<f64> {
        self.closing.alike(self.senses, felt)
    }

    /// The same while it lifted.
    pub(super) fn alike_lifting(&self, felt: &Felt) -> Vec<f64> {
        self.lifting.alike(self.senses, felt)
    }

    /// The bandwidth that best predicts success and place of closings from the others: the largest mean logarithm of
    /// p(won, place | felt), leave one out.
    fn best_bandwidth(&self, table: &Table, place: impl Fn(&Closing) -> [f32; 2]) -> f64 {
        let closings = &self.closings.closings;
        let stride = closings.len().div_ceil(MAX_PREDICTED).max(1);
        let mut scores = [0.0; BANDWIDTHS.len()];
        for left_out in (0..closings.len()).step_by(stride) {
            let squares = table.squares(table.row(left_out));
            let nearest = squares
                .iter()
                .enumerate()
                .filter(|(idx, _)| *idx != left_out)
                .fold(f64::INFINITY, |least, (_, square)| least.min(*square));
            let own = &closings[left_out];
            let (at, won) = (place(own), own.won);
            for (score, bandwidth) in scores.iter_mut().zip(BANDWIDTHS) {
                let (mut sum, mut same) = (0.0, 0.0);
                for (idx, closing) in closings.iter().enumerate() {
                    if idx == left_out {
                        continue;
                    }
                    let weight = (-(squares[idx] - nearest) / (2.0 * bandwidth * bandwidth)).exp();
                    sum += weight;
                    if closing.won == won {
                        same += weight * place_kernel(at, place(closing));
                    }
                }
                // What no closing is like says nothing: floor instead of an infinite loss.
                *score += (same / f64::max(sum, f64::MIN_POSITIVE)).max(1e-6).ln();
            }
        }
        let best = scores.iter().zip(BANDWIDTHS).max_by(|one, other| one.0.total_cmp(other.0));
        best.map_or(1.0, |(_, bandwidth)| bandwidth)
    }
}

fn place_kernel(one: [f32; 2], other: [f32; 2]) -> f64 {
    let square = (0..2).map(|axis| f64::from(one[axis] - other[axis]).powi(2)).sum::<f64>();
    (-square / (2.0 * PLACE_KERNEL_M * PLACE_KERNEL_M)).exp()
}

/// Kernel regression of success over places, by shape.
fn success(closings: &Closings, num_shapes: usize, steps: i32) -> Vec<f64> {
    let mut table = Vec::new();
    for shape in 0..num_shapes {
        for x in -steps..=steps {
            for y in -steps..=steps {
                let at = [(f64::from(x) * CELL_M) as f32, (f64::from(y) * CELL_M) as f32];
                let (mut won, mut all) = (0.0, ADDED_FAILURES);
                for closing in closings.closings.iter().filter(|closing| closing.shape == shape) {
                    let weight = place_kernel(at, closing.start_m);
                    all += weight;
                    won += if closing.won { weight } else { 0.0 };
                }
                table.push(won / all);
            }
        }
    }
    table
}

fn numbers(senses: Senses, felt: &Felt) -> impl Iterator<Item = f32> {
    let touch = felt.touch.iter().filter(move |_| senses.touch);
    touch.chain(felt.tracking.iter().filter(move |_| senses.tracking)).copied()
}

impl Table {
    fn of(closings: &[Closing], senses: Senses, felt: impl Fn(&Closing) -> &Felt) -> Self {
        let width = closings.first().map_or(0, |closing| numbers(senses, felt(closing)).count());
        let mut sums = vec![[0.0; 2]; width];
        for closing in closings {
            for (sum, number) in sums.iter_mut().zip(numbers(senses, felt(closing))) {
                sum[0] += f64::from(number);
                sum[1] += f64::from(number).powi(2);
            }
        }
        let count = closings.len().max(1) as f64;
        let scale = |[sum, squares]: &[f64; 2]| {
            let variance = squares / count - (sum / count).powi(2);
            // A number that never changes says nothing, whatever it is.
            if variance > 1e-10 { 1.0 / (variance * width as f64).sqrt() } else { 0.0 }
        };
        let scales: Vec<f64> = sums.iter().map(scale).collect();
        let mut table = Self {
            rows: Vec::with_capacity(width * closings.len()),
            num_rows: closings.len(),
            scales,
            bandwidth: 1.0,
        };
        for closing in closings {
            let row = table.scaled(senses, felt(closing));
            table.rows.extend(row);
        }
        table
    }

    fn scaled(&self, senses: Senses, felt: &Felt) -> Vec<f32> {
        let numbers = numbers(senses, felt).zip(&self.scales);
        numbers.map(|(number, scale)| (f64::from(number) * scale) as f32).collect()
    }

    fn row(&self, idx: usize) -> &[f32] {
        let width = self.scales.len();
        &self.rows[idx * width..(idx + 1) * width]
    }

    /// Squared distance of every row from `row`.
    fn squares(&self, row: &[f32]) -> Vec<f64> {
        let square = |other: &[f32]| {
            row.iter().zip(other).map(|(one, other)| f64::from(one - other).powi(2)).sum::<f64>()
        };
        match self.scales.len() {
            // Nothing was felt, so everything is alike.
            0 => vec![0.0; self.num_rows],
            width => self.rows.chunks(width).map(square).collect(),
        }
    }

    fn alike(&self, senses: Senses, felt: &Felt) -> Vec<f64> {
        let squares = self.squares(&self.scaled(senses, felt));
        let least = squares.iter().copied().fold(f64::INFINITY, f64::min);
        let over = 2.0 * self.bandwidth * self.bandwidth;
        squares.iter().map(|square| (-(square - least) / over).exp()).collect()
    }
}
