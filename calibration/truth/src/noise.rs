//! Random numbers of the truth world.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

/// A standard normal deviate (Box and Muller). Sessions of earlier versions have these bits.
pub(crate) fn gaussian(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}
