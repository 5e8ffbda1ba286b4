//! Lowest and highest reading of any range of samples in a few steps, for traces of any length.

/// Samples one level up stand for so many of the level below.
const FACTOR: usize = 8;

/// Minima and maxima at coarser and coarser steps. Readings that are no number are left out.
#[derive(Clone, Debug, Default)]
pub struct MinMaxPyramid {
    levels: Vec<Vec<[f32; 2]>>,
}

const NOTHING: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

fn join(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

impl MinMaxPyramid {
    /// Of these samples.
    pub fn new(samples: impl Iterator<Item = f32>) -> Self {
        let base: Vec<[f32; 2]> =
            samples.map(|value| if value.is_finite() { [value, value] } else { NOTHING }).collect();
        let mut levels = vec![base];
        while let Some(level) = levels.last().filter(|level| level.len() > FACTOR) {
            let next = level.chunks(FACTOR).map(|chunk| chunk.iter().copied().fold(NOTHING, join)).collect();
            levels.push(next);
        }
        Self { levels }
    }

    /// Lowest and highest of the samples in `range` (cut to what there is); `None` if none is a number.
    pub fn min_max(&self, range: std::ops::Range<usize>) -> Option<[f32; 2]> {
        let mut found = NOTHING;
        let (mut start, mut end) = (range.start, range.end.min(self.levels.first()?.len()));
        for (level_idx, level) in self.levels.iter().enumerate() {
            if start >= end {
                break;
            }
            let is_top = level_idx + 1 == self.levels.len();
            let take = |from: usize, to: usize| level[from..to].iter().copied().fold(NOTHING, join);
            let (inner_start, inner_end) = (start.div_ceil(FACTOR), end / FACTOR);
            if is_top || inner_start >= inner_end {
                found = join(found, take(start, end));
                break;
            }
            found = join(found, take(start, inner_start * FACTOR));
            found = join(found, take(inner_end * FACTOR, end));
            (start, end) = (inner_start, inner_end);
        }
        (found[0] <= found[1]).then_some(found)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn agrees_with_looking_at_every_sample(
            samples in proptest::collection::vec(prop_oneof![9 => -1e3_f32..1e3, 1 => Just(f32::NAN)], 0..1500),
            start in 0_usize..1600, length in 0_usize..1600,
        ) {
            let pyramid = MinMaxPyramid::new(samples.iter().copied());
            let slow = samples
                .iter()
                .skip(start)
                .take(length)
                .filter(|value| value.is_finite())
                .fold(None, |found: Option<[f32; 2]>, &value| {
                    Some(found.map_or([value, value], |found| join(found, [value, value])))
                });
            prop_assert_eq!(pyramid.min_max(start..start + length), slow);
        }
    }
}
