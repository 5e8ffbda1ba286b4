//! A sensor that follows its load with a lag of first order.

use std::sync::Arc;

use palpate_robot_model::{Place, Station};

use super::{
    DynFrameEffect, Effect, EffectKind, Frame, FrameEffect, Load, Parameter, Stage, TakeScene, places,
};
use crate::vectors::{exponential, exponentials};

/// Every reading of a stream follows its load with `time_constant_s`.
pub(super) struct LowPass;

impl EffectKind for LowPass {
    fn id(&self) -> &'static str {
        "low_pass"
    }

    fn stage(&self) -> Stage {
        Stage::Sensor
    }

    fn explain(&self, effect: &Effect, station: &Station) -> String {
        format!(
            "The {} follows its load with a lag of {:.0} ms.",
            places::name(&effect.place, station),
            effect.parameter("time_constant_s") * 1e3
        )
    }

    fn signature(&self) -> &'static str {
        "onsets and releases are late, light touches later than firm ones; short taps vanish"
    }

    fn parameters(&self, _place: &Place, _station: &Station) -> Vec<Parameter> {
        vec![Parameter::new("time_constant_s", 0.0..=1.0, 0.0, 0.012, 0.06)]
    }

    fn places(&self, station: &Station) -> Vec<Place> {
        places::all_streams(station)
    }

    fn load(&self, effect: &Effect, scene: &TakeScene<'_>, state: &mut Load) {
        let time_constant_s = effect.parameter("time_constant_s");
        if time_constant_s <= 0.0 {
            return;
        }
        let lag = Lag::new(scene.frame_times_s, time_constant_s);
        for channel in state.pressed_at(&effect.place, &scene.station.layout) {
            state.values[channel] = lag.of(state.of_channel(channel));
        }
    }

    fn load_by_frame(&self, effect: &Effect, station: &Station, _on_loads: &[f64]) -> Option<DynFrameEffect> {
        let time_constant_s = effect.parameter("time_constant_s");
        let channels = places::channels_of(&effect.place, &station.layout);
        (time_constant_s > 0.0).then(|| Box::new(FrameLag { channels, time_constant_s }) as DynFrameEffect)
    }
}

/// What follows its input with a time constant.
///
/// The exact solution of `y' = (x - y) / tau`, from rest at the first value, for `x` linear in between:
/// `y1 = x1 - s tau + (y0 - x0 + s tau) exp(-dt / tau)` with the slope `s`. Frames may be further apart than `tau`.
pub(super) struct Lag {
    time_constant_s: f64,
    /// Per frame, the time since the one before, s, and how much of the distance to the input is left after it.
    steps: Vec<(f64, f64)>,
}

impl Lag {
    /// For frames at `times_s`.
    pub(super) fn new(times_s: &[f64], time_constant_s: f64) -> Self {
        let before_s = times_s.first().into_iter().chain(times_s);
        let gaps_s: Vec<f64> =
            times_s.iter().zip(before_s).map(|(time_s, before_s)| time_s - before_s).collect();
        let mut left: Vec<f64> = gaps_s.iter().map(|gap_s| -gap_s / time_constant_s).collect();
        exponentials(&mut left);
        Self { time_constant_s, steps: gaps_s.into_iter().zip(left).collect() }
    }

    /// What follows `input`, frame by frame.
    pub(super) fn of(&self, input: &[f64]) -> Arc<[f64]> {
        let Some(&first) = input.first() else { return Arc::new([]) };
        let mut follower = Follower { from_x: first, y: first };
        let follow =
            |(&(gap_s, decay), &x): (&(f64, f64), &f64)| follower.step(x, gap_s, decay, self.time_constant_s);
        self.steps.iter().zip(input).map(follow).collect()
    }
}

/// Where something that lags is.
struct Follower {
    from_x: f64,
    y: f64,
}

impl Follower {
    /// Where it is once its input has come to `x` in `gap_s`, and `decay` of the distance to it is left.
    fn step(&mut self, x: f64, gap_s: f64, decay: f64, time_constant_s: f64) -> f64 {
        // Sensors rest most of the time.
        let rests = self.from_x == x && self.y == x;
        if gap_s > 0.0 && !rests {
            let behind = (x - self.from_x) / gap_s * time_constant_s;
            self.y = x - behind + (self.y - self.from_x + behind) * decay;
        }
        self.from_x = x;
        self.y
    }
}

/// [`Lag`] of the loads of some channels, frame by frame.
#[derive(Debug)]
pub(super) struct FrameLag {
    pub(super) channels: Vec<usize>,
    pub(super) time_constant_s: f64,
}

impl FrameLag {
    /// As [`FrameEffect::memory_len`].
    pub(super) fn memory_len(&self) -> usize {
        2 * self.channels.len()
    }

    /// Calls `set` with the load of each channel and what follows it.
    pub(super) fn step(
        &self,
        frame: &Frame<'_>,
        memory: &mut [f64],
        loads: &mut [f64],
        set: impl Fn(&mut f64, f64),
    ) {
        let gap_s = frame.time_s - frame.before_s;
        let decay = exponential(-gap_s / self.time_constant_s);
        for (&channel, memory) in self.channels.iter().zip(memory.chunks_exact_mut(2)) {
            let load = &mut loads[channel];
            let mut follower = if frame.is_first {
                Follower { from_x: *load, y: *load }
            } else {
                Follower { from_x: memory[0], y: memory[1] }
            };
            let follows = follower.step(*load, gap_s, decay, self.time_constant_s);
            memory.copy_from_slice(&[follower.from_x, follower.y]);
            set(load, follows);
        }
    }
}

impl FrameEffect for FrameLag {
    fn memory_len(&self) -> usize {
        self.memory_len()
    }

    fn step(&self, frame: &Frame<'_>, memory: &mut [f64], loads: &mut [f64]) {
        self.step(frame, memory, loads, |load, follows| *load = follows);
    }
}
