//! Keeps the station's reason to hold, stop or disarm, with the time and the name of who had control, until somebody has
//! read it.

use std::collections::BTreeSet;

use palpate_wire::proto::{ControlState, control_state::Phase};

/// The safety layer says this, with a verb before it, where heartbeats of the operator's page stayed away.
const SILENCE: &str = "heard of the operator";

/// See the module.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Notice {
    /// Why, in the station's words; empty when all is well.
    reason: String,
    /// The operator's time of day when the reason was first told.
    at: String,
    /// Who had control when it was first told, or last before; empty for nobody.
    holder: String,
    /// What has been told since all was well last, part by part: one of several may come and go.
    told: BTreeSet<String>,
    /// What of it somebody has read.
    read: BTreeSet<String>,
    last_holder: String,
}

impl Notice {
    /// Takes in what the station says now.
    pub(super) fn follow(&mut self, state: &ControlState, time_of_day: &str) {
        let parts = parts(&state.reason);
        if !parts.is_subset(&self.told) {
            time_of_day.clone_into(&mut self.at);
            let holder = if state.holder.is_empty() { &self.last_holder } else { &state.holder };
            self.holder = holder.clone();
        }
        if parts.is_empty() {
            self.told.clear();
            self.read.clear();
        }
        self.told.extend(parts);
        state.reason.clone_into(&mut self.reason);
        if !state.holder.is_empty() {
            state.holder.clone_into(&mut self.last_holder);
        }
        // What keeps a robot from moving, or moved it last, is read again when it comes again.
        if may_move(state.phase()) {
            self.read.clear();
        }
    }

    /// What must be read: the words before the reason (when, and whose page went silent), and the reason. `None` when all
    /// is well, or once it was dismissed.
    pub fn text(&self) -> Option<(String, &str)> {
        if parts(&self.reason).is_subset(&self.read) {
            return None;
        }
        let when = match (self.holder.as_str(), self.reason.contains(SILENCE)) {
            ("", _) => format!("{}:", self.at),
            (holder, true) => format!("{}: {holder}'s page went silent.", self.at),
            (holder, false) => format!("{}, while {holder} had control:", self.at),
        };
        Some((when, &self.reason))
    }

    /// Whether it may be dismissed in `phase`: never while motors may have torque or the station is stopped.
    pub fn is_dismissable(phase: Phase) -> bool {
        !may_move(phase) && phase != Phase::Stopped
    }

    /// Somebody has read it. It comes back when the station tells another reason.
    pub fn dismiss(&mut self) {
        self.read.extend(parts(&self.reason));
    }
}

fn may_move(phase: Phase) -> bool {
    matches!(phase, Phase::Arming | Phase::Armed | Phase::Holding | Phase::Disarming)
}

/// The parts of a reason. Digits do not count: seconds in a reason may count on, and it is the same reason all the same.
fn parts(reason: &str) -> BTreeSet<String> {
    let parts = reason.split("; ").filter(|part| !part.is_empty());
    parts.map(|part| part.chars().filter(|c| !c.is_ascii_digit()).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(phase: Phase, holder: &str, reason: &str) -> ControlState {
        let mut state = ControlState { holder: holder.into(), reason: reason.into(), ..Default::default() };
        state.set_phase(phase);
        state
    }

    #[test]
    fn silence_names_the_page_and_keeps_the_first_time() {
        let mut notice = Notice::default();
        notice.follow(&state(Phase::Armed, "Ada", ""), "10:00:00");
        assert_eq!(notice.text(), None);
        // The lease may be gone by the time the reason comes.
        notice
            .follow(&state(Phase::Disarmed, "", "nothing was heard of the operator for 0.40 s"), "10:00:01");
        notice
            .follow(&state(Phase::Disarmed, "", "nothing was heard of the operator for 0.45 s"), "10:00:02");
        let (when, why) = notice.text().expect("it must be read");
        assert_eq!(when, "10:00:01: Ada's page went silent.");
        assert_eq!(why, "nothing was heard of the operator for 0.45 s");
        notice.dismiss();
        notice
            .follow(&state(Phase::Disarmed, "", "nothing was heard of the operator for 0.50 s"), "10:00:03");
        assert_eq!(notice.text(), None, "it was read");
        notice.follow(&state(Phase::Disarmed, "Bo", "device \"xarm\" is lost"), "10:00:04");
        assert_eq!(notice.text().map(|(when, _)| when).as_deref(), Some("10:00:04, while Bo had control:"));
    }

    #[test]
    fn what_was_read_stays_read_while_something_beside_it_comes_and_goes() {
        let mut notice = Notice::default();
        let follow = |notice: &mut Notice, reason, at| notice.follow(&state(Phase::Disarmed, "", reason), at);
        follow(&mut notice, "servo 6 stopped itself", "10:00:00");
        follow(&mut notice, "servo 6 stopped itself; the audit log is full", "10:00:01");
        assert_eq!(notice.text().map(|(when, _)| when).as_deref(), Some("10:00:01:"), "something was added");
        notice.dismiss();
        for (reason, at) in [
            ("servo 6 stopped itself", "10:00:02"),
            ("servo 6 stopped itself; the audit log is full", "10:00:03"),
        ] {
            follow(&mut notice, reason, at);
            assert_eq!(notice.text(), None, "{reason}");
        }
        follow(&mut notice, "servo 6 stopped itself; the disk is full", "10:00:04");
        assert!(notice.text().is_some(), "nobody has read of the disk");
    }

    #[test]
    fn same_reason_comes_back_after_the_station_was_armed_again() {
        let mut notice = Notice::default();
        notice.follow(&state(Phase::Disarmed, "Ada", "too hot"), "10:00:00");
        notice.dismiss();
        notice.follow(&state(Phase::Armed, "Ada", ""), "10:01:00");
        notice.follow(&state(Phase::Disarmed, "Ada", "too hot"), "10:02:00");
        assert_eq!(notice.text().map(|(when, _)| when).as_deref(), Some("10:02:00, while Ada had control:"));
        for phase in [Phase::Arming, Phase::Armed, Phase::Holding, Phase::Disarming, Phase::Stopped] {
            assert!(!Notice::is_dismissable(phase), "{phase:?}");
        }
        assert!(Notice::is_dismissable(Phase::Disarmed));
    }
}
