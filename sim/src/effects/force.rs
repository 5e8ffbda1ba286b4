//! Skins that answer late to the force that they bear.

use std::fmt;

use palpate_robot_model::{Place, SensorKind, Station, TactileLayout};

use super::{
    DynFrameEffect, Frame, FrameEffect, Load, TakeScene,
    low_pass::{FrameLag, Lag},
    places,
};
use crate::vectors::powers;

/// How force goes with the load of a channel: as a power.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Force {
    exponent: f64,
}

impl Force {
    /// The load itself.
    pub(super) const LOAD: Self = Self { exponent: 1.0 };

    pub(super) fn with(exponent: f64) -> Self {
        Self { exponent }
    }

    /// Of `channel`. The load of a pressure channel is a force; that of a proximity channel is a depth, with whose
    /// square the force of a round body goes on an elastic foundation (K. L. Johnson, "Contact Mechanics", 1985,
    /// section 4.3).
    pub(super) fn usual(layout: &TactileLayout, channel: usize) -> Self {
        match layout.streams[layout.channels[channel].stream].kind {
            SensorKind::Pressure => Self::with(1.0),
            SensorKind::Proximity => Self::with(2.0),
        }
    }

    /// Makes `forces`, which are such here, what they are to `other`.
    pub(super) fn make_other(self, forces: &mut [f64], other: Self) {
        if self == other {
            return;
        }
        if self != Self::LOAD {
            powers(forces, self.exponent.recip());
        }
        if other != Self::LOAD {
            powers(forces, other.exponent);
        }
    }
}

/// Makes of the forces at `place` what is `felt` of them and of what follows them with `time_constant_s`.
pub(super) fn lag_forces(
    place: &Place,
    scene: &TakeScene<'_>,
    state: &mut Load,
    time_constant_s: f64,
    of_channel: impl Fn(usize) -> Force,
    felt: impl Fn(f64, f64) -> f64,
) {
    let layout = &scene.station.layout;
    let lag = Lag::new(scene.frame_times_s, time_constant_s);
    for channel in state.pressed_at(place, layout) {
        let forces = state.forces_mut(channel, of_channel(channel));
        let late = lag.of(forces);
        forces.iter_mut().zip(late.iter()).for_each(|(force, late)| *force = felt(*force, *late));
    }
}

/// [`lag_forces`], frame by frame.
pub(super) struct LateForce<F> {
    /// Of each channel of `lag`.
    forces: Vec<(usize, Force)>,
    lag: FrameLag,
    felt: F,
}

impl<F: Fn(f64, f64) -> f64 + Send + Sync + 'static> LateForce<F> {
    pub(super) fn boxed(
        place: &Place,
        station: &Station,
        time_constant_s: f64,
        of_channel: impl Fn(usize) -> Force,
        felt: F,
    ) -> DynFrameEffect {
        let channels = places::channels_of(place, &station.layout);
        let forces = channels.iter().map(|&channel| (channel, of_channel(channel))).collect();
        Box::new(Self { forces, lag: FrameLag { channels, time_constant_s }, felt })
    }
}

impl<F> fmt::Debug for LateForce<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LateForce").field("lag", &self.lag).finish_non_exhaustive()
    }
}

impl<F: Fn(f64, f64) -> f64 + Send + Sync> FrameEffect for LateForce<F> {
    fn memory_len(&self) -> usize {
        self.lag.memory_len()
    }

    fn forces(&self) -> Option<&[(usize, Force)]> {
        Some(&self.forces)
    }

    fn step(&self, frame: &Frame<'_>, memory: &mut [f64], forces: &mut [f64]) {
        self.lag.step(frame, memory, forces, |force, late| *force = (self.felt)(*force, late));
    }
}
