//! The experiment that a diagnosis asks for, as a plan of a session of its own.

use std::collections::BTreeSet;

use palpate_motion::{Experiment, Plan, Primitive, Primitives, experiment_plan, plan_text};
use palpate_recording::{Session, Take};
use palpate_reports::{NextExperiment, Purpose};
use palpate_robot_model::{PoseConfig, Station};

use super::accepted_takes;
use crate::{Error, assets, data::library::Library};
use palpate_sim::job::Cancel;

/// Repetitions of a motion that is recorded because nothing repeats.
const REPEATED: usize = 3;

/// The text of a plan, called `id`, that records `next` on the station of `sessions`, which were diagnosed. Where no plan of the
/// station has the motion, it touches what the sessions touched by it.
pub fn next_plan(
    library: &Library,
    sessions: &[Session],
    next: &NextExperiment,
    id: &str,
) -> Result<String, Error> {
    let mut of_motion: Vec<Take> = Vec::new();
    for session in sessions {
        accepted_takes(library, session, &Cancel::default(), |take_idx, _| {
            let take = library.take(session, take_idx)?;
            if take.meta.object == next.object && take.meta.primitive == next.primitive {
                of_motion.push((*take).clone());
            }
            Ok(())
        })?;
    }
    let Some(first) = of_motion.first() else {
        return Err(Error::Content(format!(
            "no take of {} on {} is left in the session; its station would have said how to record one",
            next.primitive, next.object
        )));
    };
    let mut station = first.station.clone();
    let mut touched: BTreeSet<usize> = BTreeSet::new();
    for take in &of_motion {
        let active = take.active_at_frames();
        let channels = active.iter().enumerate().filter(|(_, is_active)| **is_active);
        touched.extend(channels.map(|(idx, _)| idx % station.layout.num_channels()));
    }
    let touched: Vec<String> =
        touched.into_iter().map(|channel| station.layout.channels[channel].id.clone()).collect();
    let base_from_object = first.object_poses.poses.first().unwrap_or(&first.meta.base_from_object);
    let rotation = base_from_object.rotation.quaternion();
    let pose = PoseConfig {
        position_m: base_from_object.translation.vector.into(),
        quaternion_wxyz: [rotation.w, rotation.i, rotation.j, rotation.k],
    };
    if station.plans.is_empty() {
        let plan = plan_of_take(&station, first, pose)?;
        station.plans.push((plan.id.clone(), plan_text(&plan, &station, &[])));
    }
    let station = &station;
    let wanted = Experiment {
        primitive: &next.primitive,
        object: &next.object,
        repetitions: if next.purpose == Purpose::Repeat { REPEATED } else { 1 },
        object_pose: Some(pose),
        touched: &touched,
    };
    let ours = |err: palpate_motion::PlanError| Error::Content(err.to_string());
    let shipped = shipped_primitives()?;
    let plan = match experiment_plan(station, &shipped, &wanted, id) {
        Ok(plan) => plan,
        Err(err) => {
            // What is felt in passing need not be what can be touched by itself.
            let can_be_touched = |channel: &&String| {
                let one = [(*channel).clone()];
                experiment_plan(station, &shipped, &Experiment { touched: &one, ..wanted.clone() }, id)
                    .is_ok()
            };
            let touched: Vec<String> = touched.iter().filter(can_be_touched).cloned().collect();
            if touched.is_empty() {
                return Err(ours(err));
            }
            experiment_plan(station, &shipped, &Experiment { touched: &touched, ..wanted.clone() }, id)
                .map_err(ours)?
        }
    };
    let names: Vec<&str> = sessions.iter().map(|session| session.id.as_str()).collect();
    let text = plan_text(
        &plan,
        station,
        &[
            format!("Made by `palpate diagnose --plan` from the diagnosis of {}:", names.join(" + ")),
            next.sentence.clone(),
            "To record it: name it in `plans` of the station file, or in a truth file, and record by it. Then diagnose both:"
                .to_owned(),
            "palpate diagnose --session FIRST --session NEW --model MODEL_OF_THE_FIRST.toml --out MODEL.toml".to_owned(),
        ],
    );
    // As it will be read.
    Plan::from_text(&format!("{id}.toml"), &text).and_then(|plan| plan.check(station)).map_err(ours)?;
    Ok(text)
}

/// A plan by which a station moves that names none: from where `take` began, as the shipped plans do.
fn plan_of_take(station: &Station, take: &Take, pose: PoseConfig) -> Result<Plan, Error> {
    const LIKE: &str = "plans/quick_check.toml";
    let text = assets::text(LIKE).ok_or_else(|| Error::Internal(format!("{LIKE} is not shipped")))?;
    let mut plan = Plan::from_text(LIKE, text).map_err(|err| Error::Internal(err.to_string()))?;
    let joints = station.robot.dofs().zip(&take.joints.positions);
    plan.motion.rest = joints
        .filter(|(joint, _)| joint.mimic.is_none())
        .map(|(joint, &position)| {
            // Encoders may say a little more than the limits.
            let within = joint.limits.map_or(position, |limits| position.clamp(limits.lower, limits.upper));
            (joint.name.clone(), within)
        })
        .collect();
    plan.motion.away.clear();
    plan.objects = [(take.meta.object.clone(), pose)].into();
    // A plan file has a take; this one is of no motion that anybody asks for.
    plan.takes.truncate(1);
    for planned in &mut plan.takes {
        take.meta.object.clone_into(&mut planned.object);
        "none".clone_into(&mut planned.primitive);
        planned.touch = station.layout.channels.iter().take(1).map(|channel| channel.id.clone()).collect();
    }
    plan.primitives.clear();
    "session".clone_into(&mut plan.id);
    Ok(plan)
}

/// The primitives that come with Palpate.
fn shipped_primitives() -> Result<Primitives, Error> {
    let read = |id: &str| {
        let path = format!("primitives/{id}.toml");
        let text = assets::text(&path).ok_or_else(|| Error::Internal(format!("{path} is not shipped")))?;
        let primitive = Primitive::from_text(&path, text).map_err(|err| Error::Internal(err.to_string()))?;
        Ok((id.to_owned(), primitive))
    };
    assets::names_in("primitives", ".toml").into_iter().map(read).collect()
}
