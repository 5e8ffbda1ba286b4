//! The rate behind a number of successes.

use statrs::function::beta::beta_reg;

use crate::{StatisticsError, check_successes, probability};

/// An interval of a rate, both ends within 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// The lower end.
    pub low: f64,
    /// The upper end.
    pub high: f64,
}

/// Steps of a bisection: an interval of length 1 shrinks below the spacing of numbers near 1.
const BISECTIONS: usize = 60;

/// Wilson's score interval: the rates that a two-sided normal test of the score keeps at `confidence` (E. B. Wilson,
/// "Probable inference, the law of succession, and statistical inference", 1927). It covers `confidence` on average over
/// rates. 0 to 1 without trials.
///
/// # Errors
/// More successes than trials; a confidence that is not between 0 and 1.
pub fn wilson(successes: u64, trials: u64, confidence: f64) -> Result<Interval, StatisticsError> {
    check_successes(successes, trials)?;
    let z = normal_quantile(0.5 + 0.5 * probability("the confidence", confidence)?);
    if trials == 0 {
        return Ok(Interval { low: 0.0, high: 1.0 });
    }
    let n = trials as f64;
    let rate = successes as f64 / n;
    let scale = 1.0 + z * z / n;
    let center = (rate + z * z / (2.0 * n)) / scale;
    let half = z / scale * (rate * (1.0 - rate) / n + z * z / (4.0 * n * n)).sqrt();
    // Rounding must not leave an end beside the 0 or 1 that it is.
    let low = if successes == 0 { 0.0 } else { (center - half).max(0.0) };
    let high = if successes == trials { 1.0 } else { (center + half).min(1.0) };
    Ok(Interval { low, high })
}

/// Clopper and Pearson's interval: the rates that neither tail of the binomial distribution refuses at (1 - `confidence`) / 2
/// (C. J. Clopper and E. S. Pearson, 1934). It covers at least `confidence` whatever the rate is. 0 to 1 without trials.
///
/// # Errors
/// More successes than trials; a confidence that is not between 0 and 1.
pub fn clopper_pearson(successes: u64, trials: u64, confidence: f64) -> Result<Interval, StatisticsError> {
    check_successes(successes, trials)?;
    let tail = 0.5 * (1.0 - probability("the confidence", confidence)?);
    let (k, n) = (successes as f64, trials as f64);
    // P(X >= k) = I_p(k, n - k + 1) grows with p; P(X <= k) = 1 - I_p(k + 1, n - k) falls.
    let low = if successes == 0 { 0.0 } else { bisect(|p| beta_reg(k, n - k + 1.0, p) > tail) };
    let high = if successes == trials { 1.0 } else { bisect(|p| 1.0 - beta_reg(k + 1.0, n - k, p) < tail) };
    Ok(Interval { low, high })
}

/// pass^k: the chance that `k` trials, drawn from those that were made, all succeeded: C(successes, k) / C(trials, k), the
/// unbiased estimate of the k-th power of the rate. 1 for `k` = 0.
///
/// # Errors
/// More successes than trials; a `k` of more than all trials.
pub fn pass_hat_k(successes: u64, trials: u64, k: u64) -> Result<f64, StatisticsError> {
    check_successes(successes, trials)?;
    if k > trials {
        return Err(StatisticsError::Count { what: "k", value: k, max: trials });
    }
    Ok((0..k).map(|drawn| successes.saturating_sub(drawn) as f64 / (trials - drawn) as f64).product())
}

/// The point between 0 and 1 from which on `is_above` holds.
fn bisect(is_above: impl Fn(f64) -> bool) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        if is_above(middle) { high = middle } else { low = middle }
    }
    0.5 * (low + high)
}

/// The quantile of the standard normal distribution.
fn normal_quantile(p: f64) -> f64 {
    std::f64::consts::SQRT_2 * statrs::function::erf::erf_inv(2.0 * p - 1.0)
}
