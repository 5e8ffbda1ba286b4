//! Whether names account for what is there: whoever is named in place of an effect that is in no library explains a part
//! of it and leaves the rest.

use super::{Domain, Model, huber};
use crate::DiagnosisError;

/// Huber's loss of a row, in variances, in each unit: mean over the rows of `takes` that were measured.
pub(crate) fn loss_by_unit<D: Domain>(
    domain: &D,
    model: &Model,
    takes: &[usize],
) -> Result<Vec<f64>, DiagnosisError> {
    let (mut losses, mut rows) = (vec![0.0; domain.num_units()], vec![0.0_f64; domain.num_units()]);
    for &take in takes {
        for (signal, predicted) in domain.predict(take, model)?.iter().enumerate() {
            let unit = signal / domain.num_kinds();
            let weights = domain.weights(take, signal, predicted);
            for ((observed, predicted), weight) in
                domain.observed(take, signal).iter().zip(predicted.iter()).zip(weights)
            {
                if !observed.is_nan() {
                    losses[unit] += huber((observed - predicted) * weight);
                    rows[unit] += 1.0;
                }
            }
        }
    }
    Ok(losses.iter().zip(rows).map(|(loss, rows)| loss / rows.max(1.0)).collect())
}

/// Share of what was in excess of `complete` that is left, over the parts of a measurement that `counted` says.
pub(crate) fn share_left(now: &[f64], before: &[f64], complete: &[f64], counted: &[bool]) -> f64 {
    let excess = |of: &[f64]| -> f64 {
        let parts = of.iter().zip(complete).zip(counted).filter(|(_, counted)| **counted);
        parts.map(|((of, complete), _)| (of - complete).max(0.0)).sum()
    };
    let (now, before) = (excess(now), excess(before));
    if now > 0.0 { now / before.max(f64::MIN_POSITIVE) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_counted_beyond_what_a_complete_model_leaves_and_only_where_it_counts() {
        let complete = [0.5, 1.0, 2.0];
        let (before, now) = ([4.5, 1.0, 3.0], [1.5, 0.2, 9.0]);
        assert_eq!(share_left(&now, &before, &complete, &[true, true, false]), 0.25);
        assert_eq!(share_left(&complete, &before, &complete, &[true; 3]), 0.0);
        assert!(share_left(&now, &complete, &complete, &[true; 3]) > 1.0);
    }
}
