//! Whether two people score alike.

use crate::StatisticsError;

/// Cohen's kappa of two scorers: by how much more they agree than scorers would who score by chance with the same shares of
/// verdicts (J. Cohen, 1960). `counts[i][j]` is the number of trials to which the first gave verdict `i` and the second `j`.
/// 1 is full agreement, 0 that of chance, less than 0 is worse than chance; `None` where both always give the same single
/// verdict, so that chance explains everything.
///
/// # Errors
/// No trials.
pub fn cohens_kappa<const N: usize>(counts: &[[u64; N]; N]) -> Result<Option<f64>, StatisticsError> {
    let total: u64 = counts.iter().flatten().sum();
    if total == 0 {
        return Err(StatisticsError::Count { what: "the number of trials", value: 0, max: u64::MAX });
    }
    let n = total as f64;
    let agreed: u64 = (0..N).map(|verdict| counts[verdict][verdict]).sum();
    let by_chance: f64 = (0..N)
        .map(|verdict| {
            let first: u64 = counts[verdict].iter().sum();
            let second: u64 = counts.iter().map(|row| row[verdict]).sum();
            (first as f64 / n) * (second as f64 / n)
        })
        .sum();
    let beyond = 1.0 - by_chance;
    Ok((beyond > 0.0).then(|| (agreed as f64 / n - by_chance) / beyond))
}
