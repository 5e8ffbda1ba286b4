//! The end of a station: motion first, and no claim beyond what readings show.

use palpate_reports::wording::counted;

use crate::{audit::Who, control_loop::ControlLoop};

/// Braking, catching up and the arm's own steps of stopping take half a second; joints that have not let go after this
/// are told to by a stop, ns.
const ORDERLY_NS: u64 = 1_000_000_000;
/// The end is not put off for longer than this, ns.
const AT_MOST_NS: u64 = 1_600_000_000;

/// How the motion of a station ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ending {
    /// Torque was on at some time since the station was opened.
    pub was_armed: bool,
    /// Joints that are not known to be without torque, by name.
    pub not_let_go: Vec<String>,
    /// Why nothing is known of the end, if so: the control loop failed or did not answer.
    pub problem: Option<String>,
}

impl Ending {
    /// Whether readings show every joint without torque, or no motor was switched on in the first place.
    pub fn is_safe(&self) -> bool {
        self.problem.is_none() && (self.not_let_go.is_empty() || !self.was_armed)
    }
}

impl std::fmt::Display for Ending {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if let Some(problem) = &self.problem {
            return write!(f, "it is not known whether torque is off: {problem}; check the robot");
        }
        match (self.not_let_go.as_slice(), self.was_armed) {
            ([], _) => f.write_str("readings show every joint without torque"),
            (joints, false) => write!(
                f,
                "no motor was switched on; the torque of {} was not confirmed by readings",
                counted(joints.len() as u64, "joint")
            ),
            (joints, true) => write!(
                f,
                "torque was switched off, but readings do not confirm it for {}; check the robot",
                joints.join(", ")
            ),
        }
    }
}

/// What an ending loop still has to do.
#[derive(Debug)]
pub(crate) struct ShuttingDown {
    since_ns: u64,
    is_stopped: bool,
}

impl ControlLoop {
    /// Begins the end: nobody has control any more, joints brake.
    pub(crate) fn begin_shutdown(&mut self, now_ns: u64) -> ShuttingDown {
        self.supervisor.shut_down(now_ns);
        self.drive(now_ns);
        ShuttingDown { since_ns: now_ns, is_stopped: false }
    }

    /// Goes on with the end; gives how it ended once it has.
    pub(crate) fn shut_down(&mut self, now_ns: u64, ending: &mut ShuttingDown) -> Option<Ending> {
        let not_let_go = self.supervisor.not_let_go(now_ns);
        let elapsed_ns = now_ns.saturating_sub(ending.since_ns);
        // Where nothing was switched on, nothing is waited for.
        let is_over = not_let_go.is_empty() || !self.was_armed || elapsed_ns >= AT_MOST_NS;
        if is_over {
            let ended = Ending { was_armed: self.was_armed, not_let_go, problem: None };
            self.audit.note_by(
                now_ns,
                &Who::part("station"),
                &format!("the control loop has ended: {ended}"),
            );
            return Some(ended);
        }
        if elapsed_ns >= ORDERLY_NS && !ending.is_stopped {
            ending.is_stopped = true;
            self.supervisor.stop(now_ns, "the studio, which shuts down");
            self.drive(now_ns);
        }
        None
    }
}
