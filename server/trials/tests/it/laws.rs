//! What holds of every plan and every sequence of verdicts.

use std::collections::{BTreeMap, BTreeSet};

use palpate_trials::{Campaigns, start_of, trials_of};
use palpate_wire::api::{CampaignPlan, TrialOrder, TrialVerdict};
use proptest::prelude::*;

use super::{make, operator, plan};

fn any_plan() -> impl Strategy<Value = CampaignPlan> {
    (1..4_usize, 1..4_usize, 1..6_u32, any::<u64>(), any::<bool>()).prop_map(
        |(policies, objects, starts, seed, by_object)| {
            let policies = &["a", "b", "c"][..policies];
            let objects = &[("cube", "seen"), ("ring", "unseen"), ("egg", "seen")][..objects];
            let order = if by_object { TrialOrder::ByObject } else { TrialOrder::Interleaved };
            CampaignPlan { seed, order, ..plan(policies, objects, starts) }
        },
    )
}

proptest! {
    #[test]
    fn every_policy_is_tried_once_from_every_start(plan in any_plan()) {
        let trials = trials_of(&plan);
        let distinct: BTreeSet<_> = trials.iter().copied().collect();
        prop_assert_eq!(distinct.len(), trials.len());
        prop_assert_eq!(trials.len(), plan.policies.len() * plan.objects.len() * plan.starts as usize);
        // Policies stand together at each start, so that what drifts meanwhile hits all alike.
        for block in trials.chunks(plan.policies.len()) {
            prop_assert!(block.iter().all(|trial| (trial.object, trial.start) == (block[0].object, block[0].start)));
        }
        prop_assert_eq!(&trials, &trials_of(&plan));
    }

    #[test]
    fn starts_lie_in_the_region_and_do_not_depend_on_what_else_is_planned(plan in any_plan()) {
        let mut more = plan.clone();
        more.starts += 3;
        more.policies.truncate(1);
        more.order = TrialOrder::ByObject;
        for object in 0..plan.objects.len() {
            for start in 0..plan.starts {
                let at = start_of(&plan, object, start);
                prop_assert!(at.x_m.abs() <= plan.half_width_m && at.y_m.abs() <= plan.half_width_m);
                prop_assert!((0.0..1.0).contains(&at.side));
                prop_assert_eq!(at, start_of(&more, object, start));
            }
        }
    }
}

proptest! {
    // Every change waits for the disk.
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn results_count_every_trial_once(
        plan in any_plan(),
        verdicts in prop::collection::vec(prop::option::of(prop::sample::select(TrialVerdict::ALL.to_vec())), 54),
    ) {
        let dir = tempfile::tempdir().unwrap();
        let campaigns = Campaigns::new(dir.path(), Vec::new());
        let made = campaigns.create("c", plan.clone(), &operator()).unwrap();
        let mut counted: BTreeMap<(String, TrialVerdict), u64> = BTreeMap::new();
        for (trial, verdict) in made.trials.iter().zip(&verdicts) {
            if let Some(verdict) = verdict {
                make(&campaigns, "c", trial.number, *verdict);
                *counted.entry((trial.policy.clone().unwrap(), *verdict)).or_default() += 1;
            }
        }
        let results = campaigns.results("c", &operator()).unwrap();
        let of = |policy: &str, verdict| counted.get(&(policy.to_owned(), verdict)).copied().unwrap_or(0);
        for policy in &results.policies {
            let id = policy.policy.as_str();
            prop_assert_eq!(policy.overall.successes, of(id, TrialVerdict::Success));
            prop_assert_eq!(policy.failures.empty_grasp, of(id, TrialVerdict::EmptyGrasp));
            prop_assert_eq!(policy.failures.slip, of(id, TrialVerdict::Slip));
            prop_assert_eq!(policy.failures.emergency_stop, of(id, TrialVerdict::EmergencyStop));
            prop_assert_eq!(policy.void, of(id, TrialVerdict::Void));
            let planned = plan.objects.len() as u64 * u64::from(plan.starts);
            prop_assert_eq!(policy.overall.trials + policy.void + policy.open, planned);
            for rate in policy.objects.iter().map(|object| object.rate) {
                let [low, high] = rate.wilson_95;
                prop_assert!(rate.rate.is_none_or(|rate| low <= rate && rate <= high));
            }
        }
        for comparison in &results.comparisons {
            let neither = comparison.pairs - comparison.both - comparison.only_a - comparison.only_b;
            prop_assert!(neither <= comparison.pairs);
            prop_assert!((0.0..=1.0).contains(&comparison.p_mcnemar));
            prop_assert!(comparison.p_barnard.is_none_or(|p| (0.0..=1.0).contains(&p)));
        }
        prop_assert_eq!(results.comparisons.len(), plan.policies.len() * (plan.policies.len() - 1) / 2);
        // What is read again from disk says the same.
        drop(campaigns);
        let again = palpate_trials::results_of_folder(&dir.path().join("c"), &[]).unwrap();
        prop_assert_eq!(again, results);
    }
}
