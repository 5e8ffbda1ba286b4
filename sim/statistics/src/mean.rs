//! The mean behind a few numbers.

use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::{Interval, StatisticsError, probability};

/// A mean and where it may lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// Of the numbers, in their unit.
    pub mean: f64,
    /// In the same unit; nothing from a single number.
    pub interval: Option<Interval>,
}

/// The mean of `values` and Student's interval of it (Student, "The probable error of a mean", 1908): the means that a
/// two-sided t test of n - 1 degrees of freedom keeps at `confidence`. Nothing without values. Values that are all
/// alike give an interval without width: they say nothing of how they spread.
///
/// # Errors
/// A confidence that is not between 0 and 1.
pub fn student(values: &[f64], confidence: f64) -> Result<Option<Mean>, StatisticsError> {
    let p = 0.5 + 0.5 * probability("the confidence", confidence)?;
    let n = values.len() as f64;
    if values.is_empty() {
        return Ok(None);
    }
    let mean = values.iter().sum::<f64>() / n;
    let interval = StudentsT::new(0.0, 1.0, n - 1.0).ok().map(|t| {
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let half = t.inverse_cdf(p) * (variance / n).sqrt();
        Interval { low: mean - half, high: mean + half }
    });
    Ok(Some(Mean { mean, interval }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_is_students() {
        // The deviation is sqrt(7), and the 97.5 % quantile of t with 3 degrees of freedom is 3.182446 in printed
        // tables.
        let Mean { mean, interval } =
            student(&[1.0, 2.0, 4.0, 7.0], 0.95).expect("a confidence").expect("values");
        let (Interval { low, high }, half) =
            (interval.expect("four values"), 3.182_446 * 0.5 * 7.0_f64.sqrt());
        assert!((mean - 3.5).abs() < 1e-12 && (low - (3.5 - half)).abs() < 1e-5, "{mean} {low}");
        assert!((high - (3.5 + half)).abs() < 1e-5, "{high}");
    }

    #[test]
    fn one_value_has_no_interval_and_none_no_mean() {
        assert_eq!(student(&[2.0], 0.95), Ok(Some(Mean { mean: 2.0, interval: None })));
        assert_eq!(student(&[], 0.95), Ok(None));
        assert!(student(&[2.0], 1.0).is_err());
        let alike = student(&[2.0; 3], 0.95).expect("a confidence").expect("values");
        assert_eq!(alike.interval, Some(Interval { low: 2.0, high: 2.0 }));
    }
}
