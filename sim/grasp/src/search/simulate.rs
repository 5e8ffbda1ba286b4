//! Closings, simulated.

use std::sync::Arc;

use rayon::prelude::*;

use super::experience::Closing;
use super::skill::{Stage, Try};
use super::{Felt, Skill};
use crate::controller::Observation;
use crate::env::stream;
use crate::trial::{Judge, Outcome};
use crate::{GraspEnv, GraspError, GraspScene, Start};

/// Time after a lift in which what is held can be held for long enough, beyond the hold itself, s.
const SLACK_S: f64 = 0.5;

/// Closings number 0 to `count` of those with `seed` and `shape`, each at the place in the middle of the region, with the
/// object within `window_m` of it along both axes and physics randomised as in trials. Closings that ended in an emergency
/// stop count as lost.
///
/// The same seed gives the same bits for any number of threads.
///
/// # Errors
/// What keeps an episode from beginning or going on.
pub fn simulate(
    scene: &Arc<GraspScene>,
    skill: &Skill,
    shape: usize,
    window_m: f64,
    seed: u64,
    count: u64,
) -> Result<Vec<Closing>, GraspError> {
    (0..count).into_par_iter().map(|idx| one(scene, skill, shape, window_m, seed, idx)).collect()
}

fn one(
    scene: &Arc<GraspScene>,
    skill: &Skill,
    shape: usize,
    window_m: f64,
    seed: u64,
    idx: u64,
) -> Result<Closing, GraspError> {
    // Shapes have places of their own, so that chance does not favour the same ones for all.
    let mut rng = stream(seed, ((shape as u64) << 32) | idx);
    let mut start = Start::draw_within(scene, window_m, false, &mut rng);
    let place = skill.nearest([0.0, 0.0]);
    let raised = &skill.places()[place];
    for (dof, position) in start.positions.iter_mut().enumerate() {
        // The hand's own joints keep their noise about the posture in which the hand is carried.
        let noise = if scene.dofs_in_hand()[dof] { *position - scene.start_positions()[dof] } else { 0.0 };
        *position = raised.raised[dof] + noise;
    }
    let mut env = GraspEnv::at(Arc::clone(scene), &start, rng)?;
    let task = &scene.config().task;
    let seen_from = [task.center_m[0] + raised.at_m[0], task.center_m[1] + raised.at_m[1]];
    let place_of = |env: &GraspEnv| {
        let at = env.world().base_from_object().translation;
        [(at.x - seen_from[0]) as f32, (at.y - seen_from[1]) as f32]
    };
    let empty = |lengths: [usize; 2]| Felt { touch: vec![0.0; lengths[0]], tracking: vec![0.0; lengths[1]] };
    let start_m = place_of(&env);
    let mut closing = Closing {
        shape,
        start_m,
        glanced_m: start_m,
        closed_m: start_m,
        end_m: start_m,
        won: false,
        glance: empty(skill.num_felt()),
        closing: empty(skill.num_felt()),
        lifting: empty(skill.num_felt()),
    };
    let mut judge = Judge::new(env.world(), f64::INFINITY);
    let mut one = Try::new(skill, env.targets(), place, 0.0);
    let mut ends_s = f64::INFINITY;
    loop {
        let now = Observation {
            time_s: env.time_s(),
            positions: env.positions(),
            commands: env.targets(),
            active: &env.readings().active,
            strengths: None,
            told_place_m: None,
        };
        let (stage, targets) = one.go_on(skill, &now);
        match stage {
            Stage::Glanced(felt) => {
                closing.glance = felt;
                closing.glanced_m = place_of(&env);
            }
            Stage::Closed(felt) => {
                one.lift(skill, now.commands, now.time_s);
                closing.closing = felt;
                closing.closed_m = place_of(&env);
                continue;
            }
            Stage::Lifted(felt) if ends_s == f64::INFINITY => {
                closing.lifting = felt;
                ends_s = now.time_s + task.hold_s + SLACK_S;
            }
            _ => (),
        }
        match env.step(&targets) {
            Err(GraspError::Diverged { .. }) => break,
            other => other?,
        }
        let contacts = env.world().contacts();
        match judge.look(scene.config(), env.world(), &contacts) {
            Some(Outcome::Success) => {
                closing.won = true;
                // A slow lift may succeed before it has ended; what it feels like at its end is still to come.
                if ends_s < f64::INFINITY {
                    break;
                }
            }
            Some(_) => break,
            None => (),
        }
        if env.time_s() >= ends_s {
            break;
        }
    }
    let end_m = place_of(&env);
    // A simulation that diverged has no place.
    closing.end_m = if end_m.iter().all(|at_m| at_m.is_finite()) { end_m } else { closing.closed_m };
    Ok(closing)
}
