//! The pace of whoever moves the hand.

use palpate_recording::{Span, SpanKind};
use rand_chacha::ChaCha8Rng;

use super::imperfections::OperatorConfig;
use super::{normal, within};

/// When a planned motion is where: it waits before each repetition, and each has a pace of its own.
pub(super) struct Pacing {
    /// Real and planned times, s, ascending; between them the pace is even.
    knots: Vec<[f64; 2]>,
}

impl Pacing {
    pub(super) fn new(
        spans: &[Span],
        duration_s: f64,
        operator: &OperatorConfig,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let mut pacing = Self { knots: vec![[0.0, 0.0]] };
        for span in spans.iter().filter(|span| span.kind == SpanKind::Repetition) {
            pacing.go_on(span.start_s, 1.0);
            pacing.wait(within(rng, [0.0, operator.longest_pause_s]));
            pacing.go_on(span.end_s, (operator.pace * normal(rng)).exp());
        }
        pacing.go_on(duration_s, 1.0);
        pacing
    }

    fn last(&self) -> [f64; 2] {
        self.knots.last().copied().unwrap_or_default()
    }

    /// Moves on to the planned time `motion_s`, at `pace` times the planned one.
    fn go_on(&mut self, motion_s: f64, pace: f64) {
        let [real_s, from_s] = self.last();
        if motion_s > from_s {
            self.knots.push([real_s + (motion_s - from_s) / pace, motion_s]);
        }
    }

    fn wait(&mut self, pause_s: f64) {
        let [real_s, motion_s] = self.last();
        self.knots.push([real_s + pause_s, motion_s]);
    }

    pub(super) fn duration_s(&self) -> f64 {
        self.last()[0]
    }

    /// The planned time of the real one.
    pub(super) fn motion_s(&self, real_s: f64) -> f64 {
        self.along(0, real_s)
    }

    /// The real time of the planned one; of a pause, its beginning.
    pub(super) fn real_s(&self, motion_s: f64) -> f64 {
        self.along(1, motion_s)
    }

    /// What belongs to `time_s` on the clock with the index `from`, on the other one.
    fn along(&self, from: usize, time_s: f64) -> f64 {
        let after = self.knots.partition_point(|knot| knot[from] < time_s);
        let (Some(before), Some(next)) = (after.checked_sub(1), self.knots.get(after)) else {
            return if after == 0 { 0.0 } else { self.last()[1 - from] };
        };
        let before = self.knots[before];
        let share = (time_s - before[from]) / (next[from] - before[from]);
        before[1 - from] + share * (next[1 - from] - before[1 - from])
    }
}
