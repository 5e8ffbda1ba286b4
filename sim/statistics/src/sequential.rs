//! An exact group-sequential test of two policies on pairs of trials, which may stop after any pair.
//!
//! After n pairs the state is (successes of A, successes of B). For each n up to the number that was fixed before the first
//! trial, the states are put in order of their pooled z; from the most extreme on they are taken into the set in which the
//! test ends, for as long as the chance to have ended by then stays within alpha n / n_max for every common rate (K. K. G.
//! Lan and D. L. DeMets, "Discrete sequential boundaries for clinical trials", 1983, with linear spending; exact binomial
//! paths as in C. Jennison and B. W. Turnbull, "Group Sequential Methods", 2000). Both directions are tested, each with half
//! of alpha.

use std::f64::consts::PI;

use crate::{StatisticsError, comparison::pooled_z, probability};

/// Most pairs that a test may plan for: the boundary takes time with the cube of it.
const MAX_PAIRS: u64 = 400;
/// Common rates at which the chance of a false end is held. Between them it is greater by less than 0.2 %, which
/// [`GRID_RESERVE`] leaves room for.
const NUISANCE_RATES: usize = 64;
/// The share of alpha that is spent.
const GRID_RESERVE: f64 = 0.998;
/// States whose statistic differs by less than this are taken in together.
const TIE: f64 = 1e-9;
/// A hint promises to settle a comparison with this chance.
const HINT_POWER: f64 = 0.8;

/// What has been seen so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pairs {
    /// Pairs of trials, one of each policy.
    pub pairs: u64,
    /// Successes of policy A.
    pub successes_a: u64,
    /// Successes of policy B.
    pub successes_b: u64,
}

/// What a comparison says so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// A is better.
    A,
    /// B is better.
    B,
    /// Go on.
    Undecided,
    /// All pairs are made, and neither was shown to be better.
    Exhausted,
}

/// How a test behaves at given rates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Operating {
    /// Chance that B is said to be better.
    pub says_b: f64,
    /// Chance that A is said to be better.
    pub says_a: f64,
    /// Pairs that are made on average.
    pub mean_pairs: f64,
}

/// A planned comparison. Its number of pairs must be fixed before the first trial.
#[derive(Clone, Debug, PartialEq)]
pub struct SequentialTest {
    max_pairs: usize,
    /// For n pairs and x successes of the worse policy, at `n * (max_pairs + 1) + x`: successes of the better one from which
    /// on the test ends; `max_pairs + 1` where it does not.
    ends_from: Vec<u16>,
}

impl SequentialTest {
    /// Plans at most `max_pairs` pairs, with a chance of at most `alpha` to call two equal policies different.
    ///
    /// # Errors
    /// No pairs, or more than 400; an alpha that is not between 0 and 1.
    pub fn plan(max_pairs: u64, alpha: f64) -> Result<Self, StatisticsError> {
        probability("alpha", alpha)?;
        if max_pairs == 0 || max_pairs > MAX_PAIRS {
            let what = "the number of pairs";
            return Err(StatisticsError::Count { what, value: max_pairs, max: MAX_PAIRS });
        }
        let max_pairs = max_pairs as usize;
        let never = (max_pairs + 1) as u16;
        let mut test = Self { max_pairs, ends_from: vec![never; (max_pairs + 1) * (max_pairs + 1)] };
        let budget = 0.5 * alpha * GRID_RESERVE;
        let mut walks: Vec<Walk> = (0..NUISANCE_RATES)
            .map(|i| {
                // Chebyshev's points: close together near 0 and 1, where few states have all the mass.
                let rate = 0.5 - 0.5 * (PI * (i as f64 + 0.5) / NUISANCE_RATES as f64).cos();
                Walk::new(max_pairs, rate, rate)
            })
            .collect();
        let mut spent = vec![0.0; NUISANCE_RATES];
        for n in 1..=max_pairs {
            walks.iter_mut().for_each(Walk::step);
            let may_spend = budget * n as f64 / max_pairs as f64;
            test.take_in(n, &walks, &mut spent, may_spend);
            for walk in &mut walks {
                walk.end(n, |x, y| test.is_ended(n, x, y) || test.is_ended(n, y, x));
            }
        }
        Ok(test)
    }

    /// Takes the most extreme states after `n` pairs into the set in which the test ends, as many as may be.
    fn take_in(&mut self, n: usize, walks: &[Walk], spent: &mut [f64], may_spend: f64) {
        let n_pairs = n as u64;
        let z = |x: usize, y: usize| pooled_z((x as u64, n_pairs), (y as u64, n_pairs));
        let mut states: Vec<(f64, usize, usize)> =
            (0..n).flat_map(|x| (x + 1..=n).map(move |y| (x, y))).map(|(x, y)| (z(x, y), x, y)).collect();
        states.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        for tied in states.chunk_by(|a, b| a.0 - b.0 < TIE) {
            let wanted: Vec<f64> = walks
                .iter()
                .zip(&*spent)
                .map(|(walk, spent)| spent + tied.iter().map(|&(_, x, y)| walk.mass(x, y)).sum::<f64>())
                .collect();
            if wanted.iter().any(|&spent| spent > may_spend) {
                return;
            }
            spent.copy_from_slice(&wanted);
            for &(_, x, y) in tied {
                let ends_from = &mut self.ends_from[n * (self.max_pairs + 1) + x];
                *ends_from = (*ends_from).min(y as u16);
            }
        }
    }

    /// Whether it ends after `n` pairs in which the worse policy had `x` successes and the better one `y`.
    fn is_ended(&self, n: usize, x: usize, y: usize) -> bool {
        y >= usize::from(self.ends_from[n * (self.max_pairs + 1) + x])
    }

    /// Pairs that were planned.
    pub fn max_pairs(&self) -> u64 {
        self.max_pairs as u64
    }

    /// What `seen` says. Whoever asks after each pair may stop at the first decision.
    ///
    /// # Errors
    /// More successes than pairs, more pairs than were planned.
    pub fn decide(&self, seen: Pairs) -> Result<Decision, StatisticsError> {
        let (n, a, b) = self.checked(seen)?;
        Ok(match (self.is_ended(n, a, b), self.is_ended(n, b, a), n == self.max_pairs) {
            (true, _, _) => Decision::B,
            (_, true, _) => Decision::A,
            (_, _, true) => Decision::Exhausted,
            _ => Decision::Undecided,
        })
    }

    /// How the test behaves where A succeeds with `rate_a` and B with `rate_b`, independently.
    ///
    /// # Errors
    /// Rates that are not between 0 and 1.
    pub fn operating(&self, rate_a: f64, rate_b: f64) -> Result<Operating, StatisticsError> {
        let (rate_a, rate_b) = (probability("the rate of A", rate_a)?, probability("the rate of B", rate_b)?);
        let mut walk = Walk::new(self.max_pairs, rate_a, rate_b);
        let (mut says_a, mut says_b, mut mean_pairs) = (0.0, 0.0, 0.0);
        for n in 1..=self.max_pairs {
            mean_pairs += walk.total(n - 1);
            walk.step();
            says_b += walk.end(n, |x, y| self.is_ended(n, x, y));
            says_a += walk.end(n, |x, y| self.is_ended(n, y, x));
        }
        Ok(Operating { says_b, says_a, mean_pairs })
    }

    /// How many more pairs would settle an undecided comparison with a chance of 80 %, if both policies go on as they did
    /// (rates by Laplace's rule of succession); `None` if not even all that are planned would, or if nothing was seen yet.
    ///
    /// # Errors
    /// More successes than pairs, more pairs than were planned.
    pub fn pairs_to_settle(&self, seen: Pairs) -> Result<Option<u64>, StatisticsError> {
        let (n, a, b) = self.checked(seen)?;
        if n == 0 || self.decide(seen)? != Decision::Undecided {
            return Ok(None);
        }
        let rate = |successes: usize| (successes as f64 + 1.0) / (n as f64 + 2.0);
        let mut walk = Walk::at(self.max_pairs, rate(a), rate(b), (n, a, b));
        let mut settled = 0.0;
        for later in n + 1..=self.max_pairs {
            walk.step();
            settled += walk.end(later, |x, y| self.is_ended(later, x, y) || self.is_ended(later, y, x));
            if settled >= HINT_POWER {
                return Ok(Some((later - n) as u64));
            }
        }
        Ok(None)
    }

    fn checked(&self, seen: Pairs) -> Result<(usize, usize, usize), StatisticsError> {
        crate::check_successes(seen.successes_a, seen.pairs)?;
        crate::check_successes(seen.successes_b, seen.pairs)?;
        if seen.pairs > self.max_pairs as u64 {
            let (what, max) = ("the number of pairs", self.max_pairs as u64);
            return Err(StatisticsError::Count { what, value: seen.pairs, max });
        }
        Ok((seen.pairs as usize, seen.successes_a as usize, seen.successes_b as usize))
    }
}

/// Probabilities of all states after some pairs that did not end the test.
struct Walk {
    rate_a: f64,
    rate_b: f64,
    n: usize,
    stride: usize,
    /// By successes of A and B, at `a * stride + b`.
    mass: Vec<f64>,
}

impl Walk {
    fn new(max_pairs: usize, rate_a: f64, rate_b: f64) -> Self {
        Self::at(max_pairs, rate_a, rate_b, (0, 0, 0))
    }

    /// From a state that was reached.
    fn at(max_pairs: usize, rate_a: f64, rate_b: f64, (n, a, b): (usize, usize, usize)) -> Self {
        let stride = max_pairs + 1;
        let mut mass = vec![0.0; stride * stride];
        mass[a * stride + b] = 1.0;
        Self { rate_a, rate_b, n, stride, mass }
    }

    fn mass(&self, a: usize, b: usize) -> f64 {
        self.mass[a * self.stride + b]
    }

    fn total(&self, n: usize) -> f64 {
        (0..=n).flat_map(|a| (0..=n).map(move |b| (a, b))).map(|(a, b)| self.mass(a, b)).sum()
    }

    /// One more pair. Larger counts come first, so that each state is read before it is written.
    fn step(&mut self) {
        let (p, q) = (self.rate_a, self.rate_b);
        self.n += 1;
        for a in (0..=self.n).rev() {
            for b in (0..=self.n).rev() {
                let before = |has_a: bool, has_b: bool| match (has_a && a == 0, has_b && b == 0) {
                    (false, false) => self.mass(a - usize::from(has_a), b - usize::from(has_b)),
                    _ => 0.0,
                };
                self.mass[a * self.stride + b] = (1.0 - p)
                    * ((1.0 - q) * before(false, false) + q * before(false, true))
                    + p * ((1.0 - q) * before(true, false) + q * before(true, true));
            }
        }
    }

    /// Takes out the states in which the test has ended; gives their probability.
    fn end(&mut self, n: usize, is_ended: impl Fn(usize, usize) -> bool) -> f64 {
        let mut ended = 0.0;
        for a in 0..=n {
            for b in 0..=n {
                if is_ended(a, b) {
                    ended += std::mem::take(&mut self.mass[a * self.stride + b]);
                }
            }
        }
        ended
    }
}
