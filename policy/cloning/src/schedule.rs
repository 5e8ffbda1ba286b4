//! How much noise there is at each step of a diffusion, and how it is taken away again.

use crate::Predicts;

/// How far the cosine schedule begins from no noise at all (Nichol and Dhariwal 2021, equation 17).
const OFFSET: f64 = 0.008;
/// Most of what is left of the signal that one step may take away (there, section 3.2).
const MAX_BETA: f64 = 0.999;
/// Where noise is predicted, sampling begins where at least so much of the signal is left. What a network gets wrong about
/// the noise counts in the chunk over this share: at the last step of a schedule, where a thousandth is left, chunks are
/// thrown to the limit of [`CLIP`], and no later step brings them back.
const MIN_SIGNAL: f64 = 0.1;
/// Denoised chunks stay within this many standard deviations of what the expert did.
const CLIP: f64 = 6.0;

/// The share of the signal's variance that is left after each step, falling from nearly 1 to nearly 0: alpha bar.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Schedule {
    kept: Vec<f64>,
}

impl Schedule {
    /// The cosine schedule with this many `steps`.
    pub(crate) fn cosine(steps: usize) -> Self {
        let of = |time: f64| ((time + OFFSET) / (1.0 + OFFSET) * std::f64::consts::FRAC_PI_2).cos().powi(2);
        let mut left = 1.0;
        let kept = (0..steps).map(|step| {
            let [before, after] = [step, step + 1].map(|step| of(step as f64 / steps as f64));
            left *= 1.0 - (1.0 - after / before).min(MAX_BETA);
            left
        });
        Self { kept: kept.collect() }
    }

    /// Number of steps.
    pub(crate) fn len(&self) -> usize {
        self.kept.len()
    }

    /// What signal and noise count after `step`: x = signal * x0 + noise * epsilon.
    pub(crate) fn shares(&self, step: usize) -> [f64; 2] {
        [self.kept[step].sqrt(), (1.0 - self.kept[step]).sqrt()]
    }

    /// The steps of a sampling in `count` steps, evenly spread to the first; fewer where there are not as many. It begins at
    /// the last step where the chunk is predicted, and where the noise is, at the noisiest step that has enough signal.
    pub(crate) fn sampled(&self, count: usize, predicts: Predicts) -> Vec<usize> {
        let has_enough = |&step: &usize| predicts == Predicts::Chunk || self.shares(step)[0] >= MIN_SIGNAL;
        let noisiest = (0..self.len()).rev().find(has_enough).unwrap_or(0);
        match count.min(noisiest + 1) {
            0 | 1 => vec![noisiest],
            count => (0..count).rev().map(|idx| idx * noisiest / (count - 1)).collect(),
        }
    }

    /// DDIM without noise (Song et al. 2021, equation 12 with sigma = 0): `noisy` as it is after `step`, with what was
    /// `predicted` of it, becomes what it was after `next`, or the chunk itself.
    pub(crate) fn denoise(
        &self,
        noisy: &mut [f32],
        predicted: &[f32],
        predicts: Predicts,
        step: usize,
        next: Option<usize>,
    ) {
        let [signal, noise] = self.shares(step);
        let [next_signal, next_noise] = next.map_or([1.0, 0.0], |next| self.shares(next));
        for (value, &predicted) in noisy.iter_mut().zip(predicted) {
            let clean = match predicts {
                Predicts::Noise => (f64::from(*value) - noise * f64::from(predicted)) / signal,
                Predicts::Chunk => f64::from(predicted),
            };
            let clean = clean.clamp(-CLIP, CLIP);
            // The noise that belongs to the clipped value.
            let epsilon = (f64::from(*value) - signal * clean) / noise;
            *value = (next_signal * clean + next_noise * epsilon) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_signal_fades_from_all_to_nothing() {
        let schedule = Schedule::cosine(50);
        assert!(schedule.kept.windows(2).all(|pair| pair[1] < pair[0]));
        assert!(schedule.kept[0] > 0.99 && schedule.kept[49] < 1e-4, "{:?}", schedule.kept);
        // Half way: cos^2 of (0.5 + s) / (1 + s) * 90 degrees, against the same at 0.
        let of = |time: f64| ((time + 0.008) / 1.008 * std::f64::consts::FRAC_PI_2).cos().powi(2);
        assert!((schedule.kept[24] - of(0.5) / of(0.0)).abs() < 1e-12);
    }

    #[test]
    fn sampling_goes_from_where_there_is_signal_to_the_first_step_with_even_gaps() {
        let schedule = Schedule::cosine(50);
        assert_eq!(schedule.sampled(10, Predicts::Noise), [45, 40, 35, 30, 25, 20, 15, 10, 5, 0]);
        assert_eq!(schedule.sampled(2, Predicts::Noise), [45, 0]);
        assert_eq!(schedule.sampled(1, Predicts::Noise), [45]);
        assert_eq!(schedule.sampled(50, Predicts::Noise), (0..=45).rev().collect::<Vec<_>>());
        assert_eq!(Schedule::cosine(2).sampled(10, Predicts::Noise), [0]);
        // A chunk can be predicted of noise alone.
        assert_eq!(schedule.sampled(8, Predicts::Chunk), [49, 42, 35, 28, 21, 14, 7, 0]);
    }

    proptest! {
        /// Who is wrong about the noise by a tenth at every step still gets a chunk within a standard deviation or so.
        #[test]
        fn a_small_error_about_the_noise_stays_small(
            clean in -2.0_f64..2.0, epsilon in -2.0_f64..2.0, wrong in -0.1_f64..0.1, count in 2_usize..=50,
        ) {
            let schedule = Schedule::cosine(50);
            let steps = schedule.sampled(count, Predicts::Noise);
            let [signal, noise] = schedule.shares(steps[0]);
            let mut noisy = [(signal * clean + noise * epsilon) as f32];
            for (idx, &step) in steps.iter().enumerate() {
                let [signal, noise] = schedule.shares(step);
                let predicted = (f64::from(noisy[0]) - signal * clean) / noise + wrong;
                schedule.denoise(&mut noisy, &[predicted as f32], Predicts::Noise, step, steps.get(idx + 1).copied());
            }
            prop_assert!((f64::from(noisy[0]) - clean).abs() < 1.0, "{noisy:?} {clean}");
        }

        /// Whoever predicts the chunk has it after the last step, whatever came before.
        #[test]
        fn a_predicted_chunk_is_what_is_left(chunk in -3.0_f32..3.0, noise in -3.0_f32..3.0, count in 1_usize..=20) {
            let schedule = Schedule::cosine(20);
            let steps = schedule.sampled(count, Predicts::Chunk);
            let mut noisy = [noise];
            for (idx, &step) in steps.iter().enumerate() {
                schedule.denoise(&mut noisy, &[chunk], Predicts::Chunk, step, steps.get(idx + 1).copied());
            }
            prop_assert!((noisy[0] - chunk).abs() < 1e-6, "{noisy:?} {chunk}");
        }

        /// Whoever predicts the noise exactly gets the chunk back, in any number of steps.
        #[test]
        fn exact_predictions_give_the_chunk_back(
            chunk in prop::collection::vec(-3.0_f32..3.0, 1..8),
            epsilon in prop::collection::vec(-3.0_f32..3.0, 8),
            count in 1_usize..=20,
        ) {
            let schedule = Schedule::cosine(20);
            let steps = schedule.sampled(count, Predicts::Noise);
            let [signal, noise] = schedule.shares(steps[0]);
            let mix = |(&clean, &epsilon): (&f32, &f32)| (signal * f64::from(clean) + noise * f64::from(epsilon)) as f32;
            let mut noisy: Vec<f32> = chunk.iter().zip(&epsilon).map(mix).collect();
            for (idx, &step) in steps.iter().enumerate() {
                let [signal, noise] = schedule.shares(step);
                let exact: Vec<f32> = noisy
                    .iter()
                    .zip(&chunk)
                    .map(|(&value, &clean)| ((f64::from(value) - signal * f64::from(clean)) / noise) as f32)
                    .collect();
                schedule.denoise(&mut noisy, &exact, Predicts::Noise, step, steps.get(idx + 1).copied());
            }
            for (found, expected) in noisy.iter().zip(&chunk) {
                prop_assert!((found - expected).abs() < 2e-2, "{found} {expected}");
            }
        }
    }
}
