//! Why a request was refused, in words for an operator, with what to do.

/// Why a request was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Someone else has the lease.
    #[error("{holder:?} has control for another {left_s:.1} s; ask them to give it back, or take over")]
    Held {
        /// Who has it.
        holder: String,
        /// Until it ends if they are gone, s.
        left_s: f64,
    },
    /// The lease that came with the request is not the one in force.
    #[error("lease {lease} has ended{now_with}; take control again")]
    LeaseEnded {
        /// The lease of the request.
        lease: u64,
        /// Who has control now, as the end of a clause; empty for nobody.
        now_with: String,
    },
    /// An operator needs a name.
    #[error("the operator has no name; give one, so that others know who has control")]
    NoName,
    /// A stop is latched.
    #[error("stopped by {who:?}; make sure that all is well, then reset the stop")]
    Stopped {
        /// Who stopped it.
        who: String,
    },
    /// There is nothing to reset.
    #[error("there is no stop to reset")]
    NotStopped,
    /// Joints are not armed.
    #[error("the station is {phase}; {todo}")]
    NotArmed {
        /// What it is.
        phase: &'static str,
        /// What to do.
        todo: &'static str,
    },
    /// It holds.
    #[error("the station holds: {reason}")]
    Holding {
        /// Why.
        reason: String,
    },
    /// It cannot be armed.
    #[error("cannot be armed: {problem}")]
    NotReady {
        /// What is in the way, and what to do.
        problem: String,
    },
    /// Requests came out of order.
    #[error("target {sequence} comes after target {newest}, which is newer; number targets upwards")]
    StaleSequence {
        /// Number of the request.
        sequence: u64,
        /// The newest number that came before.
        newest: u64,
    },
    /// There is no such degree of freedom.
    #[error("there is no joint {dof}, expected 0 to {last}")]
    UnknownJoint {
        /// As asked for.
        dof: usize,
        /// The last there is.
        last: usize,
    },
    /// A target is no number.
    #[error("joint {joint:?}: the target is {value}, expected a finite number of {unit}")]
    NotFinite {
        /// Which joint.
        joint: String,
        /// As asked for.
        value: f64,
        /// rad or m.
        unit: &'static str,
    },
    /// A target lies beyond a limit.
    #[error(
        "joint {joint:?}: the target {value:.4} {unit} is {side} its limit of {limit:.4} {unit}; nothing was moved"
    )]
    BeyondLimit {
        /// Which joint.
        joint: String,
        /// As asked for.
        value: f64,
        /// `above` or `below`.
        side: &'static str,
        /// The limit.
        limit: f64,
        /// rad or m.
        unit: &'static str,
    },
    /// The joint yields to the operator's hands.
    #[error("joint {joint:?} yields to your hands; let the arm hold first")]
    LedByHand {
        /// Which joint.
        joint: String,
    },
    /// Lead-through is not possible.
    #[error("{problem}")]
    NoLeadThrough {
        /// Why, and what to do.
        problem: &'static str,
    },
}
