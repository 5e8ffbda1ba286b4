//! Goals over time.

/// A motion that a servo is asked to follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Two sines at once.
    SinSin,
    /// Up in two seconds, then the torque is switched off.
    LiftAndDrop,
    /// Up in three seconds and slowly down a little.
    UpAndDown,
    /// A sine that gets faster.
    SinTimeSquare,
    /// Steps to both sides.
    Square,
}

impl Motion {
    /// Every motion.
    pub const ALL: [Self; 5] =
        [Self::SinSin, Self::LiftAndDrop, Self::UpAndDown, Self::SinTimeSquare, Self::Square];

    /// Its name in logs.
    pub fn name(self) -> &'static str {
        match self {
            Self::SinSin => "sin_sin",
            Self::LiftAndDrop => "lift_and_drop",
            Self::UpAndDown => "up_and_down",
            Self::SinTimeSquare => "sin_time_square",
            Self::Square => "square",
        }
    }

    /// Goal at `time_s`, rad, and whether the torque is on.
    pub fn goal(self, time_s: f64) -> (f64, bool) {
        use std::f64::consts::{FRAC_PI_2, PI};
        // From 0 to 1 over `span_s`, starting and ending at rest.
        let ease = |span_s: f64| 0.5 - 0.5 * (PI * (time_s / span_s).clamp(0.0, 1.0)).cos();
        match self {
            Self::SinSin => {
                ((time_s * 1.05).sin() * FRAC_PI_2 + 0.5 * (time_s * 5.0).sin() * time_s.sin(), true)
            }
            Self::LiftAndDrop => (-FRAC_PI_2 * ease(2.0), time_s < 2.0),
            Self::UpAndDown => {
                let down = 0.5 - 0.5 * (PI * ((time_s - 3.0) / 3.0).clamp(0.0, 1.0)).cos();
                (FRAC_PI_2 * ease(3.0) - 0.3 * down, true)
            }
            Self::SinTimeSquare => ((time_s * time_s).sin(), true),
            Self::Square => (0.7 * if ((time_s / 1.5) as u32).is_multiple_of(2) { 1.0 } else { -1.0 }, true),
        }
    }
}
