//! What a plan asks for: its trials in order, and where each begins.

use std::{collections::BTreeSet, f64::consts::PI};

use palpate_wire::api::{CampaignPlan, TrialOrder, TrialStart};
use rand::{RngExt as _, SeedableRng as _, seq::SliceRandom as _};
use rand_chacha::ChaCha8Rng;

use crate::TrialsError;

/// Most trials of a campaign.
pub const MAX_TRIALS: usize = 10_000;
/// Widest region in which objects are placed, half of its edge, m: far beyond what the arm reaches.
const MAX_HALF_WIDTH_M: f64 = 1.0;
/// Longest text of a plan, bytes.
const MAX_TEXT_BYTES: usize = 500;
/// The stream of random numbers that orders trials; those of starts are numbered by object and start.
const ORDER_STREAM: u64 = u64::MAX;

/// A trial by its place in the plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PlannedTrial {
    /// Index of the policy.
    pub policy: usize,
    /// Index of the object.
    pub object: usize,
    /// Which of the object's starts, from 0.
    pub start: u32,
}

/// Refuses a plan that nobody could carry out, and says which field is wrong.
///
/// # Errors
/// The first field that is wrong.
pub fn check_plan(plan: &CampaignPlan) -> Result<(), TrialsError> {
    let wrong = |field: String, problem: &str| Err(TrialsError::Argument(format!("{field} {problem}")));
    if plan.policies.is_empty() {
        return wrong("policies".into(), "is empty; a campaign tries at least one policy");
    }
    if plan.objects.is_empty() {
        return wrong("objects".into(), "is empty; a campaign needs at least one object");
    }
    let policies = plan.policies.iter().map(|policy| ("policies", policy.id.as_str()));
    let objects = plan.objects.iter().map(|object| ("objects", object.id.as_str()));
    let mut known = BTreeSet::new();
    for (list, id) in policies.chain(objects) {
        if let Err(problem) = palpate_recording::files::check_name(id) {
            return wrong(format!("{list}: id {id:?}"), &problem);
        }
        if !known.insert((list, id)) {
            return wrong(format!("{list}: id {id:?}"), "is there twice; give each its own id");
        }
    }
    let texts = plan.policies.iter().map(|policy| policy.source.as_str());
    for text in texts.chain([plan.name.as_str(), plan.criterion.as_str()]) {
        if text.len() > MAX_TEXT_BYTES {
            return wrong(
                format!("the text {:?}...", text.chars().take(20).collect::<String>()),
                "is too long; expected at most 500 bytes",
            );
        }
    }
    if let Some(policy) = plan.policies.iter().find(|policy| policy.source.trim().is_empty()) {
        return wrong(
            format!("policies: source of {:?}", policy.id),
            "is empty; give a policy file, or script:NAME",
        );
    }
    let trials = (plan.policies.len() * plan.objects.len()).saturating_mul(plan.starts as usize);
    if trials == 0 || trials > MAX_TRIALS {
        return wrong(
            format!("starts is {} and gives {trials} trials;", plan.starts),
            &format!("expected 1 to {MAX_TRIALS} trials (policies x objects x starts)"),
        );
    }
    if !(0.0..=MAX_HALF_WIDTH_M).contains(&plan.half_width_m) {
        return wrong(format!("half_width_m is {},", plan.half_width_m), "expected 0 to 1 m");
    }
    if !(1..=2).contains(&plan.scorers) {
        return wrong(format!("scorers is {},", plan.scorers), "expected 1 or 2");
    }
    if !(plan.alpha > 0.0 && plan.alpha < 1.0) {
        return wrong(format!("alpha is {},", plan.alpha), "expected more than 0 and less than 1, e.g. 0.05");
    }
    Ok(())
}

/// The trials of `plan` in the order in which they are made. The same plan gives the same order.
pub fn trials_of(plan: &CampaignPlan) -> Vec<PlannedTrial> {
    let mut rng = random_numbers(plan.seed, ORDER_STREAM);
    let mut objects: Vec<usize> = (0..plan.objects.len()).collect();
    objects.shuffle(&mut rng);
    let mut blocks: Vec<(usize, u32)> =
        objects.iter().flat_map(|&object| (0..plan.starts).map(move |start| (object, start))).collect();
    match plan.order {
        TrialOrder::Interleaved => blocks.shuffle(&mut rng),
        TrialOrder::ByObject => {
            blocks.chunk_by_mut(|a, b| a.0 == b.0).for_each(|starts| starts.shuffle(&mut rng));
        }
    }
    let mut policies: Vec<usize> = (0..plan.policies.len()).collect();
    let mut trials = Vec::with_capacity(blocks.len() * policies.len());
    for (object, start) in blocks {
        policies.shuffle(&mut rng);
        trials.extend(policies.iter().map(|&policy| PlannedTrial { policy, object, start }));
    }
    trials
}

/// Where the object number `object` lies at its start number `start`: the same for every policy, whatever else is planned.
pub fn start_of(plan: &CampaignPlan, object: usize, start: u32) -> TrialStart {
    let mut rng = random_numbers(plan.seed, (object as u64) << 32 | u64::from(start));
    let mut within = |half: f64| half * (2.0 * rng.random::<f64>() - 1.0);
    let (x_m, y_m, yaw_rad) = (within(plan.half_width_m), within(plan.half_width_m), within(PI));
    TrialStart { x_m, y_m, yaw_rad, side: rng.random(), seed: u64::from(rng.random::<u32>()) }
}

fn random_numbers(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    rng
}
