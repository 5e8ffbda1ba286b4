//! The motion of a take, as the planner gives it.

use palpate_motion::{Primitives, Scene, TakeMotion, plan_in};

use crate::EmulationError;
use crate::truth::Emulation;

/// Plans the take at `take_idx`. The same plan gives the same motion, whatever the seed of the recording.
pub(crate) fn plan_take(
    emulation: &Emulation,
    scene: &Scene<'_>,
    take_idx: usize,
) -> Result<TakeMotion, EmulationError> {
    Ok(plan_in(scene, &emulation.plan, &Primitives::new(), take_idx, None)?)
}
