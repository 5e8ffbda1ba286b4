//! Skins that answer late to the force that they bear.

use std::fmt;

use palpate_robot_model::{Place, SensorKind, Station, TactileLayout};

use super::{
    DynFrameEffect, Frame, FrameEffect, Load, TakeScene,
    low_pass::{FrameLag, Lag},
    places,
};

/// How force goes with the load of a channel: as a power.
#[derive(Clone, Copy, Debug)]
pub(super) struct Force {
    exponent: f64,
}

impl Force {
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

    fn of_load(self, load: f64) -> f64 {
        if self.exponent == 1.0 { load } else { load.max(0.0).powf(self.exponent) }
    }

    fn to_load(self, force: f64) -> f64 {
        if self.exponent == 1.0 { force } else { force.max(0.0).powf(self.exponent.recip()) }
    }
}

/// Makes of the loads at `place` those of what is `felt` of their force and of what follows it with `time_constant_s`.
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
        let bears = of_channel(channel);
        let loads = state.of_channel_mut(channel);
        loads.iter_mut().for_each(|load| *load = bears.of_load(*load));
        let late = lag.of(loads);
        loads
            .iter_mut()
            .zip(late.iter())
            .for_each(|(force, late)| *force = bears.to_load(felt(*force, *late)));
    }
}

/// [`lag_forces`], frame by frame.
pub(super) struct LateForce<F> {
    /// Of each channel of `lag`.
    bears: Vec<Force>,
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
        let bears = channels.iter().map(|&channel| of_channel(channel)).collect();
        Box::new(Self { bears, lag: FrameLag { channels, time_constant_s }, felt })
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

    fn step(&self, frame: &Frame<'_>, memory: &mut [f64], loads: &mut [f64]) {
        let of_channels = || self.lag.channels.iter().copied().zip(&self.bears);
        for (channel, bears) in of_channels() {
            loads[channel] = bears.of_load(loads[channel]);
        }
        self.lag.step(frame, memory, loads, |force, late| *force = (self.felt)(*force, late));
        for (channel, bears) in of_channels() {
            loads[channel] = bears.to_load(loads[channel]);
        }
    }
}
