//! Results as people print them.

use palpate_trials::{Campaigns, Format, render};
use palpate_wire::api::{CampaignResults, PublishedResult, TrialVerdict};

use super::{make, operator, plan};

fn results() -> CampaignResults {
    let dir = tempfile::tempdir().unwrap();
    let published = PublishedResult {
        label: "Blind grasping".to_owned(),
        source: "a paper, table 1".to_owned(),
        objects: [("cube".to_owned(), [4, 5])].into(),
        seen: [16, 50],
        unseen: [11, 50],
    };
    let campaigns = Campaigns::new(dir.path(), vec![published]);
    let objects = [("cube", "seen"), ("c_shape", "unseen")];
    let made = campaigns.create("first", plan(&["dp_50%", "script"], &objects, 4), &operator()).unwrap();
    for trial in &made.trials {
        let is_policy = trial.policy.as_deref() == Some("dp_50%");
        let verdict = match (is_policy, trial.object.as_str(), trial.start_number) {
            (_, _, 4) => continue,
            (true, "cube", _) => TrialVerdict::Success,
            (true, _, 1) => TrialVerdict::Slip,
            (true, ..) => TrialVerdict::Success,
            (false, "cube", 1) => TrialVerdict::Void,
            (false, "cube", _) => TrialVerdict::EmptyGrasp,
            (false, ..) => TrialVerdict::EmergencyStop,
        };
        make(&campaigns, "first", trial.number, verdict);
    }
    campaigns.results("first", &operator()).unwrap()
}

#[test]
fn text_table() {
    insta::assert_snapshot!(render(&results(), Format::Text).unwrap());
}

#[test]
fn csv_table_has_a_row_for_each_policy_object_and_group() {
    insta::assert_snapshot!(render(&results(), Format::Csv).unwrap());
}

#[test]
fn csv_of_trials_has_every_attempt_and_every_trial_that_was_not_begun() {
    let dir = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::new(dir.path(), Vec::new());
    let made = campaigns.create("first", plan(&["a", "b"], &[("cube", "seen")], 1), &operator()).unwrap();
    make(&campaigns, "first", 1, TrialVerdict::Void);
    campaigns.begin("first", 1, &operator()).unwrap();
    let csv = campaigns.trials_csv("first", &operator()).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    let named = |row: usize, name: &str| {
        let column = rows[0].iter().position(|column| *column == name).unwrap_or_else(|| panic!("no {name}"));
        rows[row][column]
    };
    assert_eq!(rows.len(), 4, "{csv}");
    for (row, [trial, attempt, verdict]) in
        [["1", "0", "void"], ["1", "1", ""], ["2", "", ""]].iter().enumerate()
    {
        let found = [named(row + 1, "trial"), named(row + 1, "attempt"), named(row + 1, "verdict")];
        assert_eq!(found, [*trial, *attempt, *verdict], "{csv}");
        let policy = made.trials[trial.parse::<usize>().unwrap() - 1].policy.as_deref();
        assert_eq!(Some(named(row + 1, "policy")), policy);
    }
    assert!(named(1, "scores").ends_with(": void") && named(2, "scores").is_empty(), "{csv}");
}

#[test]
fn latex_table_escapes_names() {
    insta::assert_snapshot!(render(&results(), Format::Latex).unwrap());
}

#[test]
fn picture_shows_every_rate_and_escapes_names() {
    let mut results = results();
    results.policies[0].policy = "<b>&".to_owned();
    let svg = render(&results, Format::Svg).unwrap();
    assert_eq!(svg.matches("<circle").count(), 9, "{svg}");
    assert!(svg.contains("&lt;b&gt;&amp;") && !svg.contains("<b>"), "{svg}");
}

#[test]
fn json_keeps_its_field_names() {
    insta::assert_json_snapshot!(results());
}
