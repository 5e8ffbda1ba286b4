//! A plan for one motion that is wanted: what a diagnosis asks for, as a session of its own.

use std::collections::{BTreeMap, BTreeSet};

use palpate_robot_model::{PoseConfig, Station};

use crate::{MotionLimits, Plan, PlanError, PlannedTake, Primitives, plan_take};

/// Fewer takes are recorded twice: a diagnosis keeps some of them for judging.
const FEWEST_TAKES: usize = 2;
/// Touches of a take whose plan is not known.
const MOST_TOUCHES: usize = 6;
/// Shortest duration that is asked for, s: takes are as long as their motions need.
const SHORTEST_S: f64 = 10.0;

/// The motion that is wanted.
#[derive(Clone, Debug)]
pub struct Experiment<'a> {
    /// Primitive id.
    pub primitive: &'a str,
    /// Object id.
    pub object: &'a str,
    /// Each touch is made at least so often, so that something repeats.
    pub repetitions: usize,
    /// Where the object was, for a plan that does not say.
    pub object_pose: Option<PoseConfig>,
    /// Channels that the motion touched, for a plan that does not say.
    pub touched: &'a [String],
}

/// A plan that records `wanted` on `station`, called `id`: takes of the first of the station's plans that has that motion, or
/// else, by the first plan that says how the robot moves, touches of the channels that it touched. Primitives that no plan has
/// come from `shipped`.
///
/// Refused where the station's plans do not say how it moves, where nobody knows the motion or what it touches, and where it
/// cannot be planned.
pub fn experiment_plan(
    station: &Station,
    shipped: &Primitives,
    wanted: &Experiment<'_>,
    id: &str,
) -> Result<Plan, PlanError> {
    let plans = Plan::of_station(station)?;
    let fits = |take: &&PlannedTake| take.object == wanted.object && take.primitive == wanted.primitive;
    let Some(from) = plans.iter().find(|plan| plan.takes.iter().any(|take| fits(&take))).or(plans.first())
    else {
        return Err(PlanError::new(
            &station.id,
            "plans",
            "the station has no plan, so nobody knows how it moves; name one in its station file, plans = [\"FILE.toml\"] \
             (docs/plans.md)",
        ));
    };
    let mut plan = from.clone();
    plan.file = format!("{id}.toml");
    id.clone_into(&mut plan.id);
    plan.label = format!("{} on {}, for a diagnosis", wanted.primitive, wanted.object);
    plan.takes.retain(|take| fits(&take));
    if plan.takes.is_empty() {
        plan.takes = takes_of(&plan, wanted)?;
    }
    let mut primitive = match from.primitives.get(wanted.primitive).or_else(|| shipped.get(wanted.primitive))
    {
        Some(primitive) => primitive.clone(),
        None => {
            let known: BTreeSet<&String> = from.primitives.keys().chain(shipped.keys()).collect();
            let known: Vec<&str> = known.into_iter().map(String::as_str).collect();
            let problem = format!(
                "no plan of the station has such a primitive, and none is shipped; there are {}; add it to a plan",
                known.join(", ")
            );
            return Err(PlanError::new(&plan.file, format!("primitive {:?}", wanted.primitive), problem));
        }
    };
    primitive.repetitions = primitive.repetitions.max(wanted.repetitions);
    plan.primitives = BTreeMap::from([(wanted.primitive.to_owned(), primitive)]);
    plan.primitives_dir = None;
    if let (None, Some(pose)) = (plan.objects.get(wanted.object), wanted.object_pose) {
        plan.objects.insert(wanted.object.to_owned(), pose);
    }
    plan.objects.retain(|object, _| object == wanted.object);
    while plan.takes.len() < FEWEST_TAKES {
        plan.takes.extend(plan.takes.clone());
    }
    let limits = MotionLimits::of(station);
    for take_idx in 0..plan.takes.len() {
        let motion = plan_take(station, &plan, &Primitives::new(), take_idx, Some(&limits))?;
        plan.takes[take_idx].duration_s = plan.takes[take_idx].duration_s.max(motion.duration_s().ceil());
    }
    Ok(plan)
}

/// Takes that touch what the motion touched.
fn takes_of(plan: &Plan, wanted: &Experiment<'_>) -> Result<Vec<PlannedTake>, PlanError> {
    if wanted.touched.is_empty() {
        let problem = "no plan of the station has this motion, and it touched nothing in this session; add such a [[take]] to a plan";
        let place = format!("{} on {}", wanted.primitive, wanted.object);
        return Err(PlanError::new(&plan.file, place, problem));
    }
    let take = |touch: &[String]| PlannedTake {
        object: wanted.object.to_owned(),
        primitive: wanted.primitive.to_owned(),
        duration_s: plan.motion.baseline_s + SHORTEST_S,
        touch: touch.to_vec(),
        instruction: String::new(),
    };
    Ok(wanted.touched.chunks(MOST_TOUCHES).map(take).collect())
}
