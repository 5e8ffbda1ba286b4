use palpate_grasp::trial::Outcome::{self, EmptyGrasp, Slip, Success};
use palpate_rollout::verdict::TrialVerdict;

use super::report::{Comparison, LeftOut, Model, OnHand, Pair, Touch};

/// Touch of three channels: the first is felt by both, by simulation two steps later; the second by the hand; the third by
/// nobody.
fn touch() -> Touch {
    let steps = |first: usize, second: bool| -> Vec<bool> {
        (0..10).flat_map(|step| [step >= first, second && step == 4, false]).collect()
    };
    // The hand's trial goes on for longer; what simulation has no part in is not compared.
    let mut hand = steps(3, true);
    hand.extend([true; 9]);
    Touch::of(20.0, 3, &hand, &steps(5, false))
}

fn comparison(trials: &[(TrialVerdict, Outcome)]) -> Comparison {
    let pair = |(_, outcome): &(TrialVerdict, Outcome)| Pair {
        outcome: *outcome,
        touch: touch(),
        replayed_outcome: Success,
        replayed_touch: touch(),
        joint_difference: vec![0.01, 0.03],
    };
    Comparison {
        rollout: "runs/rollout".to_owned(),
        object: "cube".to_owned(),
        policy: "p.safetensors".to_owned(),
        channels: ["thumb", "index", "palm"].map(str::to_owned).to_vec(),
        control_rate_hz: 20.0,
        num_recorded: trials.len() + 2,
        starts_as_planned: Vec::new(),
        left_out: LeftOut { unknown_start: vec![7], void: vec![9], ..LeftOut::default() },
        hand: (0..)
            .zip(trials)
            .map(|(trial, (verdict, _))| OnHand { trial, verdict: *verdict, is_suggested: trial == 0 })
            .collect(),
        models: vec![Model {
            name: "nominal".to_owned(),
            sources: Vec::new(),
            pairs: trials.iter().map(pair).collect(),
        }],
        seconds: 0.0,
    }
}

#[test]
fn pairs_and_channels_are_counted_by_hand() {
    let compared = comparison(&[
        (TrialVerdict::Success, Success),
        (TrialVerdict::EmptyGrasp, Success),
        (TrialVerdict::Slip, EmptyGrasp),
        (TrialVerdict::Slip, Slip),
        (TrialVerdict::Success, Slip),
    ]);
    let document = compared.document(true);
    let same_start = &document["models"][0]["same_start"];
    assert_eq!(
        ["same_verdict", "only_hand", "only_simulation"].map(|key| same_start[key].as_u64()),
        [Some(2), Some(1), Some(1)]
    );
    assert_eq!(same_start["verdicts"]["SL"], serde_json::json!({ "EG": 1, "SL": 1 }));
    assert_eq!(
        (&document["hand"]["suggested_by_robot"], &document["hand"]["seen_by_operator"]),
        (&1.into(), &4.into())
    );
    let channels = same_start["touch"]["channels"].as_array().expect("channels");
    let names: Vec<&str> = channels.iter().filter_map(|channel| channel["channel"].as_str()).collect();
    assert_eq!(names, ["thumb", "index"], "the largest mismatch first, and none that nobody felt");
    // Of each trial: 7 steps on the hand, 5 of them in simulation too.
    assert_eq!(channels[0]["f1"], serde_json::json!(10.0 / 12.0));
    assert_eq!(channels[0]["first_onset_later_ms"], serde_json::json!(100.0));
    assert_eq!((&channels[1]["trials_hand_only"], &channels[1]["trials_both"]), (&5.into(), &0.into()));
    assert_eq!(same_start["touch"]["gap"], serde_json::json!(3.0 / 30.0));

    let text = compared.text();
    for expected in [
        "5 of 7 trials compared",
        "left out, a person placed the object, so nobody knows where it began: trial 7",
        "left out, void: trial 9",
        "hand: won 2 of 5",
        "same start     won 2 of 5",
        "same verdict 2; only hand 1, only simulation 1, p 1.00",
        "0.030 rad apart at most",
    ] {
        assert!(text.contains(expected), "{expected:?} in {text}");
    }
}

#[test]
fn without_anything_to_compare_that_is_what_is_said() {
    let compared = comparison(&[]);
    assert!(compared.text().contains("0 of 2 trials compared"));
    assert!(!compared.text().contains("p 1"), "no figure comes of nothing");
    assert_eq!(compared.document(false)["compared"], 0);
}
