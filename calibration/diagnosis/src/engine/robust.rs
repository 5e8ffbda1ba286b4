//! Standard errors that hold where few blocks tell a parameter.
//!
//! The sandwich over blocks believes that errors of many blocks stand for those of all. Where a parameter is told
//! by three or four (the few touches near the end of a cylinder say where it stands along its axis), these may be
//! wrong together, and what they leave after a fit to them is small. How many blocks tell a parameter, if they told
//! it equally, is known, and with it how heavy the tail of its error is. Source: Carter, Schnepel and Steigerwald,
//! "Asymptotic behavior of a t-test robust to cluster heterogeneity", Review of Economics and Statistics 99(4),
//! 2017; Cameron and Miller, "A practitioner's guide to cluster-robust inference", Journal of Human Resources
//! 50(2), 2015.

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

/// Probability, of both tails, at which an error of few blocks is made to look like one of many: that with which
/// the shipped bar of a name, 12, is passed by chance.
const BEYOND_BAR: f64 = 5e-4;
/// With fewer degrees of freedom than this nothing is told anyhow.
const FEWEST_DEGREES: f64 = 1.0;
/// Share of the variance that independent rows of standard weight would give a parameter, below which none is believed:
/// what explains its rows perfectly leaves no spread to judge by, but no row is measured without error.
const LEAST_SPREAD: f64 = 0.01;

/// What blocks are taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Blocks {
    /// As many, which a search goes by: what is hardly told yet may lead to what is.
    Many,
    /// As many as tell each parameter, which a name in the end is judged by.
    Counted,
}

/// Standard errors of the last `count` parameters, robust against dependence within blocks and, where blocks are
/// [`Blocks::Counted`], against their being few.
///
/// `inverse` is that of the normal matrix; `scores` and `normals` are those of blocks, the last of which is what is
/// known beforehand; `step` is the fit to all of them. Counted, errors are made for a normal distribution: a
/// parameter lies so many of them from the truth that the bar is passed by chance with the probability
/// [`BEYOND_BAR`].
pub(crate) fn standard_errors(
    inverse: &DMatrix<f64>,
    (count, blocks): (usize, Blocks),
    step: &DVector<f64>,
    scores: &[DVector<f64>],
    normals: &[DMatrix<f64>],
) -> Vec<f64> {
    let first = inverse.nrows() - count;
    let rows = inverse.rows(first, count);
    let mut sums = vec![Sums::default(); count];
    for (block, (score, normal)) in scores.iter().zip(normals).enumerate() {
        let told = (rows * normal).component_mul(&rows).column_sum();
        let errors = rows * (score - normal * step);
        for (sums, (told, error)) in sums.iter_mut().zip(told.iter().zip(errors.iter())) {
            if block + 1 == scores.len() {
                // What is known beforehand has the variance that is known.
                sums.known = *told;
            } else {
                sums.add(told.max(0.0), *error);
            }
        }
    }
    let of_rows = (first..).map(|idx| LEAST_SPREAD * inverse[(idx, idx)]);
    sums.iter().zip(of_rows).map(|(sums, least)| sums.variance(blocks).max(least).max(0.0).sqrt()).collect()
}

/// What blocks say of the error of one parameter.
#[derive(Clone, Default)]
struct Sums {
    /// Variance of what is known beforehand.
    known: f64,
    /// Squares of what blocks leave, in the parameter's unit.
    squares: f64,
    /// What blocks tell, and its squares.
    told: f64,
    told_squares: f64,
}

impl Sums {
    fn add(&mut self, told: f64, error: f64) {
        self.squares += error * error;
        self.told += told;
        self.told_squares += told * told;
    }

    fn variance(&self, blocks: Blocks) -> f64 {
        let Self { known, squares, told, told_squares } = *self;
        let factor = match blocks {
            Blocks::Counted if told_squares > 0.0 => few_blocks(told * told / told_squares),
            Blocks::Counted | Blocks::Many => 1.0,
        };
        known + factor * squares
    }
}

/// By how much the variance that `num_blocks` equal blocks leave after a fit has to be larger, so that the bar is
/// passed by chance as rarely as with many.
fn few_blocks(num_blocks: f64) -> f64 {
    let degrees = (num_blocks - 1.0).max(FEWEST_DEGREES);
    heavier_tail(degrees) * (degrees + 1.0) / degrees
}

/// What speaks for an effect without which blocks lose `beyond` more than all of them lose with it: the square of the
/// normal deviate that is as rare as Student's t is for so much, where each block counts as one observation.
///
/// As many blocks count as would lose as much if they lost equally; the `loss` with the effect stands for their
/// variance.
pub(crate) fn missed_by(beyond: &[f64], loss: f64) -> f64 {
    let sum: f64 = beyond.iter().sum();
    let squares: f64 = beyond.iter().map(|of_block| of_block * of_block).sum();
    if sum <= 0.0 || squares <= 0.0 {
        return 0.0;
    }
    let degrees = sum * sum / squares - 1.0;
    let deviate = (sum / loss.max(f64::MIN_POSITIVE) * degrees).sqrt();
    let rarity = StudentsT::new(0.0, 1.0, degrees).map_or(1.0, |t| t.sf(deviate));
    Normal::standard().inverse_cdf(rarity.max(RAREST)).min(0.0).powi(2)
}

/// What is rarer counts as this rare.
const RAREST: f64 = 1e-300;

/// Square of how much farther from the middle [`BEYOND_BAR`] begins in Student's t with `degrees` than in a normal
/// distribution.
fn heavier_tail(degrees: f64) -> f64 {
    let below = 1.0 - BEYOND_BAR / 2.0;
    let of_few = StudentsT::new(0.0, 1.0, degrees).map_or(f64::NAN, |t| t.inverse_cdf(below));
    (of_few / Normal::standard().inverse_cdf(below)).powi(2)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn tails_of_one_and_two_degrees_have_their_closed_form() {
        let quantile_of_normal = 3.480756_f64;
        let both = 1.0 - BEYOND_BAR;
        let one = (std::f64::consts::PI * both / 2.0).tan();
        let two = both * (2.0 / (1.0 - both * both)).sqrt();
        for (degrees, quantile) in [(1.0, one), (2.0, two)] {
            let wanted = (quantile / quantile_of_normal).powi(2);
            assert!((heavier_tail(degrees) / wanted - 1.0).abs() < 1e-3, "{degrees}: {wanted}");
        }
        assert!((heavier_tail(1e5) - 1.0).abs() < 1e-3);
        assert_eq!(few_blocks(0.3), 2.0 * heavier_tail(1.0));
    }

    /// Standard error of one parameter whose blocks have these scores and tell so much of it; nothing is known
    /// beforehand.
    fn error(inverse: &DMatrix<f64>, step: f64, scores: &[f64], told: &[f64]) -> f64 {
        let with_known = |values: &[f64]| [values, &[0.0]].concat();
        let scores: Vec<_> =
            with_known(scores).into_iter().map(|score| DVector::from_element(1, score)).collect();
        let normals: Vec<_> =
            with_known(told).into_iter().map(|told| DMatrix::from_element(1, 1, told)).collect();
        standard_errors(inverse, (1, Blocks::Counted), &DVector::from_element(1, step), &scores, &normals)[0]
    }

    /// Share of 40,000 means of blocks with these shares of what is known whose error passes the bar, by chance.
    fn beyond(shares: &[f64]) -> f64 {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let normal = Normal::standard();
        let inverse = DMatrix::from_element(1, 1, 1.0 / shares.iter().sum::<f64>());
        let bar = normal.inverse_cdf(1.0 - BEYOND_BAR / 2.0);
        let draws = 40_000;
        let passed = (0..draws).filter(|_| {
            let scores = shares
                .iter()
                .map(|share| share.sqrt() * normal.inverse_cdf(random.random_range(0.0..1.0)))
                .collect::<Vec<f64>>();
            let step = inverse[(0, 0)] * scores.iter().sum::<f64>();
            step.abs() / error(&inverse, step, &scores, shares) > bar
        });
        passed.count() as f64 / f64::from(draws)
    }

    #[test]
    fn an_effect_is_missed_where_blocks_agree_on_it() {
        let alike = |count: usize, each: f64| missed_by(&vec![each; count], 10.0);
        assert!(alike(12, 10.0) > 20.0, "{}", alike(12, 10.0));
        assert!(alike(12, 10.0) < alike(12, 100.0) && alike(12, 10.0) < alike(24, 10.0));
        // One block, or two that do not agree, say nothing; neither does what is not lost.
        assert!(alike(1, 1e6) < 1e-9 && missed_by(&[1e6, -9e5, 10.0], 10.0) < 1e-9);
        assert!(alike(12, 0.05) < 2.0, "{}", alike(12, 0.05));
        assert_eq!([alike(12, -1.0), missed_by(&[], 10.0), missed_by(&[0.0; 4], 10.0)], [0.0; 3]);
        assert!(missed_by(&[1.0; 400], 0.0).is_finite());
    }

    #[test]
    fn few_blocks_pass_the_bar_by_chance_as_rarely_as_many() {
        for num_blocks in [3, 4, 8, 60] {
            let share = beyond(&vec![1.0; num_blocks]);
            assert!((2e-4..1e-3).contains(&share), "{num_blocks} blocks: {share}");
        }
        // Of many blocks a few tell nearly all.
        let unequal = [vec![10.0; 4], vec![0.1; 60]].concat();
        let share = beyond(&unequal);
        assert!(share < 2e-3, "{share}");
    }

    proptest! {
        #[test]
        fn blocks_that_tell_nothing_do_not_count(
            scores in prop::collection::vec(-2.0..2.0_f64, 2..8),
            silent in 0..20_usize,
        ) {
            let inverse = DMatrix::from_element(1, 1, 1.0 / scores.len() as f64);
            let step = inverse[(0, 0)] * scores.iter().sum::<f64>();
            let told = vec![1.0; scores.len()];
            let more = |values: &[f64]| [values, vec![0.0; silent].as_slice()].concat();
            prop_assert_eq!(
                error(&inverse, step, &scores, &told),
                error(&inverse, step, &more(&scores), &more(&told))
            );
        }
    }
}
