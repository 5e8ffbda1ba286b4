//! What has been made of geometries lately.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::effects::FingerTouches;
use crate::replay::PatchTrace;

/// Pressures at the taxels of a patch, each frame by frame; none where nothing presses.
type Pressures = Arc<[Option<Arc<[f64]>>]>;

/// What has been made of the patches of a geometry lately.
#[derive(Clone, Debug, Default)]
pub(crate) struct Made {
    /// By decay.
    pub(super) spread: ByPatch<Pressures>,
    /// What soft pads feel, by softness.
    pub(super) softened: ByPatch<Arc<PatchTrace>>,
    /// What fingers feel of each other.
    pub(super) touches: FingerTouches,
}

/// Values by the bits of a number, the latest last.
type ByNumber<T> = Vec<(u64, T)>;

/// Values by patch and the bits of a number.
#[derive(Clone, Debug)]
pub(super) struct ByPatch<T>(Arc<Mutex<BTreeMap<usize, ByNumber<T>>>>);

impl<T> Default for ByPatch<T> {
    fn default() -> Self {
        Self(Arc::default())
    }
}

/// Numbers for which something is remembered of a patch: those of a few fits that go on side by side, with their steps.
const NUMBERS_KEPT: usize = 8;

impl<T: Clone> ByPatch<T> {
    /// What there is for the `number` of `patch`, or else what `make` makes.
    pub(super) fn of(&self, patch: usize, number: f64, make: impl FnOnce() -> T) -> T {
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let number = number.to_bits();
        let known = |(known, _): &(u64, T)| *known == number;
        if let Some(of_patch) = lock().get_mut(&patch)
            && let Some(at) = of_patch.iter().position(known)
        {
            of_patch[at..].rotate_left(1);
            return of_patch[of_patch.len() - 1].1.clone();
        }
        let new = make();
        let mut kept = lock();
        let of_patch = kept.entry(patch).or_default();
        if !of_patch.iter().any(known) {
            if of_patch.len() == NUMBERS_KEPT {
                of_patch.remove(0);
            }
            of_patch.push((number, new.clone()));
        }
        new
    }
}
