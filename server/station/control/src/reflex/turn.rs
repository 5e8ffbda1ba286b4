//! The reflex of all digits from turn to turn.

use palpate_robot_model::Station;
use palpate_safety::{JointReading, Lease};
use palpate_wire::proto::{DigitReflex, ReflexStatus};

use super::{DigitConfig, DigitSeen, DigitState, ReflexConfig, step};
use crate::streams::Reading;

/// Time between two turns counts as this much at most, s: what happened in a longer one is not known.
const MAX_TURN_S: f64 = 0.02;
/// A reflex that is switched on.
#[derive(Clone, Debug)]
pub(crate) struct Reflex {
    /// Under whom. It ends with this lease.
    pub(crate) lease: Lease,
    config: ReflexConfig,
    /// One for each digit.
    states: Vec<DigitState>,
    /// What joints were told by whoever has control, in the station's order, rad; `None` where nothing is in force.
    pub(crate) told: Vec<Option<f64>>,
    last_ns: Option<u64>,
}

/// What a turn of the reflex goes by.
pub(crate) struct Now<'a> {
    pub(crate) now_ns: u64,
    /// Newest readings of the channels; `None` where a board is silent or has no zero.
    pub(crate) readings: &'a [Option<Reading>],
    /// Newest readings of the joints.
    pub(crate) joints: &'a [Option<JointReading>],
    /// Positions that are commanded now; empty without torque.
    pub(crate) commanded: &'a [f64],
}

impl Reflex {
    pub(crate) fn new(lease: Lease, config: ReflexConfig, num_dofs: usize) -> Self {
        let states = vec![DigitState::default(); config.digits.len()];
        Self { lease, config, states, told: vec![None; num_dofs], last_ns: None }
    }

    /// Whoever has control has told joints where to go.
    pub(crate) fn told(&mut self, dofs: &[u32], positions: &[f64]) {
        for (&dof, &position) in dofs.iter().zip(positions) {
            if let Some(told) = self.told.get_mut(dof as usize) {
                *told = Some(position);
            }
        }
    }

    /// Nothing that was told is in force any more.
    pub(crate) fn forget(&mut self) {
        self.states.fill(DigitState::default());
        self.told.fill(None);
        self.last_ns = None;
    }

    /// The targets that differ from those in force now, for which `in_force` speaks; none while no digit has an offset.
    pub(crate) fn turn(
        &mut self,
        station: &Station,
        now: &Now<'_>,
        in_force: impl Fn(usize) -> Option<f64>,
    ) -> Vec<(usize, f64)> {
        let before_ns = self.last_ns.replace(now.now_ns).unwrap_or(now.now_ns);
        let dt_s = (now.now_ns.saturating_sub(before_ns) as f64 * 1e-9).min(MAX_TURN_S);
        let mut targets = Vec::new();
        for (digit, state) in self.config.digits.iter().zip(&mut self.states) {
            // The safety layer forgets targets when it holds, and this forgets them with it.
            let lost = digit.joints.iter().any(|&(dof, _)| in_force(dof).is_none());
            if lost {
                digit.joints.iter().for_each(|&(dof, _)| self.told[dof] = None);
            }
            let told: Option<Vec<f64>> = digit.joints.iter().map(|&(dof, _)| self.told[dof]).collect();
            let Some(told) = told else {
                *state = DigitState::default();
                continue;
            };
            match seen(digit, now, &told, self.config.gains.still_rad_per_s) {
                Some(seen) => *state = step(&self.config.gains, state, &seen, dt_s),
                // What is not known is no reason to move: the digit goes where it is told.
                None => *state = DigitState::default(),
            }
            for (&(dof, weight), &told) in digit.joints.iter().zip(&told) {
                let target = sum(station, dof, told, weight * state.offset_rad);
                if in_force(dof) != Some(target) {
                    targets.push((dof, target));
                }
            }
        }
        targets
    }

    pub(crate) fn status(&self) -> ReflexStatus {
        let digits = self.config.digits.iter().zip(&self.states);
        let digits = digits.map(|(config, state)| DigitReflex {
            digit: config.name.clone(),
            phase: state.phase.word().to_owned(),
            offset_rad: state.offset_rad as f32,
        });
        ReflexStatus { digits: digits.collect() }
    }
}

/// `told` with an offset, within the limits of the safety layer. Without an offset it has the bits of `told`.
fn sum(station: &Station, dof: usize, told: f64, offset: f64) -> f64 {
    if offset == 0.0 {
        return told;
    }
    let limits = &station.safety.joints[dof];
    (told + offset).clamp(limits.lower, limits.upper)
}

/// What is known of a digit whose joints are `told` where to go; `None` where one of its channels or joints is not known.
fn seen(digit: &DigitConfig, now: &Now<'_>, told: &[f64], still_rad_per_s: f64) -> Option<DigitSeen> {
    let (mut in_contact, mut load) = (false, 0.0_f64);
    for (&channel, threshold) in digit.channels.iter().zip(&digit.thresholds) {
        let reading = now.readings.get(channel).copied().flatten()?;
        in_contact |= reading.active;
        load = load.max((f64::from(reading.raw) - reading.reference) / threshold);
    }
    let (mut error_rad, mut closed_rad, mut weights) = (0.0_f64, 0.0, 0.0);
    for (&(dof, weight), told) in digit.joints.iter().zip(told) {
        let joint = now.joints.get(dof).copied().flatten()?;
        let commanded = now.commanded.get(dof)?;
        if joint.velocity.abs() < still_rad_per_s {
            error_rad = error_rad.max(weight.signum() * (commanded - joint.position));
        }
        closed_rad += weight * told;
        weights += weight * weight;
    }
    // Where it would take the digit's joints to if they had come from 0 by an offset alone.
    Some(DigitSeen { in_contact, load, error_rad, closed_rad: closed_rad / weights })
}

#[cfg(test)]
mod tests;
