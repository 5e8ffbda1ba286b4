//! Carries the reflex out under whoever has control, when they have asked for it.

use palpate_safety::{Lease, Phase as SafetyPhase};
use palpate_wire::proto::ReflexStatus;

use crate::{
    control_loop::ControlLoop,
    reflex::{Now, Reflex, ReflexConfig},
};

/// Who the audit log names for what the reflex does.
const REFLEX: &str = "reflex";

impl ControlLoop {
    /// Switches the reflex on as `config` has it, or off.
    pub(crate) fn set_reflex(&mut self, config: Option<ReflexConfig>, lease: Lease) {
        let reflex = config.map(|config| Reflex::new(lease, config, self.station.robot.num_dofs()));
        if let Some(on) = std::mem::replace(&mut self.reflex, reflex) {
            self.give_back(&on);
        }
    }

    /// Joints that `reflex` has moved are told again what they were told without it.
    fn give_back(&mut self, reflex: &Reflex) {
        let now_ns = self.clock.now_ns();
        let moved = reflex.told.iter().enumerate().filter_map(|(dof, told)| {
            let (told, in_force) = ((*told)?, self.supervisor.target(dof)?);
            (told != in_force).then_some((dof, told))
        });
        let targets: Vec<(usize, f64)> = moved.collect();
        if !targets.is_empty() {
            self.commands += 1;
            // Whoever has lost the lease has nothing to be told.
            let _ = self.supervisor.targets(now_ns, reflex.lease, self.commands, &targets);
        }
    }

    /// One turn of the reflex.
    pub(crate) fn reflex(&mut self, now_ns: u64) {
        let Some(reflex) = &mut self.reflex else { return };
        let status = self.supervisor.status(now_ns);
        if status.lease != Some(reflex.lease) {
            self.audit.note(now_ns, REFLEX, "is off: whoever asked for it has not got control any more");
            self.reflex = None;
            return;
        }
        if status.phase != SafetyPhase::Armed || self.guided.moves() {
            reflex.forget();
            return;
        }
        let readings = self.senses.streams.readings(now_ns);
        let joints = &self.senses.measured.joints;
        let now = Now { now_ns, readings: &readings, joints, commanded: &self.commanded };
        let targets = reflex.turn(&self.station, &now, |dof| self.supervisor.target(dof));
        if targets.is_empty() {
            return;
        }
        self.commands += 1;
        if let Err(refusal) = self.supervisor.targets(now_ns, reflex.lease, self.commands, &targets) {
            self.audit.warn(now_ns, REFLEX, &format!("is off: {refusal}"));
            self.reflex = None;
        }
    }

    /// What the reflex is up to; `None` while it is off.
    pub(crate) fn reflex_status(&self) -> Option<ReflexStatus> {
        self.reflex.as_ref().map(Reflex::status)
    }
}
