//! Whether two policies differ, after a number of trials that was fixed before the first.

use statrs::function::factorial::ln_binomial;

use crate::{StatisticsError, check_successes};

/// Trials of each policy up to which Barnard's test is computed: it looks at every table.
const MAX_BARNARD_TRIALS: u64 = 2_000;
/// Rates between 0 and 1 at which Barnard's test looks for its worst case, before it looks closer around the worst of them.
const NUISANCE_RATES: usize = 1_000;
/// Tables whose statistic differs by less than this are equally extreme.
const TIE: f64 = 1e-9;

/// McNemar's exact test for pairs of trials on the same starts: `only_a` pairs in which policy A alone succeeded, `only_b`
/// in which B alone did. The two-sided p-value of a fair coin that fell so (Q. McNemar, 1947): pairs in which both did the
/// same say nothing. 1 without such pairs.
pub fn mcnemar_exact(only_a: u64, only_b: u64) -> f64 {
    let n = only_a + only_b;
    let fewer = only_a.min(only_b);
    let half = -(n as f64) * std::f64::consts::LN_2;
    let tail: f64 = (0..=fewer).map(|k| (ln_binomial(n, k) + half).exp()).sum();
    (2.0 * tail).min(1.0)
}

/// Barnard's exact test for trials on starts of their own: the two-sided p-value of two equal rates, by the pooled z
/// statistic, at the common rate for which it is greatest (G. A. Barnard, 1947). `a` and `b` are successes and trials.
///
/// # Errors
/// More successes than trials; no trials, or more than 2,000 of a policy.
pub fn barnard_exact(a: (u64, u64), b: (u64, u64)) -> Result<f64, StatisticsError> {
    for (successes, trials) in [a, b] {
        check_successes(successes, trials)?;
        if trials == 0 || trials > MAX_BARNARD_TRIALS {
            let what = "the number of trials of a policy";
            return Err(StatisticsError::Count { what, value: trials, max: MAX_BARNARD_TRIALS });
        }
    }
    let seen = pooled_z(a, b).abs() - TIE;
    // For each number of successes of A, the extreme tables are those with few and with many successes of B.
    let rows: Vec<(u64, u64, u64)> = (0..=a.1)
        .map(|x| {
            let z = |y: u64| pooled_z((x, a.1), (y, b.1));
            let few = partition_point(b.1 + 1, |y| z(y) <= -seen);
            let many = partition_point(b.1 + 1, |y| z(y) < seen);
            // Where nothing was seen to differ, every table is extreme.
            if few >= many { (x, b.1 + 1, b.1 + 1) } else { (x, few, many) }
        })
        .collect();
    let (ln_a, ln_b) = (ln_binomials(a.1), ln_binomials(b.1));
    let p_at = |rate: f64| {
        let mass_a = binomial_masses(&ln_a, rate);
        let below_b: Vec<f64> = std::iter::once(0.0)
            .chain(binomial_masses(&ln_b, rate).into_iter().scan(0.0, |sum, mass| {
                *sum += mass;
                Some(*sum)
            }))
            .collect();
        let all = below_b[below_b.len() - 1];
        let extreme = |&(x, few, many): &(u64, u64, u64)| {
            mass_a[x as usize] * (below_b[few as usize] + (all - below_b[many as usize]))
        };
        rows.iter().map(extreme).sum::<f64>()
    };
    let grid = |low: f64, high: f64| {
        (0..NUISANCE_RATES).map(move |i| low + (high - low) * (i as f64 + 0.5) / NUISANCE_RATES as f64)
    };
    let worst = |rates: &mut dyn Iterator<Item = f64>| {
        rates
            .map(|rate| (p_at(rate), rate))
            .fold((0.0, 0.5), |most, next| if next.0 > most.0 { next } else { most })
    };
    let (_, rate) = worst(&mut grid(0.0, 1.0));
    let step = 1.0 / NUISANCE_RATES as f64;
    let (p, _) = worst(&mut grid((rate - step).max(0.0), (rate + step).min(1.0)));
    Ok(p.min(1.0))
}

/// The first of 0 to `n` at which `holds`, which holds up to a point, does not.
fn partition_point(n: u64, holds: impl Fn(u64) -> bool) -> u64 {
    let (mut low, mut high) = (0, n);
    while low < high {
        let middle = low + (high - low) / 2;
        if holds(middle) { low = middle + 1 } else { high = middle }
    }
    low
}

/// The pooled z statistic of (successes, trials): positive where B has the greater rate; 0 where all succeed or none.
pub(crate) fn pooled_z(a: (u64, u64), b: (u64, u64)) -> f64 {
    let (n_a, n_b) = (a.1 as f64, b.1 as f64);
    let (rate_a, rate_b) = (a.0 as f64 / n_a, b.0 as f64 / n_b);
    let pooled = (a.0 + b.0) as f64 / (n_a + n_b);
    let variance = pooled * (1.0 - pooled) * (1.0 / n_a + 1.0 / n_b);
    if variance > 0.0 { (rate_b - rate_a) / variance.sqrt() } else { 0.0 }
}

fn ln_binomials(n: u64) -> Vec<f64> {
    (0..=n).map(|k| ln_binomial(n, k)).collect()
}

/// Binomial probabilities of 0 to n successes at `rate`, which is neither 0 nor 1.
fn binomial_masses(ln_binomials: &[f64], rate: f64) -> Vec<f64> {
    let n = ln_binomials.len() - 1;
    let (ln_success, ln_failure) = (rate.ln(), (-rate).ln_1p());
    let mass = |(k, ln): (usize, &f64)| (ln + k as f64 * ln_success + (n - k) as f64 * ln_failure).exp();
    ln_binomials.iter().enumerate().map(mass).collect()
}
