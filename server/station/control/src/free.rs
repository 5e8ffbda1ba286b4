//! A take outside guided sessions: whoever has control begins and ends it, and moves the robot meanwhile by whatever means.
//!
//! Pure, as the [guide](crate::guide) is: it is told what happens and what time it is, and answers with [`Effect`]s for the
//! control loop to carry out. It moves nothing. Whatever ends control or stops an armed station ends the take, which is kept;
//! one that holds for a moment, e.g. because a finger was about to leave the workspace, goes on.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use palpate_recording::{SpanKind, TakeMeta};
use palpate_reports::TakeVerdict;
use palpate_safety::Phase;
use palpate_wire::{
    api::{FreeTake, FreeTakeState, MarkKind, TakeAction},
    proto::{ObjectPose, RecordingStatus},
};

use crate::{
    guide::Effect,
    recorder::{RecorderCommand, RecorderEvent},
};

/// A span without touch that is shorter says little about the zero of a channel, ns. It is not marked.
const MIN_BASELINE_NS: u64 = 250_000_000;
/// An armed station may hold for so long, ns, and be part of the take: whoever moves it tells it to go elsewhere meanwhile.
const MAX_HOLD_NS: u64 = 1_000_000_000;
/// Marks that may be open at once.
const MAX_MARKS: usize = 64;
/// Characters of a label.
const MAX_LABEL_CHARS: usize = 200;
/// A pose may be so much ahead of the station's clock, ns: a client knows that clock to a few milliseconds.
const MAX_AHEAD_NS: u64 = 100_000_000;
/// How far the norm of a rotation may be from 1, as readers of takes see it.
const UNIT_TOLERANCE: f64 = 1e-3;

/// What a take is about.
#[derive(Clone, Debug)]
pub(crate) struct FreePlan {
    /// Id of the session.
    pub(crate) session: String,
    /// Its step of the session.
    pub(crate) step: usize,
    pub(crate) meta: TakeMeta,
    /// The client marks the span without touch.
    pub(crate) marks_baseline: bool,
}

/// What the safety layer is up to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Standing<'a> {
    pub(crate) phase: Phase,
    /// The lease that is held; 0 for none.
    pub(crate) lease: u64,
    /// Why it does not follow commands, in words; may be empty.
    pub(crate) reason: &'a str,
}

/// A take, from its begin on.
#[derive(Debug)]
pub(crate) struct Free {
    session: String,
    object: String,
    primitive: String,
    take: Option<String>,
    state: FreeTakeState,
    problem: String,
    verdict: Option<TakeVerdict>,
    /// Under which it was begun.
    lease: u64,
    since_ns: u64,
    was_armed: bool,
    /// Since when the armed station holds.
    holds_since_ns: Option<u64>,
    /// Nothing has moved a joint of the hand since the take began, so that nothing touches.
    is_baseline: bool,
    marks: Vec<Mark>,
    last_pose_ns: Option<u64>,
    /// Nobody wants it.
    is_unwanted: bool,
    /// The recorder has let go of the session.
    is_over: bool,
    revision: u64,
}

/// A span that has begun.
#[derive(Clone, Debug, PartialEq)]
struct Mark {
    kind: MarkKind,
    label: String,
    since_ns: u64,
}

impl Free {
    /// Begins the take that `plan` says, under `lease`.
    pub(crate) fn begin(plan: FreePlan, lease: u64, now_ns: u64) -> (Self, Vec<Effect>) {
        let FreePlan { session, step, meta, marks_baseline } = plan;
        let free = Self {
            object: meta.object.clone(),
            primitive: meta.primitive.clone(),
            take: None,
            state: FreeTakeState::Recording,
            problem: String::new(),
            verdict: None,
            lease,
            since_ns: now_ns,
            was_armed: false,
            holds_since_ns: None,
            is_baseline: !marks_baseline,
            marks: Vec::new(),
            last_pose_ns: None,
            is_unwanted: false,
            is_over: false,
            revision: 1,
            session,
        };
        let audit = format!("recording {} on {} into session {}", free.primitive, free.object, free.session);
        let start = RecorderCommand::StartFreeTake { step, meta, at_ns: now_ns };
        (free, vec![Effect::Audit(audit), Effect::Record(start)])
    }

    /// Whether it needs the recorder no more.
    pub(crate) fn is_over(&self) -> bool {
        self.is_over
    }

    fn is_recording(&self) -> bool {
        self.state == FreeTakeState::Recording
    }

    /// Time passes.
    pub(crate) fn tick(&mut self, now_ns: u64, standing: &Standing<'_>) -> Vec<Effect> {
        let Standing { phase, lease, reason } = *standing;
        if !self.is_recording() {
            return Vec::new();
        }
        if lease != self.lease {
            return self.stop(now_ns, "the lease was given back or taken over, or it ran out");
        }
        let reason = if reason.is_empty() { "it is not armed any more" } else { reason };
        match phase {
            Phase::Armed => (self.was_armed, self.holds_since_ns) = (true, None),
            Phase::Holding if self.was_armed => {
                let Some(since_ns) = self.holds_since_ns else {
                    self.holds_since_ns = Some(now_ns);
                    let text = format!("the station holds: {reason}");
                    return vec![Effect::Record(RecorderCommand::Log { at_ns: now_ns, text })];
                };
                if now_ns.saturating_sub(since_ns) > MAX_HOLD_NS {
                    return self.stop(now_ns, &format!("the station held: {reason}"));
                }
            }
            _ if self.was_armed => return self.stop(now_ns, &format!("the station stopped: {reason}")),
            _ => {}
        }
        Vec::new()
    }

    /// Does what the operator asks, or says why not and what to do instead.
    pub(crate) fn act(&mut self, now_ns: u64, action: &TakeAction) -> Result<Vec<Effect>, String> {
        if !self.is_recording() {
            return Err("no take is being recorded outside guided sessions; begin one first".to_owned());
        }
        match action {
            TakeAction::BeginMark { kind, label } => self.begin_mark(now_ns, *kind, label),
            TakeAction::EndMark { kind, label } => {
                let found = self.marks.iter().position(|mark| mark.kind == *kind && mark.label == *label);
                let Some(found) = found else {
                    return Err(format!("no mark {label:?} of this kind has begun; begin it first"));
                };
                let mark = self.marks.remove(found);
                Ok(span(mark, now_ns).into_iter().collect())
            }
            TakeAction::End { set_aside } => {
                self.is_unwanted = *set_aside;
                Ok(self.end(now_ns, ""))
            }
        }
    }

    fn begin_mark(&mut self, now_ns: u64, kind: MarkKind, label: &str) -> Result<Vec<Effect>, String> {
        if label.chars().count() > MAX_LABEL_CHARS {
            return Err(format!("the label is longer than {MAX_LABEL_CHARS} characters; give a shorter one"));
        }
        if self.marks.len() >= MAX_MARKS {
            return Err(format!("{MAX_MARKS} marks have not ended; end some first"));
        }
        if self.marks.iter().any(|mark| mark.kind == kind && mark.label == label) {
            return Err(format!("the mark {label:?} has begun already; end it first"));
        }
        if kind == MarkKind::Baseline && self.is_baseline {
            return Err(
                "the span without touch is marked by itself until a joint of the hand moves; begin the take with \
                 marks_baseline to mark it yourself"
                    .to_owned(),
            );
        }
        self.marks.push(Mark { kind, label: label.to_owned(), since_ns: now_ns });
        Ok(Vec::new())
    }

    /// A joint of the hand was told to move, or somebody leads the arm: from here on something may be touched.
    pub(crate) fn moved(&mut self, now_ns: u64) -> Vec<Effect> {
        if !self.is_recording() || !std::mem::take(&mut self.is_baseline) {
            return Vec::new();
        }
        if now_ns.saturating_sub(self.since_ns) < MIN_BASELINE_NS {
            return Vec::new();
        }
        let mark = Mark { kind: MarkKind::Baseline, label: String::new(), since_ns: self.since_ns };
        span(mark, now_ns).into_iter().collect()
    }

    /// When and where the object was, in the station's time, as `pose` says that came in at `received_ns`.
    pub(crate) fn pose(
        &mut self,
        now_ns: u64,
        received_ns: u64,
        pose: &ObjectPose,
    ) -> Result<(u64, Isometry3<f64>), String> {
        if !self.is_recording() {
            return Err("no take is being recorded outside guided sessions; begin one first".to_owned());
        }
        let base_from_object = pose_of(&pose.position_m, &pose.quaternion_wxyz)?;
        let at_ns = match pose.time_s {
            0.0 => received_ns,
            // The cast saturates.
            time_s if time_s.is_finite() && time_s > 0.0 => (time_s * 1e9).round() as u64,
            time_s => {
                return Err(format!("time_s is {time_s}, expected a time of the station, or 0 for now"));
            }
        };
        if at_ns > now_ns.saturating_add(MAX_AHEAD_NS) {
            let ahead_s = (at_ns - now_ns) as f64 * 1e-9;
            return Err(format!(
                "the pose is {ahead_s:.3} s ahead of the station's time; time_s counts as that of live frames"
            ));
        }
        if at_ns < self.since_ns {
            return Err("the pose is of a time before the take began; it is left out".to_owned());
        }
        if self.last_pose_ns.is_some_and(|last_ns| at_ns <= last_ns) {
            return Err("the pose is not newer than the one before; it is left out".to_owned());
        }
        self.last_pose_ns = Some(at_ns);
        Ok((at_ns, base_from_object))
    }

    /// Ends the take early and says why.
    pub(crate) fn stop(&mut self, now_ns: u64, why: &str) -> Vec<Effect> {
        if !self.is_recording() {
            return Vec::new();
        }
        let mut effects = vec![Effect::Audit(format!("the take ended early: {why}"))];
        effects.extend(self.end(now_ns, why));
        effects
    }

    fn end(&mut self, now_ns: u64, broken_off: &str) -> Vec<Effect> {
        self.state = FreeTakeState::Checking;
        broken_off.clone_into(&mut self.problem);
        self.revision += 1;
        let marks = std::mem::take(&mut self.marks);
        let mut effects: Vec<Effect> = marks.into_iter().filter_map(|mark| span(mark, now_ns)).collect();
        effects.push(Effect::Record(RecorderCommand::EndTake { broken_off: broken_off.to_owned() }));
        effects
    }

    /// The recorder says what it has done.
    pub(crate) fn recorder(&mut self, event: RecorderEvent) -> Vec<Effect> {
        self.revision += 1;
        match event {
            RecorderEvent::TakeStarted { take } => self.take = Some(take),
            RecorderEvent::TakeEnded { take, broken_off } => {
                self.state = FreeTakeState::Checking;
                if !broken_off.is_empty() {
                    self.problem = broken_off;
                }
                let set_aside = self.is_unwanted.then_some(RecorderCommand::SetAside { take });
                // The recorder does these once it has checked the take.
                let commands = set_aside.into_iter().chain([RecorderCommand::EndSession]);
                return commands.map(Effect::Record).collect();
            }
            RecorderEvent::TakeLost { problem } => {
                (self.state, self.problem) = (FreeTakeState::Lost, problem);
                return vec![Effect::Record(RecorderCommand::EndSession)];
            }
            RecorderEvent::Checked { verdict, readable, .. } => {
                if !readable {
                    self.state = FreeTakeState::Lost;
                    verdict.summary.clone_into(&mut self.problem);
                }
                self.verdict = Some(verdict);
            }
            RecorderEvent::Accepted { take } => {
                self.state = FreeTakeState::Accepted;
                return vec![Effect::Audit(format!("{take} is part of session {}", self.session))];
            }
            RecorderEvent::SetAside { take } => {
                self.state = FreeTakeState::SetAside;
                return vec![Effect::Audit(format!("{take} is set aside"))];
            }
            RecorderEvent::Restored { .. } => {}
            RecorderEvent::Failed { problem } => self.problem = problem,
            RecorderEvent::SessionEnded => self.is_over = true,
        }
        Vec::new()
    }

    /// Changes whenever [`Free::view`] does.
    pub(crate) fn revision(&self) -> u64 {
        self.revision
    }

    /// What pages see of it.
    pub(crate) fn view(&self) -> FreeTake {
        // What could not be written is no more being checked.
        let is_lost = self.is_over && self.state == FreeTakeState::Checking;
        FreeTake {
            session: self.session.clone(),
            take: self.take.clone(),
            object: self.object.clone(),
            primitive: self.primitive.clone(),
            state: match self.state {
                // Its check follows; until the recorder is through with it, nobody can begin another.
                FreeTakeState::Accepted | FreeTakeState::SetAside if !self.is_over => FreeTakeState::Checking,
                _ if is_lost => FreeTakeState::Lost,
                state => state,
            },
            problem: self.problem.clone(),
            verdict: self.verdict.clone(),
        }
    }

    /// What changes while it is recorded; `None` once it is over.
    pub(crate) fn status(&self, now_ns: u64) -> Option<RecordingStatus> {
        (!self.is_over).then(|| RecordingStatus {
            revision: self.revision,
            phase: if self.is_recording() { "running" } else { "checking" }.to_owned(),
            elapsed_s: (now_ns.saturating_sub(self.since_ns) as f64 * 1e-9) as f32,
            ..RecordingStatus::default()
        })
    }
}

/// The span from the begin of `mark` to now; none without a length.
fn span(mark: Mark, now_ns: u64) -> Option<Effect> {
    let Mark { kind, label, since_ns } = mark;
    let kind = match kind {
        MarkKind::Baseline => SpanKind::Baseline,
        MarkKind::Repetition => SpanKind::Repetition,
        MarkKind::Note => SpanKind::Note,
    };
    let span = RecorderCommand::Span { kind, start_ns: since_ns, end_ns: now_ns, label };
    (now_ns > since_ns).then_some(Effect::Record(span))
}

/// A pose of numbers that others sent: x y z, m, and w x y z.
pub(crate) fn pose_of(position_m: &[f64], quaternion_wxyz: &[f64]) -> Result<Isometry3<f64>, String> {
    let (&[x, y, z], &[w, i, j, k]) = (position_m, quaternion_wxyz) else {
        return Err(format!(
            "a pose has {} and {} numbers, expected a position of three (x y z, m) and a quaternion of four (w x y z)",
            position_m.len(),
            quaternion_wxyz.len()
        ));
    };
    let quaternion = Quaternion::new(w, i, j, k);
    let is_rotation = (quaternion.norm() - 1.0).abs() <= UNIT_TOLERANCE;
    if !position_m.iter().all(|number| number.is_finite()) || !is_rotation {
        return Err(format!(
            "a pose is {position_m:?} m, {quaternion_wxyz:?}; expected finite numbers and a quaternion of length 1, w first"
        ));
    }
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion)))
}

#[cfg(test)]
mod tests;
