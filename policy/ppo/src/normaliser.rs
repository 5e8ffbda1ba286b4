//! Observations brought to mean zero and variance one.

/// Mean and variance of every component of all observations so far (Welford 1962).
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Normaliser {
    pub(crate) count: u64,
    pub(crate) mean: Vec<f64>,
    /// Sum of squared distances from the mean.
    pub(crate) squares: Vec<f64>,
}

/// Components that move less than this are shifted only: dividing by their spread would amplify rounding.
const MIN_STD: f64 = 1e-4;

impl Normaliser {
    pub(crate) fn new(dim: usize) -> Self {
        Self { count: 0, mean: vec![0.0; dim], squares: vec![0.0; dim] }
    }

    /// Takes in `rows`, `[any, dim]`, in their order.
    pub(crate) fn add(&mut self, rows: &[f32]) {
        for row in rows.chunks_exact(self.mean.len()) {
            self.count += 1;
            let share = 1.0 / self.count as f64;
            for ((mean, squares), &value) in self.mean.iter_mut().zip(&mut self.squares).zip(row) {
                let before = f64::from(value) - *mean;
                *mean += before * share;
                *squares += before * (f64::from(value) - *mean);
            }
        }
    }

    /// `rows`, `[any, dim]`, shifted and scaled, within `±clip`. Before any observation came in, only clipped.
    pub(crate) fn normalise(&self, rows: &[f32], clip: f64) -> Vec<f32> {
        let count = self.count as f64;
        let scales: Vec<f64> = self
            .squares
            .iter()
            .map(|squares| (squares / count).sqrt())
            .map(|std| if std > MIN_STD { 1.0 / std } else { 1.0 })
            .collect();
        let mut normal = Vec::with_capacity(rows.len());
        for row in rows.chunks_exact(self.mean.len()) {
            for ((&value, mean), scale) in row.iter().zip(&self.mean).zip(&scales) {
                normal.push(((f64::from(value) - mean) * scale).clamp(-clip, clip) as f32);
            }
        }
        normal
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_out_with_mean_zero_and_variance_one() {
        let rows: Vec<f32> =
            (0..3000).flat_map(|i| [(i % 10) as f32 * 3.0 + 100.0, 5.0, (i % 7) as f32]).collect();
        let mut normaliser = Normaliser::new(3);
        let (first, second) = rows.split_at(900);
        normaliser.add(first);
        normaliser.add(second);
        let normal = normaliser.normalise(&rows, 10.0);
        for column in 0..3 {
            let values: Vec<f64> =
                normal.iter().skip(column).step_by(3).map(|&value| f64::from(value)).collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let variance = values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64;
            // The second component never moves: it is shifted, not blown up.
            let expected = if column == 1 { 0.0 } else { 1.0 };
            assert!(mean.abs() < 1e-6 && (variance - expected).abs() < 1e-5, "{column}: {mean} {variance}");
        }
        assert_eq!(normaliser.normalise(&[1e9, -1e9, 0.0], 10.0)[..2], [10.0, -10.0]);
    }

    #[test]
    fn before_any_observation_rows_pass() {
        assert_eq!(Normaliser::new(2).normalise(&[3.0, -40.0], 10.0), [3.0, -10.0]);
    }
}
