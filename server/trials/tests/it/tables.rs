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
