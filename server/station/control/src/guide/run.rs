//! What happens by itself: time passes, motions end, the recorder answers.

use palpate_recording::SpanKind;

use super::{Effect, Guide, Pending, Phase, Recorded, Run, Safety, Stage};
use crate::recorder::{RecorderCommand, RecorderEvent};

/// The zero is captured in half a second; boards that have not answered by now, s, will not.
const MOST_TARE_S: f64 = 5.0;
/// A motion that has not ended so long after its time has got stuck, s.
const MOST_OVERTIME_S: f64 = 10.0;

impl Guide {
    /// Time passes. To be called every period of the control loop, before the robot is commanded.
    pub(crate) fn tick(&mut self, now_ns: u64, safety: &Safety<'_>) -> Vec<Effect> {
        let (lease, run) = match &self.phase {
            Phase::GoingToStart { lease } => (*lease, None),
            Phase::Run(run) => (run.lease, Some(run.clone())),
            _ => return Vec::new(),
        };
        if safety.lease != lease {
            return self.stop(now_ns, "the lease was given back or taken over");
        }
        if !safety.armed {
            let reason = if safety.reason.is_empty() { "it is not armed any more" } else { safety.reason };
            return self.stop(now_ns, &format!("the station stopped: {reason}"));
        }
        let (Some(run), Some(step)) = (run, self.current) else { return Vec::new() };
        let elapsed_s = now_ns.saturating_sub(run.since_ns) as f64 * 1e-9;
        match run.stage {
            Stage::Taring if elapsed_s > MOST_TARE_S => {
                self.stop(now_ns, "the zero of the tactile readings was not captured; check the boards")
            }
            Stage::Baseline if elapsed_s >= self.plan.baseline_s => {
                self.set_stage(&run, now_ns, Stage::Countdown);
                vec![Effect::Record(RecorderCommand::Span {
                    kind: SpanKind::Baseline,
                    start_ns: run.since_ns,
                    end_ns: now_ns,
                    label: String::new(),
                })]
            }
            Stage::Countdown if elapsed_s >= self.plan.countdown_s => {
                // It stood still since the recording was started, unless somebody pushed it.
                if let Some(problem) = self.not_at_start(step, safety) {
                    return self.stop(now_ns, &problem);
                }
                self.set_stage(&run, now_ns, Stage::Running { marked: 0 });
                vec![Effect::RunMotion { lease, step }]
            }
            Stage::Running { marked } => {
                if elapsed_s > self.plan.steps[step].duration_s + MOST_OVERTIME_S {
                    return self.stop(now_ns, "the motion did not come to its end in time");
                }
                self.mark_spans(&run, marked, elapsed_s)
            }
            _ => Vec::new(),
        }
    }

    /// The motion has come to its end.
    pub(crate) fn arrived(&mut self, now_ns: u64) -> Vec<Effect> {
        match self.phase.clone() {
            Phase::GoingToStart { .. } => {
                self.phase = Phase::StartPose;
                self.revision += 1;
                Vec::new()
            }
            Phase::Run(run) => match run.stage {
                Stage::Running { marked } => {
                    let mut effects = self.mark_spans(&run, marked, f64::INFINITY);
                    self.phase = Phase::Checking;
                    self.revision += 1;
                    let text = "the motion came to its end".to_owned();
                    effects.push(Effect::Record(RecorderCommand::Log { at_ns: now_ns, text }));
                    effects.push(Effect::Record(RecorderCommand::EndTake { broken_off: String::new() }));
                    effects
                }
                // Of a motion that was stopped in the meantime.
                _ => Vec::new(),
            },
            _ => Vec::new(),
        }
    }

    /// The motion cannot go on: `why`, in words, with what to do.
    pub(crate) fn motion_failed(&mut self, now_ns: u64, why: &str) -> Vec<Effect> {
        if self.moves() { self.stop(now_ns, why) } else { Vec::new() }
    }

    /// The zero of the tactile readings is captured, or could not be.
    pub(crate) fn tared(&mut self, now_ns: u64, problems: &[String]) -> Vec<Effect> {
        let Phase::Run(run @ Run { stage: Stage::Taring, .. }) = self.phase.clone() else {
            return Vec::new();
        };
        if !problems.is_empty() {
            return self.stop(now_ns, &problems.join("; "));
        }
        self.set_stage(&run, now_ns, Stage::Baseline);
        let text = "the zero of the tactile readings was captured".to_owned();
        vec![Effect::Audit(text.clone()), Effect::Record(RecorderCommand::Log { at_ns: now_ns, text })]
    }

    /// The recorder says what it has done.
    pub(crate) fn recorder(&mut self, event: RecorderEvent) -> Vec<Effect> {
        self.revision += 1;
        let mut effects = self.recorded(event);
        effects.extend(self.leave_when_done());
        effects
    }

    fn recorded(&mut self, event: RecorderEvent) -> Vec<Effect> {
        match event {
            RecorderEvent::TakeStarted { take } => {
                let recorded = Recorded { take, accepted: false, readable: None, verdict: None };
                if let Some(step) = self.current
                    && self.steps[step].is_none()
                {
                    self.steps[step] = Some(recorded);
                }
                Vec::new()
            }
            RecorderEvent::TakeEnded { broken_off, .. } => {
                if !broken_off.is_empty() {
                    self.problem = broken_off;
                }
                // The recorder ended it by itself: there is nothing to move for.
                let moved = matches!(self.phase, Phase::Run(_));
                if moved {
                    self.phase = Phase::Checking;
                }
                if moved { vec![Effect::StopMotion] } else { Vec::new() }
            }
            RecorderEvent::TakeLost { problem } => {
                self.problem = problem;
                let moved = self.moves();
                if moved || self.phase == Phase::Checking {
                    if let Some(step) = self.current.filter(|&step| !self.is_accepted(step)) {
                        self.steps[step] = None;
                    }
                    self.phase = Phase::StartPose;
                }
                if moved { vec![Effect::StopMotion] } else { Vec::new() }
            }
            RecorderEvent::Checked { take, verdict, readable } => {
                if let Some(recorded) = self.steps.iter_mut().flatten().find(|recorded| recorded.take == take)
                {
                    recorded.verdict = Some(verdict);
                    recorded.readable = Some(readable);
                }
                if self.phase == Phase::Checking
                    && self.current_take().is_some_and(|recorded| recorded.take == take)
                {
                    self.phase = Phase::Review;
                }
                Vec::new()
            }
            RecorderEvent::Accepted { take } => {
                self.pending = None;
                if let Some(step) = self.step_of(&take) {
                    if let Some(recorded) = &mut self.steps[step] {
                        recorded.accepted = true;
                    }
                    self.go_on(step);
                }
                Vec::new()
            }
            RecorderEvent::SetAside { take } => {
                let pending = self.pending.take();
                if let Some(step) = self.step_of(&take)
                    && let Some(recorded) = self.steps[step].take()
                {
                    self.undo = Some((step, Recorded { accepted: false, ..recorded }));
                    if pending == Some(Pending::Discard) { self.go_on(step + 1) } else { self.enter(step) }
                }
                Vec::new()
            }
            RecorderEvent::Restored { take } => {
                self.pending = None;
                let Some((step, recorded)) = self.undo.take_if(|(_, recorded)| recorded.take == take) else {
                    return Vec::new();
                };
                let unchecked = recorded.verdict.is_none();
                self.steps[step] = Some(Recorded { accepted: false, ..recorded });
                self.enter(step);
                let planned = self.plan.steps[step].touches.clone();
                let check = Effect::Record(RecorderCommand::Check { take, planned });
                if unchecked { vec![check] } else { Vec::new() }
            }
            RecorderEvent::Failed { problem } => {
                // Whoever wanted to leave should see this first.
                (self.pending, self.leaving) = (None, false);
                self.problem = problem;
                Vec::new()
            }
            RecorderEvent::SessionEnded => {
                self.pending = None;
                self.finished = true;
                Vec::new()
            }
        }
    }

    /// Ends what is under way: a take is kept, and what stopped it is said.
    pub(super) fn stop(&mut self, now_ns: u64, why: &str) -> Vec<Effect> {
        let audit = Effect::Audit(format!("the motion ended early: {why}"));
        why.clone_into(&mut self.problem);
        self.revision += 1;
        match std::mem::replace(&mut self.phase, Phase::StartPose) {
            Phase::Run(_) => {
                self.phase = Phase::Checking;
                let (broken_off, text) = (why.to_owned(), format!("stopped: {why}"));
                vec![
                    Effect::StopMotion,
                    audit,
                    Effect::Record(RecorderCommand::Log { at_ns: now_ns, text }),
                    Effect::Record(RecorderCommand::EndTake { broken_off }),
                ]
            }
            Phase::GoingToStart { .. } => vec![Effect::StopMotion, audit],
            other => {
                self.phase = other;
                Vec::new()
            }
        }
    }

    /// Marks the spans of the motion that are over after `elapsed_s` of it.
    fn mark_spans(&mut self, run: &Run, marked: usize, elapsed_s: f64) -> Vec<Effect> {
        let Some(step) = self.current else { return Vec::new() };
        let spans = &self.plan.steps[step].spans;
        let over = spans.iter().take_while(|span| span.end_s <= elapsed_s).count();
        if over > marked {
            // Not what pages show, so that the revision stays.
            self.phase = Phase::Run(Run { stage: Stage::Running { marked: over }, ..run.clone() });
        }
        let at_ns = |time_s: f64| run.since_ns.saturating_add((time_s.max(0.0) * 1e9).round() as u64);
        spans
            .get(marked..over)
            .unwrap_or_default()
            .iter()
            .map(|span| {
                Effect::Record(RecorderCommand::Span {
                    kind: span.kind,
                    start_ns: at_ns(span.start_s),
                    end_ns: at_ns(span.end_s),
                    label: span.label.clone(),
                })
            })
            .collect()
    }

    fn set_stage(&mut self, run: &Run, now_ns: u64, stage: Stage) {
        self.phase = Phase::Run(Run { lease: run.lease, since_ns: now_ns, stage });
        self.revision += 1;
    }

    fn step_of(&self, take: &str) -> Option<usize> {
        self.steps.iter().position(|step| step.as_ref().is_some_and(|recorded| recorded.take == take))
    }

    fn current_take(&self) -> Option<&Recorded> {
        self.current.and_then(|step| self.steps[step].as_ref())
    }

    fn is_accepted(&self, step: usize) -> bool {
        self.steps[step].as_ref().is_some_and(|recorded| recorded.accepted)
    }
}
