//! Campaigns from plan to table.
#![expect(clippy::unwrap_used, reason = "helpers of tests stop at what they do not expect, as tests do")]

mod campaigns;
mod laws;
mod tables;

use palpate_trials::{Campaigns, Viewer};
use palpate_wire::api::{
    CampaignObject, CampaignPlan, CampaignPolicy, RolloutOutcome, ScoreRequest, TrialOrder, TrialVerdict,
};

fn operator() -> Viewer {
    Viewer { name: "Olga".to_owned(), is_scorer: false }
}

fn scorer(name: &str) -> Viewer {
    Viewer { name: name.to_owned(), is_scorer: true }
}

fn plan(policies: &[&str], objects: &[(&str, &str)], starts: u32) -> CampaignPlan {
    CampaignPlan {
        name: "First trials".to_owned(),
        policies: policies
            .iter()
            .map(|id| CampaignPolicy {
                id: (*id).to_owned(),
                source: format!("script:{id}"),
                is_silenced: false,
            })
            .collect(),
        objects: objects
            .iter()
            .map(|(id, group)| CampaignObject { id: (*id).to_owned(), group: Some((*group).to_owned()) })
            .collect(),
        starts,
        half_width_m: 0.02,
        seed: 7,
        order: TrialOrder::Interleaved,
        is_blind: false,
        scorers: 1,
        alpha: 0.05,
        criterion: "3 cm above the table for 1 s".to_owned(),
    }
}

fn outcome(suggested: TrialVerdict) -> RolloutOutcome {
    RolloutOutcome {
        suggested: Some(suggested),
        reasons: vec!["lifted by 41 mm for 1.2 s".to_owned()],
        time_to_grasp_s: Some(3.5),
        held_s: Some(1.2),
        take: Some("trials/take-01".to_owned()),
        record: None,
    }
}

fn says(attempt: u32, verdict: TrialVerdict) -> ScoreRequest {
    ScoreRequest { scorer: String::new(), attempt, verdict, note: String::new() }
}

/// Makes trial `trial` and has it scored.
fn make(campaigns: &Campaigns, id: &str, trial: u32, verdict: TrialVerdict) {
    let campaign = campaigns.begin(id, trial, &operator()).unwrap();
    let attempt = campaign.trials[trial as usize - 1].attempts.len() as u32 - 1;
    campaigns.end(id, (trial, attempt), &outcome(verdict), &operator()).unwrap();
    campaigns.score(id, trial, &says(attempt, verdict), &operator()).unwrap();
}
