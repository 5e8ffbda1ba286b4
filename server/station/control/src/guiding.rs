//! Carries out what the guide of a session asks for, and tells it what came of it.

use std::{collections::VecDeque, sync::Arc};

use palpate_motion::TakeMotion;
use palpate_safety::{Lease, Phase, Status};
use palpate_wire::api::{RecordingAction, RecordingDocument, WantedTake};

use crate::{
    audit::Who,
    control_loop::{ControlLoop, TARE_NS},
    error::ControlError,
    follow::{Follow, Progress},
    guide::{Effect, Safety},
    prepare::{AddedStep, Prepared},
    requests::Claim,
};

/// Who asks for what the guide does, in the audit log.
const GUIDE: &str = "guided session";

impl ControlLoop {
    /// Begins a session whose motions are planned.
    pub(crate) fn begin_session(
        &mut self,
        claim: &Claim,
        mut prepared: Prepared,
    ) -> Result<RecordingDocument, ControlError> {
        let now_ns = self.clock.now_ns();
        let what = format!("began session {} by plan {}", prepared.id, prepared.plan.id);
        let who = self.authorise(claim, "begin a session", false)?;
        if prepared.operator.is_empty() {
            prepared.operator.clone_from(&who.name);
        }
        let effects = self.guided.begin(prepared)?;
        self.audit.note_by(now_ns, &who, &what);
        self.carry_out(now_ns, &who, effects);
        Ok(self.guided.document())
    }

    /// What the operator does in the session.
    pub(crate) fn act(
        &mut self,
        claim: &Claim,
        action: &RecordingAction,
    ) -> Result<RecordingDocument, ControlError> {
        let now_ns = self.clock.now_ns();
        let who = self.authorise(claim, describe(action), false)?;
        if let RecordingAction::Run = action
            && let Some((device, problem)) = self.senses.missing().next()
        {
            return Err(ControlError::Refused(format!(
                "{device} is missing, so that the take would be without it: {problem}"
            )));
        }
        let status = self.supervisor.status(now_ns);
        let measured = self.senses.positions();
        let safety = safety(&status, measured.as_deref());
        let Some(guide) = &mut self.guided.guide else {
            return Err(ControlError::Refused("no session is under way; begin one first".to_owned()));
        };
        let effects = guide.act(now_ns, action, &safety).map_err(ControlError::Refused)?;
        self.carry_out(now_ns, &who, effects);
        Ok(self.guided.document())
    }

    /// A take for the next session.
    pub(crate) fn want(
        &mut self,
        claim: &Claim,
        wanted: WantedTake,
    ) -> Result<RecordingDocument, ControlError> {
        let who = self.authorise(claim, "ask for a take", true)?;
        let what = format!("{} on {} is wanted", wanted.primitive, wanted.object);
        self.guided.want(wanted)?;
        self.audit.note_by(self.clock.now_ns(), &who, &what);
        Ok(self.guided.document())
    }

    /// A step for the session under way, whose motion is planned.
    pub(crate) fn add_step(
        &mut self,
        claim: &Claim,
        step: AddedStep,
    ) -> Result<RecordingDocument, ControlError> {
        let who = self.authorise(claim, "add a step", false)?;
        let effects = self.guided.add_step(step)?;
        self.carry_out(self.clock.now_ns(), &who, effects);
        Ok(self.guided.document())
    }

    /// What was wanted is not any more.
    pub(crate) fn unwant(
        &mut self,
        claim: &Claim,
        object: &str,
        primitive: &str,
    ) -> Result<RecordingDocument, ControlError> {
        let who = self.authorise(claim, "take back what was asked for", true)?;
        let effects = self.guided.unwant(object, primitive)?;
        self.carry_out(self.clock.now_ns(), &who, effects);
        Ok(self.guided.document())
    }

    /// One turn of the session: what the recorder says, what time it is, where the motion stands.
    pub(crate) fn guide(&mut self, now_ns: u64) {
        while let Some(event) = self.guided.recorder.poll() {
            if self.guided.free.as_ref().is_some_and(|free| !free.is_over()) {
                self.take_recorded(now_ns, event);
            } else if let Some(guide) = &mut self.guided.guide {
                let effects = guide.recorder(event);
                self.carry_out(now_ns, &Who::part(GUIDE), effects);
            }
        }
        self.guided.forget_finished();
        self.tick_take(now_ns);
        if let Some(problem) = self.guided.misplaced() {
            self.audit.note(now_ns, GUIDE, &problem);
            self.fail_motion(now_ns, &problem);
        }
        if self.guided.guide.is_none() {
            return;
        }
        let missing =
            self.senses.missing().next().map(|(device, problem)| format!("{device} is lost: {problem}"));
        if let Some(problem) = missing {
            self.fail_motion(now_ns, &problem);
        }
        let status = self.supervisor.status(now_ns);
        let measured = self.senses.positions();
        if let Some(guide) = &mut self.guided.guide {
            guide.touched(&self.senses.streams.touch(now_ns).active);
            let effects = guide.tick(now_ns, &safety(&status, measured.as_deref()));
            self.carry_out(now_ns, &Who::part(GUIDE), effects);
        }
        match self.guided.approach() {
            Some((lease, Ok(way))) => self.start_motion(now_ns, lease, way),
            Some((_, Err(problem))) => self.fail_motion(now_ns, &problem),
            None => {}
        }
        self.follow(now_ns, measured.as_deref());
    }

    /// Commands the next moment of the motion that is under way.
    fn follow(&mut self, now_ns: u64, measured: Option<&[f64]>) {
        let Some(motion) = &mut self.guided.motion else { return };
        let lease = motion.lease;
        let targets: Vec<(usize, f64)> = motion.target(now_ns).iter().copied().enumerate().collect();
        self.commands += 1;
        if let Err(refusal) = self.supervisor.targets(now_ns, lease, self.commands, &targets) {
            return self.fail_motion(now_ns, &refusal.to_string());
        }
        let Some(measured) = measured else { return };
        match motion.progress(now_ns, &self.commanded, measured) {
            Progress::Moving => {}
            Progress::Lagging(dof, error) => {
                let name = self.station.robot.dofs().nth(dof).map_or("?", |joint| &joint.name);
                let problem = format!(
                    "joint {name:?} is {error:.2} behind and does not follow; look whether something holds it"
                );
                self.fail_motion(now_ns, &problem);
            }
            Progress::Arrived => {
                let worst = motion.worst_error();
                tracing::info!(worst_error = worst, "a guided motion has come to its end");
                self.guided.motion = None;
                if let Some(guide) = &mut self.guided.guide {
                    let effects = guide.arrived(now_ns);
                    self.carry_out(now_ns, &Who::part(GUIDE), effects);
                }
            }
        }
    }

    /// The zero of the tactile readings was captured, or could not be.
    pub(crate) fn tared(&mut self, now_ns: u64, problems: &[String]) {
        if let Some(guide) = &mut self.guided.guide {
            let effects = guide.tared(now_ns, problems);
            self.carry_out(now_ns, &Who::part(GUIDE), effects);
        }
    }

    /// Ends the motion that is under way, if one is, and says why.
    fn fail_motion(&mut self, now_ns: u64, problem: &str) {
        if let Some(guide) = &mut self.guided.guide {
            let effects = guide.motion_failed(now_ns, problem);
            self.carry_out(now_ns, &Who::part(GUIDE), effects);
        }
    }

    fn carry_out(&mut self, now_ns: u64, who: &Who, effects: Vec<Effect>) {
        let mut effects = VecDeque::from(effects);
        while let Some(effect) = effects.pop_front() {
            let refused = match effect {
                Effect::PlaceObject { object } => {
                    self.guided.place(&object);
                    None
                }
                // The guide's pose is where the take of its step starts, and the way there is planned to that.
                Effect::MoveTo { lease, .. } => {
                    let from = match self.commanded.is_empty() {
                        true => self.senses.positions(),
                        false => Some(self.commanded.clone()),
                    };
                    let unknown = "not every joint has said where it is; check the devices".to_owned();
                    let from = from.ok_or(unknown);
                    from.and_then(|from| self.guided.plan_approach(Lease(lease), from)).err()
                }
                Effect::RunMotion { lease, step } => match self.guided.take_motion(step) {
                    Some(motion) => {
                        self.start_motion(now_ns, Lease(lease), motion);
                        None
                    }
                    None => Some("the step has no motion; leave the session and begin it again".to_owned()),
                },
                Effect::StopMotion => {
                    self.guided.stand_still();
                    None
                }
                Effect::Tare => {
                    self.tare_for = Some(who.clone());
                    self.senses.streams.tare(now_ns, TARE_NS);
                    None
                }
                Effect::Record(command) => {
                    self.guided.recorder.command(command);
                    None
                }
                Effect::Audit(what) => {
                    self.audit.note_by(now_ns, who, &what);
                    None
                }
            };
            if let Some(problem) = refused
                && let Some(guide) = &mut self.guided.guide
            {
                effects.extend(guide.motion_failed(now_ns, &problem));
            }
        }
    }

    fn start_motion(&mut self, now_ns: u64, lease: Lease, motion: Arc<TakeMotion>) {
        let tolerances = self.tolerances.clone();
        self.guided.motion = Some(Follow::new(Box::new(motion), now_ns, lease, tolerances));
    }
}

/// What `action` does, in words for the audit log.
fn describe(action: &RecordingAction) -> &'static str {
    match action {
        RecordingAction::ConfirmObject { .. } => "confirm an object",
        RecordingAction::GoToStart => "go to the start pose",
        RecordingAction::Run => "run a motion",
        RecordingAction::Cancel => "cancel a motion",
        RecordingAction::Accept => "accept a take",
        RecordingAction::Again => "record a take again",
        RecordingAction::Discard => "discard a take",
        RecordingAction::Undo => "take a discarded take back",
        RecordingAction::Select { .. } => "select a step",
        RecordingAction::Note { .. } => "make a note",
        RecordingAction::Leave => "leave the session",
    }
}

/// What the guide has to know of the safety layer.
fn safety<'a>(status: &'a Status, measured: Option<&'a [f64]>) -> Safety<'a> {
    Safety {
        armed: status.phase == Phase::Armed,
        lease: status.lease.map_or(0, |lease| lease.0),
        reason: &status.reason,
        measured,
    }
}
