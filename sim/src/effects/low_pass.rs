//! A sensor that follows its load with a lag of first order.

use std::sync::Arc;

use palpate_robot_model::{Place, Station};

use super::{Effect, EffectKind, Load, Parameter, Stage, TakeScene, places};

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
        let gaps_s = times_s.iter().zip(before_s).map(|(time_s, before_s)| time_s - before_s);
        Self {
            time_constant_s,
            steps: gaps_s.map(|gap_s| (gap_s, (-gap_s / time_constant_s).exp())).collect(),
        }
    }

    /// What follows `input`, frame by frame.
    pub(super) fn of(&self, input: &[f64]) -> Arc<[f64]> {
        let Some(&first) = input.first() else { return Arc::new([]) };
        let (mut from_x, mut y) = (first, first);
        let follow = |(&(gap_s, decay), &x): (&(f64, f64), &f64)| {
            // Sensors rest most of the time.
            let rests = from_x == x && y == x;
            if gap_s > 0.0 && !rests {
                let behind = (x - from_x) / gap_s * self.time_constant_s;
                y = x - behind + (y - from_x + behind) * decay;
            }
            from_x = x;
            y
        };
        self.steps.iter().zip(input).map(follow).collect()
    }
}
