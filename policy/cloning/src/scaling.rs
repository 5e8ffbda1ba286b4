//! Numbers made about one, and back.

/// Normalised numbers stay within this.
const MAX_INPUT: f64 = 10.0;

/// Means and factors that make numbers about one.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Scaling {
    pub(crate) mean: Vec<f64>,
    pub(crate) factor: Vec<f64>,
}

impl Scaling {
    pub(crate) fn of<'a>(rows: impl Iterator<Item = &'a Vec<f32>> + Clone, min_std: f64) -> Self {
        let count = rows.clone().count().max(1) as f64;
        let len = rows.clone().next().map_or(0, Vec::len);
        let (mut mean, mut square) = (vec![0.0; len], vec![0.0; len]);
        for row in rows.clone() {
            mean.iter_mut().zip(row).for_each(|(mean, &value)| *mean += f64::from(value) / count);
        }
        for row in rows {
            let of_row = square.iter_mut().zip(&mean).zip(row);
            of_row.for_each(|((square, mean), &value)| *square += (f64::from(value) - mean).powi(2) / count);
        }
        let factor = square.iter().map(|square: &f64| square.sqrt().max(min_std).recip()).collect();
        Self { mean, factor }
    }

    /// The same for all `frames` at the beginning, that of the first: a recurrent memory reads each in the same way.
    pub(crate) fn with_equal_frames(mut self, frames: usize, frame_len: usize) -> Self {
        for numbers in [&mut self.mean, &mut self.factor] {
            (1..frames).for_each(|frame| numbers.copy_within(..frame_len, frame * frame_len));
        }
        self
    }

    /// `values` made about one.
    pub(crate) fn apply(&self, values: &[f32]) -> impl Iterator<Item = f32> {
        values.iter().zip(&self.mean).zip(&self.factor).map(|((&value, mean), factor)| {
            (((f64::from(value) - mean) * factor).clamp(-MAX_INPUT, MAX_INPUT)) as f32
        })
    }

    /// The way back.
    pub(crate) fn undo(&self, values: &[f32]) -> impl Iterator<Item = f64> {
        let scaled = values.iter().zip(&self.mean).zip(&self.factor);
        scaled.map(|((&value, mean), factor)| f64::from(value) / factor + mean)
    }
}
