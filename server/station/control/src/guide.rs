//! The checklist of a guided session: what the operator may do next, and what has to happen for it.
//!
//! Pure: it is told what happens and what time it is, and answers with [`Effect`]s for the control loop to carry out. It
//! starts no motion unless the station is armed under the operator's lease, and a take that is accepted is only
//! ever set aside, by an action of its own, never replaced.
//!
//! ```text
//! PlaceObject -> StartPose <-> GoingToStart
//!                StartPose -> Baseline -> Countdown -> Running -> Checking -> Review -> next step, or Done
//! ```
//!
//! Whatever stops a motion once a take has begun leads to Checking: what was recorded is kept, with the reason.

use nalgebra::Isometry3;
use palpate_recording::{PlannedStep, RecordedTake, RecordingFile, Span, TakeMeta, TakeState};
use palpate_reports::TakeVerdict;
use palpate_wire::api::{RecordingAction, RecordingPhase};

use crate::recorder::RecorderCommand;

mod run;
mod view;

/// A degree of freedom of a plan.
#[derive(Clone, Debug)]
pub(crate) struct GuideJoint {
    pub(crate) name: String,
    /// How near to the start pose it has to be, rad or m.
    pub(crate) near: f64,
    /// `rad` or `m`.
    pub(crate) unit: &'static str,
}

/// A plan, ready to be followed: its motions are planned.
#[derive(Clone, Debug)]
pub(crate) struct GuidePlan {
    /// Id of the plan.
    pub(crate) id: String,
    /// Its steps, in order; at least one.
    pub(crate) steps: Vec<GuideStep>,
    /// The degrees of freedom.
    pub(crate) joints: Vec<GuideJoint>,
    /// Ids of the channels, in the layout's order.
    pub(crate) channels: Vec<String>,
    /// How long the baseline is captured, s.
    pub(crate) baseline_s: f64,
    /// From the baseline to the motion, s.
    pub(crate) countdown_s: f64,
    /// What is said to have written the takes.
    pub(crate) software: String,
}

/// One take of the plan.
#[derive(Clone, Debug)]
pub(crate) struct GuideStep {
    /// Object id, its name for people, and where it stands.
    pub(crate) object: String,
    pub(crate) object_label: String,
    pub(crate) base_from_object: Isometry3<f64>,
    /// Primitive id, and its name for people.
    pub(crate) primitive: String,
    pub(crate) primitive_label: String,
    /// What to do before the motion runs.
    pub(crate) instruction: String,
    /// Where the motion starts, one position for each degree of freedom.
    pub(crate) start: Vec<f64>,
    /// How long it takes, s.
    pub(crate) duration_s: f64,
    /// What it marks, in its own time.
    pub(crate) spans: Vec<Span>,
    /// What it does from which time on, s.
    pub(crate) activities: Vec<(f64, String)>,
    /// Channels that it means to touch.
    pub(crate) touches: Vec<usize>,
    /// Why it was added to the plan's own takes; `None` for those of the plan.
    pub(crate) added_because: Option<String>,
}

impl GuideStep {
    /// As they are marked one after the other.
    fn sort_spans(&mut self) {
        self.spans.sort_by(|a, b| a.end_s.total_cmp(&b.end_s));
    }
}

/// What the safety layer and the joints are up to.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Safety<'a> {
    /// Whether the station follows commands now.
    pub(crate) armed: bool,
    /// The lease that is held; 0 for none.
    pub(crate) lease: u64,
    /// Why it does not follow commands, in words; may be empty.
    pub(crate) reason: &'a str,
    /// Where every joint is; `None` while a device has not said yet.
    pub(crate) measured: Option<&'a [f64]>,
}

/// What the control loop has to do.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Effect {
    /// On an emulated station: puts the object in place.
    PlaceObject { object: String },
    /// Moves to a pose; [`Guide::arrived`] or [`Guide::motion_failed`] says how it went.
    MoveTo { lease: u64, positions: Vec<f64> },
    /// Runs the motion of a step; answered as [`Effect::MoveTo`].
    RunMotion { lease: u64, step: usize },
    /// Stands still where the robot is.
    StopMotion,
    /// Captures the zero of the tactile readings; [`Guide::tared`] says how it went.
    Tare,
    /// For the recorder.
    Record(RecorderCommand),
    /// A line for the audit log.
    Audit(String),
}

/// The state of the checklist.
#[derive(Debug)]
pub(crate) struct Guide {
    plan: GuidePlan,
    session: String,
    operator: String,
    steps: Vec<Option<Recorded>>,
    current: Option<usize>,
    phase: Phase,
    problem: String,
    /// What the recorder has been asked and has not answered.
    pending: Option<Pending>,
    /// The session is left once what is still being written or checked is done.
    leaving: bool,
    /// The take that was set aside last, and its step.
    undo: Option<(usize, Recorded)>,
    /// Whether the fixture of the step under way is trusted.
    fixture_trusted: bool,
    /// Channels touched in the take under way.
    covered: Vec<bool>,
    revision: u64,
    finished: bool,
}

/// A take of a step.
#[derive(Clone, Debug)]
struct Recorded {
    take: String,
    accepted: bool,
    readable: Option<bool>,
    verdict: Option<TakeVerdict>,
}

#[derive(Clone, Debug, PartialEq)]
enum Phase {
    PlaceObject,
    StartPose,
    GoingToStart { lease: u64 },
    Run(Run),
    Checking,
    Review,
    Done,
}

/// A take under way.
#[derive(Clone, Debug, PartialEq)]
struct Run {
    lease: u64,
    /// When what is under way began, ns.
    since_ns: u64,
    stage: Stage,
}

#[derive(Clone, Debug, PartialEq)]
enum Stage {
    /// The zero is being captured.
    Taring,
    Baseline,
    Countdown,
    Running {
        /// Spans of the motion that are over and marked, by end.
        marked: usize,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pending {
    Accept,
    Again,
    Discard,
    Undo,
    Leave,
}

impl Guide {
    /// Goes on where `recording` stands. `report` is what was found when the session was opened.
    ///
    /// The effects have the takes checked that never were.
    pub(crate) fn new(
        mut plan: GuidePlan,
        session: &str,
        recording: &RecordingFile,
        report: &[String],
    ) -> (Self, Vec<Effect>) {
        plan.steps.iter_mut().for_each(GuideStep::sort_spans);
        let mut steps = vec![None; plan.steps.len()];
        let mut effects = Vec::new();
        let of = |take: &RecordedTake| Recorded {
            take: take.id().to_owned(),
            accepted: take.state == TakeState::Accepted,
            readable: take.readable,
            verdict: take.verdict.clone(),
        };
        for take in &recording.takes {
            let kept = matches!(take.state, TakeState::Review | TakeState::Accepted);
            let Some(step) = steps.get_mut(take.step).filter(|_| kept) else { continue };
            // Of several, the accepted one; the others stay in the folder.
            if step.as_ref().is_none_or(|other: &Recorded| !other.accepted) {
                *step = Some(of(take));
            }
            if take.verdict.is_none() {
                let planned = plan.steps[take.step].touches.clone();
                effects.push(Effect::Record(RecorderCommand::Check { take: take.id().to_owned(), planned }));
            }
        }
        let undo = recording
            .takes
            .iter()
            .filter(|take| take.state == TakeState::Discarded && take.readable != Some(false))
            .max_by_key(|take| take.set_aside)
            .filter(|take| take.step < steps.len())
            .map(|take| (take.step, of(take)));
        let covered = vec![false; plan.channels.len()];
        let mut guide = Self {
            plan,
            session: session.to_owned(),
            operator: recording.operator.clone(),
            steps,
            current: None,
            phase: Phase::Done,
            problem: report.join("; "),
            pending: None,
            leaving: false,
            undo,
            fixture_trusted: false,
            covered,
            revision: 1,
            finished: false,
        };
        guide.go_on(0);
        (guide, effects)
    }

    /// Does what the operator asks, or says why not and what to do instead.
    pub(crate) fn act(
        &mut self,
        now_ns: u64,
        action: &RecordingAction,
        safety: &Safety<'_>,
    ) -> Result<Vec<Effect>, String> {
        if self.finished {
            return Err("the session was left; begin one, or go on with this one".to_owned());
        }
        let during_take = matches!(action, RecordingAction::Note { .. } | RecordingAction::Cancel);
        let leave = matches!(action, RecordingAction::Leave);
        if (self.pending == Some(Pending::Leave) || self.leaving) && !leave {
            return Err("the session is being left".to_owned());
        }
        if self.pending.is_some() && !during_take && !leave {
            return Err("the last decision is still being written; try again in a moment".to_owned());
        }
        let effects = match action {
            RecordingAction::ConfirmObject { fixture_trusted } => self.confirm_object(*fixture_trusted),
            RecordingAction::GoToStart => self.go_to_start(safety),
            RecordingAction::Run => self.begin_run(now_ns, safety),
            RecordingAction::Cancel => self.cancel(now_ns),
            RecordingAction::Accept => self.accept(),
            RecordingAction::Again => self.put_aside(Pending::Again),
            RecordingAction::Discard => self.put_aside(Pending::Discard),
            RecordingAction::Undo => self.take_back(),
            RecordingAction::Select { step } => self.select(*step),
            RecordingAction::Note { text } => self.note(now_ns, text),
            RecordingAction::Leave => self.leave(),
        }?;
        if !matches!(action, RecordingAction::Note { .. } | RecordingAction::Cancel) {
            self.problem.clear();
        }
        self.revision += 1;
        Ok(effects)
    }

    /// Puts a step at the end of the list.
    pub(crate) fn add_step(&mut self, mut step: GuideStep) -> Result<Vec<Effect>, String> {
        if self.finished || self.leaving || self.pending == Some(Pending::Leave) {
            return Err("the session was left; try again".to_owned());
        }
        step.sort_spans();
        let planned = PlannedStep {
            object: step.object.clone(),
            primitive: step.primitive.clone(),
            added_because: step.added_because.clone(),
        };
        let audit = format!("step {}: {} on {} is added", self.steps.len() + 1, step.primitive, step.object);
        self.plan.steps.push(step);
        self.steps.push(None);
        if self.current.is_none() {
            self.go_on(0);
        }
        self.revision += 1;
        Ok(vec![Effect::Audit(audit), Effect::Record(RecorderCommand::AddStep { step: planned })])
    }

    /// Takes a step off the list that was added and has no take; gives its index.
    pub(crate) fn remove_step(
        &mut self,
        object: &str,
        primitive: &str,
    ) -> Result<(usize, Vec<Effect>), String> {
        self.refuse_while_busy()?;
        if self.finished || self.leaving || self.pending.is_some() {
            return Err("the last decision is still being written; try again in a moment".to_owned());
        }
        let added = |step: &GuideStep| {
            step.added_because.is_some() && step.object == object && step.primitive == primitive
        };
        let mut found = (0..self.steps.len()).filter(|&step| added(&self.plan.steps[step])).peekable();
        if found.peek().is_none() {
            return Err(format!("{primitive} on {object} was not added to this session"));
        }
        let Some(removed) = found.find(|&step| self.steps[step].is_none()) else {
            return Err(format!("{primitive} on {object} is recorded; discard its take first"));
        };
        let audit = format!("step {}: {primitive} on {object} is taken off the list", removed + 1);
        self.plan.steps.remove(removed);
        self.steps.remove(removed);
        self.undo = self.undo.take().filter(|(step, _)| *step != removed);
        let moved_up = |step: &mut usize| *step -= usize::from(*step > removed);
        self.undo.iter_mut().for_each(|(step, _)| moved_up(step));
        if self.current == Some(removed) {
            self.go_on(0);
        } else {
            self.current.iter_mut().for_each(moved_up);
        }
        self.revision += 1;
        let remove = Effect::Record(RecorderCommand::RemoveStep { step: removed });
        Ok((removed, vec![Effect::Audit(audit), remove]))
    }

    /// Whether the session was left; the guide has nothing to do any more.
    pub(crate) fn finished(&self) -> bool {
        self.finished
    }

    /// Whether the guide moves the robot, or is about to: nobody else may then.
    pub(crate) fn moves(&self) -> bool {
        matches!(self.phase, Phase::GoingToStart { .. } | Phase::Run(_))
    }

    /// Channels that are active now; counted while the motion runs.
    pub(crate) fn touched(&mut self, active: &[bool]) {
        if let Phase::Run(Run { stage: Stage::Running { .. }, .. }) = self.phase {
            for (covered, active) in self.covered.iter_mut().zip(active) {
                *covered |= active;
            }
        }
    }

    fn confirm_object(&mut self, fixture_trusted: bool) -> Result<Vec<Effect>, String> {
        let step = self.step_in(&Phase::PlaceObject)?;
        let object = self.plan.steps[step].object.clone();
        let trusted = if fixture_trusted { "fixture trusted" } else { "fixture not trusted" };
        let audit = format!("step {}: {object} is in place, {trusted}", step + 1);
        self.fixture_trusted = fixture_trusted;
        self.phase = Phase::StartPose;
        Ok(vec![Effect::Audit(audit), Effect::PlaceObject { object }])
    }

    fn go_to_start(&mut self, safety: &Safety<'_>) -> Result<Vec<Effect>, String> {
        let step = self.step_in(&Phase::StartPose)?;
        let lease = may_move(safety)?;
        self.phase = Phase::GoingToStart { lease };
        let positions = self.plan.steps[step].start.clone();
        Ok(vec![
            Effect::Audit(format!("step {}: going to the start pose", step + 1)),
            Effect::MoveTo { lease, positions },
        ])
    }

    fn begin_run(&mut self, now_ns: u64, safety: &Safety<'_>) -> Result<Vec<Effect>, String> {
        let step = self.step_in(&Phase::StartPose)?;
        let lease = may_move(safety)?;
        if let Some(problem) = self.not_at_start(step, safety) {
            return Err(format!("{problem}; go to the start pose first"));
        }
        let planned = &self.plan.steps[step];
        let meta = TakeMeta {
            object: planned.object.clone(),
            base_from_object: planned.base_from_object,
            primitive: planned.primitive.clone(),
            fixture_trusted: self.fixture_trusted,
            operator: self.operator.clone(),
            software: self.plan.software.clone(),
            surroundings: Vec::new(),
        };
        let start =
            RecorderCommand::StartTake { step, meta, at_ns: now_ns, planned: planned.touches.clone() };
        self.covered.fill(false);
        self.phase = Phase::Run(Run { lease, since_ns: now_ns, stage: Stage::Taring });
        Ok(vec![
            Effect::Audit(format!("step {}: recording {}", step + 1, planned.primitive)),
            Effect::Record(start),
            Effect::Tare,
        ])
    }

    fn cancel(&mut self, now_ns: u64) -> Result<Vec<Effect>, String> {
        if !self.moves() {
            return Err("nothing is under way that could be stopped".to_owned());
        }
        Ok(self.stop(now_ns, "the operator stopped it"))
    }

    fn accept(&mut self) -> Result<Vec<Effect>, String> {
        let recorded = self.reviewed()?;
        if recorded.accepted {
            return Err("this take is accepted already; select another step".to_owned());
        }
        if recorded.readable == Some(false) {
            return Err(
                "this take cannot be read back, so no calibration could use it; record it again".to_owned()
            );
        }
        if recorded.verdict.is_none() {
            return Err("this take is still being checked; wait for the verdict".to_owned());
        }
        let take = recorded.take.clone();
        self.pending = Some(Pending::Accept);
        Ok(vec![
            Effect::Audit(format!("{take} is accepted")),
            Effect::Record(RecorderCommand::Accept { take }),
        ])
    }

    fn put_aside(&mut self, pending: Pending) -> Result<Vec<Effect>, String> {
        let take = self.reviewed()?.take.clone();
        self.pending = Some(pending);
        Ok(vec![
            Effect::Audit(format!("{take} is set aside")),
            Effect::Record(RecorderCommand::SetAside { take }),
        ])
    }

    fn take_back(&mut self) -> Result<Vec<Effect>, String> {
        self.refuse_while_busy()?;
        let Some((step, recorded)) = &self.undo else {
            return Err("nothing was discarded that could be taken back".to_owned());
        };
        if let Some(newer) = &self.steps[*step] {
            return Err(format!(
                "step {} has a newer take, {}; discard that one first, then take {} back from the folder discarded",
                step + 1,
                newer.take,
                recorded.take
            ));
        }
        let take = recorded.take.clone();
        self.pending = Some(Pending::Undo);
        Ok(vec![
            Effect::Audit(format!("{take} is taken back")),
            Effect::Record(RecorderCommand::Restore { take }),
        ])
    }

    fn select(&mut self, step: usize) -> Result<Vec<Effect>, String> {
        self.refuse_while_busy()?;
        if step >= self.steps.len() {
            return Err(format!("there is no step {}, the plan has {}", step + 1, self.steps.len()));
        }
        self.enter(step);
        Ok(Vec::new())
    }

    fn note(&mut self, now_ns: u64, text: &str) -> Result<Vec<Effect>, String> {
        let text = text.trim().to_owned();
        if let Phase::Run(_) = self.phase {
            return Ok(vec![Effect::Record(RecorderCommand::Note { at_ns: now_ns, text })]);
        }
        if self.phase != Phase::Review {
            return Err("a note belongs to a take: make it while one is recorded or reviewed".to_owned());
        }
        if text.is_empty() {
            return Err("a bare mark belongs to a moment of a recording; write something".to_owned());
        }
        let take = self.reviewed()?.take.clone();
        Ok(vec![Effect::Record(RecorderCommand::Annotate { take, text })])
    }

    fn leave(&mut self) -> Result<Vec<Effect>, String> {
        if self.moves() {
            return Err(self.hint());
        }
        self.leaving = self.pending != Some(Pending::Leave);
        Ok(self.leave_when_done())
    }

    /// Leaves the session if that is wanted and nothing is being written or checked any more.
    fn leave_when_done(&mut self) -> Vec<Effect> {
        if !self.leaving || self.pending.is_some() || self.phase == Phase::Checking {
            return Vec::new();
        }
        self.leaving = false;
        self.pending = Some(Pending::Leave);
        vec![
            Effect::Audit(format!("session {} is left", self.session)),
            Effect::Record(RecorderCommand::EndSession),
        ]
    }

    /// The step under way if the guide is in `phase`.
    fn step_in(&self, phase: &Phase) -> Result<usize, String> {
        match self.current {
            Some(step) if self.phase == *phase => Ok(step),
            _ => Err(self.hint()),
        }
    }

    fn reviewed(&self) -> Result<&Recorded, String> {
        let recorded = self.current.filter(|_| self.phase == Phase::Review);
        recorded.and_then(|step| self.steps[step].as_ref()).ok_or_else(|| self.hint())
    }

    fn refuse_while_busy(&self) -> Result<(), String> {
        if self.moves() || self.phase == Phase::Checking { Err(self.hint()) } else { Ok(()) }
    }

    /// What the operator can do instead of what was asked.
    fn hint(&self) -> String {
        match self.phase() {
            RecordingPhase::PlaceObject => "confirm first that the object is in place",
            RecordingPhase::StartPose => "bring the robot to the start pose and start the recording",
            RecordingPhase::GoingToStart => "the robot is on its way to the start pose; wait, or cancel",
            RecordingPhase::Baseline | RecordingPhase::Countdown | RecordingPhase::Running => {
                "a take is being recorded; wait for its end, or cancel"
            }
            RecordingPhase::Checking => "the take is being checked; wait a moment",
            RecordingPhase::Review => "a take waits for a decision: accept it, record again, or discard it",
            RecordingPhase::Done => "every step is done; select one to look at it or to record it again",
        }
        .to_owned()
    }

    /// Which joint is too far from the start pose of `step`, if one is.
    fn not_at_start(&self, step: usize, safety: &Safety<'_>) -> Option<String> {
        let Some(measured) = safety.measured else {
            return Some("not every joint has said where it is; check the devices".to_owned());
        };
        let start = &self.plan.steps[step].start;
        let far = self.plan.joints.iter().zip(start).zip(measured).map(|((joint, start), measured)| {
            // Not a number is as far as can be.
            let distance = (measured - start).abs();
            let times = distance / joint.near;
            (joint, distance, if times.is_finite() { times } else { f64::INFINITY })
        });
        let (GuideJoint { name, unit, .. }, distance, times) = far.max_by(|a, b| a.2.total_cmp(&b.2))?;
        (times > 1.0).then(|| format!("joint {name:?} is {distance:.3} {unit} from its start position"))
    }

    /// Makes `step` the one under way.
    fn enter(&mut self, step: usize) {
        self.current = Some(step);
        self.phase = match &self.steps[step] {
            Some(Recorded { verdict: None, .. }) => Phase::Checking,
            Some(_) => Phase::Review,
            None => Phase::PlaceObject,
        };
    }

    /// Goes to the first step from `from` on that is not accepted, over the end if need be.
    fn go_on(&mut self, from: usize) {
        let count = self.steps.len();
        let open = (0..count)
            .map(|offset| (from + offset) % count)
            .find(|&step| self.steps[step].as_ref().is_none_or(|recorded| !recorded.accepted));
        match open {
            Some(step) => self.enter(step),
            None => {
                self.current = None;
                self.phase = Phase::Done;
            }
        }
    }
}

/// The lease under which the robot may be moved now, or why it may not be. Whoever asks holds that lease: the desk lets
/// nobody else act.
fn may_move(safety: &Safety<'_>) -> Result<u64, String> {
    if safety.lease == 0 {
        return Err("take control first: what moves the robot needs the lease".to_owned());
    }
    if !safety.armed {
        return Err(match safety.reason {
            "" => "the station is not armed; arm it first".to_owned(),
            reason => format!("the station does not follow commands: {reason}"),
        });
    }
    if safety.measured.is_none() {
        return Err("not every joint has said where it is; check the devices".to_owned());
    }
    Ok(safety.lease)
}

#[cfg(test)]
mod tests;
