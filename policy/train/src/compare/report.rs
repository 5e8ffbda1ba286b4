//! What a comparison found, as text and as a document.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use palpate_grasp::Protocol;
use palpate_grasp::trial::{Ending, Outcome, Score};
use palpate_robot_model::ObjectGroup;
use palpate_statistics::mcnemar_exact;
use serde::Serialize;

use super::is_in;
use crate::files::Source;

/// Trials of one arm on one object, in the order of the starts.
pub(super) struct OfObject {
    pub(super) id: String,
    pub(super) group: Option<ObjectGroup>,
    pub(super) trials: Vec<Ending>,
}

/// Trials of one arm; of every arm on the same objects in the same order.
pub(super) struct Arm {
    pub(super) name: String,
    pub(super) objects: Vec<OfObject>,
}

/// Everything that was compared, the policy first.
pub(super) struct Comparison {
    pub(super) protocol_name: String,
    pub(super) protocol: Protocol,
    pub(super) policy: String,
    pub(super) arms: Vec<Arm>,
    pub(super) sources: Vec<Source>,
    pub(super) seconds: f64,
}

/// Trials counted.
#[derive(Serialize)]
struct Counts {
    #[serde(flatten)]
    score: Score,
    false_claims: usize,
    /// Mean time to success, s; nothing without one.
    mean_seconds: Option<f64>,
}

impl Counts {
    fn of<'a>(trials: impl Iterator<Item = &'a Ending>) -> Self {
        let trials: Vec<&Ending> = trials.collect();
        let outcomes: Vec<Outcome> = trials.iter().map(|ending| ending.outcome).collect();
        let won: Vec<f64> =
            trials.iter().filter(|ending| ending.is_won()).map(|ending| ending.time_s).collect();
        Self {
            score: Score::of(&outcomes),
            false_claims: trials.iter().filter(|ending| ending.is_false_claim()).count(),
            mean_seconds: (!won.is_empty()).then(|| won.iter().sum::<f64>() / won.len() as f64),
        }
    }

    fn text(&self) -> String {
        let Score { trials, successes, empty_grasp, slip, emergency_stop, interval_95: [low, high] } =
            self.score;
        let time = self.mean_seconds.map_or_else(|| "-".to_owned(), |mean_s| format!("{mean_s:.1}"));
        format!(
            "{successes:>4} of {trials:<4} {low:.2} to {high:.2}  EG {empty_grasp:<3} SL {slip:<3} ES {emergency_stop:<3} \
             false {:<3} {time:>5} s",
            self.false_claims
        )
    }
}

/// Pairs of trials on the same starts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Paired {
    only_policy: u64,
    only_control: u64,
    /// McNemar's exact test, two-sided.
    p_value: f64,
}

/// Which objects a line is about.
type Group = (&'static str, fn(Option<ObjectGroup>) -> bool);

const GROUPS: [Group; 3] = [
    ("seen", |group| is_in(group, ObjectGroup::Seen)),
    ("unseen", |group| is_in(group, ObjectGroup::Unseen)),
    ("overall", |_| true),
];

impl Arm {
    fn counts(&self, is_in: fn(Option<ObjectGroup>) -> bool) -> Option<Counts> {
        let objects: Vec<&OfObject> = self.objects.iter().filter(|object| is_in(object.group)).collect();
        (!objects.is_empty()).then(|| Counts::of(objects.into_iter().flat_map(|object| &object.trials)))
    }

    /// Against `control`.
    fn paired(&self, control: &Self, is_in: fn(Option<ObjectGroup>) -> bool) -> Paired {
        let (mut only_policy, mut only_control) = (0, 0);
        let pairs = self.objects.iter().zip(&control.objects).filter(|(object, _)| is_in(object.group));
        for (own, other) in pairs.flat_map(|(own, other)| own.trials.iter().zip(&other.trials)) {
            only_policy += u64::from(own.is_won() && !other.is_won());
            only_control += u64::from(!own.is_won() && other.is_won());
        }
        Paired { only_policy, only_control, p_value: mcnemar_exact(only_policy, only_control) }
    }

    fn document(&self, with_trials: bool) -> serde_json::Map<String, serde_json::Value> {
        let mut document = serde_json::Map::new();
        let objects: BTreeMap<&str, Counts> = self
            .objects
            .iter()
            .map(|object| (object.id.as_str(), Counts::of(object.trials.iter())))
            .collect();
        document.insert("objects".to_owned(), serde_json::json!(objects));
        for (name, is_in) in GROUPS {
            if let Some(counts) = self.counts(is_in) {
                document.insert(name.to_owned(), serde_json::json!(counts));
            }
        }
        let mean_s = self.counts(|_| true).and_then(|counts| counts.mean_seconds);
        document.insert("mean_seconds".to_owned(), serde_json::json!(mean_s));
        if with_trials {
            let trials: BTreeMap<&str, serde_json::Value> = self
                .objects
                .iter()
                .map(|object| (object.id.as_str(), serde_json::json!(object.trials)))
                .collect();
            document.insert("trials".to_owned(), serde_json::json!(trials));
        }
        document
    }
}

impl Comparison {
    /// As JSON, with every trial or without.
    pub(super) fn document(&self, with_trials: bool) -> serde_json::Value {
        let Some((policy, controls)) = self.arms.split_first() else { return serde_json::Value::Null };
        let mut document = serde_json::Map::new();
        document.insert("protocol".to_owned(), self.protocol_name.clone().into());
        document.insert("settings".to_owned(), serde_json::json!(self.protocol));
        document.insert("policy".to_owned(), self.policy.clone().into());
        document.extend(policy.document(with_trials));
        let controls: serde_json::Map<String, serde_json::Value> = controls
            .iter()
            .map(|control| {
                let mut of_control = control.document(with_trials);
                let paired: BTreeMap<&str, Paired> = GROUPS
                    .iter()
                    .filter(|(_, is_in)| control.counts(*is_in).is_some())
                    .map(|(name, is_in)| (*name, policy.paired(control, *is_in)))
                    .collect();
                of_control.insert("paired".to_owned(), serde_json::json!(paired));
                (control.name.clone(), of_control.into())
            })
            .collect();
        document.insert("controls".to_owned(), controls.into());
        document.insert("seconds".to_owned(), self.seconds.into());
        document.insert("sources".to_owned(), serde_json::json!(self.sources));
        document.into()
    }

    /// As lines for people.
    pub(super) fn text(&self) -> String {
        let Protocol { half_width_m, episode_s, one_claim, trials, seed } = self.protocol;
        let claim = if one_claim { ", one claim" } else { "" };
        let mut text = format!(
            "protocol {}: within {:.1} cm, {episode_s} s{claim}, {trials} starts an object, seed {seed}\n",
            self.protocol_name,
            100.0 * half_width_m
        );
        let Some(policy) = self.arms.first() else { return text };
        let mut line = |name: &str, rest: &str| {
            // A string takes every line.
            let _ = writeln!(text, "{name:<18} {rest}");
        };
        for object in &policy.objects {
            line(&object.id, &Counts::of(object.trials.iter()).text());
        }
        for arm in &self.arms {
            let shown = if arm.name == "policy" { &self.policy } else { &arm.name };
            line("", "");
            for (group, is_in) in GROUPS {
                let Some(counts) = arm.counts(is_in) else { continue };
                let paired = policy.paired(arm, is_in);
                let against = if arm.name == "policy" {
                    String::new()
                } else {
                    format!("  +{} -{} p {:.2e}", paired.only_policy, paired.only_control, paired.p_value)
                };
                line(&format!("{shown} {group}"), &format!("{}{against}", counts.text()));
            }
        }
        text
    }
}
