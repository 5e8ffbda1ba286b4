//! Noise that depends on what it is for and on nothing else.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The generator of `(seed, purpose, first, second)`: the four numbers are ChaCha's key. Each training numbers the purposes
/// of its noise.
pub fn generator(seed: u64, purpose: u64, first: u64, second: u64) -> ChaCha8Rng {
    let mut key = [0; 32];
    for (bytes, number) in key.chunks_exact_mut(8).zip([seed, purpose, first, second]) {
        bytes.copy_from_slice(&number.to_le_bytes());
    }
    ChaCha8Rng::from_seed(key)
}

/// Fills `noise` with standard normal numbers (Box and Muller 1958).
pub fn fill_normal(generator: &mut ChaCha8Rng, noise: &mut [f32]) {
    for pair in noise.chunks_mut(2) {
        let radius = (-2.0 * (1.0 - generator.random::<f64>()).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * generator.random::<f64>()).sin_cos();
        for (value, part) in pair.iter_mut().zip([cos, sin]) {
            *value = (radius * part) as f32;
        }
    }
}

/// A number below `len`, each as likely as the others.
pub fn below(generator: &mut ChaCha8Rng, len: usize) -> usize {
    // The bias of a remainder of 64 bits is below 1e-12 for any number of things that fits into memory.
    (generator.next_u64() % len as u64) as usize
}

/// Numbers `0..len` in random order (Fisher and Yates).
pub fn permutation(generator: &mut ChaCha8Rng, len: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..len).collect();
    for last in (1..len).rev() {
        order.swap(last, below(generator, last + 1));
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_of_the_key_changes_the_noise() {
        let draw = |seed, purpose, first, second| generator(seed, purpose, first, second).next_u64();
        let base = draw(1, 2, 3, 4);
        assert_eq!(base, draw(1, 2, 3, 4));
        for other in [draw(2, 2, 3, 4), draw(1, 3, 3, 4), draw(1, 2, 2, 4), draw(1, 2, 3, 3)] {
            assert_ne!(base, other);
        }
    }

    #[test]
    fn noise_has_mean_zero_variance_one_and_normal_tails() {
        let mut noise = vec![0.0; 200_001];
        fill_normal(&mut generator(7, 2, 0, 0), &mut noise);
        let count = noise.len() as f64;
        let mean = noise.iter().map(|&x| f64::from(x)).sum::<f64>() / count;
        let variance = noise.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() / count;
        let beyond_two = noise.iter().filter(|x| x.abs() > 2.0).count() as f64 / count;
        // Four standard errors of each.
        assert!(mean.abs() < 4.0 / count.sqrt(), "{mean}");
        assert!((variance - 1.0).abs() < 4.0 * (2.0 / count).sqrt(), "{variance}");
        assert!((beyond_two - 0.0455).abs() < 4.0 * (0.0455_f64 / count).sqrt(), "{beyond_two}");
    }

    #[test]
    fn a_permutation_holds_every_number_once_and_moves_most() {
        let order = permutation(&mut generator(7, 3, 0, 0), 1000);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..1000).collect::<Vec<_>>());
        assert!(order.iter().enumerate().filter(|(at, number)| at == *number).count() < 20);
    }
}
