//! What noise is for.

use rand_chacha::ChaCha8Rng;

/// What noise is for; each has generators of its own.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Purpose {
    /// First weights: one generator for each layer.
    Weights = 1,
    /// Actions: one generator for each environment and step.
    Actions = 2,
    /// Order of a batch: one generator for each update and epoch.
    Shuffle = 3,
}

/// The generator of `(seed, purpose, first, second)`.
pub(crate) fn generator(seed: u64, purpose: Purpose, first: u64, second: u64) -> ChaCha8Rng {
    palpate_training::generator(seed, purpose as u64, first, second)
}
