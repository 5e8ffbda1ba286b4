//! The stretch of time that is on the screen.

/// Shortest view, s.
const MIN_SPAN_S: f64 = 0.02;
/// Room beyond either end of the take, as a share of its duration.
const MARGIN: f64 = 0.02;

/// A view of a take, `from_s < to_s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeView {
    /// Left edge, s.
    pub from_s: f64,
    /// Right edge, s.
    pub to_s: f64,
    duration_s: f64,
}

impl TimeView {
    /// All of a take.
    pub fn fit(duration_s: f64) -> Self {
        let duration_s = if duration_s.is_finite() { duration_s.max(MIN_SPAN_S) } else { MIN_SPAN_S };
        Self { from_s: -MARGIN * duration_s, to_s: (1.0 + MARGIN) * duration_s, duration_s }
    }

    /// Its length, s.
    pub fn span_s(&self) -> f64 {
        self.to_s - self.from_s
    }

    /// Zooms in (`factor` over 1) or out; what is at `anchor_s` stays where it is, unless the edge of the take is near.
    pub fn zoom_at(&mut self, anchor_s: f64, factor: f64) {
        if !(factor.is_finite() && factor > 0.0 && anchor_s.is_finite()) {
            return;
        }
        let whole_s = Self::fit(self.duration_s).span_s();
        let span_s = (self.span_s() / factor).clamp(MIN_SPAN_S, whole_s);
        let share = (anchor_s - self.from_s) / self.span_s();
        self.place(anchor_s - share * span_s, span_s);
    }

    /// Moves by `offset_s`, as far as the take goes.
    pub fn pan(&mut self, offset_s: f64) {
        if offset_s.is_finite() {
            self.place(self.from_s + offset_s, self.span_s());
        }
    }

    /// Moves so that `time_s` is on the screen: not at all if it is, else so that it is a quarter from the left.
    pub fn reveal(&mut self, time_s: f64) {
        if time_s.is_finite() && !(self.from_s..=self.to_s).contains(&time_s) {
            self.place(time_s - self.span_s() / 4.0, self.span_s());
        }
    }

    /// Moves so that `time_s` is in the middle, with at most `around_s` on either side.
    pub fn focus(&mut self, time_s: f64, around_s: f64) {
        if time_s.is_finite() && around_s > 0.0 {
            let span_s = self.span_s().min(2.0 * around_s).max(MIN_SPAN_S);
            self.place(time_s - span_s / 2.0, span_s);
        }
    }

    fn place(&mut self, from_s: f64, span_s: f64) {
        let whole = Self::fit(self.duration_s);
        let last_from_s = (whole.to_s - span_s).max(whole.from_s);
        self.from_s = from_s.clamp(whole.from_s, last_from_s);
        self.to_s = self.from_s + span_s;
    }
}

/// Steps of an axis from a second on, s: those of a clock.
const CLOCK_STEPS_S: [f64; 12] = [1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 3600.0];

/// Times for the marks of an axis: the finest step of a clock, or below a second of 1, 2 or 5 times a power of ten, that
/// leaves at least `min_px` between marks, as (first mark, step), s.
pub fn ticks(view: &TimeView, width_px: f32, min_px: f32) -> (f64, f64) {
    let at_least_s = view.span_s() * f64::from(min_px) / f64::from(width_px.max(1.0));
    let power = 10_f64.powf(at_least_s.log10().floor());
    let decimal = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
    let steps_s = if at_least_s > 0.5 { &CLOCK_STEPS_S[..] } else { &decimal[..] };
    let step_s = steps_s.iter().copied().find(|step_s| *step_s >= at_least_s).unwrap_or(10.0 * power);
    ((view.from_s / step_s).ceil() * step_s, step_s)
}

/// A time on an axis whose marks are `step_s` apart: `12.4 s`, from a minute on `1:02.4`.
pub fn tick_text(time_s: f64, step_s: f64) -> String {
    let decimals = (-step_s.log10().floor()).clamp(0.0, 3.0) as usize;
    // Rounding first: 59.9996 s is a minute.
    let scale = 10_f64.powi(decimals as i32);
    let time_s = (time_s * scale).round() / scale;
    if time_s.abs() < 60.0 {
        return format!("{:.decimals$} s", if time_s == 0.0 { 0.0 } else { time_s });
    }
    let minutes = (time_s.abs() / 60.0).floor();
    let seconds = time_s.abs() - 60.0 * minutes;
    let width = if decimals == 0 { 2 } else { 3 + decimals };
    let sign = if time_s < 0.0 { "-" } else { "" };
    format!("{sign}{minutes:.0}:{seconds:0width$.decimals$}")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn ticks_read_well() {
        let texts = [(0.0, 1.0), (12.4, 0.2), (62.4, 0.2), (120.0, 10.0), (59.9996, 0.5)];
        let texts = texts.map(|(time_s, step_s)| tick_text(time_s, step_s));
        assert_eq!(texts, ["0 s", "12.4 s", "1:02.4", "2:00", "1:00.0"]);
    }

    #[test]
    fn what_is_on_the_screen_stays_there() {
        let mut view = TimeView::fit(100.0);
        view.zoom_at(50.0, 10.0);
        let before = view;
        view.reveal(50.0);
        assert_eq!(view, before);
        view.reveal(90.0);
        assert!(view.from_s < 90.0 && 90.0 < view.to_s);
    }

    #[test]
    fn focus_brings_near_and_never_farther_away() {
        let mut view = TimeView::fit(100.0);
        view.focus(50.0, 1.0);
        assert_eq!((view.from_s, view.to_s), (49.0, 51.0));
        view.zoom_at(50.0, 4.0);
        view.focus(70.0, 1.0);
        assert_eq!((view.from_s, view.to_s), (69.75, 70.25));
        view.focus(0.0, 1.0);
        assert!(view.from_s <= 0.0 && view.to_s > 0.0, "the edge of the take is near");
    }

    proptest! {
        #[test]
        fn any_steps_leave_a_view_within_the_take(
            duration_s in 0.0_f64..2000.0,
            steps in proptest::collection::vec((any::<bool>(), -3000.0_f64..3000.0, 1e-3_f64..1e3), 0..20),
        ) {
            let whole = TimeView::fit(duration_s);
            let mut view = whole;
            for (zoom, amount, factor) in steps {
                if zoom { view.zoom_at(amount, factor) } else { view.pan(amount) }
                prop_assert!(view.from_s < view.to_s);
                prop_assert!(view.from_s >= whole.from_s - 1e-9 && view.to_s <= whole.to_s + 1e-9);
                let (first_s, step_s) = ticks(&view, 900.0, 80.0);
                prop_assert!(first_s >= view.from_s && step_s > 0.0);
                prop_assert!(view.span_s() / step_s <= 900.0 / 80.0 + 1e-6);
            }
        }

        #[test]
        fn zoom_keeps_the_anchor_in_place(anchor in 30.0_f64..70.0, factor in 1.0_f64..50.0) {
            let mut view = TimeView::fit(100.0);
            let share = (anchor - view.from_s) / view.span_s();
            view.zoom_at(anchor, factor);
            prop_assert!(((anchor - view.from_s) / view.span_s() - share).abs() < 1e-9);
        }
    }
}
