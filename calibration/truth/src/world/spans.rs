//! Spans of a take in which a device freezes.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::secrets::Hold;

/// Part of the device's noise that spans are drawn from.
const SPANS_PART: u64 = 1 << 40;

/// Spans in which the device repeats its last sample, drawn as time goes on.
#[derive(Clone, Debug)]
pub(crate) struct Frozen {
    hold: Hold,
    /// Start of the coming span, or of the one that it is in, s.
    start_s: f64,
    rng: ChaCha8Rng,
    /// What the device last said about touch before it froze.
    pub(crate) active: Vec<bool>,
}

impl Frozen {
    /// Spans from the take's start on. `noise` is the device's own generator, which stays as it is.
    pub(crate) fn new(hold: Hold, noise: &ChaCha8Rng) -> Self {
        let mut rng = noise.clone();
        rng.set_stream(noise.get_stream() + SPANS_PART);
        let mut frozen = Self { hold, start_s: 0.0, rng, active: Vec::new() };
        frozen.start_s = frozen.pause_s();
        frozen
    }

    /// Whether the device is frozen at `now_s`, which must not go back.
    pub(crate) fn at(&mut self, now_s: f64) -> bool {
        while now_s >= self.start_s + self.hold.length_s {
            self.start_s += self.hold.length_s + self.pause_s();
        }
        now_s >= self.start_s
    }

    /// Time between two spans: between half and one and a half times the mean.
    fn pause_s(&mut self) -> f64 {
        self.hold.every_s * (0.5 + self.rng.random::<f64>())
    }
}
