//! The end of a station: motion first, and no claim beyond what readings show.

use crate::{
    audit::Who,
    control_loop::ControlLoop,
    ending::{Ending, ShuttingDown},
};

/// Braking, catching up and the arm's own steps of stopping take half a second; joints that have not let go after this
/// are told to by a stop, ns.
const ORDERLY_NS: u64 = 1_000_000_000;
/// The end is not put off for longer than this, ns.
const AT_MOST_NS: u64 = 1_600_000_000;

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
