//! What a try felt like, as numbers.

use super::Skill;
use crate::Observation;

/// Numbers about a stretch of time, while the hand closes or lifts: of touch, then of tracking errors.
///
/// Touch, for each digit and then for the rest of the hand: the largest share of its channels that was active, the share at
/// the end, and how early the first was (1 at once, 0 never). Tracking: the error (command minus reading) of each hand joint
/// at the end, rad or m, and how early each digit was stopped.
#[derive(Clone, Debug, PartialEq)]
pub struct Felt {
    /// Length 3 (digits + 1).
    pub touch: Vec<f32>,
    /// Length hand joints + digits.
    pub tracking: Vec<f32>,
}

/// Gathers what is felt step by step.
#[derive(Clone, Debug)]
pub(super) struct Feeling {
    began_s: f64,
    longest_s: f64,
    most: Vec<f32>,
    now: Vec<f32>,
    first_s: Vec<Option<f64>>,
    errors: Vec<f32>,
    stopped_s: Vec<Option<f64>>,
}

impl Feeling {
    /// From `began_s` on, over about `longest_s`.
    pub(super) fn new(skill: &Skill, began_s: f64, longest_s: f64) -> Self {
        let groups = skill.num_digits + 1;
        Self {
            began_s,
            longest_s: longest_s.max(f64::MIN_POSITIVE),
            most: vec![0.0; groups],
            now: vec![0.0; groups],
            first_s: vec![None; groups],
            errors: vec![0.0; skill.hand_dofs.len()],
            stopped_s: vec![None; skill.num_digits],
        }
    }

    pub(super) fn look(&mut self, skill: &Skill, now: &Observation<'_>) {
        self.now.fill(0.0);
        for (group, _) in skill.group_of_channel.iter().zip(now.active).filter(|(_, active)| **active) {
            self.now[*group] += 1.0 / skill.channels_of_group[*group];
            self.first_s[*group].get_or_insert(now.time_s);
        }
        for (most, now) in self.most.iter_mut().zip(&self.now) {
            *most = most.max(*now);
        }
        for (error, &dof) in self.errors.iter_mut().zip(&skill.hand_dofs) {
            let off = now.commands[dof] - now.positions[dof];
            *error = off as f32;
            if let Some(digit) = skill.digit_of_dof[dof]
                && off.abs() > skill.config.stopped_error
            {
                self.stopped_s[digit].get_or_insert(now.time_s);
            }
        }
    }

    pub(super) fn felt(&self) -> Felt {
        let early = |first_s: &Option<f64>| {
            first_s.map_or(0.0, |at_s| (1.0 - (at_s - self.began_s) / self.longest_s).clamp(0.0, 1.0) as f32)
        };
        Felt {
            touch: self.most.iter().chain(&self.now).copied().chain(self.first_s.iter().map(early)).collect(),
            tracking: self.errors.iter().copied().chain(self.stopped_s.iter().map(early)).collect(),
        }
    }

    /// Whether each digit feels something or is stopped by something in `now`.
    pub(super) fn contacts(skill: &Skill, now: &Observation<'_>) -> Vec<bool> {
        let mut contacts = vec![false; skill.num_digits];
        for (group, active) in skill.group_of_channel.iter().zip(now.active) {
            if let (true, Some(contact)) = (*active, contacts.get_mut(*group)) {
                *contact = true;
            }
        }
        for &dof in &skill.hand_dofs {
            if let Some(digit) = skill.digit_of_dof[dof] {
                contacts[digit] |=
                    (now.commands[dof] - now.positions[dof]).abs() > skill.config.stopped_error;
            }
        }
        contacts
    }
}
