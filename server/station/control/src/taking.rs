//! Takes outside guided sessions in the control loop: who may begin one, and what ends it.

use std::sync::Arc;

use palpate_recording::GrowingSession;
use palpate_robot_model::Station;
use palpate_wire::{
    api::{RecordingDocument, TakeAction},
    proto::{ObjectPose, Targets},
};

use crate::{
    audit::Who,
    control_loop::ControlLoop,
    error::ControlError,
    free::{Free, FreePlan, Standing},
    guide::Effect,
    prepared_take::PreparedTake,
    requests::Claim,
};

/// Who ends takes by itself, in the audit log.
const RECORDER: &str = "recording";
/// A joint of the hand that is told to be farther than this from where it is told to be now moves, rad or m.
const MOVES: f64 = 1e-3;

impl ControlLoop {
    /// Begins a take outside guided sessions.
    pub(crate) fn begin_take(
        &mut self,
        claim: &Claim,
        prepared: PreparedTake,
    ) -> Result<RecordingDocument, ControlError> {
        let who = self.authorise(claim, "record a take", false)?;
        if let Some((device, problem)) = self.senses.missing().next() {
            return Err(ControlError::Refused(format!(
                "{device} is missing, so that the take would be without it: {problem}"
            )));
        }
        let now_ns = self.clock.now_ns();
        let PreparedTake { mut plan, session, station, mended } = prepared;
        if plan.meta.operator.is_empty() {
            plan.meta.operator.clone_from(&who.name);
        }
        let lease = self.supervisor.status(now_ns).lease.map_or(0, |lease| lease.0);
        let object = (plan.meta.object.clone(), plan.meta.base_from_object);
        let effects = self.guided.begin_take(plan, session, station, lease, now_ns)?;
        self.guided.show_object(object);
        for line in mended {
            self.audit.note_by(now_ns, &Who::part(RECORDER), &line);
        }
        self.record(now_ns, &who, effects);
        Ok(self.guided.document())
    }

    /// What the operator does with it.
    pub(crate) fn act_on_take(
        &mut self,
        claim: &Claim,
        action: &TakeAction,
    ) -> Result<RecordingDocument, ControlError> {
        let who = self.authorise(claim, "record a take", false)?;
        let now_ns = self.clock.now_ns();
        let none = || "no take is being recorded outside guided sessions; begin one first".to_owned();
        let free = self.guided.free.as_mut().ok_or_else(none).map_err(ControlError::Refused)?;
        let effects = free.act(now_ns, action).map_err(ControlError::Refused)?;
        self.record(now_ns, &who, effects);
        Ok(self.guided.document())
    }

    /// Whoever has control says where the object is.
    pub(crate) fn object_is_at(
        &mut self,
        now_ns: u64,
        received_ns: u64,
        pose: &ObjectPose,
    ) -> Result<(), String> {
        let none = || "no take is being recorded outside guided sessions; begin one first".to_owned();
        let free = self.guided.free.as_mut().ok_or_else(none)?;
        let (at_ns, base_from_object) = free.pose(now_ns, received_ns, pose)?;
        let object = free.view().object;
        self.guided.recorder.object_pose(at_ns, base_from_object);
        self.guided.show_object((object, base_from_object));
        Ok(())
    }

    /// Targets were accepted: the first that moves a joint of the hand ends the span without touch.
    pub(crate) fn told(&mut self, now_ns: u64, targets: &Targets) {
        let is_far = |dof: usize, target: f64| {
            self.commanded.get(dof).is_none_or(|commanded| (target - commanded).abs() > MOVES)
        };
        let mut told = targets.dofs.iter().map(|&dof| dof as usize).zip(&targets.positions);
        let moves_hand = self.guided.free.is_some()
            && told.any(|(dof, &target)| !self.station.carrier_dofs.contains(&dof) && is_far(dof, target));
        if moves_hand {
            self.touch_begins(now_ns);
        }
    }

    /// From now on something may be touched.
    pub(crate) fn touch_begins(&mut self, now_ns: u64) {
        if let Some(free) = &mut self.guided.free {
            let effects = free.moved(now_ns);
            self.record(now_ns, &Who::part(RECORDER), effects);
        }
    }

    /// One turn of the take.
    pub(crate) fn tick_take(&mut self, now_ns: u64) {
        let Some(free) = self.guided.free.as_mut().filter(|free| !free.is_over()) else { return };
        let status = self.supervisor.status(now_ns);
        let missing = self.senses.missing().next();
        let effects = match missing {
            Some((device, problem)) => free.stop(now_ns, &format!("{device} is lost: {problem}")),
            None => {
                let lease = status.lease.map_or(0, |lease| lease.0);
                free.tick(now_ns, &Standing { phase: status.phase, lease, reason: &status.reason })
            }
        };
        self.record(now_ns, &Who::part(RECORDER), effects);
    }

    /// The recorder says something while a take outside guided sessions has it.
    pub(crate) fn take_recorded(&mut self, now_ns: u64, event: crate::recorder::RecorderEvent) {
        let effects = self.guided.free.as_mut().map(|free| free.recorder(event)).unwrap_or_default();
        self.record(now_ns, &Who::part(RECORDER), effects);
    }

    fn record(&mut self, now_ns: u64, who: &Who, effects: Vec<Effect>) {
        for effect in effects {
            match effect {
                Effect::Record(command) => self.guided.recorder.command(command),
                Effect::Audit(what) => self.audit.note_by(now_ns, who, &what),
                // A take outside guided sessions moves nothing.
                _ => {}
            }
        }
    }
}

impl crate::guided::Guided {
    /// Begins a take where nothing else is recorded.
    fn begin_take(
        &mut self,
        plan: FreePlan,
        session: GrowingSession,
        station: Arc<Station>,
        lease: u64,
        now_ns: u64,
    ) -> Result<Vec<Effect>, ControlError> {
        self.refuse_second_session()?;
        self.recorder.begin_with(session, station);
        let (free, effects) = Free::begin(plan, lease, now_ns);
        if let Some(before) = self.free.replace(free) {
            self.count_revisions(before.revision() + 1);
        }
        Ok(effects)
    }
}
