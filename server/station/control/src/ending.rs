//! How the motion of a station ends, and what is known of it.

use palpate_reports::wording::counted;

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
    pub(crate) since_ns: u64,
    pub(crate) is_stopped: bool,
}
