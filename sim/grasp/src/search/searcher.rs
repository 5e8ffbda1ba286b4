//! The controller that searches.

use std::sync::Arc;

use super::skill::{Stage, Try};
use super::{Attempt, Belief, Experience, Moment, Skill};
use crate::controller::{Command, Controller, Observation};

/// How far a belief's grid reaches beyond the region that objects start in, m: what is pushed further is gone.
const BEYOND_M: f64 = 0.1;
/// Share of the mass from which on an object is believed to be out of the grid, and the search begins again from the start.
const GONE: f64 = 0.9;
/// Time after which a lifted object that is held would have ended a trial, beyond the hold itself, s.
const SLACK_S: f64 = 0.15;

/// What a searcher believes before it has tried.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    /// Half the edge length of the square that the object starts in, m.
    pub half_width_m: f64,
    /// Number of its shape in the experience, where it is known.
    pub shape: Option<usize>,
}

/// Searches for an object and grasps it.
///
/// At every decision it plans anew from the commands of that moment, whatever they are. It lifts when that makes success likelier
/// within the time that is left than trying elsewhere does, taking every later try to succeed as likely as the best next one.
#[derive(Clone, Debug)]
pub struct Searcher {
    skill: Arc<Skill>,
    experience: Arc<Experience>,
    prior: Belief,
    belief: Belief,
    state: State,
    num_tries: usize,
}

#[derive(Clone, Debug)]
enum State {
    Thinking,
    Trying(Try),
    Lifting(Try, Attempt),
    Holding { lift: Try, attempt: Attempt, until_s: f64 },
    Done(Vec<f64>),
}

impl Searcher {
    /// A searcher that has not moved yet.
    pub fn new(skill: Arc<Skill>, experience: Arc<Experience>, prior: &Prior) -> Self {
        let prior = Belief::even(&experience, prior.half_width_m, BEYOND_M, prior.shape);
        Self { belief: prior.clone(), prior, skill, experience, state: State::Thinking, num_tries: 0 }
    }

    /// What it believes now about the object.
    pub fn belief(&self) -> &Belief {
        &self.belief
    }

    /// Tries begun so far.
    pub fn num_tries(&self) -> usize {
        self.num_tries
    }

    /// Chance of success within `left_s` for tries that take `each_s` and succeed with probability `chance`.
    fn chance_within(chance: f64, each_s: f64, left_s: f64) -> f64 {
        let tries = (left_s / each_s + 1e-6).floor().max(0.0);
        1.0 - (1.0 - chance.clamp(0.0, 1.0)).powf(tries)
    }

    /// Chance of success when the hand lets go at `commands` and goes on from `belief`, with `left_s` to go.
    fn chance_elsewhere(&self, belief: &Belief, commands: &[f64], left_s: f64) -> f64 {
        let (place, chance) = belief.best_place(&self.experience, &self.skill);
        let each_s = self.skill.try_s(commands, place) + self.skill.lift_s(place) + self.skill.hold_s;
        Self::chance_within(chance, each_s, left_s)
    }

    fn begin(&mut self, now: &Observation<'_>) -> Try {
        if self.belief.gone() > GONE {
            self.belief = self.prior.clone();
        }
        if let Some(place_m) = now.told_place_m {
            self.belief = self.belief.told(place_m);
        }
        let (place, _) = self.belief.best_place(&self.experience, &self.skill);
        self.num_tries += 1;
        Try::new(&self.skill, now.commands, place, now.time_s)
    }

    /// Whether to go on closing after a glance that felt so, rather than to go elsewhere at once.
    fn goes_on(&self, attempt: &Attempt, place: usize, now: &Observation<'_>) -> bool {
        let left_s = self.skill.episode_s - now.time_s;
        let rest_s = self.skill.rest_s();
        let in_time = left_s >= rest_s + self.skill.lift_s(place) + self.skill.hold_s;
        let held = if in_time { attempt.held(&self.experience) } else { 0.0 };
        let missed = attempt.lost(&self.experience).belief(&self.experience, Moment::Closed);
        let after = self.chance_elsewhere(&missed, now.commands, left_s - rest_s);
        let here = attempt.belief(&self.experience, Moment::Glanced);
        held + (1.0 - held) * after >= self.chance_elsewhere(&here, now.commands, left_s)
    }

    /// Whether to lift after a closing that felt so, rather than to go elsewhere.
    fn lifts(&self, attempt: &Attempt, place: usize, now: &Observation<'_>) -> bool {
        let left_s = self.skill.episode_s - now.time_s;
        let lift_s = self.skill.lift_s(place) + self.skill.hold_s;
        let held = attempt.held(&self.experience);
        let elsewhere = attempt.lost(&self.experience).belief(&self.experience, Moment::Closed);
        // What an empty lift leaves time for.
        let after = self.chance_elsewhere(&elsewhere, now.commands, left_s - lift_s);
        let here = attempt.belief(&self.experience, Moment::Closed);
        held + (1.0 - held) * after >= self.chance_elsewhere(&here, now.commands, left_s)
    }
}

impl Controller for Searcher {
    fn control(&mut self, now: &Observation<'_>) -> Command {
        let left_s = self.skill.episode_s - now.time_s;
        loop {
            let state = std::mem::replace(&mut self.state, State::Thinking);
            match state {
                State::Thinking => self.state = State::Trying(self.begin(now)),
                State::Trying(mut one) => {
                    let (stage, targets) = one.go_on(&self.skill, now);
                    let place_m = self.skill.places()[one.place].at_m;
                    if let Stage::Glanced(felt) = &stage {
                        let attempt = self.belief.glance(&self.experience, place_m, felt);
                        if !self.goes_on(&attempt, one.place, now) {
                            self.belief = attempt.belief(&self.experience, Moment::Glanced);
                            continue;
                        }
                    }
                    let Stage::Closed(felt) = stage else {
                        self.state = State::Trying(one);
                        return Command { targets, claims_held: false };
                    };
                    let attempt = self.belief.attempt(&self.experience, place_m, &felt);
                    if self.lifts(&attempt, one.place, now) {
                        one.lift(&self.skill, now.commands, now.time_s);
                        self.state = State::Lifting(one, attempt);
                    } else {
                        self.belief = attempt.belief(&self.experience, Moment::Closed);
                    }
                }
                State::Lifting(mut lift, attempt) => {
                    let (stage, targets) = lift.go_on(&self.skill, now);
                    let Stage::Lifted(felt) = stage else {
                        self.state = State::Lifting(lift, attempt);
                        return Command { targets, claims_held: false };
                    };
                    let attempt = attempt.lifted(&self.experience, &felt);
                    let held = attempt.held(&self.experience);
                    let belief = attempt.lost(&self.experience).belief(&self.experience, Moment::Lifted);
                    let elsewhere = self.chance_elsewhere(&belief, now.commands, left_s);
                    let after = self.chance_elsewhere(&belief, now.commands, left_s - self.skill.hold_s);
                    if held + (1.0 - held) * after >= elsewhere {
                        // A control step for the lift that comes to its end with this one.
                        let until_s = now.time_s + self.skill.hold_s + SLACK_S;
                        self.state = State::Holding { lift, attempt, until_s };
                    } else {
                        self.belief = belief;
                    }
                }
                State::Holding { mut lift, attempt, until_s } => {
                    let (stage, targets) = lift.go_on(&self.skill, now);
                    if now.time_s < until_s {
                        self.state = State::Holding { lift, attempt, until_s };
                        return Command { targets, claims_held: false };
                    }
                    let lost = attempt.lost(&self.experience).belief(&self.experience, Moment::Lifted);
                    if !self.skill.one_claim {
                        // A held object would have ended the trial.
                        self.belief = lost;
                        continue;
                    }
                    let Stage::Lifted(felt) = stage else { continue };
                    let held = attempt.lifted(&self.experience, &felt).held(&self.experience);
                    if held >= self.skill.config.claim_from {
                        self.state = State::Done(targets.clone());
                        return Command { targets, claims_held: true };
                    }
                    if held < self.chance_elsewhere(&lost, now.commands, left_s) {
                        self.belief = lost;
                        continue;
                    }
                    self.state = State::Holding { lift, attempt, until_s };
                    return Command { targets, claims_held: false };
                }
                State::Done(targets) => {
                    self.state = State::Done(targets.clone());
                    return Command { targets, claims_held: true };
                }
            }
        }
    }
}
