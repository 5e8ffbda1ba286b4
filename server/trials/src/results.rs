//! What the verdicts of a campaign say.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

use palpate_statistics::{
    Decision, Pairs, SequentialTest, barnard_exact, clopper_pearson, cohens_kappa, mcnemar_exact, pass_hat_k,
    wilson,
};
use palpate_wire::api::{
    Agreement, Attempt, CampaignResults, FailureModes, ObjectResult, PassHatK, PolicyComparison,
    PolicyResult, PublishedResult, SequentialResult, SuccessRate, TrialVerdict,
};

use crate::{TrialsError, campaign::State, plan::PlannedTrial};

const CONFIDENCE: f64 = 0.95;
/// Most pairs that the sequential test plans for: planning takes time with their cube, 200 take seconds.
const MAX_SEQUENTIAL_PAIRS: u64 = 200;
/// Sequential tests that are remembered.
const MAX_REMEMBERED_TESTS: usize = 8;

/// The results of a campaign.
pub(crate) fn of(state: &State, published: &[PublishedResult]) -> Result<CampaignResults, TrialsError> {
    let plan = &state.plan;
    let policies =
        (0..plan.policies.len()).map(|policy| policy_result(state, policy)).collect::<Result<_, _>>()?;
    let mut comparisons = Vec::new();
    for a in 0..plan.policies.len() {
        for b in a + 1..plan.policies.len() {
            comparisons.push(compare(state, a, b)?);
        }
    }
    Ok(CampaignResults {
        campaign: state.id.clone(),
        planned: state.planned.len() as u64,
        scored: u64::from(state.summary().scored),
        policies,
        comparisons,
        agreement: agreement(state)?,
        published: published.to_vec(),
    })
}

/// The trials of a campaign with their attempts.
fn trials(state: &State) -> impl Iterator<Item = (&PlannedTrial, &[Attempt])> {
    state.planned.iter().zip(state.attempts.iter().map(Vec::as_slice))
}

/// The verdict of a trial, void ones left out.
fn verdict(attempts: &[Attempt]) -> Option<TrialVerdict> {
    attempts.last().and_then(|last| last.verdict).filter(|verdict| *verdict != TrialVerdict::Void)
}

/// The rate of `successes` of `trials`.
pub(crate) fn rate(successes: u64, trials: u64) -> Result<SuccessRate, TrialsError> {
    let interval = |interval: palpate_statistics::Interval| [interval.low, interval.high];
    Ok(SuccessRate {
        successes,
        trials,
        rate: (trials > 0).then(|| successes as f64 / trials as f64),
        wilson_95: interval(wilson(successes, trials, CONFIDENCE)?),
        clopper_pearson_95: interval(clopper_pearson(successes, trials, CONFIDENCE)?),
    })
}

impl From<palpate_statistics::StatisticsError> for TrialsError {
    fn from(err: palpate_statistics::StatisticsError) -> Self {
        Self::Argument(err.to_string())
    }
}

fn policy_result(state: &State, policy: usize) -> Result<PolicyResult, TrialsError> {
    let mut objects = Vec::new();
    for (idx, object) in state.plan.objects.iter().enumerate() {
        let mut failures = FailureModes::default();
        let (mut successes, mut scored, mut void, mut open) = (0, 0, 0, 0);
        for (_, attempts) in trials(state).filter(|(trial, _)| trial.policy == policy && trial.object == idx)
        {
            void +=
                attempts.iter().filter(|attempt| attempt.verdict == Some(TrialVerdict::Void)).count() as u64;
            open += u64::from(attempts.last().is_none_or(|last| last.verdict.is_none()));
            let counted = match verdict(attempts) {
                None | Some(TrialVerdict::Void) => continue,
                Some(TrialVerdict::Success) => &mut successes,
                Some(TrialVerdict::EmptyGrasp) => &mut failures.empty_grasp,
                Some(TrialVerdict::Slip) => &mut failures.slip,
                Some(TrialVerdict::EmergencyStop) => &mut failures.emergency_stop,
            };
            *counted += 1;
            scored += 1;
        }
        objects.push(ObjectResult {
            object: object.id.clone(),
            group: object.group.clone(),
            rate: rate(successes, scored)?,
            failures,
            void,
            open,
        });
    }
    let of_group = |group: &str| -> Vec<&ObjectResult> {
        objects.iter().filter(|object| object.group.as_deref() == Some(group)).collect()
    };
    let failures = objects.iter().fold(FailureModes::default(), |sum, object| FailureModes {
        empty_grasp: sum.empty_grasp + object.failures.empty_grasp,
        slip: sum.slip + object.failures.slip,
        emergency_stop: sum.emergency_stop + object.failures.emergency_stop,
    });
    Ok(PolicyResult {
        policy: state.plan.policies[policy].id.clone(),
        seen: together(&of_group("seen"))?,
        unseen: together(&of_group("unseen"))?,
        overall: together(&objects.iter().collect::<Vec<_>>())?.map_or_else(|| rate(0, 0), Ok)?,
        failures,
        void: objects.iter().map(|object| object.void).sum(),
        open: objects.iter().map(|object| object.open).sum(),
        median_time_to_grasp_s: median_time_to_grasp_s(state, policy),
        pass_hat_k: all_in_a_row(&objects)?,
        objects,
    })
}

fn together(objects: &[&ObjectResult]) -> Result<Option<SuccessRate>, TrialsError> {
    if objects.is_empty() {
        return Ok(None);
    }
    let sum = |count: fn(&SuccessRate) -> u64| objects.iter().map(|object| count(&object.rate)).sum();
    rate(sum(|rate| rate.successes), sum(|rate| rate.trials)).map(Some)
}

fn median_time_to_grasp_s(state: &State, policy: usize) -> Option<f64> {
    let mut times: Vec<f64> = trials(state)
        .filter(|(trial, attempts)| {
            trial.policy == policy && verdict(attempts) == Some(TrialVerdict::Success)
        })
        .filter_map(|(_, attempts)| attempts.last()?.outcome.as_ref()?.time_to_grasp_s)
        .collect();
    times.sort_by(f64::total_cmp);
    let middle = times.len() / 2;
    match times.len() {
        0 => None,
        len if len % 2 == 1 => Some(times[middle]),
        _ => Some(0.5 * (times[middle - 1] + times[middle])),
    }
}

/// pass^k of every k for which all objects have enough trials.
fn all_in_a_row(objects: &[ObjectResult]) -> Result<Vec<PassHatK>, TrialsError> {
    let fewest = objects.iter().map(|object| object.rate.trials).min().unwrap_or(0);
    let mut all = Vec::new();
    for k in 1..=fewest {
        let mut sum = 0.0;
        for object in objects {
            sum += pass_hat_k(object.rate.successes, object.rate.trials, k)?;
        }
        all.push(PassHatK { k, chance: sum / objects.len() as f64 });
    }
    Ok(all)
}

fn compare(state: &State, a: usize, b: usize) -> Result<PolicyComparison, TrialsError> {
    // By object and start, with the later of the two trials' places in the order.
    let mut starts: BTreeMap<(usize, u32), [Option<bool>; 2]> = BTreeMap::new();
    let mut order: Vec<(usize, u32)> = Vec::new();
    let mut totals = [(0, 0), (0, 0)];
    for (trial, attempts) in trials(state) {
        let side = match trial.policy {
            policy if policy == a => 0,
            policy if policy == b => 1,
            _ => continue,
        };
        let Some(verdict) = verdict(attempts) else { continue };
        let has_won = verdict == TrialVerdict::Success;
        totals[side].0 += u64::from(has_won);
        totals[side].1 += 1;
        let key = (trial.object, trial.start);
        let pair = starts.entry(key).or_default();
        pair[side] = Some(has_won);
        if pair.iter().all(Option::is_some) {
            order.push(key);
        }
    }
    let pairs: Vec<[bool; 2]> = order
        .iter()
        .filter_map(|key| match starts.get(key) {
            Some([Some(a), Some(b)]) => Some([*a, *b]),
            _ => None,
        })
        .collect();
    let count = |wanted: [bool; 2]| pairs.iter().filter(|pair| **pair == wanted).count() as u64;
    let (both, only_a, only_b) = (count([true, true]), count([true, false]), count([false, true]));
    let has_both = totals.iter().all(|(_, trials)| *trials > 0);
    let id = |policy: usize| state.plan.policies[policy].id.clone();
    Ok(PolicyComparison {
        a: id(a),
        b: id(b),
        pairs: pairs.len() as u64,
        both,
        only_a,
        only_b,
        p_mcnemar: mcnemar_exact(only_a, only_b),
        p_barnard: if has_both { Some(barnard_exact(totals[0], totals[1])?) } else { None },
        sequential: sequential(state, &pairs, [id(a), id(b)])?,
    })
}

/// The sequential test on pairs in the order in which they were planned. It plans for all pairs of the campaign, which are
/// fixed with its plan.
fn sequential(state: &State, pairs: &[[bool; 2]], ids: [String; 2]) -> Result<SequentialResult, TrialsError> {
    let plan = &state.plan;
    let max_pairs = (plan.objects.len() as u64 * u64::from(plan.starts)).min(MAX_SEQUENTIAL_PAIRS);
    let test = planned_test(max_pairs, plan.alpha)?;
    let mut seen = Pairs { pairs: 0, successes_a: 0, successes_b: 0 };
    let mut decision = Decision::Undecided;
    for [a, b] in pairs.iter().take(max_pairs as usize) {
        seen.pairs += 1;
        seen.successes_a += u64::from(*a);
        seen.successes_b += u64::from(*b);
        decision = test.decide(seen)?;
        // The first decision stands, whatever comes later.
        if decision != Decision::Undecided {
            break;
        }
    }
    let [id_a, id_b] = ids;
    Ok(SequentialResult {
        max_pairs,
        alpha: plan.alpha,
        better: match decision {
            Decision::A => Some(id_a),
            Decision::B => Some(id_b),
            _ => None,
        },
        is_exhausted: decision == Decision::Exhausted,
        pairs_to_settle: test.pairs_to_settle(seen)?,
    })
}

/// A test that was planned before, or a new one.
fn planned_test(max_pairs: u64, alpha: f64) -> Result<Arc<SequentialTest>, TrialsError> {
    type Remembered = Vec<(u64, u64, Arc<SequentialTest>)>;
    static TESTS: Mutex<Remembered> = Mutex::new(Vec::new());
    let mut tests = TESTS.lock().unwrap_or_else(PoisonError::into_inner);
    let key = (max_pairs, alpha.to_bits());
    if let Some((.., test)) = tests.iter().find(|(pairs, alpha, _)| (*pairs, *alpha) == key) {
        return Ok(test.clone());
    }
    let test = Arc::new(SequentialTest::plan(max_pairs, alpha)?);
    if tests.len() >= MAX_REMEMBERED_TESTS {
        tests.remove(0);
    }
    tests.push((key.0, key.1, test.clone()));
    Ok(test)
}

/// How the two scorers agree who scored most attempts together.
fn agreement(state: &State) -> Result<Option<Agreement>, TrialsError> {
    let mut by_pair: BTreeMap<[&str; 2], [[u64; 5]; 5]> = BTreeMap::new();
    let index =
        |verdict: TrialVerdict| TrialVerdict::ALL.iter().position(|other| *other == verdict).unwrap_or(0);
    let mut to_settle = Vec::new();
    for ((_, attempts), number) in trials(state).zip(1..) {
        for attempt in attempts {
            let [first, second] = attempt.scores.as_slice() else { continue };
            let mut pair = [first, second];
            pair.sort_by(|a, b| a.scorer.cmp(&b.scorer));
            let counts = by_pair.entry(pair.map(|score| score.scorer.as_str())).or_default();
            counts[index(pair[0].verdict)][index(pair[1].verdict)] += 1;
        }
        let last = attempts.last();
        if last.is_some_and(|last| last.verdict.is_none() && last.scores.len() >= 2) {
            to_settle.push(number);
        }
    }
    let total = |counts: &[[u64; 5]; 5]| counts.iter().flatten().sum::<u64>();
    // The first of several with the most, in the order of names.
    let most = by_pair.iter().rev().max_by_key(|(_, counts)| total(counts));
    let Some((scorers, counts)) = most else { return Ok(None) };
    Ok(Some(Agreement {
        scorers: scorers.map(str::to_owned),
        attempts: total(counts),
        agreed: (0..5).map(|idx| counts[idx][idx]).sum(),
        kappa: cohens_kappa(counts)?,
        to_settle,
    }))
}
