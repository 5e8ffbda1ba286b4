//! Counts the interruptions of the way to the start, and keeps time and reason of the newest one until the next press.

use palpate_wire::{api::RecordingPhase, proto::control_state::Phase};

use super::Scene;
use crate::store::Store;

/// The interruptions of one step.
#[derive(Debug, Default)]
pub(super) struct Interruptions {
    /// The step, so that another one begins at none.
    step: Option<usize>,
    count: u32,
    /// The newest one, until the operator presses something.
    newest: Option<Interruption>,
    /// The robot was on its way in the frame before.
    was_going: bool,
    /// Why the station holds or is not armed, as told while it was on its way.
    held: String,
    /// The problem of the checklist that was counted last.
    counted: String,
}

#[derive(Debug)]
struct Interruption {
    at: String,
    reason: String,
}

impl Interruptions {
    /// Takes in what the station says now. `called_off` is whether this page ended the way itself.
    pub(super) fn follow(&mut self, scene: &Scene<'_>, store: &Store, called_off: bool) {
        let problem = scene.session.problem.as_str();
        if self.step != scene.session.current {
            *self = Self { step: scene.session.current, ..Self::default() };
            // What was there when the page came to this step happened before, nobody knows when.
            if scene.phase == RecordingPhase::StartPose && !problem.is_empty() {
                self.count = 1;
                self.newest = Some(Interruption { at: String::new(), reason: problem.to_owned() });
                problem.clone_into(&mut self.counted);
            }
        }
        let reason = store.control_state().map_or("", |state| state.reason.as_str());
        let is_held = store.phase() != Phase::Armed && !reason.is_empty();
        let going = scene.phase == RecordingPhase::GoingToStart;
        if going {
            if is_held {
                reason.clone_into(&mut self.held);
            }
            self.newest = None;
            self.counted.clear();
        } else if scene.phase == RecordingPhase::StartPose {
            let ended = self.was_going && !called_off && (is_held || !self.held.is_empty());
            // A page that draws slowly may have seen nothing of the way but that it ended.
            let untold = !called_off && !problem.is_empty() && problem != self.counted;
            if self.newest.is_none() && (ended || untold) {
                self.count += 1;
                let held = if is_held { reason } else { &self.held };
                let reason = if held.is_empty() { problem } else { held }.to_owned();
                self.newest = Some(Interruption { at: store.live_at().to_owned(), reason });
            }
            // The checklist, which comes later, may know more.
            if let Some(newest) = &mut self.newest
                && !problem.is_empty()
            {
                problem.clone_into(&mut newest.reason);
            }
            problem.clone_into(&mut self.counted);
        }
        self.was_going = going;
        if !going {
            self.held.clear();
        }
    }

    /// The operator pressed something, and so has read the screen.
    pub(super) fn pressed(&mut self) {
        self.newest = None;
    }

    /// Whether the last way to the start was interrupted, and nothing was pressed since.
    pub(super) fn is_fresh(&self) -> bool {
        self.newest.is_some()
    }

    /// The newest interruption in words, and the reason in them.
    pub(super) fn text(&self) -> Option<(String, &str)> {
        let newest = self.newest.as_ref()?;
        let at = match newest.at.as_str() {
            "" => String::new(),
            at => format!(" at {at}"),
        };
        let times = match self.count {
            0 | 1 => String::new(),
            count => format!(", {count} times by now"),
        };
        let text = format!("The way to the start was interrupted{at}{times}: {}", newest.reason);
        Some((text, &newest.reason))
    }
}
