//! A reflex of the digits: it grips tighter where contact is lost or slips, and yields where a digit presses too hard.
//!
//! [`step`] is all that it decides, a function of one digit's state and of what is known of it now. What it gives is an offset on
//! the targets of whoever has control; the safety layer takes the sum as it takes any other targets.

mod config;
mod turn;

pub(crate) use config::{DigitConfig, Gains, ReflexConfig};
pub(crate) use turn::{Now, Reflex};

/// What the reflex of a digit is up to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Phase {
    /// Nothing is held.
    #[default]
    Free,
    /// Contact is firm.
    Holding,
    /// Contact is lost or slips: it closes.
    Tightening,
    /// It presses too hard: it opens.
    Yielding,
}

impl Phase {
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Free => "free",
            Self::Holding => "holding",
            Self::Tightening => "tightening",
            Self::Yielding => "yielding",
        }
    }
}

/// The reflex of one digit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct DigitState {
    pub(crate) phase: Phase,
    /// By how much the digit is more closed than it was told to be, rad.
    pub(crate) offset_rad: f64,
    /// For how long the phase has lasted, s.
    in_phase_s: f64,
    /// For how long there has been reason to leave it, s.
    turning_s: f64,
    /// How strong contact was lately, in thresholds.
    peak_load: f64,
    /// How far the digit was told to close since there is contact, rad.
    most_closed_rad: f64,
}

/// What is known of a digit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DigitSeen {
    /// A channel of it is on.
    pub(crate) in_contact: bool,
    /// Its strongest reading, in thresholds of that channel's stream; 1 where a channel switches on.
    pub(crate) load: f64,
    /// How far a joint that stands still is from where it is commanded to close to, rad; the largest, at least 0.
    pub(crate) error_rad: f64,
    /// How far it is told to be closed, rad, without the reflex.
    pub(crate) closed_rad: f64,
}

/// The state `dt_s` later.
///
/// The offset never leaves `-yield_rad` to `tighten_rad`, changes by no more than its speeds allow, and does not grow while the
/// error is above `tighten_error_rad`. Under firm contact, and with none, it goes back to nothing.
pub(crate) fn step(gains: &Gains, state: &DigitState, seen: &DigitSeen, dt_s: f64) -> DigitState {
    // Relaxation of a skin is slower than a slip: only a fall that is faster than the memory counts.
    let memory = (dt_s / gains.slip_within_s).min(1.0);
    let peak_load = (state.peak_load - memory * (state.peak_load - seen.load)).max(seen.load);
    let is_firm = seen.in_contact && seen.load >= (1.0 - gains.slip_share) * peak_load;
    let lets_go = seen.closed_rad < state.most_closed_rad - gains.let_go_rad;
    let turns = match state.phase {
        Phase::Free => seen.in_contact,
        Phase::Holding => !is_firm,
        Phase::Tightening => is_firm,
        Phase::Yielding => false,
    };
    let turning_s = if turns { state.turning_s + dt_s } else { 0.0 };
    let in_phase_s = state.in_phase_s + dt_s;
    let phase = match state.phase {
        _ if seen.error_rad > gains.yield_error_rad => Phase::Yielding,
        Phase::Yielding if seen.error_rad > gains.calm_error_rad => Phase::Yielding,
        Phase::Yielding => Phase::Free,
        Phase::Holding | Phase::Tightening if lets_go => Phase::Free,
        Phase::Free if turning_s >= gains.confirm_s => Phase::Holding,
        Phase::Holding if turning_s >= gains.lost_s => Phase::Tightening,
        Phase::Tightening if turning_s >= gains.confirm_s => Phase::Holding,
        // There is nothing to hold there.
        Phase::Tightening if in_phase_s >= gains.give_up_s => Phase::Free,
        same => same,
    };
    let (goal_rad, speed) = match phase {
        Phase::Free | Phase::Holding => (0.0, gains.return_rad_per_s),
        Phase::Tightening => (gains.tighten_rad, gains.tighten_rad_per_s),
        Phase::Yielding => (-gains.yield_rad, gains.yield_rad_per_s),
    };
    let moved_rad = state.offset_rad + (goal_rad - state.offset_rad).clamp(-speed * dt_s, speed * dt_s);
    // The sum may round to just beyond a limit.
    let moved_rad = moved_rad.clamp(-gains.yield_rad, gains.tighten_rad);
    let is_pressing = seen.error_rad > gains.tighten_error_rad;
    let offset_rad = if is_pressing { moved_rad.min(state.offset_rad) } else { moved_rad };
    let is_new = phase != state.phase;
    let is_free = phase == Phase::Free;
    DigitState {
        phase,
        offset_rad,
        in_phase_s: if is_new { 0.0 } else { in_phase_s },
        turning_s: if is_new { 0.0 } else { turning_s },
        peak_load: if is_free { seen.load } else { peak_load },
        most_closed_rad: if is_free { seen.closed_rad } else { state.most_closed_rad.max(seen.closed_rad) },
    }
}

#[cfg(test)]
pub(crate) mod tests;
