//! What pages see of the checklist.

use nalgebra::Isometry3;
use palpate_messages::bits;
use palpate_robot_model::PoseConfig;
use palpate_wire::{
    api::{RecordingPhase, RecordingSession, RecordingStep, StepState},
    proto::RecordingStatus,
};

use super::{Guide, Phase, Run, Stage};

impl Guide {
    /// Changes whenever [`Guide::session`] does.
    pub(crate) fn revision(&self) -> u64 {
        self.revision
    }

    /// The checklist.
    pub(crate) fn session(&self) -> RecordingSession {
        let steps = self.plan.steps.iter().zip(&self.steps).map(|(planned, recorded)| RecordingStep {
            object: planned.object.clone(),
            object_label: planned.object_label.clone(),
            primitive: planned.primitive.clone(),
            primitive_label: planned.primitive_label.clone(),
            instruction: planned.instruction.clone(),
            object_pose: numbers_of(&planned.base_from_object),
            start: planned.start.clone(),
            touches: planned
                .touches
                .iter()
                .filter_map(|&channel| self.plan.channels.get(channel).cloned())
                .collect(),
            duration_s: planned.duration_s,
            added_because: planned.added_because.clone(),
            state: match recorded {
                None => StepState::Open,
                Some(recorded) if recorded.accepted => StepState::Accepted,
                Some(_) => StepState::Review,
            },
            take: recorded.as_ref().map(|recorded| recorded.take.clone()),
            verdict: recorded.as_ref().and_then(|recorded| recorded.verdict.clone()),
        });
        let accepted = self.steps.iter().flatten().filter(|recorded| recorded.accepted);
        let covered: Vec<&String> = accepted
            .filter_map(|recorded| recorded.verdict.as_ref())
            .flat_map(|verdict| &verdict.covered)
            .collect();
        RecordingSession {
            session: self.session.clone(),
            plan: self.plan.id.clone(),
            operator: self.operator.clone(),
            steps: steps.collect(),
            current: self.current,
            phase: self.phase(),
            problem: self.problem.clone(),
            untouched: self.plan.channels.iter().filter(|id| !covered.contains(id)).cloned().collect(),
            can_undo: self.undo.as_ref().is_some_and(|(step, _)| self.steps[*step].is_none())
                && !self.moves()
                && self.phase != Phase::Checking,
        }
    }

    /// What changes while a take is recorded. Lost samples and free space are the recorder's to fill in, and the
    /// revision that of the whole document.
    pub(crate) fn status(&self, now_ns: u64) -> RecordingStatus {
        let mut status = RecordingStatus {
            revision: self.revision,
            phase: phase_name(self.phase()).to_owned(),
            covered: bits::pack(self.covered.iter().copied()),
            ..RecordingStatus::default()
        };
        let (Phase::Run(Run { since_ns, stage, .. }), Some(step)) = (&self.phase, self.current) else {
            return status;
        };
        let planned = &self.plan.steps[step];
        let elapsed_s = now_ns.saturating_sub(*since_ns) as f64 * 1e-9;
        let (baseline_s, countdown_s) = (self.plan.baseline_s, self.plan.countdown_s);
        match stage {
            Stage::Taring => status.countdown_s = (baseline_s + countdown_s) as f32,
            Stage::Baseline => status.countdown_s = (baseline_s + countdown_s - elapsed_s).max(0.0) as f32,
            Stage::Countdown => status.countdown_s = (countdown_s - elapsed_s).max(0.0) as f32,
            Stage::Running { .. } => {
                status.elapsed_s = elapsed_s as f32;
                status.fraction = (elapsed_s / planned.duration_s).clamp(0.0, 1.0) as f32;
                let doing = planned.activities.iter().rev().find(|(from_s, _)| *from_s <= elapsed_s);
                status.activity = doing.map(|(_, activity)| activity.clone()).unwrap_or_default();
            }
        }
        status
    }

    pub(super) fn phase(&self) -> RecordingPhase {
        match &self.phase {
            Phase::PlaceObject => RecordingPhase::PlaceObject,
            Phase::StartPose => RecordingPhase::StartPose,
            Phase::GoingToStart { .. } => RecordingPhase::GoingToStart,
            Phase::Run(run) => match run.stage {
                Stage::Taring | Stage::Baseline => RecordingPhase::Baseline,
                Stage::Countdown => RecordingPhase::Countdown,
                Stage::Running { .. } => RecordingPhase::Running,
            },
            Phase::Checking => RecordingPhase::Checking,
            Phase::Review => RecordingPhase::Review,
            Phase::Done => RecordingPhase::Done,
        }
    }
}

/// As the JSON of the API has it.
fn phase_name(phase: RecordingPhase) -> &'static str {
    match phase {
        RecordingPhase::PlaceObject => "place_object",
        RecordingPhase::StartPose => "start_pose",
        RecordingPhase::GoingToStart => "going_to_start",
        RecordingPhase::Baseline => "baseline",
        RecordingPhase::Countdown => "countdown",
        RecordingPhase::Running => "running",
        RecordingPhase::Checking => "checking",
        RecordingPhase::Review => "review",
        RecordingPhase::Done => "done",
    }
}

/// Position, m, and quaternion, w first.
fn numbers_of(pose: &Isometry3<f64>) -> Vec<f64> {
    let PoseConfig { position_m, quaternion_wxyz } = PoseConfig::from_isometry(pose);
    position_m.into_iter().chain(quaternion_wxyz).collect()
}
