//! A sensor that follows its load with a lag of first order.

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
        for channel in state.needed_at(&effect.place, &scene.station.layout) {
            let lagging = lag(scene.frame_times_s, state.of_channel(channel), time_constant_s);
            state.of_channel_mut(channel).copy_from_slice(&lagging);
        }
    }
}

/// The exact solution of `y' = (x - y) / tau` at `times_s`, from rest at the first value, for `x` linear in between:
/// `y1 = x1 - s tau + (y0 - x0 + s tau) exp(-dt / tau)` with the slope `s`. Frames may be further apart than `tau`.
pub(super) fn lag(times_s: &[f64], input: &[f64], time_constant_s: f64) -> Vec<f64> {
    let mut before: Option<(f64, f64, f64)> = None;
    let follow = |(&time_s, &x): (&f64, &f64)| {
        let (from_s, from_x, from_y) = before.unwrap_or((time_s, x, x));
        let gap_s = time_s - from_s;
        let y = if gap_s <= 0.0 {
            from_y
        } else if from_x == x && from_y == x {
            // Sensors rest most of the time.
            x
        } else {
            let decay = (-gap_s / time_constant_s).exp();
            let behind = (x - from_x) / gap_s * time_constant_s;
            x - behind + (from_y - from_x + behind) * decay
        };
        before = Some((time_s, x, y));
        y
    };
    times_s.iter().zip(input).map(follow).collect()
}
