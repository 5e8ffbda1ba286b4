//! What may happen in a campaign, and what survives.

use std::{fs, io::Write as _};

use palpate_trials::{Campaigns, TrialsError, results_of_folder};
use palpate_wire::api::{TrialState, TrialVerdict};

use super::{make, operator, outcome, plan, says, scorer};

#[test]
fn campaign_goes_on_after_a_restart_and_asks_nothing_twice() {
    let dir = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::new(dir.path(), Vec::new());
    let made = campaigns.create("first", plan(&["a", "b"], &[("cube", "seen")], 2), &operator()).unwrap();
    assert_eq!((made.summary.planned, made.next), (4, Some(1)));
    make(&campaigns, "first", 1, TrialVerdict::Success);
    campaigns.begin("first", 2, &operator()).unwrap();
    let before = campaigns.campaign("first", &operator()).unwrap();

    let again = Campaigns::new(dir.path(), Vec::new());
    assert_eq!(again.campaign("first", &operator()).unwrap(), before);
    assert_eq!((before.next, before.trials[1].state), (Some(2), TrialState::Running));
    assert_eq!(again.list().unwrap(), vec![before.summary]);
}

#[test]
fn half_a_line_after_a_power_cut_is_left_out_and_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::new(dir.path(), Vec::new());
    campaigns.create("first", plan(&["a"], &[("cube", "seen")], 2), &operator()).unwrap();
    make(&campaigns, "first", 1, TrialVerdict::Slip);
    let before = campaigns.campaign("first", &operator()).unwrap();
    drop(campaigns);
    let log = dir.path().join("first/log.jsonl");
    fs::OpenOptions::new().append(true).open(&log).unwrap().write_all(b"{\"time\":\"2026").unwrap();

    let again = Campaigns::new(dir.path(), Vec::new());
    assert_eq!(again.campaign("first", &operator()).unwrap(), before);
    make(&again, "first", 2, TrialVerdict::Success);
    drop(again);
    let results = results_of_folder(&dir.path().join("first"), &[]).unwrap();
    assert_eq!((results.scored, results.policies[0].overall.successes), (2, 1));
}

#[test]
fn damaged_line_is_named_and_nothing_is_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::new(dir.path(), Vec::new());
    campaigns.create("first", plan(&["a"], &[("cube", "seen")], 2), &operator()).unwrap();
    make(&campaigns, "first", 1, TrialVerdict::Slip);
    drop(campaigns);
    let log = dir.path().join("first/log.jsonl");
    let text = fs::read_to_string(&log).unwrap().replacen("\"ended\"", "\"endet\"", 1);
    fs::write(&log, &text).unwrap();

    let again = Campaigns::new(dir.path(), Vec::new());
    let err = again.campaign("first", &operator()).unwrap_err().to_string();
    assert!(err.contains("line 2"), "{err}");
    assert!(again.list().unwrap()[0].error.is_some());
    assert!(again.begin("first", 2, &operator()).is_err());
    assert_eq!(fs::read_to_string(&log).unwrap(), text);
}

#[test]
fn void_trial_can_be_repeated_and_stays_in_the_table() {
    let dir = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::new(dir.path(), Vec::new());
    campaigns.create("first", plan(&["a"], &[("cube", "seen")], 1), &operator()).unwrap();
    make(&campaigns, "first", 1, TrialVerdict::Void);
    let void = campaigns.results("first", &operator()).unwrap();
    assert_eq!((void.policies[0].void, void.policies[0].overall.trials, void.scored), (1, 0, 1));
    make(&campaigns, "first", 1, TrialVerdict::Success);
    let repeated = campaigns.results("first", &operator()).unwrap();
    assert_eq!((repeated.policies[0].void, repeated.policies[0].overall.trials), (1, 1));
    let refused = campaigns.begin("first", 1, &operator()).unwrap_err();
    assert!(matches!(refused, TrialsError::Conflict(_)), "{refused}");
}

#[test]
fn one_trial_runs_at_a_time() {
    let dir = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::new(dir.path(), Vec::new());
    campaigns.create("first", plan(&["a"], &[("cube", "seen")], 3), &operator()).unwrap();
    campaigns.begin("first", 2, &operator()).unwrap();
    let err = campaigns.begin("first", 1, &operator()).unwrap_err().to_string();
    assert!(err.contains("trial 2 is running"), "{err}");
    assert!(campaigns.score("first", 2, &says(0, TrialVerdict::Slip), &operator()).is_err());
    assert!(matches!(campaigns.begin("first", 4, &operator()), Err(TrialsError::UnknownTrial { .. })));
    assert!(matches!(campaigns.begin("first", 0, &operator()), Err(TrialsError::UnknownTrial { .. })));
}

#[test]
fn paused_campaign_begins_no_trial_until_it_is_resumed() {
    let dir = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::new(dir.path(), Vec::new());
    campaigns.create("first", plan(&["a"], &[("cube", "seen")], 2), &operator()).unwrap();
    campaigns.begin("first", 1, &operator()).unwrap();
    for _ in 0..2 {
        let paused = campaigns.pause("first", &operator()).unwrap();
        assert!(paused.summary.paused.is_some());
    }
    // What runs goes on to its end, and is scored.
    campaigns.end("first", (1, 0), &outcome(TrialVerdict::Slip), &operator()).unwrap();
    campaigns.score("first", 1, &says(0, TrialVerdict::Slip), &operator()).unwrap();
    let again = Campaigns::new(dir.path(), Vec::new());
    let refused = again.begin("first", 2, &operator()).unwrap_err().to_string();
    assert!(refused.contains("is paused since"), "{refused}");
    again.resume("first", &operator()).unwrap();
    assert!(again.resume("first", &operator()).unwrap().summary.paused.is_none());
    again.begin("first", 2, &operator()).unwrap();
    let lines = fs::read_to_string(dir.path().join("first/log.jsonl")).unwrap().lines().count();
    assert_eq!(lines, 6, "each act is kept once");
    again.close("first", &operator()).unwrap();
    assert!(again.pause("first", &operator()).is_err());
}

#[test]
fn requests_that_come_twice_are_kept_once_and_others_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::new(dir.path(), Vec::new());
    campaigns.create("first", plan(&["a"], &[("cube", "seen")], 1), &operator()).unwrap();
    campaigns.begin("first", 1, &operator()).unwrap();
    for _ in 0..2 {
        campaigns.end("first", (1, 0), &outcome(TrialVerdict::Slip), &operator()).unwrap();
        campaigns.score("first", 1, &says(0, TrialVerdict::Slip), &operator()).unwrap();
    }
    assert_eq!(fs::read_to_string(dir.path().join("first/log.jsonl")).unwrap().lines().count(), 3);
    assert!(campaigns.end("first", (1, 0), &outcome(TrialVerdict::Success), &operator()).is_err());
    assert!(campaigns.score("first", 1, &says(0, TrialVerdict::Success), &operator()).is_err());
    assert!(campaigns.score("first", 1, &says(1, TrialVerdict::Slip), &operator()).is_err());
    // A score can be taken back and given anew.
    campaigns.unscore("first", (1, 0), &operator()).unwrap();
    let campaign = campaigns.score("first", 1, &says(0, TrialVerdict::Success), &operator()).unwrap();
    assert_eq!(campaign.trials[0].attempts[0].verdict, Some(TrialVerdict::Success));
}

#[test]
fn blind_scorer_learns_nothing_before_the_campaign_is_closed() {
    let dir = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::new(dir.path(), Vec::new());
    let mut blind = plan(&["secret-one", "secret-two"], &[("cube", "seen")], 1);
    blind.is_blind = true;
    blind.scorers = 2;
    campaigns.create("first", blind, &operator()).unwrap();
    campaigns.begin("first", 1, &operator()).unwrap();
    campaigns.end("first", (1, 0), &outcome(TrialVerdict::Slip), &operator()).unwrap();
    campaigns.score("first", 1, &says(0, TrialVerdict::EmptyGrasp), &scorer("Ada")).unwrap();

    let seen = campaigns.campaign("first", &scorer("Ben")).unwrap();
    let trial = &seen.trials[0];
    assert_eq!((seen.next_to_score, seen.plan.seed, trial.start.seed), (Some(1), 0, 0));
    assert_eq!((trial.policy.clone(), trial.attempts[0].outcome.clone()), (None, None));
    assert!(trial.attempts[0].scores.is_empty(), "another scorer's verdict is no business of Ben's");
    let text = serde_json::to_string(&seen).unwrap();
    assert!(!text.contains("secret") && !text.contains("lifted by"), "{text}");
    assert!(campaigns.results("first", &scorer("Ben")).is_err());
    assert!(campaigns.trials_csv("first", &scorer("Ben")).is_err());
    assert_eq!(campaigns.campaign("first", &scorer("Ada")).unwrap().next_to_score, None);

    campaigns.score("first", 1, &says(0, TrialVerdict::Slip), &scorer("Ben")).unwrap();
    assert!(campaigns.score("first", 1, &says(0, TrialVerdict::Slip), &scorer("Cyd")).is_err());
    assert_eq!(campaigns.results("first", &operator()).unwrap().agreement.unwrap().to_settle, vec![1]);
    campaigns.settle("first", 1, &says(0, TrialVerdict::Slip), &operator()).unwrap();
    campaigns.close("first", &operator()).unwrap();
    let closed = campaigns.campaign("first", &scorer("Ben")).unwrap();
    assert_eq!(closed.trials[0].attempts[0].verdict, Some(TrialVerdict::Slip));
    assert!(closed.trials[0].policy.as_deref().is_some_and(|policy| policy.starts_with("secret")));
    assert!(campaigns.reopen("first", &operator()).is_err(), "what everybody knows is not blind any more");
}

#[test]
fn plans_that_nobody_could_carry_out_are_refused_by_field() {
    let dir = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::new(dir.path(), Vec::new());
    let good = || plan(&["a", "b"], &[("cube", "seen")], 2);
    let refused = |change: fn(&mut palpate_wire::api::CampaignPlan), field: &str| {
        let mut bad = good();
        change(&mut bad);
        let err = campaigns.create("bad", bad, &operator()).unwrap_err().to_string();
        assert!(err.contains(field), "{err}");
    };
    refused(|plan| plan.policies.clear(), "policies");
    refused(|plan| plan.objects.clear(), "objects");
    refused(|plan| plan.policies[1].id = "a".to_owned(), "policies");
    refused(|plan| plan.policies[1].id = "../a".to_owned(), "policies");
    refused(|plan| plan.policies[0].source.clear(), "source");
    refused(|plan| plan.starts = 0, "starts");
    refused(|plan| plan.starts = u32::MAX, "starts");
    refused(|plan| plan.half_width_m = f64::NAN, "half_width_m");
    refused(|plan| plan.half_width_m = -0.1, "half_width_m");
    refused(|plan| plan.scorers = 3, "scorers");
    refused(|plan| plan.alpha = 1.0, "alpha");
    assert!(campaigns.list().unwrap().is_empty());
    campaigns.create("good", good(), &operator()).unwrap();
    assert!(matches!(campaigns.create("good", good(), &operator()), Err(TrialsError::Conflict(_))));
}
