use serde_json::Value;

use super::*;

fn campaign() -> Campaign {
    let start = json!({ "x_m": 0.01, "y_m": -0.02, "yaw_rad": 1.0, "side": 0.3, "seed": 7 });
    let trial = |number: u32, policy: &str| {
        json!({
            "number": number, "policy": policy, "object": "cube", "start_number": 1, "start": start, "state": "waiting",
            "attempts": [],
        })
    };
    let document = json!({
        "summary": {
            "id": "night", "name": "Night", "created": "2026-11-25T09:00:00.000Z", "planned": 2, "scored": 0, "to_score": 0,
            "closed": null, "error": null,
        },
        "plan": {
            "name": "Night", "starts": 1, "half_width_m": 0.02,
            "policies": [
                { "id": "expert", "source": "{object}.safetensors" },
                { "id": "close", "source": "script:cube", "is_silenced": true },
            ],
            "objects": [{ "id": "cube" }],
        },
        "trials": [trial(1, "expert"), trial(2, "close")],
        "next": 1, "next_to_score": null,
    });
    serde_json::from_value(document).expect("a campaign")
}

/// The trial of this number has an attempt that was scored so.
fn scored(campaign: &mut Campaign, number: usize, verdict: &str) {
    let attempt: Value = json!({
        "began": "", "by": "Olga", "outcome": null, "take": null, "has_ended": true, "scores": [], "settled": null,
        "verdict": verdict,
    });
    let trial = &mut campaign.trials[number - 1];
    trial.attempts.push(serde_json::from_value(attempt).expect("an attempt"));
    trial.state = TrialState::Scored;
}

#[test]
fn trials_go_on_until_none_is_left_or_somebody_pauses() {
    let mut campaign = campaign();
    assert_eq!(standing(&campaign, false), None);
    assert_eq!(next(&campaign, false).map(|trial| trial.number), Some(1));
    campaign.summary.paused = Some("2026-11-25T10:00:00.000Z".to_owned());
    assert_eq!(standing(&campaign, true), Some(Done::Paused));
    campaign.summary.closed = Some("2026-11-25T11:00:00.000Z".to_owned());
    assert_eq!(standing(&campaign, true), Some(Done::Closed));
}

#[test]
fn void_trials_are_repeated_only_where_that_is_asked_for_and_after_all_others() {
    let mut campaign = campaign();
    scored(&mut campaign, 1, "void");
    campaign.next = Some(2);
    assert_eq!(next(&campaign, true).map(|trial| trial.number), Some(2));
    scored(&mut campaign, 2, "success");
    campaign.next = None;
    assert_eq!(standing(&campaign, false), Some(Done::Complete));
    assert_eq!(next(&campaign, true).map(|trial| trial.number), Some(1));
    scored(&mut campaign, 1, "SL");
    assert_eq!(standing(&campaign, true), Some(Done::Complete));
}

#[test]
fn the_command_line_replaces_sources_of_policies_by_their_ids() {
    let plan = campaign().plan;
    let of = |given: &[&str]| {
        let given: Vec<String> = given.iter().map(|&text| text.to_owned()).collect();
        sources(&plan, &given)
    };
    assert_eq!(of(&[]).expect("sources"), ["{object}.safetensors", "script:cube"]);
    assert_eq!(of(&["close=a=b.toml"]).expect("sources"), ["{object}.safetensors", "a=b.toml"]);
    for (given, expected) in [
        (&["expert"][..], "it is ID=PATH, e.g. expert=..."),
        (&["exprt=x"], "no policy \"exprt\"; it has expert, close"),
        (&["close=x", "close=y"], "twice for \"close\""),
    ] {
        let refused = of(given).expect_err("it is wrong").to_string();
        assert!(refused.contains(expected), "{given:?}: {refused}");
    }
}

#[test]
fn reasons_are_cut_where_a_letter_ends() {
    let long = "\u{e4}".repeat(MAX_REASON_BYTES);
    assert_eq!(cut(&long).len(), MAX_REASON_BYTES);
    assert_eq!(cut(&format!("a{long}")).len(), MAX_REASON_BYTES - 1);
    assert_eq!(cut("short"), "short");
}

#[test]
fn the_start_that_the_campaign_says_is_what_the_operator_is_asked_for() {
    let campaign = campaign();
    let request = place_request(&campaign.trials[0]);
    assert_eq!(
        request,
        json!({
            "act": "place", "object": "cube", "offset_m": [0.01, -0.02], "yaw_rad": 1.0, "side": 0.3, "seed": 7,
        })
    );
}
