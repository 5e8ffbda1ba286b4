//! Effects frame by frame, while a take goes on.

use std::fmt::Debug;

use palpate_robot_model::TactileLayout;

use super::{Effect, force::Force};

/// A frame of a take that goes on, with what effects need to know of the ones before it.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Whether no frame was before it.
    pub is_first: bool,
    /// Time of the first frame, s.
    pub start_s: f64,
    /// Time of the frame before, s; its own, if it is the first.
    pub before_s: f64,
    /// Its time, s.
    pub time_s: f64,
    /// Measured joint positions, one per degree of freedom, rad or m.
    pub positions: &'a [f64],
    /// Those of the frame before; its own, if it is the first.
    pub positions_before: &'a [f64],
}

/// What an effect does to the joint positions, or to the loads, of one frame: an effect with its places looked up, to be
/// shared by many takes that go on at once.
///
/// Each take keeps the memory. Steps over all frames give the bits that the effect gives for the whole take.
pub trait FrameEffect: Debug + Send + Sync {
    /// How many numbers it remembers from frame to frame. They are zero before the first frame.
    fn memory_len(&self) -> usize {
        0
    }

    /// Of each channel that it acts on, the force that it is to be given; `None` where it acts on loads.
    fn forces(&self) -> Option<&[(usize, Force)]> {
        None
    }

    /// Changes the `values` of `frame`: joint positions by degree of freedom, or by channel loads ([`Self::forces`],
    /// where it acts on these).
    fn step(&self, frame: &Frame<'_>, memory: &mut [f64], values: &mut [f64]);
}

/// A [`FrameEffect`] of any kind.
pub type DynFrameEffect = Box<dyn FrameEffect>;

/// Values that are each multiplied by a factor.
#[derive(Clone, Debug)]
pub(super) struct Factors(pub(super) Vec<(usize, f64)>);

impl Factors {
    /// What the `presence` of `effect` leaves of the channels of its place.
    pub(super) fn left_by_presence(effect: &Effect, layout: &TactileLayout) -> Self {
        let left = 1.0 - effect.parameter("presence");
        Self(effect.channels(layout).into_iter().map(|channel| (channel, left)).collect())
    }
}

impl FrameEffect for Factors {
    fn step(&self, _frame: &Frame<'_>, _memory: &mut [f64], values: &mut [f64]) {
        for &(channel, factor) in &self.0 {
            values[channel] *= factor;
        }
    }
}
