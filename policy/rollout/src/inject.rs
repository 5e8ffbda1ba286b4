//! Faults that are put into a policy on purpose, to see that the station ends them as it should.

use std::str::FromStr;
use std::time::Duration;

/// What goes wrong, from a moment of a trial on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Injected {
    /// What.
    pub kind: InjectedKind,
    /// Since the trial began, s.
    pub at_s: f64,
}

/// Kinds of [`Injected`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InjectedKind {
    /// Every target is not a number.
    Nan,
    /// Targets jump to the other end of each joint's range and back, step by step.
    Jumps,
    /// Each step takes three times as long as it may.
    Slow,
    /// The policy does not come back.
    Hang,
}

impl Injected {
    /// Time that a step of `period` is held up.
    pub(crate) fn delay(&self, time_s: f64, period: Duration) -> Duration {
        match self.kind {
            InjectedKind::Slow if time_s >= self.at_s => 3 * period,
            // Longer than anybody waits.
            InjectedKind::Hang if time_s >= self.at_s => Duration::from_secs(3600),
            _ => Duration::ZERO,
        }
    }

    /// Spoils the targets of step `step`.
    pub(crate) fn spoil(&self, time_s: f64, step: u64, limits: &[(f64, f64)], targets: &mut [f64]) {
        if time_s < self.at_s {
            return;
        }
        match self.kind {
            InjectedKind::Nan => targets.fill(f64::NAN),
            InjectedKind::Jumps => {
                for (target, &(lower, upper)) in targets.iter_mut().zip(limits) {
                    *target = if step.is_multiple_of(2) { lower } else { upper };
                }
            }
            InjectedKind::Slow | InjectedKind::Hang => {}
        }
    }
}

impl FromStr for Injected {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!("{text:?} is no fault; expected nan, jumps, slow or hang, as nan=2.5 (s into the trial)")
        };
        let (kind, at_s) = text.split_once('=').ok_or_else(wrong)?;
        let kind = match kind {
            "nan" => InjectedKind::Nan,
            "jumps" => InjectedKind::Jumps,
            "slow" => InjectedKind::Slow,
            "hang" => InjectedKind::Hang,
            _ => return Err(wrong()),
        };
        let at_s =
            at_s.parse().ok().filter(|at_s: &f64| at_s.is_finite() && *at_s >= 0.0).ok_or_else(wrong)?;
        Ok(Self { kind, at_s })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_read_and_others_refused_with_what_there_is() {
        assert_eq!("slow=2.5".parse(), Ok(Injected { kind: InjectedKind::Slow, at_s: 2.5 }));
        for wrong in ["", "nan", "nan=", "nan=-1", "nan=inf", "dance=1"] {
            let problem = wrong.parse::<Injected>().expect_err("it is wrong");
            assert!(problem.contains("expected nan, jumps, slow or hang"), "{problem}");
        }
    }

    #[test]
    fn nothing_is_wrong_before_its_time() {
        let period = Duration::from_millis(50);
        let jumps = Injected { kind: InjectedKind::Jumps, at_s: 1.0 };
        let mut targets = [0.5];
        jumps.spoil(0.9, 3, &[(-1.0, 2.0)], &mut targets);
        assert_eq!(targets, [0.5]);
        jumps.spoil(1.0, 3, &[(-1.0, 2.0)], &mut targets);
        assert_eq!(targets, [2.0]);
        let slow = Injected { kind: InjectedKind::Slow, at_s: 1.0 };
        assert_eq!([slow.delay(0.9, period), slow.delay(1.0, period)], [Duration::ZERO, 3 * period]);
    }
}
